//! Whether the images of the cameras show enough to be mapped.

use lsfb_perception::statistics::median;

use super::keyframes::Keyframes;
use super::report::{BLURRED_SCALE, FEATURELESS_SHARE, MappingReport, MappingWarning};
use crate::error::MIN_FEATURES_PER_IMAGE;

/// The fewest images that are said.
const FEATURELESS_IMAGES: u64 = 3;

/// Counts features, and warns of cameras that see too little.
pub(super) fn describe_images(
    keyframes: &Keyframes,
    cameras: &[String],
    report: &mut MappingReport,
) {
    report.keyframes = keyframes.frames.len() as u64;
    report.images = keyframes.images.len() as u64;
    let mut scales_px: Vec<(&String, f64)> = Vec::new();
    for camera in cameras {
        let images = keyframes.images.iter().filter(|i| i.camera == *camera);
        let count = images.clone().count() as u64;
        let features: u64 = images.clone().map(|i| i.features.len() as u64).sum();
        let featureless = images.clone();
        let featureless = featureless
            .filter(|i| i.features.len() < MIN_FEATURES_PER_IMAGE)
            .count() as u64;
        report.features += features;
        if features < MIN_FEATURES_PER_IMAGE as u64 * count.max(1) {
            report.warnings.push(MappingWarning::FewFeatures {
                camera: camera.clone(),
                features,
                images: count,
            });
        } else if featureless >= FEATURELESS_IMAGES
            && featureless as f64 > FEATURELESS_SHARE * count as f64
        {
            report.warnings.push(MappingWarning::FeaturelessImages {
                camera: camera.clone(),
                featureless,
                images: count,
            });
        }
        let keypoints = images.flat_map(|i| i.features.keypoints.iter());
        let scale_px = median(keypoints.map(|k| f64::from(k.scale_px)).collect());
        scales_px.extend(scale_px.map(|px| (camera, px)));
    }
    for (camera, scale_px) in &scales_px {
        let others = scales_px.iter().filter(|(other, _)| other != camera);
        let Some(of_others_px) = median(others.map(|(_, px)| *px).collect()) else {
            continue;
        };
        if *scale_px > BLURRED_SCALE * of_others_px {
            report.warnings.push(MappingWarning::Blurred {
                camera: (*camera).clone(),
                scale_px: *scale_px,
                of_others_px,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::Timestamp;

    use super::*;
    use crate::features::{Features, Keypoint};
    use crate::hd_map::KeyframeImage;
    use crate::mapping::keyframes::Keyframe;

    /// Codes of what is said of two cameras whose ten images show so many features of such a scale.
    fn said(of: impl Fn(usize, usize) -> (usize, f32)) -> Vec<String> {
        let mut keyframes = Keyframes {
            frames: Vec::new(),
            images: Vec::new(),
        };
        for keyframe in 0..10 {
            keyframes.frames.push(Keyframe {
                time: Timestamp::from_nanos(keyframe as i64),
                world_from_rig: lsfb_geometry::Se3::identity(),
                lidar: None,
            });
            for camera in 0..2 {
                let (features, scale_px) = of(camera, keyframe);
                let keypoint = Keypoint {
                    pixel: [0.0; 2],
                    scale_px,
                    angle_rad: 0.0,
                    response: 0.1,
                };
                keyframes.images.push(KeyframeImage {
                    keyframe,
                    camera: format!("cam{camera}"),
                    features: Features {
                        keypoints: vec![keypoint; features],
                        descriptors: Vec::new(),
                    },
                });
            }
        }
        let mut report = MappingReport::default();
        let cameras = ["cam0", "cam1"].map(str::to_owned);
        describe_images(&keyframes, &cameras, &mut report);
        let findings = report.warnings.iter().map(MappingWarning::finding);
        findings
            .map(|f| format!("{} {}", f.subject, f.code))
            .collect()
    }

    #[test]
    fn cameras_that_show_little_or_coarse_features_are_named() {
        assert_eq!(said(|_, _| (300, 1.5)), Vec::<String>::new());
        // One that looks at a bare wall for a moment.
        assert_eq!(
            said(|c, k| (if c == 0 && k < 2 { 5 } else { 300 }, 1.5)),
            Vec::<String>::new()
        );
        let dark = said(|c, k| (if c == 1 && k % 2 == 0 { 5 } else { 300 }, 1.5));
        assert_eq!(dark, ["cam1 featureless-images"]);
        assert_eq!(said(|c, _| ([300, 20][c], 1.5)), ["cam1 few-features"]);
        assert_eq!(said(|c, _| (300, [6.5, 1.5][c])), ["cam0 blurred"]);
    }
}
