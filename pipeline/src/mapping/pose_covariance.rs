//! How well Eq. (4) knows the poses of the keyframes, relative to the first.
//!
//! Where a map begins and which way it faces is chosen, so that no covariance means anything but that of the way from one keyframe to
//! another. It is the inverse of Eq. (4)'s normal matrix where it ended, with the first keyframe held and all points free.
//!
//! In it each comparison of two scans counts as a measurement of its own, and a keyframe is compared with many. What it is off by against
//! its own scans and images (they are taken over some tenths of a second, and joined along the odometry) is the same in all of these, and no
//! number of them lessens it: it is added, of the first keyframe as of the other.

use lsfb_geometry::{Matrix6, Vector3};
use lsfb_solver::{BlockId, Kernel, VectorPrior, covariance, covariance_of_groups};
use lsfb_types::{Progress, ProgressFn};
use nalgebra::DMatrix;

use super::adjustment::{Equation, equation};
use super::rig_check::Checked;
use super::weights::lidar_residuals;
use super::{MappingConfig, MappingWarning};
use crate::Error;
use crate::hd_map::MapPoint;

/// Standard deviation of a point beside its observations, as a multiple of how near it is to the nearest of its cameras: so loose that it says nothing, and
/// a point whose rays are parallel is not undetermined.
const POINT_SIGMA_PER_DEPTH: f64 = 30.0;
/// More tells nothing, metres.
const MOST_DEPTH_M: f64 = 1e6;

/// What a keyframe is off by against its own scans and images, 1 σ: metres and radians along each axis per metre by which distances from planes
/// scatter. Chosen on four simulated walks (stairs 1, medium office 4, wide corridor 2, atrium 3; `docs/figures.md` has others).
const OWN_M_PER_M: f64 = 0.04;
const OWN_RAD_PER_M: f64 = 0.0067;

/// The covariance of each keyframe, `[rotation, translation]` in its tangent; the first is exact. Where the measurements do not determine all
/// poses none is known, and that is the warning.
pub(super) fn pose_covariances(
    checked: &Checked,
    points: &[MapPoint],
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Result<Vec<Matrix6<f64>>, MappingWarning>, Error> {
    let terms = &checked.terms;
    let Equation {
        problem, keyframes, ..
    } = determined(checked, points, config)?;
    let poses = keyframes.poses.iter();
    let groups: Vec<Vec<BlockId>> = poses.skip(1).map(|pose| vec![pose.id()]).collect();
    let total = groups.len() as u64;
    let found = covariance_of_groups(&problem, &groups, |done| {
        progress(Progress {
            stage: "covariance of keyframes",
            done: done as u64,
            total,
        })
        .map_err(Error::from)
    });
    let found = match found {
        Err(Error::Solver(error @ lsfb_solver::Error::Undetermined { .. })) => {
            let reason = error.to_string();
            return Ok(Err(MappingWarning::PosesUndetermined { reason }));
        }
        found => found?,
    };
    let frames = &checked.keyframes.frames;
    let scatter_m = lidar_residuals(frames, terms.scans).plane_rms_m;
    let own = own_covariance(scatter_m);
    let mut covariances = vec![Matrix6::zeros()];
    for (solved, keyframe) in found.iter().zip(frames.iter().skip(1)) {
        let solved = solved.joint().fixed_view::<6, 6>(0, 0);
        // An error of the first keyframe moves the other relative to it by −Ad(T⁻¹ T₀).
        let to_first = keyframe.world_from_rig.inverse() * frames[0].world_from_rig;
        let moved = to_first.adjoint();
        let covariance = solved + own + moved * own * moved.transpose();
        covariances.push((covariance + covariance.transpose()) * 0.5);
    }
    Ok(Ok(covariances))
}

/// The joint covariance of the marks that the terms place, in their order; `None` where the measurements do not determine the map.
pub(super) fn mark_covariance(
    checked: &Checked,
    points: &[MapPoint],
    config: &MappingConfig,
) -> Result<Option<DMatrix<f64>>, Error> {
    let Equation {
        problem, control, ..
    } = determined(checked, points, config)?;
    let marks = control.map_or_else(Vec::new, |control| control.marks);
    let ids: Vec<BlockId> = marks.iter().map(|mark| mark.id()).collect();
    match covariance(&problem, &ids) {
        Ok(found) => Ok(Some(found.joint().clone())),
        Err(lsfb_solver::Error::Undetermined { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// Eq. (4) with points that parallel rays leave undetermined held a little.
fn determined(
    checked: &Checked,
    points: &[MapPoint],
    config: &MappingConfig,
) -> Result<Equation, Error> {
    let (rig, keyframes) = (checked.rig, checked.keyframes);
    let mut equation = equation(rig, keyframes, points, &checked.terms, config)?;
    for (point, block) in points.iter().zip(&equation.points) {
        let depth_m = keyframes.nearest_camera_m(rig, point).min(MOST_DEPTH_M);
        let sigma_m = POINT_SIGMA_PER_DEPTH * depth_m;
        let prior = VectorPrior::new(point.point_in_world, Vector3::repeat(sigma_m));
        let kernel = Kernel::Squared;
        equation
            .problem
            .add_residual(prior, &[block.id()], kernel)?;
    }
    Ok(equation)
}

fn own_covariance(scatter_m: f64) -> Matrix6<f64> {
    let (r, t) = (OWN_RAD_PER_M * scatter_m, OWN_M_PER_M * scatter_m);
    let variances = [r, r, r, t, t, t].map(|sigma| sigma * sigma);
    Matrix6::from_diagonal(&variances.into())
}
