//! Images that share hardly anything with the others: their poses are not theirs.
//!
//! A few images under other images' poses change neither what most pairs say (`contradicted`) nor how most points fit: their features
//! make no points, and nobody hears of it. In the HoloLens office with every tenth image under another's pose 29 keyframes have 0 to 16
//! observations where the median has 216; of right images the least has an eighth of the median.

use super::super::{KeyframeImage, MapPoint};

/// Views that make a point certain: two meet somewhere by chance.
const CERTAIN_VIEWS: usize = 3;
/// Share of the median number of observations below which an image is a stranger.
const LEAST_SHARE: f64 = 1.0 / 12.0;
/// Images with fewer features show little of anything.
const FEWEST_FEATURES: usize = 200;
/// Strangers, and their share of all images, that are no accident.
const FEWEST: usize = 2;
const FEWEST_SHARE: f64 = 0.02;

/// What is wrong, in words; `None` where nothing is.
pub(super) fn strangers(images: &[KeyframeImage], points: &[MapPoint]) -> Option<String> {
    let mut observations = vec![0usize; images.len()];
    let certain = points
        .iter()
        .filter(|p| p.observations.len() >= CERTAIN_VIEWS);
    for o in certain.flat_map(|p| &p.observations) {
        if let Some(count) = observations.get_mut(o.image) {
            *count += 1;
        }
    }
    let mut sorted = observations.clone();
    sorted.sort_unstable();
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0) as f64;
    let counted = observations.iter().zip(images);
    let strange = counted
        .filter(|(count, image)| {
            (**count as f64) < LEAST_SHARE * median && image.features.len() >= FEWEST_FEATURES
        })
        .count();
    let is_wrong = strange >= FEWEST && strange as f64 >= FEWEST_SHARE * images.len() as f64;
    is_wrong.then(|| {
        format!(
            "{strange} of {} images share hardly anything with those that should see the same: their poses are not theirs",
            images.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector3;

    use super::*;
    use crate::features::{Features, Keypoint};
    use crate::hd_map::PointObservation;

    /// A tenth of the images under each other's poses was PASS.
    #[test]
    fn a_tenth_of_the_images_under_other_poses_is_named() {
        let keypoint = Keypoint {
            pixel: [0.0; 2],
            scale_px: 1.0,
            angle_rad: 0.0,
            response: 0.1,
        };
        let images: Vec<KeyframeImage> = (0..40)
            .map(|keyframe| KeyframeImage {
                keyframe,
                camera: "cam0".to_owned(),
                features: Features {
                    keypoints: vec![keypoint; 300],
                    descriptors: vec![[0; 128]; 300],
                },
            })
            .collect();
        let points = |strange: usize| -> Vec<MapPoint> {
            let point = |i: usize| {
                let observation = |k: usize| PointObservation {
                    image: strange + (i + k) % (40 - strange),
                    keypoint: 0,
                };
                MapPoint {
                    point_in_world: Vector3::zeros(),
                    observations: (0..4).map(observation).collect(),
                    reprojection_rms_px: 0.5,
                }
            };
            (0..2000).map(point).collect()
        };
        assert_eq!(strangers(&images, &points(0)), None);
        assert_eq!(strangers(&images, &points(1)), None);
        let said = strangers(&images, &points(4)).expect("named");
        assert!(said.starts_with("4 of 40 images"), "{said}");
        // Images that show nothing are no strangers.
        let mut black = images.clone();
        black[..4]
            .iter_mut()
            .for_each(|i| i.features = Features::default());
        assert_eq!(strangers(&black, &points(4)), None);
        assert_eq!(strangers(&[], &[]), None);
    }
}
