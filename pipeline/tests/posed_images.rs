//! Maps exported to other programs' files, read back as posed images; real images whose poses are refined.

use std::fs;
use std::path::Path;

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, CameraTiming, Rig, RigCamera, Se3, StampedPose, Vector3};
use lsfb_pipeline::features::{Feature, Features, Keypoint};
use lsfb_pipeline::hd_map::{
    ColmapCamera, HdMap, HdMapConfig, KeyframeImage, MapContent, MapFormat, MapPoint,
    PointObservation, PoseRefinement, PosedMapConfig, build_map_from_posed_images,
};
use lsfb_pipeline::posed_images::{ImageLayout, PosedImages, UnposedImages};
use lsfb_types::{Timestamp, no_progress};

const PRINCIPAL_PX: [f64; 2] = [318.25, 241.5];
const PINHOLE_PX: [f64; 2] = [400.0, 410.0];
const FISHEYE_PX: [f64; 2] = [220.0, 221.0];
const DISTORTION: [f64; 4] = [-0.02, 0.006, -0.003, 0.0004];

fn rig() -> Rig {
    let pinhole = Camera::pinhole(640, 480, PINHOLE_PX, PRINCIPAL_PX);
    let fisheye = Camera {
        lens: Lens::KannalaBrandt {
            focal_px: FISHEYE_PX,
            principal_px: PRINCIPAL_PX,
            distortion: DISTORTION,
        },
        ..pinhole
    };
    let mounted = |camera, pose: [f64; 6]| RigCamera {
        camera,
        rig_from_camera: Se3::exp(&pose.into()),
        timing: CameraTiming::default(),
        sigmas: Default::default(),
    };
    Rig {
        cameras: [
            (
                "cam0".to_owned(),
                mounted(pinhole, [0.3, -0.2, 0.1, 0.1, 0.0, 0.2]),
            ),
            (
                "cam1".to_owned(),
                mounted(fisheye, [0.0, 1.2, 0.0, -0.1, 0.0, 0.2]),
            ),
        ]
        .into(),
        ..Rig::empty("two")
    }
}

/// As COLMAP describes the two cameras: its pixel (0, 0) is the first one's corner.
fn cameras() -> [ColmapCamera; 2] {
    let principal = PRINCIPAL_PX.map(|v| v + 0.5);
    let camera = |model: &str, parameters: Vec<f64>| ColmapCamera {
        model: model.to_owned(),
        size: [640, 480],
        parameters,
    };
    [
        camera("PINHOLE", [PINHOLE_PX, principal].concat()),
        camera(
            "OPENCV_FISHEYE",
            [&FISHEYE_PX[..], &principal, &DISTORTION].concat(),
        ),
    ]
}

/// Three keyframes whose images of both cameras saw one point.
fn map() -> HdMap {
    let keyframes = [0, 1, 2].map(|i| StampedPose {
        time: Timestamp::from_nanos(1_700_000_000_000_000_000 + i),
        world_from_rig: Se3::exp(&[0.1 * i as f64, 0.7, -0.3, i as f64, 5.0, -2.0].into()),
    });
    let images: Vec<KeyframeImage> = (0..6)
        .map(|i| KeyframeImage {
            keyframe: i / 2,
            camera: format!("cam{}", i % 2),
            features: Features {
                keypoints: vec![Keypoint {
                    pixel: [10.0, 20.0],
                    scale_px: 2.0,
                    angle_rad: 0.0,
                    response: 0.1,
                }],
                descriptors: vec![[7; 128]],
            },
        })
        .collect();
    let point = MapPoint {
        point_in_world: Vector3::new(1.0, 2.0, 3.0),
        observations: (0..6)
            .map(|image| PointObservation { image, keypoint: 0 })
            .collect(),
        reprojection_rms_px: 0.5,
    };
    let content = MapContent {
        rig: &rig(),
        keyframes: &keyframes,
        images: &images,
        points: &[point],
        feature: &Feature::Sift,
        provenance: "made up",
    };
    HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("consistent content")
}

fn export(format: MapFormat, folder: &Path) {
    for file in map().export(format, &cameras()).expect("known cameras") {
        let path = folder.join(&file.path);
        fs::create_dir_all(path.parent().expect("a folder")).expect("folder");
        fs::write(path, file.bytes).expect("written");
    }
}

fn message(folder: &Path) -> String {
    PosedImages::read(folder).expect_err("unusable").to_string()
}

#[test]
fn exported_maps_are_read_back_as_posed_images() {
    let (map, rig) = (map(), rig());
    for (format, images) in [
        (MapFormat::Nerfstudio, "."),
        (MapFormat::Kapture, "sensors/records_data"),
        (MapFormat::ColmapText, "."),
        (MapFormat::ColmapBinary, "."),
    ] {
        let scratch = tempfile::tempdir().expect("scratch folder");
        export(format, scratch.path());
        let found = PosedImages::read(scratch.path()).expect("its own files");
        assert_eq!(found.images.len(), 6, "{format:?}");
        assert!(found.notes.is_empty(), "{:?}", found.notes);
        let images = scratch.path().join(images);
        for (at, image) in found.images.iter().enumerate() {
            let keyframe = map.keyframe(at as u32 / 2).expect("a keyframe");
            let name = format!("cam{}", at % 2);
            let file = images.join(format!("{name}/{}.png", keyframe.time.nanos()));
            assert_eq!(
                image.path.components().collect::<Vec<_>>(),
                file.components().collect::<Vec<_>>(),
                "{format:?}"
            );
            let own = &found.rig.cameras[&image.camera];
            // kapture alone has rigs.
            let mounted = match format {
                MapFormat::Kapture => rig.cameras[&name].rig_from_camera,
                _ => Se3::identity(),
            };
            let off = (own.rig_from_camera.inverse() * mounted).log().norm();
            assert!(off < 1e-9, "{format:?}: {off}");
            // Each camera has a pose of its own there.
            assert_eq!(image.instant, None, "{format:?}");
            let [a, b] = [&own.camera, &rig.cameras[&name].camera];
            assert_eq!((a.width, a.height), (b.width, b.height));
            assert_eq!(a.lens.model(), b.lens.model(), "{format:?}");
            let [a, b] = [a, b].map(|camera| camera.lens.parameters().values);
            for (a, b) in a.iter().zip(&b) {
                assert!((a - b).abs() < 1e-9, "{format:?}: {a} {b}");
            }
            let pose = keyframe.world_from_rig * rig.cameras[&name].rig_from_camera;
            let found = image.world_from_rig * own.rig_from_camera;
            let off = (pose.inverse() * found).log().norm();
            assert!(off < 1e-9, "{format:?}: {off}");
        }
    }
}

/// What was read with poses is read without them: the same images of the same cameras.
#[test]
fn images_are_read_where_no_pose_is_known() {
    for (format, layout) in [
        (MapFormat::Nerfstudio, ImageLayout::Nerfstudio),
        (MapFormat::Kapture, ImageLayout::Kapture),
        (MapFormat::ColmapText, ImageLayout::Colmap),
        (MapFormat::ColmapBinary, ImageLayout::Colmap),
    ] {
        let scratch = tempfile::tempdir().expect("scratch folder");
        let folder = scratch.path();
        export(format, folder);
        let posed = PosedImages::read(folder).expect("its own files");
        if format == MapFormat::Kapture {
            fs::remove_file(folder.join("sensors/trajectories.txt")).expect("poses");
        }
        if format == MapFormat::Nerfstudio {
            let path = folder.join("transforms.json");
            let text = fs::read_to_string(&path).expect("text");
            fs::write(&path, text.replace("transform_matrix", "no_matrix")).expect("written");
        }
        assert_eq!(ImageLayout::found_in(folder).expect("read"), [layout]);
        let found = UnposedImages::read(folder, layout).expect("images");
        // Without poses each camera is its own rig.
        let mut alone = posed.rig.clone();
        for mounted in alone.cameras.values_mut() {
            mounted.rig_from_camera = Se3::identity();
        }
        assert_eq!(found.rig, alone, "{format:?}");
        let expected: Vec<_> = posed.images.iter().map(|i| (&i.path, &i.camera)).collect();
        let images: Vec<_> = found.images.iter().map(|i| (&i.path, &i.camera)).collect();
        assert_eq!(images, expected, "{format:?}");
        if layout != ImageLayout::Colmap {
            let said = message(folder);
            assert!(said.contains("none of its 6 images"), "{said}");
        }
    }
}

/// COLMAP lists what it could place; of one camera the others are images as well, of several nobody knows which took them.
#[test]
fn images_that_colmap_could_not_place_are_images_of_its_one_camera() {
    let scratch = tempfile::tempdir().expect("scratch folder");
    let folder = scratch.path();
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("folder");
        fs::write(path, text).expect("written");
    };
    let camera = |number: u32| format!("{number} PINHOLE 640 480 500 500 320 240\n");
    for name in ["images/a.png", "images/day/b.jpg", "images/notes.txt"] {
        write(name, "");
    }
    let read = || UnposedImages::read(folder, ImageLayout::Colmap);
    let names = |found: &UnposedImages| -> Vec<String> {
        let below = |path: &Path| path.strip_prefix(folder).map(|p| p.display().to_string());
        let names = found.images.iter();
        names.map(|i| below(&i.path).expect("below")).collect()
    };
    write("sparse/0/cameras.txt", &camera(1));
    let found = read().expect("one camera, no list");
    assert_eq!(names(&found), ["images/a.png", "images/day/b.jpg"]);
    write("sparse/0/images.txt", "1 1 0 0 0 0 0 0 1 day/b.jpg\n\n");
    let found = read().expect("one camera, half a list");
    assert_eq!(names(&found), ["images/day/b.jpg", "images/a.png"]);
    assert!(found.images.iter().all(|image| image.camera == "cam1"));
    write("sparse/0/cameras.txt", &(camera(1) + &camera(2)));
    let found = read().expect("two cameras, half a list");
    assert_eq!(names(&found), ["images/day/b.jpg"]);
    assert!(
        found.notes[0].contains("1 images that"),
        "{:?}",
        found.notes
    );
    fs::remove_file(folder.join("sparse/0/images.txt")).expect("removed");
    let said = read().expect_err("nothing says which").to_string();
    assert!(said.contains("several cameras"), "{said}");
}

#[test]
fn images_beside_intrinsics_are_those_of_one_place() {
    let scratch = tempfile::tempdir().expect("scratch folder");
    let folder = scratch.path();
    let found_in = || ImageLayout::found_in(folder).expect("read");
    assert!(found_in().is_empty());
    fs::write(folder.join("K.txt"), "60 0 31.5 0 60 23.5 0 0 1").expect("written");
    assert_eq!(found_in(), [ImageLayout::Pinhole]);
    fs::write(folder.join("transforms.json"), "{}").expect("written");
    assert_eq!(found_in(), [ImageLayout::Nerfstudio, ImageLayout::Pinhole]);
    let read = || UnposedImages::read(folder, ImageLayout::Pinhole);
    let said = read().expect_err("no image").to_string();
    assert!(said.contains("no .png"), "{said}");
    fs::create_dir(folder.join("images")).expect("folder");
    for name in ["images/a.png", "b.png"] {
        fs::write(folder.join(name), "").expect("written");
    }
    let said = read().expect_err("in two places").to_string();
    assert!(said.contains("and in images/"), "{said}");
    // Of 7-Scenes the intrinsics are a part, and its depths are no images.
    for name in ["frame-000000.color.png", "frame-000000.depth.png"] {
        fs::write(folder.join(name), "").expect("written");
    }
    assert_eq!(
        found_in(),
        [ImageLayout::Nerfstudio, ImageLayout::SevenScenes]
    );
}

/// Values worked out by hand from nerfstudio's documentation: the camera of this frame looks along the world's x, its image upright.
#[test]
fn axes_of_nerfstudio_are_turned_and_angles_give_focal_lengths() {
    let scratch = tempfile::tempdir().expect("scratch folder");
    let text = r#"{"camera_angle_x": 1.5707963267948966, "w": 800, "h": 600, "frames": [{"file_path": "./train/r_0",
        "transform_matrix": [[0, 0, -1, 4], [-1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 0, 1]]}]}"#;
    fs::write(scratch.path().join("transforms.json"), text).expect("written");
    let found = PosedImages::read(scratch.path()).expect("read");
    let image = &found.images[0];
    assert!(image.path.ends_with("train/r_0.png"));
    let camera = &found.rig.cameras[&image.camera].camera;
    let px = [camera.focal_px(), camera.principal_px()].concat();
    for (px, expected) in px.iter().zip([400.0, 400.0, 399.5, 299.5]) {
        assert!((px - expected).abs() < 1e-9, "{px} {expected}");
    }
    // Ahead of the camera, to its right and below it.
    for (in_camera, in_world) in [
        ([0.0, 0.0, 1.0], [5.0, 5.0, 6.0]),
        ([1.0, 0.0, 0.0], [4.0, 4.0, 6.0]),
        ([0.0, 1.0, 0.0], [4.0, 5.0, 5.0]),
    ] {
        let off = image.world_from_rig * Vector3::from(in_camera) - Vector3::from(in_world);
        assert!(off.norm() < 1e-9, "{in_camera:?}: {off}");
    }
}

#[test]
fn a_kapture_of_a_rig_is_read_and_images_without_pose_are_said() {
    let scratch = tempfile::tempdir().expect("scratch folder");
    let sensors = scratch.path().join("sensors");
    fs::create_dir(&sensors).expect("folder");
    let write = |name: &str, text: &str| fs::write(sensors.join(name), text).expect("written");
    write(
        "sensors.txt",
        "# kapture format: 1.1\nleft, , camera, SIMPLE_PINHOLE, 640, 480, 500, 320, 240\ngps, , gnss, EPSG:4326\n",
    );
    // A metre to the left of the rig's middle: what is there is a metre to the right of the camera.
    write("rigs.txt", "pair, left, 1, 0, 0, 0, 1, 0, 0\n");
    write(
        "trajectories.txt",
        "10, pair, 1, 0, 0, 0, 0, 0, -2\n11, pair, , , , , 0, 0, 0\n",
    );
    write("records_camera.txt", "10, left, a.jpg\n11, left, b.jpg\n");
    let found = PosedImages::read(scratch.path()).expect("read");
    assert_eq!(found.images.len(), 1);
    let place = found.images[0].world_from_rig.translation;
    assert_eq!(place, Vector3::new(0.0, 0.0, 2.0));
    let mounted = found.rig.cameras["left"].rig_from_camera.translation;
    assert_eq!(mounted, Vector3::new(-1.0, 0.0, 0.0));
    assert_eq!(found.images[0].instant, Some(0));
    assert_eq!(found.notes.len(), 1);
    assert!(
        found.notes[0].contains("1 of 2 images"),
        "{:?}",
        found.notes
    );

    write("trajectories.txt", "12, pair, 1, 0, 0, 0, 0, 0, -2\n");
    assert!(message(scratch.path()).contains("none of its 2 images"));
    write("trajectories.txt", "10, pair, 1, 1, 0, 0, 0, 0, -2\n");
    let said = message(scratch.path());
    assert!(said.contains("trajectories.txt: line 1"), "{said}");
    write(
        "sensors.txt",
        "left, , camera, SIMPLE_PINHOLE, 640, 480, 500\n",
    );
    let said = message(scratch.path());
    assert!(said.contains("expected 3"), "{said}");
    write("sensors.txt", "");
    write("trajectories.txt", "");
    let said = message(scratch.path());
    assert!(said.contains("left is not in sensors.txt"), "{said}");
}

#[test]
fn broken_lists_are_named() {
    let scratch = tempfile::tempdir().expect("scratch folder");
    let transforms = scratch.path().join("transforms.json");
    let frame = |rest: &str| {
        format!(r#"{{"w": 64, "h": 48, "frames": [{{"file_path": "a.png", {rest}}}]}}"#)
    };
    let turned = r#""transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"#;
    for (text, expected) in [
        ("{".to_owned(), "not a JSON"),
        ("{}".to_owned(), "frames"),
        (r#"{"frames": []}"#.to_owned(), "none of its 0 images"),
        (
            frame(r#""transform_matrix": [[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]"#),
            "frame 0",
        ),
        (frame(turned), "fl_x"),
        (
            frame(&format!(r#""fl_x": -5, {turned}"#)),
            "it must be positive",
        ),
        (
            frame(&format!(r#""fl_x": 50, "cx": 3, {turned}"#)),
            "principal point",
        ),
        (
            frame(&format!(
                r#""fl_x": 50, "camera_model": "EQUIRECTANGULAR", {turned}"#
            )),
            "EQUIRECTANGULAR",
        ),
    ] {
        fs::write(&transforms, &text).expect("written");
        let said = message(scratch.path());
        assert!(said.contains(expected), "{text}: {said}");
    }
    fs::remove_file(transforms).expect("removed");
    export(MapFormat::ColmapBinary, scratch.path());
    for name in ["cameras.bin", "images.bin"] {
        let path = scratch.path().join(name);
        let bytes = fs::read(&path).expect("its own");
        for (broken, expected) in [
            (&bytes[..bytes.len() - 3], "truncated"),
            (&[&bytes[..], b"more"].concat()[..], "too many"),
        ] {
            fs::write(&path, broken).expect("written");
            let said = message(scratch.path());
            assert!(said.contains(expected) && said.contains(name), "{said}");
        }
        fs::write(&path, &bytes).expect("written");
    }
}

/// Strecha's fountain: its cameras stand where a laser scanner has them. Poses that are disturbed by a degree and centimetres come back by the images alone.
#[test]
fn the_fountains_cameras_come_back_to_where_the_laser_has_them() {
    let test = "the_fountains_cameras_come_back_to_where_the_laser_has_them";
    let Some(folder) = lsfb_tests::recordings(test, "vision/strecha_fountain_P11_half") else {
        return;
    };
    let mut posed = PosedImages::read(&folder).expect("the recording");
    let places = |posed: &PosedImages| -> Vec<Vector3<f64>> {
        let images = posed.images.iter();
        images.map(|i| i.world_from_rig.translation).collect()
    };
    let truth = places(&posed);
    for (i, image) in (0..).zip(&mut posed.images) {
        let error = |axis: i32| (2.3 * f64::from(i) + 1.7 * f64::from(axis)).sin();
        let [a, b, c] = [0, 1, 2].map(|axis| 0.01 * error(axis));
        let [x, y, z] = [3, 4, 5].map(|axis| 0.05 * error(axis));
        image.world_from_rig = image.world_from_rig * Se3::exp(&[a, b, c, x, y, z].into());
    }
    let mut config = PosedMapConfig {
        keyframe_distance_per_depth: 0.0,
        keyframe_angle_deg: 0.0,
        refine_cameras: false,
        refine_poses: PoseRefinement {
            enabled: true,
            rotation_sigma_deg: 1.0,
            place_sigma_per_depth: 0.02,
        },
        ..PosedMapConfig::default()
    };
    config.sift.max_features = 3000;
    let apart_m = |found: &[Vector3<f64>]| {
        let aligned = umeyama(found, &truth, Scale::Free).expect("places");
        let off = found.iter().zip(&truth);
        off.map(|(f, t)| (aligned.apply(f) - t).norm())
            .fold(0.0, f64::max)
    };
    let before_m = apart_m(&places(&posed));
    let map = build_map_from_posed_images(&posed, &config, &no_progress).expect("a map");
    let keyframes = 0..map.keyframe_count() as u32;
    let found: Vec<Vector3<f64>> = keyframes
        .filter_map(|k| Some(map.keyframe(k)?.world_from_rig.translation))
        .collect();
    let after_m = apart_m(&found);
    println!("the farthest camera: {before_m:.4} → {after_m:.4} m");
    assert!(
        before_m > 0.03 && after_m < 0.005,
        "{before_m} → {after_m} m"
    );
}
