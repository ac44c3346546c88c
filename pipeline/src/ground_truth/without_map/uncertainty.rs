//! How far each pose may be off, relative to the first.
//!
//! Where a walk began and which way it faced is chosen: no covariance of poses in such a world means anything but that of the way from
//! one of them to another. It is taken from the whole adjustment, since drift is what all of the walk up to there leaves open.
//!
//! A corner is followed from image to image: where one step misses by a tenth of a pixel, all that follow do. What the sights of a track
//! are wrong by is alike from one frame to the next, and where the device swings back it is so again: a thousand of them say no more than
//! a few that are independent. How alike, the residuals show; what varies slowly (a pose, a drift) is then known as if the variance of each
//! were `1 + 2 (ρ₁ + ρ₂ + …)` times as large, the integrated time of their correlation `ρ` over so many frames, as for the mean of any
//! stationary series. Of a first-order autoregressive series it would be `(1 + ρ₁) / (1 − ρ₁)`; of real tracks it is up to twice that, of
//! short ones it seems less, since the point takes what stays the same: the larger counts.

use lsfb_geometry::{Matrix6, Vector2, Vector3};
use lsfb_solver::{BlockId, Covariance, Kernel, VectorPrior, covariance_of_groups};
use lsfb_types::{Progress, ProgressFn};

use super::extension::Settled;
use crate::ground_truth::GroundTruthConfig;
use crate::ground_truth::estimate::Estimate;
use crate::ground_truth::optimization::Adjustment;
use crate::ground_truth::report::local_errors;
use crate::ground_truth::walk::{LocalPoint, Walk};
use crate::residuals::CameraCorrection;
use crate::{Error, Refusal};

/// Poses whose covariance is asked for at a time: the first pose is solved for anew with each group.
const AT_ONCE: usize = 12;
/// Followed corners are no better than this, pixels in each direction.
const LEAST_PIXEL_SIGMA: f64 = 0.2;
/// Frames over which errors of a track are compared.
const LAGS: usize = 100;
/// Errors of a track's neighbouring sights are taken for no more alike than this: with one they would say nothing.
const MOST_ALIKE: f64 = 0.98;
/// Standard deviation of a point's place beside its sights, in its distances: so loose that it says nothing of the scale, and a point
/// that is seen from one direction alone leaves nothing undetermined.
const POINT_DISTANCES: f64 = 30.0;

/// Entries of a camera's correction.
const CORRECTIONS: usize = 9;

/// How far what was found may be off.
pub(super) struct Uncertainty {
    /// Of each pose that was asked for relative to the one that was chosen, in its tangent `[rotation, translation]` on the right, rad² and m².
    pub poses: Vec<Matrix6<f64>>,
    /// Standard deviations of each camera's correction.
    pub corrections: Vec<CameraCorrection>,
}

/// Covariances of some frames' poses after the last solve, relative to the pose of a frame, with the pixels as good as it shows.
pub(super) fn uncertainty(
    walk: &Walk,
    settled: &Settled,
    reference: usize,
    frames: &[usize],
    progress: ProgressFn<'_>,
) -> Result<Uncertainty, Error> {
    let (estimate, points) = (&settled.last.estimate, &settled.last.points);
    let shown_px = local_errors(estimate, points).rms_px
        * std::f64::consts::FRAC_1_SQRT_2
        * correlated_frames(estimate, points).sqrt();
    let as_shown = GroundTruthConfig {
        local_sigma_px: shown_px.max(LEAST_PIXEL_SIGMA),
        ..settled.config.clone()
    };
    let anchor = Some(&settled.anchor);
    let mut adjustment = Adjustment::of(walk, estimate, points, anchor, &as_shown)?;
    for (point, block) in points.iter().zip(&adjustment.blocks.points) {
        let Some(block) = block else { continue };
        let used = point.observations.iter().filter(|seen| seen.used);
        let away_m = used
            .map(|seen| (point.point_in_world - estimate.pose(seen.frame).translation).norm())
            .fold(f64::INFINITY, f64::min);
        let sigma_m = POINT_DISTANCES * away_m.max(f64::EPSILON);
        let prior = VectorPrior::new(point.point_in_world, Vector3::repeat(sigma_m));
        let squared = Kernel::Squared;
        adjustment
            .problem
            .add_residual(prior, &[block.id()], squared)?;
    }
    let poses: Vec<BlockId> = adjustment
        .blocks
        .states
        .iter()
        .map(|s| s.pose.id())
        .collect();
    let cameras: Vec<BlockId> = adjustment
        .blocks
        .corrections
        .iter()
        .map(|c| c.id())
        .collect();
    let known = poses.get(reference..=reference).unwrap_or_default();
    let with_reference = |few: &[BlockId]| [known, few].concat();
    let wanted: Vec<BlockId> = frames.iter().map(|k| poses[*k]).collect();
    let mut groups: Vec<Vec<BlockId>> = wanted.chunks(AT_ONCE).map(with_reference).collect();
    groups.push(cameras);
    let total = groups.len() as u64;
    let mut found = covariance_of_groups(&adjustment.problem, &groups, |done| {
        progress(Progress {
            stage: "covariance",
            done: done as u64,
            total,
        })
        .map_err(Error::from)
    })
    .map_err(|error| match error {
        Error::Solver(problem @ lsfb_solver::Error::Undetermined { .. }) => {
            Error::Refused(Refusal::UnknownCovariance {
                frames: poses.len(),
                problem,
            })
        }
        other => other,
    })?;
    let of_cameras = found.pop();
    let mut relative = Vec::with_capacity(frames.len());
    for joint in found.iter().map(Covariance::joint) {
        let block = |row: usize, column: usize| joint.fixed_view::<6, 6>(6 * row, 6 * column);
        for row in 1..joint.nrows() / 6 {
            let frame = frames[relative.len()];
            if frame == reference {
                relative.push(Matrix6::zeros());
                continue;
            }
            // An error of the reference moves the pose relative to it by −Ad(T⁻¹ T₀).
            let to_reference = estimate.pose(frame).inverse() * *estimate.pose(reference);
            let moved = to_reference.adjoint();
            let shared = block(row, 0) * moved.transpose();
            let covariance = block(row, row) + moved * block(0, 0) * moved.transpose()
                - shared
                - shared.transpose();
            relative.push((covariance + covariance.transpose()) * 0.5);
        }
    }
    let variances = of_cameras.map(|c| c.joint().diagonal()).unwrap_or_default();
    let each = variances.as_slice().chunks_exact(CORRECTIONS);
    let deviations = each.map(|v| CameraCorrection::from_column_slice(v).map(f64::sqrt));
    Ok(Uncertainty {
        poses: relative,
        corrections: deviations.collect(),
    })
}

/// How many sights of a track say as much as one that is independent: the integrated time of the correlation of residuals of one point in
/// one camera, in frames, summed until they are not alike any more.
fn correlated_frames(estimate: &Estimate, points: &[LocalPoint]) -> f64 {
    let mut products = [(0.0, 0u64); LAGS];
    for point in points.iter().filter(|p| p.is_determined()) {
        let used = point.observations.iter().filter(|seen| seen.used);
        let mut residuals: Vec<(usize, usize, Vector2<f64>)> = used
            .filter_map(|seen| {
                let residual = estimate.local_residual_px(point, seen)?;
                Some((seen.camera, seen.frame, residual))
            })
            .collect();
        residuals.sort_by_key(|(camera, frame, _)| (*camera, *frame));
        for (k, (camera, frame, residual)) in residuals.iter().enumerate() {
            for (other_camera, other_frame, other) in &residuals[k..] {
                let lag = other_frame - frame.min(other_frame);
                if other_camera != camera || lag >= LAGS {
                    break;
                }
                products[lag].0 += residual.dot(other);
                products[lag].1 += 1;
            }
        }
    }
    let mean = |(sum, count): &(f64, u64)| sum / (*count).max(1) as f64;
    let square = mean(&products[0]);
    let alike = |p: &(f64, u64)| mean(p) / square;
    let first = alike(&products[1]).clamp(0.0, MOST_ALIKE);
    let sum: f64 = products[1..]
        .iter()
        .map(alike)
        .take_while(|a| *a > 0.0)
        .sum();
    // What is no number, of no residuals, is the smaller of both.
    ((1.0 + first) / (1.0 - first))
        .max(1.0 + 2.0 * sum)
        .max(1.0)
}
