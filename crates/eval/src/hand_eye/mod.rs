//! Two trajectories of one rigid body, by two systems with their own worlds, bodies and clocks (Eq. 7): a GNSS/INS or motion capture
//! beside AR glasses. Found are both transforms and the offset of the clocks, with their standard deviations, and what must not be
//! trusted because the motion does not show it.

mod closed_form;
mod continuous;
mod correlation;
mod gyroscope;
mod judge;
mod mocap;
mod refine;
mod residual;
mod truth;

use lsfb_geometry::{Se3, StampedPose, Vector3, mean_position};
use lsfb_types::{Bounds, Finding, Progress, ProgressFn, Stopped};
use serde::Serialize;

use crate::{Error, Statistics};
use closed_form::{Moment, closed_form};
use continuous::Continuous;
use correlation::correlate;
use judge::judge;
use refine::{Halved, refine};
use residual::Interpolated;

pub use closed_form::Excitation;
pub use gyroscope::{GyroAlignment, GyroSample, align_gyroscope, align_gyroscopes};
pub use mocap::{MocapAlignment, MocapConfig, align_mocap};
pub use truth::AlignedTruth;

/// How two trajectories are aligned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeConfig {
    /// What must be added to the estimate's stamps to have about the reference's, seconds.
    pub offset_guess_secs: f64,
    /// How far from it is searched, seconds.
    pub search_secs: f64,
    /// Whether the offset stays.
    pub clock: ClockModel,
}

/// How the offset of two clocks behaves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClockModel {
    /// It is the same throughout.
    #[default]
    Constant,
    /// It changes evenly.
    Drifting,
}

impl Default for HandEyeConfig {
    fn default() -> Self {
        Self {
            offset_guess_secs: 0.0,
            search_secs: 10.0,
            clock: ClockModel::Constant,
        }
    }
}

lsfb_types::bounds! {
    HandEyeConfig {
        offset_guess_secs: number(OFFSET_SECS),
        search_secs: number(SEARCH_SECS),
        clock: any,
    }
}

/// Offsets beyond are none of two stamps.
const OFFSET_SECS: Bounds = Bounds::Within(-9e9, 9e9);
/// An hour about the guess is some hundred thousand offsets to try.
const SEARCH_SECS: Bounds = Bounds::Within(0.0, 3600.0);

/// Poses fewer than this are no trajectory to align.
const LEAST_POSES: usize = 20;

/// A transform with the standard deviations of its tangent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UncertainPose {
    /// Rotation x y z w.
    pub rotation_xyzw: [f64; 4],
    /// Translation, metres.
    pub translation_m: [f64; 3],
    /// Of the rotation about the source's x, y, z, degrees.
    pub sigma_rotation_deg: [f64; 3],
    /// Of the translation along the source's x, y, z, metres.
    pub sigma_translation_m: [f64; 3],
}

/// Two trajectories, aligned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HandEye {
    /// `reference_world_from_estimate_world`, Eq. 7's `G_T_H`.
    pub reference_from_estimate_world: UncertainPose,
    /// `reference_body_from_estimate_body`, Eq. 7's `N_T_A`: where the estimate's body sits on the reference's.
    pub reference_from_estimate_body: UncertainPose,
    /// What must be added to the estimate's stamps to have the reference's, in the middle of both, seconds.
    pub offset_secs: f64,
    /// Its standard deviation, seconds.
    pub sigma_offset_secs: f64,
    /// Change of the offset, seconds per second; zero where the clock does not drift.
    pub drift: f64,
    /// Where the offset is as given, seconds since the estimate's first pose.
    pub middle_secs: f64,
    /// Correlation of the angular speeds, by which the offset was found first.
    pub correlation: f64,
    /// How much the bodies turned.
    pub excitation: Excitation,
    /// Distances of the aligned bodies where they fit, metres.
    pub translation_m: Statistics,
    /// Angles between them where they fit, degrees.
    pub rotation_deg: Statistics,
    /// Poses compared.
    pub poses: usize,
    /// Of these, those that do not fit: dropped or swapped markers, lost tracking.
    pub outliers: usize,
    /// What must not be trusted.
    #[serde(skip)]
    pub findings: Vec<Finding>,
    /// Reference world from estimate world.
    #[serde(skip)]
    pub world: Se3,
    /// Reference body from estimate body.
    #[serde(skip)]
    pub body: Se3,
    /// Standard deviations by which poses that do not fit were told, rad and metres.
    #[serde(skip)]
    sigmas: [f64; 2],
}

/// Aligns `estimate` to `reference`; both in order of time, with orientations.
pub fn align_trajectories(
    estimate: &[StampedPose],
    reference: &[StampedPose],
    config: &HandEyeConfig,
    progress: ProgressFn<'_>,
) -> Result<HandEye, Error> {
    config.check_bounds("")?;
    for (role, poses) in [("estimate", estimate), ("reference", reference)] {
        if poses.len() < LEAST_POSES {
            return Err(Error::TooFewPoses {
                role,
                poses: poses.len(),
                needed: LEAST_POSES,
            });
        }
    }
    let base = estimate[0].time;
    let sizes_m = [scatter_m(estimate), scatter_m(reference)];
    // Around their own middles coordinates of surveyors keep their digits.
    let (estimate_middle, reference_middle) = (mean_position(estimate), mean_position(reference));
    let estimate = Continuous::new(&moved(estimate, &-estimate_middle), base);
    let reference = Continuous::new(&moved(reference, &-reference_middle), base);
    let found = correlate(
        &estimate,
        &reference,
        config.offset_guess_secs,
        config.search_secs,
        progress,
    )?;
    let interpolated = match estimate.median_step_secs < reference.median_step_secs {
        true => Interpolated::Estimate,
        false => Interpolated::Reference,
    };
    let moments = moments(&estimate, &reference, interpolated, found.offset_secs);
    let (start, excitation) = closed_form(&moments)?;
    let Halved {
        whole: refined,
        halves,
    } = refine(
        estimate,
        reference,
        interpolated,
        start,
        found.offset_secs,
        config.clock,
        progress,
    )?;
    let world = shift(&reference_middle) * refined.world * shift(&-estimate_middle);
    let mut found = HandEye {
        reference_from_estimate_world: uncertain(&world, &refined.sigma_world),
        reference_from_estimate_body: uncertain(&refined.body, &refined.sigma_body),
        offset_secs: refined.offset_secs,
        sigma_offset_secs: refined.sigma_offset_secs,
        drift: refined.drift,
        middle_secs: refined.middle_secs,
        correlation: found.correlation,
        excitation,
        translation_m: statistics(&refined.distances_m)?,
        rotation_deg: statistics(&refined.angles_deg)?,
        poses: refined.poses,
        outliers: refined.outliers,
        findings: Vec::new(),
        world,
        body: refined.body,
        sigmas: refined.sigmas,
    };
    found.findings = judge(&found, &refined, halves, sizes_m);
    Ok(found)
}

/// Says that the next round of an adjustment begins.
fn show_round(done: usize, total: usize, progress: ProgressFn<'_>) -> Result<(), Stopped> {
    progress(Progress {
        stage: "adjusting the alignment",
        done: done as u64,
        total: total as u64,
    })
}

/// How positions scatter about their mean, rms, metres.
fn scatter_m(poses: &[StampedPose]) -> f64 {
    let mean = mean_position(poses);
    let squares = poses
        .iter()
        .map(|p| (p.world_from_rig.translation - mean).norm_squared());
    (squares.sum::<f64>() / poses.len().max(1) as f64).sqrt()
}

fn statistics(values: &[f64]) -> Result<Statistics, Error> {
    Statistics::of(values).ok_or(Error::Degenerate)
}

fn shift(by: &Vector3<f64>) -> Se3 {
    Se3::new(Default::default(), *by)
}

fn moved(poses: &[StampedPose], by: &Vector3<f64>) -> Vec<StampedPose> {
    let move_one = |p: &StampedPose| StampedPose {
        time: p.time,
        world_from_rig: shift(by) * p.world_from_rig,
    };
    poses.iter().map(move_one).collect()
}

/// Both trajectories at the poses of the sparser.
fn moments(
    estimate: &Continuous,
    reference: &Continuous,
    interpolated: Interpolated,
    offset_secs: f64,
) -> Vec<Moment> {
    let moment = |secs, estimate, reference| Moment {
        secs,
        estimate,
        reference,
    };
    match interpolated {
        Interpolated::Reference => estimate
            .samples()
            .filter_map(|(t, pose)| Some(moment(t, pose, reference.at(t + offset_secs)?)))
            .collect(),
        Interpolated::Estimate => reference
            .samples()
            .filter_map(|(t, pose)| Some(moment(t, estimate.at(t - offset_secs)?, pose)))
            .collect(),
    }
}

fn uncertain(pose: &Se3, sigma: &[f64; 6]) -> UncertainPose {
    UncertainPose {
        rotation_xyzw: pose.rotation.coords.into(),
        translation_m: pose.translation.into(),
        sigma_rotation_deg: [sigma[0], sigma[1], sigma[2]].map(f64::to_degrees),
        sigma_translation_m: [sigma[3], sigma[4], sigma[5]],
    }
}

#[cfg(test)]
mod tests;
