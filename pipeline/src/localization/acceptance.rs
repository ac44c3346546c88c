//! What speaks for a pose, and how probable that makes it.
//!
//! Inliers after guided matching prove little: the map was projected with the pose that they are to prove, and refined on what was
//! found there, so that images of other places gather 30 of them and more. What is counted here was not searched for with the pose:
//!
//! - **First matches**, paired by look before there was a pose. A wrong pair agrees with a pose by chance with a probability that is
//!   measured on pairs of one match's pixel and another's point; from that follows how many poses with so many inliers are to be
//!   expected of matches that are all wrong (a-contrario; Moisan and Stival, IJCV 2004).
//! - **Decoys**: what guided matching finds where the points are not.
//! - **Spread** of the inliers over the image.
//! - **The rival**: the best pose that contradicts this one, of another place that looks the same.
//! - **The mirror**: the best pose with left and right exchanged, and how much each first match says for the pose: features of a network
//!   know no left and right, and parts that look alike agree with poses of their own.
//! - **Other focal lengths**: the factor with which most first matches agree. Where that is another than 1 for sure, the pose is refused
//!   whatever its probability.
//!
//! [`Evidence::probability`] is the product of four: a logistic regression on the first three kinds, fitted with a ridge of 0.03 in
//! units of their standard deviations; the chance that no such pose is expected of wrong matches; that they are not wrong together; the
//! chance that the rival is wrong. Right means the right view of the right place, within 0.5 m and 10° (outdoors 1 m): how exact it is says the covariance.
//! `benches/localization/fit.py` fitted the weights on 472 queries of `examples/localization_acceptance` in the maps of
//! `hololens_office`, `sevenscenes_redkitchen` and `strecha_fountain_P11_half`: images left out, turned, halved, thinned to a tenth and
//! a thirtieth of their features, mirrored, and of other places. Fitted on the office alone, they accept none of the other maps' 138
//! mirrored images and images of other places and miss none of 58 views of their own; fitted on the kitchen alone, none of 138 and
//! none of 126.

use lsfb_geometry::{Matrix2, Se3, Vector2};
use serde::Serialize;

use super::matches::{MountedCamera, PointMatch};
use crate::features::Feature;

/// What speaks for a pose: figures that chance, or the search for the pose itself, does not reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// Features paired with map points by their look alone, each point and each spot of the image once.
    pub first_matches: usize,
    /// Those of them that agree with the pose.
    pub first_inliers: usize,
    /// Probability that a pair which is wrong agrees with the pose all the same: measured on pairs of the one's pixel and
    /// another's point.
    pub chance_level: f64,
    /// Decimal logarithm of the number of poses expected to have as many inliers by chance alone, among all poses that
    /// the matches can be asked for.
    pub log10_false_alarms: f64,
    /// Inliers after guided matching: of the points projected with the pose.
    pub guided_inliers: usize,
    /// Inliers that the same matching finds where the points are not: projected aside, the mean of four directions.
    pub decoy_inliers: f64,
    /// How much of the image the guided inliers are spread over: 1 as evenly as can be, 0 in a point or on a line.
    pub image_spread: f64,
    /// Factor of the focal lengths that fits the matches best.
    pub focal_scale: f64,
    /// Standard deviation of its logarithm; infinite where the matches do not tell.
    pub focal_log_sigma: f64,
    /// By how many decades fewer poses are expected by chance with that factor than with the focal lengths as they are given.
    pub focal_decades: f64,
    /// [`Evidence::log10_false_alarms`] of the best pose with left and right of the images exchanged, which no camera shows.
    pub log10_false_alarms_mirrored: f64,
    /// Decades below one false alarm, for each first match, that matches of this feature reach which are wrong together.
    pub decades_together: f64,
    /// First inliers of the best pose that contradicts this one and is not to be expected by chance either.
    pub rival_inliers: usize,
}

/// Pairs made by look alone, before any pose, each point and each spot of an image once: the better of two stays.
pub(super) struct FirstMatches {
    matches: Vec<PointMatch>,
}

impl FirstMatches {
    /// The pairs.
    pub fn matches(&self) -> &[PointMatch] {
        &self.matches
    }

    /// Of `matches` with their descriptor distances and points; `apart_px` is the radius of a spot.
    pub fn new(mut matches: Vec<(u32, u32, PointMatch)>, apart_px: f64) -> Self {
        matches.sort_by_key(|(distance_squared, point, _)| (*distance_squared, *point));
        let mut points: Vec<u32> = Vec::new();
        let mut kept: Vec<PointMatch> = Vec::new();
        for (_, point, m) in matches {
            let taken = kept
                .iter()
                .any(|k| k.camera == m.camera && (k.pixel - m.pixel).norm() < apart_px);
            if !taken && !points.contains(&point) {
                points.push(point);
                kept.push(m);
            }
        }
        Self { matches: kept }
    }

    /// The same pairs with left and right of each image exchanged about its principal point.
    pub fn mirrored(&self, cameras: &[MountedCamera]) -> Self {
        let mirrored = self.matches.iter().filter_map(|m| {
            let [principal_px, _] = cameras.get(m.camera)?.camera.principal_px();
            let pixel = Vector2::new(2.0 * principal_px - m.pixel.x, m.pixel.y);
            Some(PointMatch { pixel, ..*m })
        });
        Self {
            matches: mirrored.collect(),
        }
    }

    /// How well they agree with a pose: by the tolerance, `max_error_px` or a share of it, by which that is least likely by chance.
    pub fn agreement(
        &self,
        cameras: &[MountedCamera],
        world_from_rig: &Se3,
        max_error_px: f64,
    ) -> Agreement {
        let projected: Vec<Option<Vector2<f64>>> = self
            .matches
            .iter()
            .map(|m| {
                let mounted = cameras.get(m.camera)?;
                let camera_from_world = (*world_from_rig * mounted.rig_from_camera).inverse();
                mounted
                    .camera
                    .project(&(camera_from_world * m.point_in_world))
            })
            .collect();
        let tolerances_px = TOLERANCES.map(|share| share * max_error_px);
        let (mut inliers, mut by_chance) = ([0usize; TOLERANCES.len()], [0usize; TOLERANCES.len()]);
        let mut pairs = 0usize;
        for (i, m) in self.matches.iter().enumerate() {
            for (j, (other, projected)) in self.matches.iter().zip(&projected).enumerate() {
                if m.camera != other.camera {
                    continue;
                }
                pairs += usize::from(i != j);
                let error_px = projected.map_or(f64::INFINITY, |p| (p - m.pixel).norm());
                let counts = if i == j { &mut inliers } else { &mut by_chance };
                for (count, tolerance_px) in counts.iter_mut().zip(tolerances_px) {
                    *count += usize::from(error_px <= tolerance_px);
                }
            }
        }
        let areas_px2 = cameras.iter().map(|c| {
            let (width, height) = (f64::from(c.camera.width), f64::from(c.camera.height));
            (width * height).max(1.0)
        });
        let largest_px2 = areas_px2.fold(1.0, f64::max);
        let agreement = |k: usize| {
            let disc_px2 = std::f64::consts::PI * tolerances_px[k].powi(2);
            let measured = by_chance[k] as f64 / pairs.max(1) as f64;
            Agreement {
                matches: self.matches.len(),
                inliers: inliers[k],
                chance_level: measured.max(disc_px2 / largest_px2).min(1.0),
            }
        };
        let widest = agreement(TOLERANCES.len() - 1);
        let tighter = (0..TOLERANCES.len() - 1).map(agreement);
        tighter.fold(widest, |best, other| {
            let better = other.log10_false_alarms(1) < best.log10_false_alarms(1);
            if better { other } else { best }
        })
    }
}

/// Tolerances at which agreement is looked for, as shares of the largest: how exact map, lens and keypoints are differs from place
/// to place.
const TOLERANCES: [f64; 3] = [0.25, 0.5, 1.0];

/// How well the first matches agree with a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    pub matches: usize,
    pub inliers: usize,
    pub chance_level: f64,
}

/// Matches that determine a pose.
const SAMPLE: usize = 3;
/// Poses at most of three matches.
const POSES_PER_SAMPLE: f64 = 4.0;

impl Agreement {
    /// Of so many matches with no pose.
    pub fn none(matches: usize) -> Self {
        Self {
            matches,
            inliers: 0,
            chance_level: 1.0,
        }
    }

    /// Decimal logarithm of the expected number of poses with as many inliers, were all matches wrong and `places` places
    /// tried with each tolerance: `places · tolerances · 4 (n − 3) · C(n, k) · C(k, 3) · p^(k − 3)`.
    pub fn log10_false_alarms(&self, places: usize) -> f64 {
        let (n, k) = (self.matches, self.inliers);
        if k <= SAMPLE || n <= SAMPLE {
            return log10_binomial(n, SAMPLE).max(0.0);
        }
        let tries = places.max(1) as f64 * TOLERANCES.len() as f64;
        let tests = tries * POSES_PER_SAMPLE * (n - SAMPLE) as f64;
        let by_chance = (k - SAMPLE) as f64 * self.chance_level.log10();
        tests.log10() + log10_binomial(n, k) + log10_binomial(k, SAMPLE) + by_chance
    }
}

fn log10_binomial(n: usize, k: usize) -> f64 {
    (1..=k.min(n))
        .map(|i| ((n - i + 1) as f64 / i as f64).log10())
        .sum()
}

/// Spread of pixels over an image of this size: the root of the determinant of their covariance over that of an even
/// distribution, 1 at most.
pub(super) fn image_spread(pixels: &[Vector2<f64>], width: u32, height: u32) -> f64 {
    if pixels.is_empty() {
        return 0.0;
    }
    let count = pixels.len() as f64;
    let mean = pixels.iter().sum::<Vector2<f64>>() / count;
    let covariance: Matrix2<f64> = pixels
        .iter()
        .map(|p| (p - mean) * (p - mean).transpose())
        .sum::<Matrix2<f64>>()
        / count;
    let even = f64::from(width) * f64::from(height) / 12.0;
    (covariance.determinant().max(0.0).sqrt() / even.max(1.0)).min(1.0)
}

/// Weights of the evidence in the logit of the probability; see the head of this file.
struct Weights {
    constant: f64,
    /// Of decades below one false alarm.
    false_alarms: f64,
    /// Of the logarithm of guided inliers to decoys.
    decoys: f64,
    /// Of the spread over the image.
    spread: f64,
}

const WEIGHTS: Weights = Weights {
    constant: -10.461,
    false_alarms: 0.785,
    decoys: 1.975,
    spread: 24.539,
};

/// Decades below one false alarm, for each first match, that matches reach which are wrong together: a network's features know no left
/// and right, and find what is built alike more often than SIFT.
pub(super) fn decades_together(feature: &Feature) -> f64 {
    match feature {
        Feature::Sift => 0.04,
        Feature::Learned(_) => 0.15,
    }
}

/// Focal lengths may be off by this much, as a logarithm: what is left of calibrations, and of maps that are not quite in scale.
const MAX_LOG_FOCAL: f64 = 0.05;
/// Others fit better for sure where they are this many standard deviations away, and this many decades less by chance.
const SURE_SIGMAS: f64 = 3.0;
const SURE_DECADES: f64 = 3.0;

impl Evidence {
    /// Probability that the pose is right: that of the evidence, of the search not having reached it by chance, and of the rival
    /// not being the right one.
    pub fn probability(&self) -> f64 {
        let (guided, decoys) = (self.guided_inliers as f64, self.decoy_inliers);
        // Each kind of evidence is bounded: none can do without the others.
        let logit = WEIGHTS.constant
            + WEIGHTS.false_alarms * (-self.log10_false_alarms).clamp(-10.0, 20.0)
            + WEIGHTS.decoys * ((guided + 1.0) / (decoys + 1.0)).ln().clamp(0.0, 2.0)
            + WEIGHTS.spread * self.image_spread.min(0.4);
        let of_evidence = 1.0 / (1.0 + (-logit).exp());
        let no_chance = 1.0 / (1.0 + 10f64.powf(self.log10_false_alarms));
        of_evidence
            * no_chance
            * self.probability_against_likeness()
            * self.probability_against_rival()
    }

    /// Against matches that are wrong together: parts that look alike in a mirror or in a row agree with a pose of their own, so many
    /// of so few at that, however unlikely that were of each alone. And against a mirror, which explains them better.
    fn probability_against_likeness(&self) -> f64 {
        let decades = -self.log10_false_alarms / self.first_matches.max(1) as f64;
        let together = 1.0 / (1.0 + (self.decades_together / decades.max(1e-9)).powi(6));
        let by_mirror = self.log10_false_alarms - self.log10_false_alarms_mirrored;
        together / (1.0 + 10f64.powf(by_mirror))
    }

    /// Whether the matches surely fit another focal length than the cameras are said to have.
    pub fn contradicts_focal_length(&self) -> bool {
        let off = self.focal_scale.ln().abs();
        off > MAX_LOG_FOCAL
            && off > SURE_SIGMAS * self.focal_log_sigma
            && self.focal_decades > SURE_DECADES
    }

    /// One half where the rival has as many inliers, 0.98 where it has half of them.
    fn probability_against_rival(&self) -> f64 {
        let share = self.rival_inliers as f64 / self.first_inliers.max(1) as f64;
        1.0 / (1.0 + share.powi(6))
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Matrix3, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn camera() -> [MountedCamera; 1] {
        [MountedCamera {
            camera: Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::identity(),
            readout_s: 0.0,
        }]
    }

    /// Points before the camera at the origin: the first `right` are seen where they are, the others anywhere.
    fn matches(count: usize, right: usize, depth_m: f64) -> FirstMatches {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut pixel = || Vector2::new(rng.random_range(0.0..639.0), rng.random_range(0.0..479.0));
        let matches = (0..count).map(|i| {
            let shown = pixel();
            let ray = camera()[0].camera.unproject(&shown).unwrap_or_default();
            let m = PointMatch {
                camera: 0,
                pixel: if i < right { shown } else { pixel() },
                point_in_world: Vector3::z() * (depth_m - 1.0) + ray / ray.z,
                point_covariance_m2: Matrix3::zeros(),
            };
            (i as u32, i as u32, m)
        });
        FirstMatches::new(matches.collect(), 0.0)
    }

    #[test]
    fn few_that_agree_are_no_chance_and_many_may_be() {
        let pose = Se3::identity();
        let agreement = matches(200, 20, 1.0).agreement(&camera(), &pose, 3.0);
        assert!((20..23).contains(&agreement.inliers), "{agreement:?}");
        // 28 of 307 200 pixels.
        assert!(agreement.chance_level < 3e-4, "{agreement:?}");
        assert!(agreement.log10_false_alarms(1) < -20.0);
        // From far away all points are seen in one spot: whatever is seen there agrees with any of them.
        let heap = matches(200, 0, 400.0);
        let spot = FirstMatches {
            matches: heap
                .matches
                .iter()
                .map(|m| PointMatch {
                    pixel: Vector2::new(319.5, 239.5),
                    ..*m
                })
                .collect(),
        };
        let agreement = spot.agreement(&camera(), &pose, 3.0);
        assert!(agreement.inliers > 180, "{agreement:?}");
        assert!(agreement.log10_false_alarms(1) > 0.0, "{agreement:?}");
    }

    #[test]
    fn poses_found_by_chance_are_expected() {
        for count in [0, 1, 3, 4, 50] {
            let agreement = matches(count, 3.min(count), 1.0);
            let agreement = agreement.agreement(&camera(), &Se3::identity(), 3.0);
            assert!(
                agreement.log10_false_alarms(3) >= 0.0,
                "{count}: {agreement:?}"
            );
        }
    }

    #[test]
    fn a_place_that_looks_the_same_makes_a_pose_doubtful() {
        let sure = Evidence {
            first_matches: 300,
            first_inliers: 90,
            chance_level: 0.001,
            log10_false_alarms: -120.0,
            guided_inliers: 200,
            decoy_inliers: 12.0,
            image_spread: 0.6,
            focal_scale: 1.0,
            focal_log_sigma: 0.01,
            focal_decades: 0.0,
            log10_false_alarms_mirrored: 3.0,
            decades_together: decades_together(&Feature::Sift),
            rival_inliers: 0,
        };
        assert!(sure.probability() > 0.999);
        let with_rival = |rival_inliers| Evidence {
            rival_inliers,
            ..sure
        };
        assert!(with_rival(85).probability() < 0.6);
        assert!(with_rival(25).probability() > 0.99);
        // As many inliers as ever after guided matching, but none that was not searched for.
        let searched = Evidence {
            first_inliers: 3,
            log10_false_alarms: 6.0,
            decoy_inliers: 60.0,
            image_spread: 0.1,
            ..sure
        };
        assert!(searched.probability() < 1e-3);
    }

    #[test]
    fn another_focal_length_must_fit_for_sure() {
        let as_calibrated = Evidence {
            first_matches: 300,
            first_inliers: 90,
            chance_level: 0.001,
            log10_false_alarms: -120.0,
            guided_inliers: 200,
            decoy_inliers: 12.0,
            image_spread: 0.6,
            focal_scale: 1.02,
            focal_log_sigma: 0.003,
            focal_decades: 30.0,
            log10_false_alarms_mirrored: 3.0,
            decades_together: 0.15,
            rival_inliers: 0,
        };
        assert!(!as_calibrated.contradicts_focal_length());
        // Half-size images in a frame have 200 guided inliers and all else that makes a pose probable.
        let resized = Evidence {
            focal_scale: 0.5,
            ..as_calibrated
        };
        assert!(resized.probability() > 0.99 && resized.contradicts_focal_length());
        let (unsure, no_better) = (
            Evidence {
                focal_log_sigma: 0.3,
                ..resized
            },
            Evidence {
                focal_decades: 1.0,
                ..resized
            },
        );
        assert!(!unsure.contradicts_focal_length() && !no_better.contradicts_focal_length());
    }

    #[test]
    fn what_looks_alike_in_a_mirror_is_no_place() {
        // A mirrored image with XFeat: 22 of 300 first matches agree.
        let mirrored = Evidence {
            first_matches: 300,
            first_inliers: 22,
            chance_level: 0.001,
            log10_false_alarms: -18.0,
            guided_inliers: 53,
            decoy_inliers: 6.0,
            image_spread: 0.35,
            focal_scale: 1.0,
            focal_log_sigma: 0.03,
            focal_decades: 0.0,
            log10_false_alarms_mirrored: 3.0,
            decades_together: 0.15,
            rival_inliers: 0,
        };
        assert!(mirrored.probability() < 0.95);
        let alone = Evidence {
            log10_false_alarms: -190.0,
            ..mirrored
        };
        assert!(alone.probability() > 0.99);
        let explained = Evidence {
            log10_false_alarms_mirrored: -300.0,
            ..alone
        };
        assert!(explained.probability() < 0.01);
    }

    #[test]
    fn what_a_mirror_shows_agrees_with_what_is_exchanged() {
        let pose = Se3::identity();
        let shown = matches(200, 60, 1.0);
        let exchanged = shown.mirrored(&camera());
        let agreement = exchanged.agreement(&camera(), &pose, 3.0);
        assert!(agreement.log10_false_alarms(1) > 0.0, "{agreement:?}");
        let back = exchanged.mirrored(&camera());
        assert!(back.agreement(&camera(), &pose, 3.0).inliers >= 60);
    }

    #[test]
    fn a_spot_or_a_point_counts_once() {
        let m = |x: f64| PointMatch {
            camera: 0,
            pixel: Vector2::new(x, 10.0),
            point_in_world: Vector3::z(),
            point_covariance_m2: Matrix3::zeros(),
        };
        let all = vec![
            (5, 1, m(10.0)),
            (3, 2, m(12.0)),
            (9, 2, m(50.0)),
            (7, 3, m(90.0)),
        ];
        let kept = FirstMatches::new(all, 6.0).matches;
        let pixels: Vec<f64> = kept.iter().map(|k| k.pixel.x).collect();
        assert_eq!(pixels, [12.0, 90.0]);
    }

    #[test]
    fn spread_is_that_of_an_even_distribution() {
        let grid: Vec<Vector2<f64>> = (0..6400)
            .map(|i| Vector2::new(f64::from(i % 80) * 8.0, f64::from(i / 80) * 6.0))
            .collect();
        assert!((image_spread(&grid, 640, 480) - 1.0).abs() < 0.01);
        let line: Vec<_> = grid.iter().map(|p| Vector2::new(p.x, p.x)).collect();
        assert!(image_spread(&line, 640, 480) < 1e-6);
        assert_eq!(image_spread(&[], 640, 480), 0.0);
    }
}
