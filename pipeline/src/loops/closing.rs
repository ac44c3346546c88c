//! Closes loops in what the odometry found: the graph of keyframes is solved, and everything between them follows.

use lsfb_geometry::{Matrix6, Se3, StampedPose, Trajectory};
use lsfb_types::{ProgressFn, Timestamp};
use serde::{Deserialize, Serialize};

use super::assessment::CHI_SQUARED;
use super::graph::{self, Closed, squared_sigmas};
use super::keyframes::{self, Keyframe, added};
use super::{LoopDecision, Loops, Measured};
use crate::Error;
use crate::bending::bent;
use crate::odometry::{OdometryResult, OdometryWarning};

/// Loops that the odometry has closed itself, by the map it keeps, leave the trajectory as it is: metres and radians.
const CLOSED_M: f64 = 0.02;
const CLOSED_RAD: f64 = 0.002;

/// What closing the loops of a walk did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Closing {
    /// Loops that are closed.
    pub accepted: u64,
    /// Those that were looked at, and are not.
    pub rejected: u64,
    /// How far a pose was moved at most, metres; 0 where the odometry had closed all loops itself.
    pub moved_m: f64,
    /// How far a closed loop still is from what was measured at most, in standard deviations (a norm over six numbers).
    pub worst_sigmas: f64,
}

/// Closes the accepted loops. Poses and covariances of the result follow; the first pose stays where it is.
pub fn close_loops(
    result: &mut OdometryResult,
    loops: &Loops,
    progress: ProgressFn<'_>,
) -> Result<Closing, Error> {
    let accepted = loops.accepted().count() as u64;
    let mut closing = Closing {
        accepted,
        rejected: loops.all.len() as u64 - accepted,
        ..Closing::default()
    };
    let ends = loops.accepted().flat_map(|l| [l.earlier, l.later]);
    let keyframes = keyframes::with(result, &ends.collect());
    let measured = accepted_of(loops, &keyframes)?;
    let is_closed = |l: &Measured| {
        let (a, b) = (&keyframes[l.earlier], &keyframes[l.later]);
        let by_odometry = a.world_from_rig.inverse() * b.world_from_rig;
        let off = l.loop_.earlier_from_later.inverse() * by_odometry;
        off.translation.norm() < CLOSED_M && off.rotation.angle() < CLOSED_RAD
    };
    if measured.iter().all(is_closed) {
        return Ok(closing);
    }
    let closed = graph::close(&keyframes, &measured, progress)?;
    let sigmas = measured.iter().map(|l| {
        let (a, b) = (
            closed.world_from_rig[l.earlier],
            closed.world_from_rig[l.later],
        );
        squared_sigmas(&a, &b, &l.loop_).sqrt()
    });
    closing.worst_sigmas = sigmas.fold(0.0, f64::max);
    let moved = keyframes.iter().zip(&closed.world_from_rig);
    let moved_m = moved.map(|(k, now)| (k.world_from_rig.translation - now.translation).norm());
    closing.moved_m = moved_m.fold(0.0, f64::max);
    bend(result, &keyframes, &closed);
    // Bent by a loop that is not one, a walk agrees with it: what the odometry said before tells.
    let of_odometry = loops.accepted().filter_map(|l| l.scores.odometry_sigmas);
    let sigmas = of_odometry.fold(closing.worst_sigmas, f64::max);
    if sigmas * sigmas > CHI_SQUARED {
        let warnings = &mut result.report.warnings;
        warnings.push(OdometryWarning::LoopDisagrees { sigmas });
    }
    Ok(closing)
}

/// The accepted loops by the numbers of their keyframes.
fn accepted_of(loops: &Loops, keyframes: &[Keyframe]) -> Result<Vec<Measured>, Error> {
    let number = |time: Timestamp| {
        let at = keyframes.binary_search_by_key(&time, |k| k.time);
        at.map_err(|_| Error::UnknownScan { time })
    };
    let of_loop = |l: &super::Loop| {
        let (earlier, later) = (l.earlier, l.later);
        Ok(Measured {
            earlier: number(earlier)?,
            later: number(later)?,
            loop_: l
                .measured
                .ok_or(Error::LoopNotMeasured { earlier, later })?,
        })
    };
    loops.accepted().map(of_loop).collect()
}

/// Of the loops that are accepted those that do not fit the rest are rejected.
pub(super) fn reject_disagreeing(
    loops: &mut Loops,
    keyframes: &[Keyframe],
    progress: ProgressFn<'_>,
) -> Result<(), Error> {
    let measured = accepted_of(loops, keyframes)?;
    if measured.is_empty() {
        return Ok(());
    }
    let fits = graph::fitting(keyframes, &measured, progress)?;
    let is_accepted = |l: &&mut super::Loop| l.decision == LoopDecision::Accepted;
    for (l, fits) in loops.all.iter_mut().filter(is_accepted).zip(fits) {
        if !fits {
            l.decision = LoopDecision::Rejected(super::LoopRejection::ContradictsLoops);
        }
    }
    Ok(())
}

/// Takes everything between the keyframes along.
fn bend(result: &mut OdometryResult, keyframes: &[Keyframe], closed: &Closed) {
    let before: Vec<StampedPose> = keyframes
        .iter()
        .map(|k| StampedPose {
            time: k.time,
            world_from_rig: k.world_from_rig,
        })
        .collect();
    let bent = |pose: &StampedPose| StampedPose {
        time: pose.time,
        world_from_rig: bent(pose, &before, &closed.world_from_rig),
    };
    let poses = result.trajectory.poses().iter().map(bent).collect();
    result.trajectory = Trajectory::new(poses);
    for scan in &mut result.scan_poses {
        let here = scan.pose.world_from_rig;
        let behind = keyframes.partition_point(|k| k.time <= scan.pose.time);
        let nearest = behind.saturating_sub(1);
        if let (Some(keyframe), Some(covariance)) =
            (keyframes.get(nearest), closed.covariances.get(nearest))
        {
            let here_from_keyframe = here.inverse() * keyframe.world_from_rig;
            scan.covariance = carried(covariance, &here_from_keyframe)
                + added(&scan.covariance, &keyframe.covariance, &here_from_keyframe);
        }
        scan.pose = bent(&scan.pose);
    }
    result.summarise();
}

/// A covariance in the tangent of a pose that another is rigidly joined to.
fn carried(covariance: &Matrix6<f64>, here_from_there: &Se3) -> Matrix6<f64> {
    let adjoint = here_from_there.adjoint();
    adjoint * covariance * adjoint.transpose()
}
