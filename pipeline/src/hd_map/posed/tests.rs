use std::fs;
use std::path::{Path, PathBuf};

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, Rig, RigCamera, UnitQuaternion, Vector3};
use lsfb_types::no_progress;
use nalgebra::Matrix3;

use super::*;
use crate::odometry::tests::room::{Room, render, world_from_rig};
use crate::posed_images::PosedImage;

/// One camera that looks forward.
fn rig() -> Rig {
    let forward =
        UnitQuaternion::from_matrix(&Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0));
    let camera = RigCamera {
        camera: Camera {
            width: 400,
            height: 250,
            lens: Lens::KannalaBrandt {
                focal_px: [220.0; 2],
                principal_px: [199.5, 124.5],
                distortion: [-0.02, 0.006, -0.003, 0.0004],
            },
        },
        rig_from_camera: Se3::new(forward, Default::default()),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    Rig {
        cameras: [("cam0".to_owned(), camera)].into(),
        ..Rig::empty("hand")
    }
}

/// A bitmap of greys: header, then rows from the last to the first, three bytes per pixel.
fn write_bitmap(path: &Path, image: &Image) {
    let (width, height) = (image.width, image.height);
    let mut bytes = b"BM".to_vec();
    let header = [
        54 + 3 * width * height,
        0,
        54,
        40,
        width,
        height,
        0x0018_0001,
    ];
    for value in header.into_iter().chain([0; 6]) {
        bytes.extend(value.to_le_bytes());
    }
    for row in image.pixels.chunks(width as usize).rev() {
        bytes.extend(row.iter().flat_map(|grey| [*grey; 3]));
    }
    fs::write(path, bytes).expect("image");
}

/// Images of a walk through a furnished room, their poses in units of `1 / scale` metres.
fn walk(folder: &Path, scale: f64) -> PosedImages {
    let (room, rig) = (Room::furnished(), rig());
    let images = (0..12).map(|i| {
        let t = 1.5 + 0.25 * f64::from(i);
        let path: PathBuf = folder.join(format!("{i}.bmp"));
        if !path.exists() {
            write_bitmap(&path, &render(&room, &rig.cameras["cam0"], t).sample);
        }
        let pose = world_from_rig(t);
        PosedImage {
            path,
            camera: "cam0".to_owned(),
            world_from_rig: Se3::new(pose.rotation, pose.translation * scale),
            instant: None,
        }
    });
    PosedImages {
        images: images.collect(),
        rig,
        notes: Vec::new(),
    }
}

/// With baselines in metres an image set the size of a street gave an empty map, and said nothing.
#[test]
fn a_map_does_not_depend_on_the_unit_of_its_poses() {
    let folder = tempfile::tempdir().expect("folder");
    let config = PosedMapConfig::default();
    let map = |scale: f64| {
        let posed = walk(folder.path(), scale);
        build_map_from_posed_images(&posed, &config, &no_progress).expect("a map")
    };
    let mean_distance = |map: &HdMap| {
        let sum: f64 = map.positions().map(|p| p.norm()).sum();
        sum / map.point_count() as f64
    };
    let metres = map(1.0);
    assert!(metres.point_count() > 300, "{}", metres.point_count());
    assert_eq!(metres.failures(), &[] as &[String]);
    for scale in [0.1, 20.0] {
        let scaled = map(scale);
        assert_eq!(scaled.keyframe_count(), metres.keyframe_count());
        let ratio = scaled.point_count() as f64 / metres.point_count() as f64;
        assert!((ratio - 1.0).abs() < 0.01, "{ratio} at {scale}");
        let ratio = mean_distance(&scaled) / (scale * mean_distance(&metres));
        assert!((ratio - 1.0).abs() < 0.01, "{ratio} at {scale}");
    }
}

/// Two images that have each other's pose were a hundredth of an office, and nobody heard of it.
#[test]
fn two_images_with_each_others_pose_are_named() {
    let folder = tempfile::tempdir().expect("folder");
    let mut posed = walk(folder.path(), 1.0);
    let (second, ninth) = (
        posed.images[1].world_from_rig,
        posed.images[8].world_from_rig,
    );
    posed.images[1].world_from_rig = ninth;
    posed.images[8].world_from_rig = second;
    let map = build_map_from_posed_images(&posed, &PosedMapConfig::default(), &no_progress);
    let map = map.expect("a map");
    let named = |part: &str| map.failures().iter().any(|f| f.contains(part));
    assert!(named("1.bmp") && named("8.bmp"), "{:?}", map.failures());
}

/// An office whose images lay under each other's poses gave a map without a word, and images were localized in it metres off.
#[test]
fn images_under_the_poses_of_their_neighbours_are_no_sound_map() {
    let folder = tempfile::tempdir().expect("folder");
    let good = walk(folder.path(), 1.0);
    let mut late = good.clone();
    for (image, other) in late.images.iter_mut().zip(good.images.iter().skip(3)) {
        image.world_from_rig = other.world_from_rig;
    }
    late.images.truncate(9);
    let config = PosedMapConfig::default();
    match build_map_from_posed_images(&late, &config, &no_progress) {
        Err(Error::Refused(Refusal::TooFewPoints { reason, .. })) => {
            assert!(
                matches!(reason, MapShortage::Disagreement { .. }),
                "{reason:?}"
            );
        }
        Err(other) => panic!("{other}"),
        Ok(map) => {
            let failures = map.failures().join(" ");
            assert!(
                failures.contains("do not belong to these images"),
                "{failures}"
            );
        }
    }
}

/// A focal length that was off by a hundredth bent the map, and everything that was localized in it, without a word.
#[test]
fn a_list_with_another_focal_length_gives_a_map_with_the_right_one() {
    let folder = tempfile::tempdir().expect("folder");
    let config = PosedMapConfig::default();
    let map = |posed: &PosedImages| {
        build_map_from_posed_images(posed, &config, &no_progress).expect("a map")
    };
    let right = walk(folder.path(), 1.0);
    assert!(map(&right).stated_cameras().is_empty());

    let (mut long, factor) = (right.clone(), 1.02);
    let lens = |camera: &Camera| camera.lens.parameters().values;
    for mounted in long.rig.cameras.values_mut() {
        let mut values = lens(&mounted.camera);
        values[..2].iter_mut().for_each(|focal| *focal *= factor);
        mounted.camera.lens = mounted.camera.lens.model().lens(&values);
    }
    let (stated, true_camera) = (&long.rig.cameras["cam0"], &right.rig.cameras["cam0"]);
    let written = folder.path().join("map");
    map(&long).write(&written).expect("written");
    let read = HdMap::open(&written).expect("opened");
    assert!(read.stated_cameras().contains_key("cam0"));
    // Whatever a query calls its camera, where it is stated as that of the map was.
    let found = read.as_found("phone", stated);
    let focal = |camera: &RigCamera| camera.camera.focal_px()[0];
    let off = focal(&found) / focal(true_camera) - 1.0;
    assert!(off.abs() < 0.003, "{off}");
    let moved = found.rig_from_camera.inverse() * true_camera.rig_from_camera;
    assert!(moved.translation.norm() < 0.02, "{moved:?}");
    assert!(moved.rotation.angle().to_degrees() < 0.2, "{moved:?}");
    // Another camera is what is stated of it.
    assert_eq!(read.as_found("cam0", true_camera), *true_camera);
}

fn whole(posed: &PosedImages, config: &PosedMapConfig) -> PosedMap {
    let stages = KeptStages::none();
    build_map_from_posed_images_in_stages(posed, config, &stages, &no_progress).expect("a map")
}

/// Observations that the map leaves out stay in what is said of it.
#[test]
fn a_report_has_every_observation_of_every_camera() {
    let folder = tempfile::tempdir().expect("folder");
    let PosedMap { map, report } = whole(&walk(folder.path(), 1.0), &PosedMapConfig::default());
    assert_eq!(report.points, map.point_count() as u64);
    assert_eq!(report.observations, map.observation_count() as u64);
    let all = report.reprojection_errors_px.len() as u64;
    assert_eq!(all, report.observations + report.dropped_observations);
    assert!(report.dropped_observations > 0, "{report:?}");
    let [camera] = &report.by_camera[..] else {
        panic!("{:?}", report.by_camera)
    };
    assert_eq!((camera.before.count, camera.after.count), (0, all));
    assert!(report.as_listed.is_none());
    assert!(
        report.reprojection_median_px < report.reprojection_rms_px,
        "{report:?}"
    );
    assert!(report.reprojection_median_px < 0.5, "{report:?}");
}

#[test]
fn a_map_that_was_stopped_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().expect("folder");
    let posed = walk(folder.path(), 1.0);
    let config = PosedMapConfig::default();
    let kept = folder.path().join("map.unfinished");
    let stages = KeptStages::in_folder(&kept, "these images").expect("folder");
    let until = |last: &str, stages: &KeptStages| {
        build_map_from_posed_images_in_stages(&posed, &config, stages, &|p| match p.stage == last {
            true => Err(lsfb_types::Stopped),
            false => Ok(()),
        })
    };
    assert!(matches!(
        until("image matching", &stages),
        Err(Error::Stopped(_))
    ));
    // Features are there already.
    let resumed = until("image features", &stages).expect("a map");
    let at_once = whole(&posed, &config);
    assert_eq!(resumed.report, at_once.report);
    let bytes = |map: &HdMap, name: &str| {
        let out = folder.path().join(name);
        map.write(&out).expect("written");
        fs::read(out.join(HdMap::HEADER)).expect("hashes of all files")
    };
    assert_eq!(
        bytes(&resumed.map, "resumed"),
        bytes(&at_once.map, "at-once")
    );
}

/// How far places are apart after the best rigid motion, root mean square and at most, metres.
fn apart_m(found: &[Vector3<f64>], truth: &[Vector3<f64>]) -> [f64; 2] {
    let aligned = umeyama(found, truth, Scale::Fixed).expect("places");
    let off = found.iter().zip(truth);
    let off: Vec<f64> = off.map(|(f, t)| (aligned.apply(f) - t).norm()).collect();
    let squares: f64 = off.iter().map(|m| m * m).sum();
    [
        (squares / off.len() as f64).sqrt(),
        off.iter().copied().fold(0.0, f64::max),
    ]
}

#[test]
fn poses_that_are_a_little_off_become_as_the_images_show_them() {
    let folder = tempfile::tempdir().expect("folder");
    let right = walk(folder.path(), 1.0);
    let mut off = right.clone();
    for (i, image) in (0..).zip(&mut off.images) {
        // Up to half a degree and two centimetres, another way each.
        let error = |axis: i32| (2.3 * f64::from(i) + 1.7 * f64::from(axis)).sin();
        let [a, b, c] = [0, 1, 2].map(|axis| 0.008 * error(axis));
        let [x, y, z] = [3, 4, 5].map(|axis| 0.02 * error(axis));
        image.world_from_rig = image.world_from_rig * Se3::exp(&[a, b, c, x, y, z].into());
    }
    let config = |enabled: bool| PosedMapConfig {
        keyframe_distance_per_depth: 0.0,
        keyframe_angle_deg: 0.0,
        refine_cameras: false,
        refine_poses: PoseRefinement {
            enabled,
            ..PoseRefinement::default()
        },
        ..PosedMapConfig::default()
    };
    let places = |posed: &PosedImages| -> Vec<Vector3<f64>> {
        let images = posed.images.iter();
        images.map(|i| i.world_from_rig.translation).collect()
    };
    let truth = places(&right);
    let [before_m, _] = apart_m(&places(&off), &truth);
    let built = whole(&off, &config(true));
    let (map, report) = (built.map, built.report);
    let found = map.keyframes().map(|k| k.world_from_rig.translation);
    let found: Vec<Vector3<f64>> = found.collect();
    let [after_m, _] = apart_m(&found, &truth);
    assert!(
        before_m > 0.015 && after_m < 0.006,
        "{before_m} → {after_m} m"
    );
    assert!(map.failures().is_empty(), "{:?}", map.failures());
    // Of the same tracks, with the poses of the list and with those that were found.
    let listed = report.as_listed.expect("poses were refined");
    assert!(
        report.reprojection_median_px < 0.5 * listed.reprojection_median_px,
        "{report:?}"
    );
    let camera = &report.by_camera[0];
    assert!(camera.after.rms_px < camera.before.rms_px, "{report:?}");
    // As listed, few matches lie where they should.
    let listed = build_map_from_posed_images(&off, &config(false), &no_progress);
    let points = listed.map_or(0, |map| map.point_count());
    assert!(points < map.point_count(), "{points}");
}

/// A camera that looks back, where nobody walks: its images make no point, and their poses are theirs.
#[test]
fn images_without_a_baseline_are_no_strangers() {
    let folder = tempfile::tempdir().expect("folder");
    let mut posed = walk(folder.path(), 1.0);
    let mut back = posed.rig.cameras["cam0"].clone();
    let about = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    back.rig_from_camera.rotation = about * back.rig_from_camera.rotation;
    posed.rig.cameras.insert("back".to_owned(), back.clone());
    for i in 0..4 {
        let t = 1.5 + 0.004 * f64::from(i);
        let path = folder.path().join(format!("back{i}.bmp"));
        write_bitmap(&path, &render(&Room::furnished(), &back, t).sample);
        posed.images.push(PosedImage {
            path,
            camera: "back".to_owned(),
            world_from_rig: world_from_rig(t),
            instant: None,
        });
    }
    let config = PosedMapConfig {
        keyframe_distance_per_depth: 0.0,
        keyframe_angle_deg: 0.0,
        refine_cameras: false,
        ..PosedMapConfig::default()
    };
    let map = build_map_from_posed_images(&posed, &config, &no_progress).expect("a map");
    assert_eq!(map.failures(), &[] as &[String]);
    // One that is said to move, and shows the same all the while, is one.
    let mut frozen = posed.clone();
    let first = frozen.images[12].clone();
    for (i, image) in frozen.images.iter_mut().skip(12).enumerate() {
        image.path = first.path.clone();
        image.world_from_rig = first.world_from_rig;
        image.world_from_rig.translation += Vector3::new(0.2, 0.2, 0.0) * i as f64;
    }
    let map = build_map_from_posed_images(&frozen, &config, &no_progress).expect("a map");
    let said = map.failures().join(" ");
    assert!(said.contains("4 of 16 images"), "{said}");
    // Under poses that are turned, another way each, they are.
    for (i, image) in posed.images.iter_mut().skip(12).enumerate() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.2 * i as f64 - 0.3);
        image.world_from_rig.rotation = turn * image.world_from_rig.rotation;
    }
    let map = build_map_from_posed_images(&posed, &config, &no_progress).expect("a map");
    let said = map.failures().join(" ");
    assert!(said.contains("4 of 16 images"), "{said}");
}

/// Two cameras of a rig at each instant are one keyframe, and its pose is refined once.
#[test]
fn images_of_one_instant_are_one_keyframe() {
    let folder = tempfile::tempdir().expect("folder");
    let mut posed = walk(folder.path(), 1.0);
    let mut right = posed.rig.cameras["cam0"].clone();
    right.rig_from_camera.translation += Vector3::new(0.0, -0.12, 0.0);
    posed.rig.cameras.insert("cam1".to_owned(), right.clone());
    let left = std::mem::take(&mut posed.images);
    for (i, image) in left.into_iter().enumerate() {
        let path = folder.path().join(format!("right{i}.bmp"));
        let t = 1.5 + 0.25 * i as f64;
        write_bitmap(&path, &render(&Room::furnished(), &right, t).sample);
        let right = PosedImage {
            path,
            camera: "cam1".to_owned(),
            instant: Some(i),
            ..image.clone()
        };
        posed.images.extend([
            PosedImage {
                instant: Some(i),
                ..image
            },
            right,
        ]);
    }
    let config = PosedMapConfig {
        keyframe_distance_per_depth: 0.0,
        keyframe_angle_deg: 0.0,
        refine_cameras: false,
        refine_poses: PoseRefinement {
            enabled: true,
            ..PoseRefinement::default()
        },
        ..PosedMapConfig::default()
    };
    let map = build_map_from_posed_images(&posed, &config, &no_progress).expect("a map");
    assert_eq!(map.keyframe_count(), 12);
    assert_eq!(map.cameras(), ["cam0", "cam1"]);
    assert_eq!(map.failures(), &[] as &[String]);
}

#[test]
fn images_that_make_no_map_are_an_error_that_says_why() {
    let folder = tempfile::tempdir().expect("folder");
    let config = PosedMapConfig::default();
    let reason =
        |posed: &PosedImages| match build_map_from_posed_images(posed, &config, &no_progress)
            .expect_err("no map")
        {
            Error::Refused(Refusal::TooFewPoints { reason, .. }) => reason,
            other => panic!("{other}"),
        };
    let good = walk(folder.path(), 1.0);

    // Turned on the spot.
    let mut turned = good.clone();
    for image in &mut turned.images {
        image.world_from_rig.translation = Default::default();
    }
    assert_eq!(reason(&turned), MapShortage::NoBaseline { images: 12 });

    // Poses of other images.
    let mut shuffled = good.clone();
    let poses: Vec<Se3> = good.images.iter().map(|i| i.world_from_rig).collect();
    for (i, image) in shuffled.images.iter_mut().enumerate() {
        image.world_from_rig = poses[(7 * i + 3) % 12].inverse();
    }
    assert!(
        matches!(reason(&shuffled), MapShortage::Disagreement { .. }),
        "{:?}",
        reason(&shuffled)
    );

    // Black images.
    for image in &good.images {
        let black = Image {
            width: 400,
            height: 250,
            pixels: vec![0; 100_000],
            ..Image::default()
        };
        write_bitmap(&image.path, &black);
    }
    assert!(matches!(
        reason(&good),
        MapShortage::FewFeatures { features: 0, .. }
    ));
}
