//! How far each pose may be off.
//!
//! Around each pose the problem of eq. (5) is linearized once more, over a few seconds, with what it holds fixed set free: a
//! point of the map is only known to what the map says of it and what the walk itself shows of the map's errors, and errs the same
//! way in all images that see it. What lies outside the window would make the poses surer, by little: they are rather called too
//! uncertain. Errors that neighbouring points share are not in it: the cross-check tells those.

use std::collections::BTreeMap;
use std::ops::Range;

use lsfb_geometry::{Matrix3, Matrix6, Vector3};
use lsfb_solver::{BlockId, Kernel, Problem, VectorPrior, covariance};
use lsfb_types::{Progress, ProgressFn};
use nalgebra::SMatrix;

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::inertial::add_inertial_residuals;
use super::report::{local_errors, map_errors};
use super::walk::{FixedObservation, LocalObservation, LocalPoint, Walk};
use crate::Error;
use crate::inertial_blocks::StateBlocks;
use crate::residuals::{CameraCorrection, MovingReprojection};

/// Frames whose covariance one window gives, and time before and after them that it covers, seconds.
const FRAMES_AT_ONCE: usize = 30;
const MARGIN_SECS: f64 = 1.5;
/// Keypoints are no better than this, pixels in each direction.
const LEAST_PIXEL_SIGMA: f64 = 0.2;
/// Points of the map are no better than this, metres.
const LEAST_POINT_SIGMA_M: f64 = 1e-3;
/// Standard deviation of a local point's place beside its sights, as a share of its distance. It was located by the whole walk; the
/// sights of one window, of somebody who stands, may leave its distance open, and then nothing of the window would be determined.
const LOCAL_POINT_SHARE: f64 = 1.0;

/// Errors that the walk shows, as deviations in each direction.
#[derive(Clone, Copy)]
pub(super) struct Deviations {
    /// Of a keypoint, pixels.
    pixel_px: f64,
    /// Of a point of the map, pixels as seen by the walk.
    map_px: f64,
}

impl Deviations {
    /// What the map's points are off more than local points, which lie where the walk wants them, is the map's.
    pub(super) fn of(walk: &Walk, estimate: &Estimate, points: &[LocalPoint]) -> Self {
        let (map, local) = (map_errors(walk, estimate), local_errors(estimate, points));
        let local_px2 = 0.5 * local.rms_px.powi(2);
        let map_px2 = 0.5 * map.rms_px.powi(2);
        let pixel_px2 = match local.count {
            0 => map_px2,
            _ => local_px2,
        };
        Self {
            pixel_px: pixel_px2.sqrt().max(LEAST_PIXEL_SIGMA),
            map_px: (map_px2 - pixel_px2).max(0.25 * map_px2).sqrt(),
        }
    }

    /// Of a point of the map that a frame sees, metres in each direction.
    pub(super) fn of_map_point_m(
        &self,
        estimate: &Estimate,
        frame: usize,
        seen: &FixedObservation,
    ) -> f64 {
        let away_m = (seen.point_in_world - estimate.pose(frame).translation).norm();
        let focal_px = estimate.cameras[seen.camera].camera().focal_px()[0];
        (self.map_px * away_m / focal_px).max(LEAST_POINT_SIGMA_M)
    }
}

/// How far what was found may be off.
pub(super) struct Uncertainty {
    /// Covariance of the pose of each frame, tangent `[rotation, translation]` on the right, rad² and m²; `None` where what lies
    /// around it does not determine it.
    pub poses: Vec<Option<Matrix6<f64>>>,
    /// Standard deviations of each camera's correction.
    pub corrections: Vec<CameraCorrection>,
}

/// Linearizes around every pose; what the parts of the walk say of the cameras adds up.
pub(super) fn uncertainty(
    walk: &Walk,
    estimate: &Estimate,
    points: &[LocalPoint],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Uncertainty, Error> {
    let shown = Deviations::of(walk, estimate, points);
    let count = walk.frames.len();
    let mut poses = Vec::with_capacity(count);
    let stated = walk.cameras.iter();
    let stated: Vec<_> = stated.map(|c| config.calibration_sigmas(c)).collect();
    let known: Vec<_> = stated.iter().map(information_of).collect();
    let mut learned = known.clone();
    for first in (0..count).step_by(FRAMES_AT_ONCE) {
        progress(Progress {
            stage: "covariance",
            done: first as u64,
            total: count as u64,
        })?;
        let end = (first + FRAMES_AT_ONCE).min(count);
        let (from, to) = (walk.frames[first].time, walk.frames[end - 1].time);
        let begin = walk
            .frames
            .partition_point(|f| from.secs_since(f.time) > MARGIN_SECS);
        let stop = walk
            .frames
            .partition_point(|f| f.time.secs_since(to) <= MARGIN_SECS);
        let window = Window::new(walk, estimate, points, begin..stop, &shown, config)?;
        let found = window.covariances(first..end)?;
        poses.extend(found.poses);
        // Neighbours share their margins: each part of the walk counts once.
        let share = (end - first) as f64 / (stop - begin) as f64;
        let parts = known.iter().zip(found.corrections);
        for (learned, (known, covariance)) in learned.iter_mut().zip(parts) {
            if let Some(here) = covariance.try_inverse() {
                *learned += (here - known) * share;
            }
        }
    }
    let corrections = learned.iter().zip(stated).map(|(information, stated)| {
        let covariance = information.try_inverse();
        covariance.map_or(stated, |c| c.diagonal().map(f64::sqrt))
    });
    Ok(Uncertainty {
        poses,
        corrections: corrections.collect(),
    })
}

/// Covariances of all poses of a short walk; `None` where nothing determines one.
pub(super) fn of_stretch(
    walk: &Walk,
    estimate: &Estimate,
    points: &[LocalPoint],
    shown: &Deviations,
    config: &GroundTruthConfig,
) -> Result<Vec<Option<Matrix6<f64>>>, Error> {
    let all = 0..walk.frames.len();
    let window = Window::new(walk, estimate, points, all.clone(), shown, config)?;
    Ok(window.covariances(all)?.poses)
}

/// Entries of a camera's correction.
const CORRECTIONS: usize = 9;
/// Covariance of a camera's correction, or its inverse.
type CorrectionMatrix = SMatrix<f64, CORRECTIONS, CORRECTIONS>;

fn information_of(sigmas: &CameraCorrection) -> CorrectionMatrix {
    CorrectionMatrix::from_diagonal(&sigmas.map(|sigma| sigma.powi(-2)))
}

/// How well a point is known that the map does not determine, of how well one is that it states nothing of.
const NEXT_TO_NOTHING: f64 = 1e-3;

/// Where a point of the map is: with the covariance that the map states, and `shown_m` in each direction by what the walk shows. Of one that the map does not
/// determine next to nothing is known.
pub(super) fn map_point_prior(
    walk: &Walk,
    seen: &FixedObservation,
    shown_m: f64,
) -> VectorPrior<3> {
    let shown = Matrix3::from_diagonal_element(shown_m.powi(2));
    let stated = walk.point_covariances_m2.get(&seen.point);
    if stated.is_some_and(|c| c.iter().any(|v| !v.is_finite())) {
        return VectorPrior {
            value: seen.point_in_world,
            sqrt_information: Matrix3::from_diagonal_element(NEXT_TO_NOTHING / shown_m),
        };
    }
    let factor = stated.and_then(|stated| (stated + shown).cholesky());
    let sqrt_information =
        factor.and_then(|factor| factor.l().solve_lower_triangular(&Matrix3::identity()));
    VectorPrior {
        value: seen.point_in_world,
        sqrt_information: sqrt_information
            .unwrap_or(Matrix3::from_diagonal_element(shown_m.recip())),
    }
}

/// What one window says.
struct WindowCovariances {
    poses: Vec<Option<Matrix6<f64>>>,
    /// One for each camera, or none at all.
    corrections: Vec<CorrectionMatrix>,
}

/// A part of the walk.
struct Window {
    problem: Problem,
    begin: usize,
    poses: Vec<BlockId>,
    corrections: Vec<BlockId>,
}

impl Window {
    fn new(
        walk: &Walk,
        estimate: &Estimate,
        points: &[LocalPoint],
        frames: Range<usize>,
        shown: &Deviations,
        config: &GroundTruthConfig,
    ) -> Result<Self, Error> {
        let kernel = Kernel::Cauchy {
            scale: config.kernel_scale,
        };
        let mut problem = Problem::new();
        let mut corrections = Vec::with_capacity(walk.cameras.len());
        for (correction, camera) in estimate.corrections.iter().zip(&walk.cameras) {
            let block = problem.add_block(*correction);
            let known = config.calibration_sigmas(camera);
            let prior = VectorPrior::new(CameraCorrection::zeros(), known);
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
            corrections.push(block);
        }
        let states: Vec<StateBlocks> = estimate.states[frames.clone()]
            .iter()
            .map(|state| StateBlocks::add(&mut problem, state))
            .collect();
        let sight = |camera: usize, frame: usize, pixel| MovingReprojection {
            camera: walk.cameras[camera].clone(),
            motion: estimate.motions[frame],
            pixel,
            sigma_px: shown.pixel_px,
        };
        let mut of_map = BTreeMap::new();
        for k in frames.clone() {
            for seen in &walk.frames[k].fixed {
                let point = match of_map.get(&seen.point) {
                    Some(point) => *point,
                    None => {
                        let point = problem.add_eliminated_point(seen.point_in_world);
                        let shown_m = shown.of_map_point_m(estimate, k, seen);
                        let prior = map_point_prior(walk, seen, shown_m);
                        problem.add_residual(prior, &[point.id()], Kernel::Squared)?;
                        of_map.insert(seen.point, point);
                        point
                    }
                };
                let blocks = [
                    states[k - frames.start].pose.id(),
                    corrections[seen.camera].id(),
                    point.id(),
                ];
                problem.add_residual(sight(seen.camera, k, seen.pixel), &blocks, kernel)?;
            }
        }
        for point in points {
            let inside = |seen: &&LocalObservation| seen.used && frames.contains(&seen.frame);
            let inside: Vec<_> = point.observations.iter().filter(inside).collect();
            // One sight says nothing but where the point is.
            if inside.len() < 2 {
                continue;
            }
            let block = problem.add_eliminated_point(point.point_in_world);
            let nearest_m = inside
                .iter()
                .map(|seen| (point.point_in_world - estimate.pose(seen.frame).translation).norm())
                .fold(f64::INFINITY, f64::min);
            let sigma_m = (LOCAL_POINT_SHARE * nearest_m).max(LEAST_POINT_SIGMA_M);
            let prior = VectorPrior::new(point.point_in_world, Vector3::repeat(sigma_m));
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
            for seen in inside {
                let blocks = [
                    states[seen.frame - frames.start].pose.id(),
                    corrections[seen.camera].id(),
                    block.id(),
                ];
                let residual = sight(seen.camera, seen.frame, seen.pixel);
                problem.add_residual(residual, &blocks, kernel)?;
            }
        }
        add_inertial_residuals(&mut problem, walk, frames.start, &states, config)?;
        Ok(Self {
            problem,
            begin: frames.start,
            poses: states.iter().map(|s| s.pose.id()).collect(),
            corrections: corrections.iter().map(|block| block.id()).collect(),
        })
    }

    fn covariances(&self, frames: Range<usize>) -> Result<WindowCovariances, Error> {
        let poses = &self.poses[frames.start - self.begin..frames.end - self.begin];
        let asked = [poses, &self.corrections].concat();
        let found = match covariance(&self.problem, &asked) {
            Ok(found) => found,
            Err(lsfb_solver::Error::Undetermined { .. }) => {
                return Ok(WindowCovariances {
                    poses: vec![None; poses.len()],
                    corrections: Vec::new(),
                });
            }
            Err(other) => return Err(other.into()),
        };
        let of_pose = |id: &BlockId| {
            let block = found.between(*id, *id)?;
            Some(block.fixed_view::<6, 6>(0, 0).into_owned())
        };
        let of_camera = |id: &BlockId| {
            let block = found.between(*id, *id)?;
            Some(
                block
                    .fixed_view::<CORRECTIONS, CORRECTIONS>(0, 0)
                    .into_owned(),
            )
        };
        let cameras = self.corrections.iter().map(of_camera);
        Ok(WindowCovariances {
            poses: poses.iter().map(of_pose).collect(),
            corrections: cameras.collect::<Option<_>>().unwrap_or_default(),
        })
    }
}
