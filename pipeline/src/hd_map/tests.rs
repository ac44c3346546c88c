use std::fs;
use std::path::Path;

use lsfb_geometry::{Camera, CameraTiming, Rig, RigCamera, Se3, StampedPose, Vector3};
use lsfb_types::{Timestamp, no_progress};

use super::*;
use crate::Error;
use crate::features::{Feature, Features, Keypoint};

/// Two pinhole cameras that look along z.
fn rig() -> Rig {
    let mut rig = Rig::empty("two");
    rig.cameras = ["cam0", "cam1"]
        .map(|name| {
            let camera = RigCamera {
                camera: Camera::pinhole(640, 480, [400.0, 400.0], [319.5, 239.5]),
                rig_from_camera: Se3::identity(),
                timing: CameraTiming::default(),
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
    let map = small_map();
    map.write(first.path()).expect("written");
    let opened = HdMap::open(first.path()).expect("opened");
    assert!(opened.failures().is_empty());
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
        .write(first.path())
        .expect("written over the open map");
    assert_eq!(bytes_of(first.path()), bytes_of(second.path()));
    assert_eq!(opened.position(7), Some(Vector3::new(7.0, 2.0, 3.0)));
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
        text.replace("format_version = 2", "format_version = 7"),
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
