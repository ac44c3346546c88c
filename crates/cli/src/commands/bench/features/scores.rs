//! What counts: keypoints found again, matches that are right, motions that are right.

use lsfb_geometry::{Camera, Matrix3, Se3};
use lsfb_pipeline::features::matching::{DescriptorSet, Match, MatchConfig, match_mutual};
use lsfb_pipeline::features::{Features, Keypoint};
use lsfb_pipeline::two_view::{RayPair, RelativePoseConfig, estimate_relative_pose};

use super::warps::moved;

/// Errors that a keypoint or a match may have, pixels.
pub const LIMITS_PX: [f64; 2] = [1.0, 3.0];
/// Errors of a pose, degrees, up to which the area below the curve is taken.
pub const LIMITS_DEG: [f64; 3] = [5.0, 10.0, 20.0];
/// Keypoints nearer to where the images no longer overlap are left out, pixels.
const RIM_PX: f64 = 8.0;

/// A pair with a homography.
#[derive(Clone, Copy, Debug, Default)]
pub struct PlanarScore {
    /// Share of the keypoints of both images, where they overlap, that have one of the other image within each limit; `None` where
    /// there are none.
    pub repeatability: Option<[f64; 2]>,
    /// Share of the matches within each limit; zero where nothing matches.
    pub accuracy: [f64; 2],
    /// Matches within the second limit.
    pub right: usize,
}

/// Compares what was found in an image and in the same image changed.
pub fn planar(
    [source, target]: [&Features; 2],
    target_from_source: &Matrix3<f64>,
    size_px: [u32; 2],
) -> PlanarScore {
    let source_from_target = target_from_source.try_inverse().unwrap_or_default();
    let first = Shared::new(source, target_from_source, size_px);
    let second = Shared::new(target, &source_from_target, size_px);
    let matches = match_mutual(&first.descriptors, &second.descriptors, &nearest());
    let errors: Vec<f64> = matches
        .iter()
        .map(|m| {
            distance(
                first.there[m.first as usize],
                second.here[m.second as usize],
            )
        })
        .collect();
    let within = |limit: f64| errors.iter().filter(|e| **e <= limit).count();
    let share = |limit: f64| within(limit) as f64 / errors.len().max(1) as f64;
    PlanarScore {
        repeatability: repeatability(&first, &second),
        accuracy: LIMITS_PX.map(share),
        right: within(LIMITS_PX[1]),
    }
}

/// Mutual nearest neighbours, whatever their distance: the same for every feature.
fn nearest() -> MatchConfig {
    MatchConfig {
        max_ratio: 1e6,
        max_distance: 1e3,
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Features where the images overlap: in their own image, and where they should be in the other.
struct Shared {
    here: Vec<[f64; 2]>,
    there: Vec<[f64; 2]>,
    descriptors: DescriptorSet,
}

impl Shared {
    fn new(features: &Features, there_from_here: &Matrix3<f64>, size_px: [u32; 2]) -> Self {
        let inside = |at: [f64; 2]| {
            let in_range = |v: f64, side: u32| v >= RIM_PX && v <= f64::from(side) - 1.0 - RIM_PX;
            in_range(at[0], size_px[0]) && in_range(at[1], size_px[1])
        };
        let (mut here, mut there, mut descriptors) = (Vec::new(), Vec::new(), Vec::new());
        for (keypoint, descriptor) in features.keypoints.iter().zip(&features.descriptors) {
            let at = keypoint.pixel.map(f64::from);
            let other = moved(there_from_here, at).filter(|other| inside(at) && inside(*other));
            if let Some(other) = other {
                here.push(at);
                there.push(other);
                descriptors.push(*descriptor);
            }
        }
        Self {
            here,
            there,
            descriptors: DescriptorSet::new(&descriptors),
        }
    }
}

fn repeatability(first: &Shared, second: &Shared) -> Option<[f64; 2]> {
    let total = first.here.len() + second.here.len();
    // Each measured in the image of the other.
    let nearest = |of: &Shared, among: &Shared| -> Vec<f64> {
        let to = |at: &[f64; 2]| {
            let distances = among.here.iter().map(|other| distance(*at, *other));
            distances.fold(f64::INFINITY, f64::min)
        };
        of.there.iter().map(to).collect()
    };
    let distances = [nearest(first, second), nearest(second, first)].concat();
    let share =
        |limit: f64| distances.iter().filter(|d| **d <= limit).count() as f64 / total as f64;
    (total > 0).then(|| LIMITS_PX.map(share))
}

/// The matches of two images, as pixels of both.
pub fn matched(features: [&Features; 2], config: &MatchConfig) -> Vec<[[f64; 2]; 2]> {
    let [first, second] = features.map(|f| DescriptorSet::new(&f.descriptors));
    let pixel = |keypoint: &Keypoint| keypoint.pixel.map(f64::from);
    let pixels = |m: Match| {
        [
            pixel(&features[0].keypoints[m.first as usize]),
            pixel(&features[1].keypoints[m.second as usize]),
        ]
    };
    match_mutual(&first, &second, config)
        .into_iter()
        .map(pixels)
        .collect()
}

/// Matches for motions: as the toolkit matches, and mutual nearest neighbours alone.
pub fn matchings() -> [MatchConfig; 2] {
    [MatchConfig::default(), nearest()]
}

/// Error of the motion that matches give, degrees: the larger of that of the rotation and that of the direction of the translation;
/// infinite where they give none.
pub fn pose_error_deg(
    matches: &[[[f64; 2]; 2]],
    cameras: [&Camera; 2],
    second_from_first: &Se3,
) -> f64 {
    let pairs = matches
        .iter()
        .map(|pixels| RayPair::new(cameras, pixels.map(Into::into)));
    let pairs: Vec<RayPair> = pairs.flatten().collect();
    let Some(found) = estimate_relative_pose(&pairs, &RelativePoseConfig::default()) else {
        return f64::INFINITY;
    };
    let found = found.second_from_first;
    let turn = second_from_first.rotation.angle_to(&found.rotation);
    let aside = second_from_first.translation.angle(&found.translation);
    turn.max(aside).to_degrees()
}

/// Area below the curve of recall over error, up to each limit, as a share of the whole (Sarlin et al., "SuperGlue", CVPR 2020).
pub fn areas(errors_deg: &[f64]) -> [f64; 3] {
    let mut errors = errors_deg.to_vec();
    errors.sort_by(f64::total_cmp);
    LIMITS_DEG.map(|limit| {
        let (mut area, mut before, mut recall) = (0.0, 0.0, 0.0);
        for (index, error) in errors.iter().enumerate().take_while(|(_, e)| **e < limit) {
            let next = (index + 1) as f64 / errors.len() as f64;
            area += (error - before) * (recall + next) / 2.0;
            (before, recall) = (*error, next);
        }
        (area + (limit - before) * recall) / limit
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(pixels: &[[f32; 2]], looks: &[u8]) -> Features {
        let keypoint = |pixel: &[f32; 2]| Keypoint {
            pixel: *pixel,
            scale_px: 2.0,
            angle_rad: 0.0,
            response: 1.0,
        };
        Features {
            keypoints: pixels.iter().map(keypoint).collect(),
            descriptors: looks
                .iter()
                .map(|look| {
                    std::array::from_fn(|k| {
                        if k % 7 == usize::from(look % 7) {
                            *look
                        } else {
                            0
                        }
                    })
                })
                .collect(),
        }
    }

    #[test]
    fn keypoints_and_matches_are_counted_where_images_overlap() {
        // Shifted by ten pixels to the right; the last of each is seen in one image alone.
        let shift = Matrix3::new(1.0, 0.0, 10.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        let first = features(
            &[[20.0, 20.0], [40.0, 30.0], [60.0, 40.0], [95.0, 50.0]],
            &[10, 20, 30, 40],
        );
        // Exact, two pixels off, and one that is nowhere near.
        let second = features(
            &[[30.0, 20.0], [52.0, 30.0], [50.0, 80.0], [12.0, 50.0]],
            &[10, 20, 30, 90],
        );
        let score = planar([&first, &second], &shift, [110, 100]);
        assert_eq!(score.repeatability, Some([2.0 / 6.0, 4.0 / 6.0]));
        assert_eq!(score.accuracy, [1.0 / 3.0, 2.0 / 3.0]);
        assert_eq!(score.right, 2);
        let empty = planar([&Features::default(), &second], &shift, [110, 100]);
        assert_eq!(empty.repeatability.map(|r| r[1]), Some(0.0));
        assert_eq!(empty.right, 0);
        let nothing = planar([&Features::default(); 2], &shift, [110, 100]);
        assert_eq!(nothing.repeatability, None);
    }

    #[test]
    fn areas_are_those_of_the_curve() {
        assert_eq!(areas(&[0.0, 0.0]), [1.0; 3]);
        assert_eq!(areas(&[f64::INFINITY, 30.0]), [0.0; 3]);
        assert_eq!(areas(&[]), [0.0; 3]);
        // By hand: to 5°, recall rises to one half at 2.5° and stays.
        let [five, ..] = areas(&[2.5, 7.0]);
        assert!((five - (0.5 * 2.5 * 0.5 + 2.5 * 0.5) / 5.0).abs() < 1e-12);
        // numpy.trapz over the same points, as in SuperGlue's evaluation: errors 1, 4, 8, 15, recall 0.25 to 1.
        let found = areas(&[15.0, 1.0, 8.0, 4.0]);
        for (area, expected) in found.iter().zip([0.35, 0.525, 0.743_75]) {
            assert!((area - expected).abs() < 1e-9, "{found:?}");
        }
    }
}
