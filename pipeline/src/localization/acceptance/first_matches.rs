//! How many of the pairs that were made before there was a pose agree with it, and how many would by chance.

use lsfb_geometry::{Se3, Vector2};

use crate::localization::matches::{MountedCamera, PointMatch};

/// Pairs made by look alone, before any pose, each point and each spot of an image once: the better of two stays.
pub(in crate::localization) struct FirstMatches {
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

    /// Those that agree with a pose within a tolerance.
    pub fn agreeing(
        &self,
        cameras: &[MountedCamera],
        world_from_rig: &Se3,
        tolerance_px: f64,
    ) -> Vec<PointMatch> {
        let agrees = |m: &&PointMatch| {
            projected(m, cameras, world_from_rig)
                .is_some_and(|pixel| (pixel - m.pixel).norm() <= tolerance_px)
        };
        self.matches.iter().filter(agrees).copied().collect()
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
            .map(|m| projected(m, cameras, world_from_rig))
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
                tolerance_px: tolerances_px[k],
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

/// Where a pose shows the point of a match.
fn projected(
    m: &PointMatch,
    cameras: &[MountedCamera],
    world_from_rig: &Se3,
) -> Option<Vector2<f64>> {
    let mounted = cameras.get(m.camera)?;
    let camera_from_world = (*world_from_rig * mounted.rig_from_camera).inverse();
    mounted
        .camera
        .project(&(camera_from_world * m.point_in_world))
}

/// Tolerances at which agreement is looked for, as shares of the largest: how exact map, lens and keypoints are differs from place
/// to place.
const TOLERANCES: [f64; 3] = [0.25, 0.5, 1.0];

/// How well the first matches agree with a pose.
#[derive(Clone, Copy, Debug)]
pub(in crate::localization) struct Agreement {
    pub matches: usize,
    pub inliers: usize,
    /// Within which these are, pixels.
    pub tolerance_px: f64,
    pub chance_level: f64,
}

/// Matches that determine a pose.
const SAMPLE: usize = 3;
/// Poses at most of three matches of one camera; of several cameras, where a few matches are all, there may be twice as many, a third of a decade.
const POSES_PER_SAMPLE: f64 = 4.0;

impl Agreement {
    /// Of so many matches with no pose.
    pub fn none(matches: usize) -> Self {
        Self {
            matches,
            inliers: 0,
            tolerance_px: 0.0,
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
        let shown = matches(200, 20, 1.0);
        let agreement = shown.agreement(&camera(), &pose, 3.0);
        assert!((20..23).contains(&agreement.inliers), "{agreement:?}");
        let agreeing = shown.agreeing(&camera(), &pose, agreement.tolerance_px);
        assert_eq!(agreeing.len(), agreement.inliers);
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
}
