//! Mapping and localization on images of real AR glasses with given poses.
#![cfg(test)]

use std::path::PathBuf;

use lsfb_geometry::{Matrix3, Se3, Vector3};
use lsfb_pipeline::features::matching::{DescriptorSet, MatchConfig, match_mutual};
use lsfb_pipeline::features::{FrameFeatures, SiftConfig, SiftDetector, detect_all};
use lsfb_pipeline::hd_map::{HdMap, PosedMapConfig, build_map_from_posed_images};
use lsfb_pipeline::localization::{Localizer, LocalizerConfig};
use lsfb_pipeline::posed_images::{PosedImages, read_image};
use lsfb_types::{Image, no_progress};
use rayon::prelude::*;

/// The recording, or `None` after saying that the test is skipped.
fn recording(test: &str) -> Option<PathBuf> {
    let data = std::env::var_os("LSFB_TEST_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")),
        PathBuf::from,
    );
    let folder = data.join("vision/hololens_office");
    if folder.join("K.txt").exists() {
        return Some(folder);
    }
    println!("skipped: {test}: no recording at {}", folder.display());
    None
}

#[test]
fn held_out_images_are_localized() {
    let Some(folder) = recording("held_out_images_are_localized") else {
        return;
    };
    let all = PosedImages::read(&folder).expect("the recording");
    let (mut mapped, mut held_out) = (all.clone(), all);
    let mut index = 0;
    mapped.images.retain(|_| {
        index += 1;
        index % 5 != 0
    });
    index = 0;
    held_out.images.retain(|_| {
        index += 1;
        index % 5 == 0
    });
    assert_eq!(mapped.images.len() + held_out.images.len(), 298);
    let config = PosedMapConfig::default();
    let built = build_map_from_posed_images(&mapped, &config, &no_progress).expect("a map");

    // Through the files, as a user would.
    let scratch = tempfile::tempdir().expect("scratch folder");
    built.write(scratch.path()).expect("written");
    let map = HdMap::open(scratch.path()).expect("opened");
    assert!(map.point_count() > 1000, "{} points", map.point_count());

    let images: Vec<Image> = held_out
        .images
        .par_iter()
        .map(|i| read_image(&i.path).expect("an image"))
        .collect();
    let features = detect_all(
        &images.iter().collect::<Vec<_>>(),
        &config.sift,
        &no_progress,
    )
    .expect("valid configuration");
    let localizer = Localizer::new(&map, &LocalizerConfig::default()).expect("valid configuration");
    let errors: Vec<Option<Error>> = features
        .into_par_iter()
        .zip(&held_out.images)
        .map(|(features, image)| {
            let frame = FrameFeatures {
                camera: image.camera.clone(),
                features,
            };
            let found = localizer.localize(&[frame], &held_out.rig).ok()?;
            Some(Error::new(&image.world_from_rig, &found.world_from_rig))
        })
        .collect();
    let good = |e: &&Error| e.distance_m <= 0.10 && e.angle_deg <= 5.0;
    let right = errors.iter().flatten().filter(good).count();
    let share = right as f64 / errors.len() as f64;
    let mut distances: Vec<f64> = errors.iter().flatten().map(|e| e.distance_m).collect();
    distances.sort_by(f64::total_cmp);
    let median_m = distances
        .get(distances.len() / 2)
        .copied()
        .unwrap_or(f64::INFINITY);
    let figures = format!(
        "{right} of {} within 10 cm / 5°, {} poses in all, median {median_m:.4} m, map of {} points",
        errors.len(),
        distances.len(),
        map.point_count(),
    );
    println!("{figures}");
    assert!(share >= 0.90, "{figures}");
    assert!(median_m <= 0.03, "{figures}");
}

struct Error {
    distance_m: f64,
    angle_deg: f64,
}

impl Error {
    fn new(truth: &Se3, found: &Se3) -> Self {
        let error = truth.inverse() * *found;
        Self {
            distance_m: error.translation.norm(),
            angle_deg: error.rotation.angle().to_degrees(),
        }
    }
}

/// Image pairs and how many matches within 1 px of their epipolar lines OpenCV's SIFT finds in them.
/// OpenCV 4.14.0: `cv2.SIFT_create(nfeatures=900)`, root of L1-normalised descriptors, mutual nearest, ratio 0.8.
const OPENCV_INLIERS: [(&str, &str, usize); 12] = [
    ("00003.jpg", "00007.jpg", 229),
    ("00033.jpg", "00037.jpg", 83),
    ("00063.jpg", "00067.jpg", 142),
    ("00093.jpg", "00097.jpg", 81),
    ("00123.jpg", "00127.jpg", 83),
    ("00153.jpg", "00157.jpg", 63),
    ("00183.jpg", "00187.jpg", 23),
    ("00213.jpg", "00217.jpg", 208),
    ("00244.jpg", "00248.jpg", 57),
    ("00275.jpg", "00279.jpg", 46),
    ("00305.jpg", "00309.jpg", 34),
    ("00365.jpg", "00370.jpg", 108),
];

#[test]
fn as_many_good_matches_as_opencv() {
    let Some(folder) = recording("as_many_good_matches_as_opencv") else {
        return;
    };
    let posed = PosedImages::read(&folder).expect("the recording");
    let camera = posed.rig.cameras["cam0"].camera;
    let mut detector = SiftDetector::new(&SiftConfig::default()).expect("valid configuration");
    let matching = MatchConfig {
        max_ratio: 0.8,
        max_distance: 2.0,
    };
    let (mut own, mut opencv) = (0, 0);
    for (first, second, expected) in OPENCV_INLIERS {
        let [a, b] = [first, second].map(|name| {
            let posed = posed
                .images
                .iter()
                .find(|i| i.path.ends_with(name))
                .expect("listed");
            let features = detector.detect(&read_image(&posed.path).expect("an image"));
            (posed.world_from_rig, features)
        });
        let second_from_first = b.0.inverse() * a.0;
        let essential: Matrix3<f64> = lsfb_geometry::so3::hat(&second_from_first.translation)
            * second_from_first.rotation_matrix();
        let (f, c) = (camera.focal_px(), camera.principal_px());
        let pixel_from_ray = Matrix3::new(f[0], 0.0, c[0], 0.0, f[1], c[1], 0.0, 0.0, 1.0);
        let ray_from_pixel = pixel_from_ray.try_inverse().expect("a camera matrix");
        let fundamental = ray_from_pixel.transpose() * essential * ray_from_pixel;
        let sets = [&a.1, &b.1].map(|f| DescriptorSet::new(&f.descriptors));
        own += match_mutual(&sets[0], &sets[1], &matching)
            .iter()
            .filter(|m| {
                let [p, q] = [
                    a.1.keypoints[m.first as usize],
                    b.1.keypoints[m.second as usize],
                ]
                .map(|k| Vector3::new(f64::from(k.pixel[0]), f64::from(k.pixel[1]), 1.0));
                let (line, back) = (fundamental * p, fundamental.transpose() * q);
                let slope = line.xy().norm_squared() + back.xy().norm_squared();
                q.dot(&line).powi(2) / slope < 1.0
            })
            .count();
        opencv += expected;
    }
    println!("own {own}, OpenCV {opencv}");
    assert!(
        own as f64 >= 0.9 * opencv as f64,
        "own {own}, OpenCV {opencv}"
    );
}
