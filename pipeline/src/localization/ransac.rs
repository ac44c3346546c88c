//! Robust pose of a rig of cameras: P3P hypotheses with local optimisation (Chum, Matas, Kittler, "Locally optimized
//! RANSAC", DAGM 2003), scored over the matches of all cameras.

use lsfb_geometry::{Se3, Vector3};
use lsfb_types::Bounds;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::generalized_p3p::solve_generalized_p3p;
use super::matches::{MountedCamera, PointMatch};
use super::p3p::solve_p3p;
use super::prior::PoseKnowledge;
use super::refinement::{RefinementConfig, refine_pose};
use super::scoring::Scoring;
use super::upright::{SeenPoint, solve_upright};
use crate::sampling::samples_needed;

/// Configuration of [`estimate_pose`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RansacConfig {
    /// Largest reprojection error of an inlier, pixels.
    pub max_error_px: f64,
    /// Most samples drawn.
    pub max_samples: usize,
    /// Fewest samples drawn, however good the best one looks.
    pub min_samples: usize,
    /// Probability with which a sample of inliers only must have been drawn before stopping.
    pub confidence: f64,
    /// Seed of the samples.
    pub seed: u64,
    /// The local optimisation.
    pub refinement: RefinementConfig,
}

impl Default for RansacConfig {
    fn default() -> Self {
        Self {
            max_error_px: 8.0,
            max_samples: 2000,
            min_samples: 30,
            confidence: 0.9999,
            seed: 1,
            refinement: RefinementConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    RansacConfig {
        max_error_px: number(Bounds::POSITIVE),
        max_samples: any,
        min_samples: any,
        confidence: number(Bounds::Within(0.0, 1.0)),
        seed: any,
        refinement: section,
    }
}

/// A pose with the matches that support it.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseEstimate {
    /// Pose of the rig.
    pub world_from_rig: Se3,
    /// Indices of the inliers, ascending.
    pub inliers: Vec<usize>,
    /// Samples drawn.
    pub samples: usize,
}

/// A match prepared for scoring: everything in the rig frame, without a lens.
struct Bearing {
    match_index: usize,
    camera: usize,
    ray_in_camera: Vector3<f64>,
    seen: SeenPoint,
    /// Squared sine of the largest angle of an inlier.
    limit: f64,
}

/// The pose most matches agree with; `None` where no sample of three gives one that a fourth supports. The three
/// of a sample come from one camera, unless so few matches do that samples must be of several. Same matches and seed give the same pose.
pub fn estimate_pose(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    config: &RansacConfig,
) -> Option<PoseEstimate> {
    estimate_known_pose(cameras, matches, &PoseKnowledge::NOTHING, config)
}

/// [`estimate_pose`] among poses that do not contradict what is known: where up is, every second sample has two matches.
pub fn estimate_known_pose(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    known: &PoseKnowledge,
    config: &RansacConfig,
) -> Option<PoseEstimate> {
    let bearings = prepare(cameras, matches, config.max_error_px);
    let groups: Vec<Vec<usize>> = (0..cameras.len())
        .map(|c| {
            (0..bearings.len())
                .filter(|i| bearings[*i].camera == c)
                .collect::<Vec<_>>()
        })
        .filter(|group: &Vec<usize>| group.len() >= 3)
        .collect();
    let samplable: usize = groups.iter().map(Vec::len).sum();
    if bearings.len() < 4 {
        return None;
    }
    let scoring = Scoring::new(bearings.iter().map(|b| (&b.seen, b.limit)));
    let all: Vec<usize> = (0..bearings.len()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut best: Option<(Se3, f64)> = None;
    let mut needed = config.max_samples;
    let mut samples = 0;
    while samples < needed.max(config.min_samples).min(config.max_samples) {
        samples += 1;
        let poses = match &known.up {
            Some(up) if samples % 2 == 0 => {
                let [a, b] = two_of(bearings.len(), &mut rng).map(|i| &bearings[i].seen);
                solve_upright(&up.in_rig, [a, b])
            }
            _ if samplable < 4 => {
                let sample = three_of(&all, &mut rng).map(|i| &bearings[i].seen);
                solve_generalized_p3p(sample)
            }
            _ => {
                let group = choose_group(&groups, samplable, &mut rng);
                let [a, b, c] = three_of(group, &mut rng).map(|i| &bearings[i]);
                let rays = [a.ray_in_camera, b.ray_in_camera, c.ray_in_camera];
                let points = [a, b, c].map(|b| b.seen.point_in_world);
                let rig_from_camera = cameras[a.camera].rig_from_camera;
                let poses = solve_p3p(&rays, &points).into_iter();
                poses
                    .map(|camera_from_world| rig_from_camera * camera_from_world)
                    .collect()
            }
        };
        for rig_from_world in poses {
            let world_from_rig = rig_from_world.inverse();
            if known.contradicts(&world_from_rig) {
                continue;
            }
            let bound = best.as_ref().map_or(f64::INFINITY, |(_, score)| *score);
            let Some(score) = scoring.score(&rig_from_world, bound) else {
                continue;
            };
            best = Some(optimise(
                cameras,
                matches,
                &bearings,
                &scoring,
                world_from_rig,
                score,
                config,
            ));
            let (pose, _) = best.as_ref()?;
            let count = inliers(&bearings, &pose.inverse()).count();
            needed = samples_needed(count as f64 / bearings.len() as f64, 3, config.confidence);
        }
    }
    let (world_from_rig, _) = best?;
    let inliers: Vec<usize> = inliers(&bearings, &world_from_rig.inverse())
        .map(|b| b.match_index)
        .collect();
    (inliers.len() >= 4).then_some(PoseEstimate {
        world_from_rig,
        inliers,
        samples,
    })
}

fn prepare(cameras: &[MountedCamera], matches: &[PointMatch], max_error_px: f64) -> Vec<Bearing> {
    matches
        .iter()
        .enumerate()
        .filter_map(|(match_index, m)| {
            let mounted = cameras.get(m.camera)?;
            let ray = mounted.camera.unproject(&m.pixel)?;
            let seen = mounted.camera.project_with_jacobian(&ray)?;
            // Pixels per radian here, the smaller of the two directions across the ray.
            let stretch =
                (seen.pixel_by_point * seen.pixel_by_point.transpose()).symmetric_eigenvalues();
            let angle = max_error_px / stretch.min().max(1.0).sqrt();
            Some(Bearing {
                match_index,
                camera: m.camera,
                ray_in_camera: ray,
                seen: SeenPoint {
                    ray_in_rig: mounted.rig_from_camera.rotation * ray,
                    origin_in_rig: mounted.rig_from_camera.translation,
                    point_in_world: m.point_in_world,
                },
                limit: angle.min(1.0).sin().powi(2),
            })
        })
        .collect()
}

fn choose_group<'a>(groups: &'a [Vec<usize>], total: usize, rng: &mut ChaCha8Rng) -> &'a [usize] {
    let mut pick = rng.random_range(0..total);
    for group in groups {
        if pick < group.len() {
            return group;
        }
        pick -= group.len();
    }
    &groups[0]
}

fn three_of(group: &[usize], rng: &mut ChaCha8Rng) -> [usize; 3] {
    let n = group.len();
    let i = rng.random_range(0..n);
    let j = (i + rng.random_range(1..n)) % n;
    loop {
        let k = rng.random_range(0..n);
        if k != i && k != j {
            return [group[i], group[j], group[k]];
        }
    }
}

fn two_of(count: usize, rng: &mut ChaCha8Rng) -> [usize; 2] {
    let i = rng.random_range(0..count);
    [i, (i + rng.random_range(1..count)) % count]
}

/// Squared sine of the angle between a bearing and where the pose expects its point; above 1 behind.
fn squared_sine(b: &Bearing, rotation: &nalgebra::Matrix3<f64>, translation: &Vector3<f64>) -> f64 {
    let seen = &b.seen;
    let direction = rotation * seen.point_in_world + translation - seen.origin_in_rig;
    if direction.dot(&seen.ray_in_rig) <= 0.0 {
        return 2.0;
    }
    direction.cross(&seen.ray_in_rig).norm_squared() / direction.norm_squared()
}

fn inliers<'a>(
    bearings: &'a [Bearing],
    rig_from_world: &Se3,
) -> impl Iterator<Item = &'a Bearing> + 'a {
    let (rotation, translation) = (rig_from_world.rotation_matrix(), rig_from_world.translation);
    bearings
        .iter()
        .filter(move |b| squared_sine(b, &rotation, &translation) <= b.limit)
}

/// Refines on the inliers while that lowers the score.
fn optimise(
    cameras: &[MountedCamera],
    matches: &[PointMatch],
    bearings: &[Bearing],
    scoring: &Scoring,
    start: Se3,
    start_score: f64,
    config: &RansacConfig,
) -> (Se3, f64) {
    let mut best = (start, start_score);
    for _ in 0..4 {
        let support: Vec<PointMatch> = inliers(bearings, &best.0.inverse())
            .map(|b| matches[b.match_index])
            .collect();
        let Some(refined) = refine_pose(cameras, &support, &best.0, &config.refinement) else {
            break;
        };
        let Some(better) = scoring.score(&refined.world_from_rig.inverse(), best.1) else {
            break;
        };
        best = (refined.world_from_rig, better);
    }
    best
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Matrix3, Vector2};

    use super::super::prior::Up;
    use super::*;
    use lsfb_geometry::camera::Lens;
    use lsfb_geometry::{Vector6, so3};

    pub(crate) fn stereo() -> [MountedCamera; 2] {
        let camera = Camera {
            width: 640,
            height: 400,
            lens: Lens::KannalaBrandt {
                focal_px: [290.0; 2],
                principal_px: [319.5, 199.5],
                distortion: [0.01, -0.005, 0.001, 0.0],
            },
        };
        [0.06, -0.06].map(|y| MountedCamera {
            camera,
            rig_from_camera: Se3::exp(&Vector6::new(-1.2, 1.2, -1.2, 0.02, y, 0.0)),
            readout_s: 0.0,
        })
    }

    /// Matches of a known pose: half-pixel noise, and a share of pixels anywhere.
    fn problem(count: usize, outliers: f64, seed: u64) -> (Se3, Vec<PointMatch>) {
        let cameras = stereo();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let truth = Se3::exp(&Vector6::new(0.3, -0.4, 1.0, 2.0, -1.0, 0.5));
        let mut matches = Vec::new();
        while matches.len() < count {
            let camera = matches.len() % 2;
            let mounted = &cameras[camera];
            let pixel = Vector2::new(rng.random_range(0.0..639.0), rng.random_range(0.0..399.0));
            let Some(ray) = mounted.camera.unproject(&pixel) else {
                continue;
            };
            let depth = rng.random_range(1.0..6.0);
            let seen = if rng.random_bool(outliers) {
                Vector2::new(rng.random_range(0.0..639.0), rng.random_range(0.0..399.0))
            } else {
                let mut noise = || rng.random_range(-0.8..0.8);
                pixel + Vector2::new(noise(), noise())
            };
            matches.push(PointMatch {
                camera,
                pixel: seen,
                point_in_world: truth * (mounted.rig_from_camera * (ray * depth)),
                point_covariance_m2: Matrix3::zeros(),
            });
        }
        (truth, matches)
    }

    #[test]
    fn finds_the_pose_among_many_outliers() {
        for (outliers, seed) in [(0.0, 1), (0.5, 2), (0.8, 3)] {
            let (truth, matches) = problem(400, outliers, seed);
            let found =
                estimate_pose(&stereo(), &matches, &RansacConfig::default()).expect("a pose");
            let error = truth.inverse() * found.world_from_rig;
            assert!(error.translation.norm() < 0.01, "{outliers}: {error:?}");
            assert!(error.log().fixed_rows::<3>(0).norm() < 0.003, "{outliers}");
            let share = found.inliers.len() as f64 / 400.0;
            assert!(
                (share - (1.0 - outliers)).abs() < 0.08,
                "{outliers}: {share}"
            );
            let again = estimate_pose(&stereo(), &matches, &RansacConfig::default());
            assert_eq!(again.as_ref(), Some(&found));
        }
    }

    /// One in twelve is right: of three matches all are once in 1 700 samples, of two once in 144.
    #[test]
    fn who_knows_which_way_is_up_finds_the_pose_among_more_outliers() {
        let config = RansacConfig {
            max_samples: 1000,
            ..RansacConfig::default()
        };
        let (mut blind, mut upright) = (0, 0);
        for seed in 0..10 {
            let (truth, matches) = problem(300, 0.92, 20 + seed);
            let up = truth.rotation.inverse() * Vector3::z();
            // A degree off.
            let off = so3::exp(&Vector3::new(0.012, -0.012, 0.0));
            let known = PoseKnowledge {
                up: Some(Up {
                    in_rig: off * up,
                    sigma_rad: 0.02,
                }),
                pose: None,
            };
            let is_right = |found: Option<PoseEstimate>| {
                found.is_some_and(|found| {
                    let error = truth.inverse() * found.world_from_rig;
                    error.translation.norm() < 0.05
                })
            };
            blind += usize::from(is_right(estimate_pose(&stereo(), &matches, &config)));
            let found = estimate_known_pose(&stereo(), &matches, &known, &config);
            upright += usize::from(is_right(found));
        }
        assert!(upright >= 9 && blind <= upright - 3, "{blind}, {upright}");
    }

    /// Two matches in each of three cameras, and no camera with three.
    #[test]
    fn two_matches_in_each_of_three_cameras_are_a_pose() {
        let mut cameras = stereo().to_vec();
        cameras.push(MountedCamera {
            rig_from_camera: Se3::exp(&Vector6::new(-1.0, 1.0, -1.6, -0.1, 0.0, 0.15)),
            ..cameras[0]
        });
        let (mut worst, mut lost) = (0.0f64, 0);
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(50 + seed);
            let truth = Se3::exp(&Vector6::new(0.3, -0.4, 1.0, 2.0, -1.0, 0.5));
            let matches: Vec<PointMatch> = (0..6)
                .map(|k| {
                    let mounted = &cameras[k % 3];
                    let pixel = Vector2::new(
                        rng.random_range(100.0..540.0),
                        rng.random_range(60.0..340.0),
                    );
                    let ray = mounted.camera.unproject(&pixel).expect("a ray");
                    let depth = rng.random_range(1.0..6.0);
                    PointMatch {
                        camera: k % 3,
                        pixel,
                        point_in_world: truth * (mounted.rig_from_camera * (ray * depth)),
                        point_covariance_m2: Matrix3::zeros(),
                    }
                })
                .collect();
            let found = estimate_pose(&cameras, &matches, &RansacConfig::default());
            let off = found.filter(|found| found.inliers.len() == 6).map(|found| {
                let off = truth.inverse() * found.world_from_rig;
                off.translation.norm().max(off.rotation.angle())
            });
            match off {
                Some(off) => worst = worst.max(off),
                None => lost += 1,
            }
            // Five: two cameras with two, one with one; and where up is known.
            let up = Up {
                in_rig: truth.rotation.inverse() * Vector3::z(),
                sigma_rad: 0.02,
            };
            let known = PoseKnowledge {
                up: Some(up),
                pose: None,
            };
            let config = RansacConfig::default();
            let found = estimate_known_pose(&cameras, &matches[..5], &known, &config);
            let off = found.map(|found| (truth.inverse() * found.world_from_rig).log().norm());
            lost += usize::from(off.is_none_or(|off| off > 1e-6));
        }
        assert!(lost == 0 && worst < 1e-8, "{lost} lost, {worst}");
    }

    #[test]
    fn nothing_comes_of_nothing() {
        let (_, matches) = problem(3, 0.0, 4);
        assert!(estimate_pose(&stereo(), &matches, &RansacConfig::default()).is_none());
        assert!(estimate_pose(&[], &matches, &RansacConfig::default()).is_none());
        let (_, noise) = problem(60, 1.0, 5);
        if let Some(found) = estimate_pose(&stereo(), &noise, &RansacConfig::default()) {
            assert!(found.inliers.len() < 12, "{}", found.inliers.len());
        }
    }
}
