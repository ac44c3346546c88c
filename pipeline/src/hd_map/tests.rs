use std::fs;
use std::path::Path;

use lsfb_geometry::{Camera, CameraTiming, Matrix6, Rig, RigCamera, Se3, StampedPose, Vector3};
use lsfb_types::{Timestamp, no_progress};

use super::*;
use crate::descriptor_index::IndexConfig;
use crate::features::{Feature, Features, Keypoint};
use crate::{Error, Refusal};

/// Two pinhole cameras that look along z.
fn rig() -> Rig {
    let mut rig = Rig::empty("two");
    rig.cameras = ["cam0", "cam1"]
        .map(|name| {
            let camera = RigCamera {
                camera: Camera::pinhole(640, 480, [400.0, 400.0], [319.5, 239.5]),
                rig_from_camera: Se3::identity(),
                timing: CameraTiming::default(),
                sigmas: Default::default(),
            };
            (name.to_owned(), camera)
        })
        .into();
    rig
}

/// Two keyframes, two cameras, forty points; point `i` is keypoint `i` of all four images.
pub(super) fn small_map() -> HdMap {
    let keyframes = [0, 1].map(|i| StampedPose {
        time: Timestamp::from_nanos(1_000 * i),
        world_from_rig: Se3::exp(&[0.0, 0.0, 0.1 * i as f64, i as f64, 0.5, 0.0].into()),
    });
    let features = |shift: u8| Features {
        keypoints: (0..40)
            .map(|i| Keypoint {
                pixel: [10.0 * i as f32, f32::from(shift)],
                scale_px: 2.0,
                angle_rad: 0.0,
                response: 0.1,
            })
            .collect(),
        descriptors: (0..40u8)
            .map(|i| std::array::from_fn(|d| ((d as u8 ^ i.wrapping_mul(37)) & 0x7f) + shift))
            .collect(),
    };
    let images: Vec<KeyframeImage> = (0..4)
        .map(|i| KeyframeImage {
            keyframe: i / 2,
            camera: format!("cam{}", i % 2),
            features: features(3 * i as u8),
        })
        .collect();
    let points: Vec<MapPoint> = (0..40)
        .map(|i| MapPoint {
            point_in_world: Vector3::new(f64::from(i), 2.0, 3.0),
            observations: (0..4)
                .map(|image| PointObservation {
                    image,
                    keypoint: i as u32,
                })
                .collect(),
            reprojection_rms_px: 0.5,
        })
        .collect();
    let content = MapContent {
        rig: &rig(),
        keyframes: &keyframes,
        images: &images,
        points: &points,
        feature: &Feature::Sift,
        provenance: "made up",
    };
    HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("consistent content")
}

fn bytes_of(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| {
            let path = entry.expect("an entry").path();
            let name = path
                .file_name()
                .expect("a name")
                .to_string_lossy()
                .into_owned();
            (name, fs::read(path).expect("readable"))
        })
        .collect();
    files.sort();
    files
}

#[test]
fn what_is_written_is_opened_and_written_again_byte_for_byte() {
    let [first, second] = [(), ()].map(|()| tempfile::tempdir().expect("scratch folder"));
    let site = SiteFrame {
        origin_m: [500_000.0, 5_400_000.0, 0.0],
        control_points: vec!["door".to_owned()],
    };
    let map = small_map().with_site(Some(site.clone()));
    map.write(first.path()).expect("written");
    let opened = HdMap::open(first.path()).expect("opened");
    assert!(opened.failures().is_empty());
    assert_eq!(opened.site(), Some(&site));
    assert_eq!(opened.point_count(), 40);
    assert_eq!(opened.observation_count(), 160);
    assert_eq!(opened.descriptor_count(), 160);
    assert_eq!(opened.cameras(), ["cam0", "cam1"]);
    assert_eq!(opened.provenance(), "made up");
    assert_eq!(opened.position(7), Some(Vector3::new(7.0, 2.0, 3.0)));
    assert_eq!(opened.position(40), None);
    assert_eq!(opened.keyframe(1), map.keyframe(1));
    assert_eq!(opened.descriptors(5), map.descriptors(5));
    assert!(opened.descriptors(40).is_empty());
    let seen: Vec<MapObservation> = opened.observations(39).collect();
    assert_eq!(seen.len(), 4);
    let last = MapObservation {
        point: 39,
        keyframe: 1,
        camera: 1,
        pixel: [390.0, 9.0],
    };
    assert_eq!(seen[3], last);
    let query = opened.descriptors(12)[0];
    let nearest = opened.nearest(&query, 25, 8, 50, &mut SearchScratch::default());
    assert_eq!((nearest[0].point, nearest[0].distance_squared), (12, 0));

    opened.write(second.path()).expect("written again");
    small_map()
        .with_site(Some(site))
        .write(first.path())
        .expect("written over the open map");
    assert_eq!(bytes_of(first.path()), bytes_of(second.path()));
    assert_eq!(opened.position(7), Some(Vector3::new(7.0, 2.0, 3.0)));
}

/// A covariance that differs in every entry.
fn covariance() -> Matrix6<f64> {
    let root = Matrix6::from_fn(|i, j| 0.1 + (i * 6 + j) as f64 + if i == j { 40.0 } else { 0.0 });
    root * root.transpose() * 1e-6
}

#[test]
fn how_well_keyframes_are_known_is_kept() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let map = small_map().with_keyframe_covariances(vec![None, Some(covariance())]);
    map.write(folder.path()).expect("written");
    let opened = HdMap::open(folder.path()).expect("opened");
    assert_eq!(opened.keyframe_covariance(0), None);
    let kept = opened.keyframe_covariance(1).expect("known");
    assert_eq!(kept.upper_triangle(), covariance().upper_triangle());
    assert_eq!(kept, kept.transpose());
    assert_eq!(opened.keyframe_covariance(2), None);
    let all = opened.region().expect("points");
    let part = opened.crop(&all, &IndexConfig::default(), &no_progress);
    let part = part.expect("cropped");
    assert_eq!(part.keyframe_covariance(1), Some(kept));
}

#[test]
fn maps_of_the_version_before_are_read() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let known = small_map().with_keyframe_covariances(vec![Some(covariance()); 2]);
    known.write(folder.path()).expect("written");
    let header = folder.path().join("map.toml");
    let text = fs::read_to_string(&header).expect("readable");
    let without_crc = text.lines().filter(|line| !line.starts_with("crc32c"));
    let without_crc: String = without_crc.flat_map(|line| [line, "\n"]).collect();
    assert_ne!(without_crc, text);
    let version = |number: u32| {
        let stated = format!("format_version = {number}");
        without_crc.replace("format_version = 4", &stated)
    };
    fs::write(&header, version(3)).expect("write");
    let opened = HdMap::open(folder.path()).expect("opened");
    assert_eq!(opened.keyframe_covariance(1), known.keyframe_covariance(1));
    fs::write(&header, version(2)).expect("write");
    let opened = HdMap::open(folder.path()).expect("opened");
    assert_eq!(opened.keyframe(1), known.keyframe(1));
    assert_eq!(opened.keyframe_covariance(1), None);
    // Without checksums damage is told by the hashes.
    for (name, mut bytes) in bytes_of(folder.path()) {
        if name == "map.toml" {
            continue;
        }
        let (path, middle) = (folder.path().join(&name), bytes.len() / 2);
        bytes[middle] ^= 0x20;
        fs::write(&path, &bytes).expect("flipped");
        let error = HdMap::open(folder.path()).expect_err("damaged").to_string();
        assert!(
            error.contains(&name) && error.contains("SHA-256"),
            "{error}"
        );
        bytes[middle] ^= 0x20;
        fs::write(&path, &bytes).expect("restored");
    }
}

/// A wall of points before a walk of ten keyframes: each point is seen by those within two metres of it.
fn wall() -> HdMap {
    let keyframes: Vec<StampedPose> = (0..10)
        .map(|i| StampedPose {
            time: Timestamp::from_nanos(1_000 * i),
            world_from_rig: Se3::new(Default::default(), Vector3::x() * i as f64),
        })
        .collect();
    let mut points = Vec::new();
    let mut features = vec![Features::default(); 10];
    for i in 0..3_000 {
        // A grid of golden angles: even, and no two alike.
        let across = 11.0 * (f64::from(i) * 0.618_034).fract() - 1.0;
        let position = Vector3::new(across, -1.5 + f64::from(i) * 1e-3, 4.0);
        let mut observations = Vec::new();
        for (image, keyframe) in keyframes.iter().enumerate() {
            let seen = position - keyframe.world_from_rig.translation;
            if seen.x.abs() > 2.0 {
                continue;
            }
            let pixel = [319.5 + 400.0 * seen.x / 4.0, 239.5 + 400.0 * seen.y / 4.0];
            observations.push(PointObservation {
                image,
                keypoint: features[image].keypoints.len() as u32,
            });
            features[image].keypoints.push(Keypoint {
                pixel: pixel.map(|v| v as f32),
                scale_px: 2.0,
                angle_rad: 0.0,
                response: 0.1,
            });
            let look = |d: usize| ((i as usize * 7 + d * 13) % 101) as u8 + image as u8;
            features[image].descriptors.push(std::array::from_fn(look));
        }
        points.push(MapPoint {
            point_in_world: position,
            observations,
            reprojection_rms_px: 0.5,
        });
    }
    let images: Vec<KeyframeImage> = features
        .into_iter()
        .enumerate()
        .map(|(keyframe, features)| KeyframeImage {
            keyframe,
            camera: "cam0".to_owned(),
            features,
        })
        .collect();
    let content = MapContent {
        rig: &rig(),
        keyframes: &keyframes,
        images: &images,
        points: &points,
        feature: &Feature::Sift,
        provenance: "a wall",
    };
    HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("consistent content")
}

fn bytes_on_disk(map: &HdMap) -> usize {
    let folder = tempfile::tempdir().expect("scratch folder");
    map.write(folder.path()).expect("written");
    bytes_of(folder.path()).iter().map(|(_, b)| b.len()).sum()
}

#[test]
fn a_pruned_map_fits_and_covers_its_views() {
    let (map, config) = (wall(), PruneConfig::default());
    let prune = |bytes: usize| map.prune(bytes, &config, &no_progress);
    let whole = bytes_on_disk(&map);
    let (same, report) = prune(2 * whole).expect("room enough");
    assert_eq!(same.point_count(), map.point_count());
    assert_eq!(same.descriptor_count(), map.descriptor_count());
    assert_eq!(report.points, [3_000; 2]);
    for share in [0.9, 0.6, 0.3] {
        let budget = (share * whole as f64) as usize;
        let (small, report) = prune(budget).expect("room enough");
        let bytes = bytes_on_disk(&small);
        assert!(
            bytes <= budget && bytes > budget * 3 / 4,
            "{bytes} of {budget}"
        );
        assert_eq!(small.keyframe_count(), 10);
        // The views lose alike: none much more than that in the middle.
        let [before, after] = report.median_points_per_view;
        let kept = after as f64 / before as f64;
        let [fewest_before, fewest] = report.fewest_points_per_view;
        assert!(
            fewest as f64 > 0.6 * kept * fewest_before as f64,
            "{report:?}"
        );
        // What is left is what was there, and found by what it looks like.
        let query = small.descriptors(17)[0];
        let nearest = small.nearest(&query, 5, 8, 50, &mut SearchScratch::default());
        assert_eq!((nearest[0].point, nearest[0].distance_squared), (17, 0));
        let position = small.position(17).expect("a point");
        assert!(map.positions().any(|p| p == position));
    }
}

#[test]
fn a_size_that_empties_views_is_refused_with_one_that_does_not() {
    let (map, config) = (wall(), PruneConfig::default());
    let prune = |bytes: usize| map.prune(bytes, &config, &no_progress);
    for bytes in [1, 100_000, 200_000] {
        let refused = prune(bytes).expect_err("too small");
        let Error::Refused(Refusal::MapBudget {
            points,
            needed,
            smallest_mb,
            ..
        }) = refused
        else {
            panic!("{refused}")
        };
        assert!(points < needed && needed == 30, "{points} of {needed}");
        let (small, report) = prune((smallest_mb * 1e6) as usize).expect("as it was said");
        assert!(report.fewest_points_per_view[1] >= 30, "{report:?}");
        assert!(bytes_on_disk(&small) as f64 <= smallest_mb * 1e6);
    }
}

#[test]
fn damage_is_named() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let message = || {
        HdMap::open(folder.path())
            .expect_err("unusable")
            .to_string()
    };
    assert!(message().contains("no map here"), "{}", message());
    small_map().write(folder.path()).expect("written");
    for (name, bytes) in bytes_of(folder.path()) {
        let path = folder.path().join(&name);
        fs::remove_file(&path).expect("removed");
        let missing = if name == "map.toml" {
            "no map here"
        } else {
            name.as_str()
        };
        assert!(message().contains(missing), "{}", message());
        fs::write(&path, &bytes[..bytes.len() / 2]).expect("truncated");
        assert!(message().contains(&name), "{}", message());
        fs::write(&path, b"").expect("emptied");
        assert!(message().contains(&name), "{}", message());
        let mut flipped = bytes.clone();
        flipped[bytes.len() / 2] ^= 0x20;
        fs::write(&path, &flipped).expect("flipped");
        if name != "map.toml" {
            assert!(
                message().contains(&name) && message().contains("damaged"),
                "{}",
                message()
            );
        }
        fs::write(&path, &bytes).expect("restored");
    }
    assert!(HdMap::open(folder.path()).is_ok());

    let header = folder.path().join("map.toml");
    let text = fs::read_to_string(&header).expect("readable");
    fs::write(
        &header,
        text.replace("format_version = 4", "format_version = 7"),
    )
    .expect("write");
    let error = HdMap::open(folder.path()).expect_err("another version");
    assert!(
        matches!(error, Error::MapVersion { found: 7, .. }),
        "{error}"
    );
    fs::write(&header, text.replace("points = 40", "points = 41")).expect("write");
    assert!(message().contains("counts"), "{}", message());
}

#[test]
fn content_must_fit_together() {
    let content = MapContent {
        rig: &rig(),
        keyframes: &[],
        images: &[],
        points: &[],
        feature: &Feature::Sift,
        provenance: "",
    };
    let folder = tempfile::tempdir().expect("scratch folder");
    let empty = HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("empty");
    empty.write(folder.path()).expect("written");
    assert_eq!(HdMap::open(folder.path()).expect("opened").point_count(), 0);
    let lost = [MapPoint {
        point_in_world: Vector3::zeros(),
        observations: vec![PointObservation {
            image: 3,
            keypoint: 0,
        }],
        reprojection_rms_px: 0.0,
    }];
    let content = MapContent {
        points: &lost,
        ..content
    };
    let error = HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect_err("lost");
    assert!(error.to_string().contains("its image is missing"));
}

/// A table whose hash is right may still say anything about itself.
#[test]
fn tables_that_lie_about_themselves_are_refused() {
    let folder = tempfile::tempdir().expect("scratch folder");
    small_map().write(folder.path()).expect("written");
    let path = folder.path().join("keyframes.arrow");
    let bytes = fs::read(&path).expect("readable");
    let mut refused = 0;
    for at in 0..bytes.len() {
        for flip in [0x01, 0x80, 0xff] {
            let mut lie = bytes.clone();
            lie[at] ^= flip;
            let lie = Buffer::from(lie);
            let names = ["time_ns", "qx", "qy", "qz", "qw", "tx_m", "ty_m", "tz_m"];
            match crate::arrow_file::read_table(&path, &lie, &names) {
                Ok(columns) => assert_eq!(columns.len(), names.len()),
                Err(error) => {
                    assert!(error.to_string().contains("keyframes.arrow"), "{error}");
                    refused += 1;
                }
            }
        }
    }
    assert!(refused > bytes.len() / 10, "{refused} of {}", bytes.len());
}

/// Two cameras 0.4 m apart see points 4 m ahead, half a pixel beside where they are.
#[test]
fn points_are_known_as_well_as_their_rays_cross() {
    let (baseline_m, depth_m, focal_px, error_px) = (0.4, 4.0, 400.0, 0.5);
    let keyframes = [-0.5, 0.5].map(|side| StampedPose {
        time: Timestamp::from_nanos(if side < 0.0 { 0 } else { 1 }),
        world_from_rig: Se3::new(Se3::identity().rotation, Vector3::x() * (side * baseline_m)),
    });
    let position = Vector3::new(0.0, 0.0, depth_m);
    let images = [0, 1].map(|keyframe| {
        let in_camera = position - keyframes[keyframe].world_from_rig.translation;
        KeyframeImage {
            keyframe,
            camera: "cam0".to_owned(),
            features: Features {
                keypoints: vec![Keypoint {
                    pixel: [
                        (focal_px * in_camera.x / depth_m + 319.5) as f32,
                        (239.5 + error_px) as f32,
                    ],
                    scale_px: 2.0,
                    angle_rad: 0.0,
                    response: 0.1,
                }],
                descriptors: vec![[1; 128]],
            },
        }
    });
    let seen = |images: &[usize]| MapPoint {
        point_in_world: position,
        observations: images
            .iter()
            .map(|image| PointObservation {
                image: *image,
                keypoint: 0,
            })
            .collect(),
        reprojection_rms_px: error_px,
    };
    let content = MapContent {
        rig: &rig(),
        keyframes: &keyframes,
        images: &images,
        points: &[seen(&[0, 1]), seen(&[0])],
        feature: &Feature::Sift,
        provenance: "",
    };
    let map = HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("built");
    let found = map.quality(0).expect("a point");
    let sigma_px = error_px / 1.1774;
    let along_m = sigma_px * depth_m.powi(2) * 2.0_f64.sqrt() / (focal_px * baseline_m);
    let across_m = sigma_px * depth_m / (focal_px * 2.0_f64.sqrt());
    let c = found.covariance_m2;
    let near = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-3;
    assert!(near(c[(2, 2)].sqrt(), along_m), "{c} instead of {along_m}");
    assert!(
        near(c[(1, 1)].sqrt(), across_m),
        "{c} instead of {across_m}"
    );
    assert!(near(found.worst_sigma_m(), along_m));
    assert!(near(found.reprojection_rms_px, error_px));
    assert!((found.mean_view + Vector3::z()).norm() < 1e-6);
    let half_angle = (baseline_m / 2.0 / depth_m).atan();
    assert!(near(found.view_cos.acos(), half_angle));
    // One ray says nothing of the depth.
    assert_eq!(
        map.quality(1).expect("a point").worst_sigma_m(),
        f64::INFINITY
    );
    assert_eq!(map.quality(2), None);
}
