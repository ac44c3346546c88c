//! Two trajectories of one rigid body, by two systems with their own worlds, bodies and clocks (Eq. 7): a GNSS/INS or motion capture
//! beside AR glasses. Found are both transforms and the offset of the clocks, with their standard deviations, and what must not be
//! trusted because the motion does not show it.

mod closed_form;
mod continuous;
mod correlation;
mod gyroscope;
mod mocap;
mod refine;
mod residual;
mod truth;

use lsfb_geometry::{Se3, StampedPose, Vector3};
use lsfb_types::{Finding, Limit, Verdict};
use serde::Serialize;

use crate::{Error, Statistics};
use closed_form::{Moment, closed_form};
use continuous::Continuous;
use correlation::correlate;
use refine::{Apart, Halved, Refined, refine};
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

/// Poses fewer than this are no trajectory to align.
const LEAST_POSES: usize = 20;
/// Standard deviations beyond which the result is not to be used: rotation and translation of the body, the clock.
const MOST_SIGMA: [f64; 3] = [0.5, 0.02, 2.0];
/// What may stay between the positions of one walk, as a share of how they scatter, and between its orientations, degrees rms.
const MOST_LEFT: f64 = 0.1;
const MOST_LEFT_DEG: f64 = 20.0;
/// Positions that stay further apart, as a share of how they scatter, are not of one walk.
const MOST_UNLIKE: f64 = 0.5;
/// Two systems never agree so well, metres rms.
const LEAST_LEFT_M: f64 = 1e-6;
/// Positions of two bodies on one device extend alike, but for what a turn on the spot makes of a lever.
const MOST_LARGER: f64 = 1.3;
/// Share of poses that should fit, and below which the result is not to be used.
const LEAST_INLIERS: (f64, f64) = (0.7, 0.5);
/// Standard deviations by which one number of two halves may differ.
const MOST_APART: f64 = 4.0;
/// Halves that differ by so much as well, degrees, metres and seconds, are of two mountings or two clocks: one answer is wrong for both.
const CLEARLY_APART: [f64; 3] = [0.3, 0.005, 0.002];

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
) -> Result<HandEye, Error> {
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
    let (estimate_middle, reference_middle) = (middle(estimate), middle(reference));
    let estimate = Continuous::new(&moved(estimate, &-estimate_middle), base);
    let reference = Continuous::new(&moved(reference, &-reference_middle), base);
    let found = correlate(
        &estimate,
        &reference,
        config.offset_guess_secs,
        config.search_secs,
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
    found.findings = judge(&found, &refined, halves);
    let unit = other_unit(&found, sizes_m);
    let unit = unit.or_else(|| other_positions(&found, sizes_m));
    found.findings.extend(unit);
    found.findings.extend(other_rotations(&found));
    found.findings.extend(same(&found));
    Ok(found)
}

/// How positions scatter about their mean, rms, metres.
fn scatter_m(poses: &[StampedPose]) -> f64 {
    let mean = middle(poses);
    let squares = poses
        .iter()
        .map(|p| (p.world_from_rig.translation - mean).norm_squared());
    (squares.sum::<f64>() / poses.len().max(1) as f64).sqrt()
}

/// Positions that stay apart and extend differently are in different units.
fn other_unit(found: &HandEye, [estimate_m, reference_m]: [f64; 2]) -> Option<Finding> {
    let times = estimate_m / reference_m;
    let left_m = found.translation_m.rmse;
    let is_apart = left_m > MOST_LEFT * reference_m.min(estimate_m);
    (is_apart && !(1.0 / MOST_LARGER..MOST_LARGER).contains(&times)).then(|| {
        let what = format!(
            "the estimate's positions extend {times:.3} times as far as the reference's, and {left_m:.3} m rms stay between them"
        );
        Finding::new("unit", Verdict::Fail, "positions", what)
            .value(times, "")
            .remedy("write both in metres; what cannot know its scale is not aligned")
    })
}

/// Positions that no place of body and world brings together.
fn other_positions(found: &HandEye, [estimate_m, reference_m]: [f64; 2]) -> Option<Finding> {
    let left_m = found.translation_m.rmse;
    let scatter_m = reference_m.min(estimate_m);
    (left_m > MOST_UNLIKE * scatter_m).then(|| {
        let what = format!(
            "the positions stay {left_m:.3} m rms apart where they scatter by {scatter_m:.3} m, however body and world are placed"
        );
        Finding::new("positions", Verdict::Fail, "positions", what)
            .value(left_m, "m")
            .limit(Limit::AtMost(MOST_UNLIKE * scatter_m))
            .remedy("check that neither is a mirror image (left-handed axes, two exchanged) or lost; `lsfb eval` names which")
    })
}

/// A reference that was aligned to itself.
fn same(found: &HandEye) -> Option<Finding> {
    let left_m = found.translation_m.rmse;
    (left_m < LEAST_LEFT_M).then(|| {
        let what = format!(
            "both are one trajectory: {left_m:.1e} m rms between them is less than any two systems leave"
        );
        Finding::new("same", Verdict::Warn, "positions", what)
            .value(left_m, "m")
            .limit(Limit::AtLeast(LEAST_LEFT_M))
            .remedy("check which files were aligned")
    })
}

/// Orientations that no turn of body and world makes alike.
fn other_rotations(found: &HandEye) -> Option<Finding> {
    let left_deg = found.rotation_deg.rmse;
    (left_deg > MOST_LEFT_DEG).then(|| {
        let what = format!(
            "the orientations stay {left_deg:.1}° rms apart, however body and world are turned"
        );
        Finding::new("orientations", Verdict::Fail, "orientations", what)
            .value(left_deg, "°")
            .limit(Limit::AtMost(MOST_LEFT_DEG))
            .remedy("check the order of the quaternions' components (x y z w), and that they are of the body in the world and not the inverse; `lsfb eval` names which")
    })
}

fn statistics(values: &[f64]) -> Result<Statistics, Error> {
    Statistics::of(values).ok_or(Error::Degenerate)
}

fn middle(poses: &[StampedPose]) -> Vector3<f64> {
    let places = poses.iter().map(|p| p.world_from_rig.translation);
    places.sum::<Vector3<f64>>() / poses.len().max(1) as f64
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

fn judge(found: &HandEye, refined: &Refined, halves: Option<Apart>) -> Vec<Finding> {
    let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let body = &found.reference_from_estimate_body;
    let limits = [
        (
            "rotation of the body",
            largest(&body.sigma_rotation_deg),
            "°",
            MOST_SIGMA[0],
        ),
        (
            "translation of the body",
            1000.0 * largest(&body.sigma_translation_m),
            "mm",
            1000.0 * MOST_SIGMA[1],
        ),
        (
            "offset of the clocks",
            1000.0 * found.sigma_offset_secs,
            "ms",
            MOST_SIGMA[2],
        ),
    ];
    let mut findings: Vec<Finding> = limits
        .into_iter()
        .map(|(subject, sigma, unit, most)| {
            let verdict = Verdict::Fail.unless(sigma <= most);
            let what = format!("known to {sigma:.2} {unit} (1 σ)");
            Finding::new("observability", verdict, subject, what)
                .value(sigma, unit)
                .limit(Limit::AtMost(most))
                .remedy("turn the device about two axes, and longer")
        })
        .collect();
    let share = 1.0 - found.outliers as f64 / found.poses.max(1) as f64;
    let what = format!("{} of {} poses do not fit", found.outliers, found.poses);
    findings.push(
        Finding::new("outliers", of_inliers(share), "poses", what)
            .value(100.0 * share, "%")
            .limit(Limit::AtLeast(100.0 * LEAST_INLIERS.0))
            .remedy("check that both are of one rigid body"),
    );
    // Residuals of neighbouring poses are alike: their standard deviations are then too small.
    if let Some(factor) = refined.correlated_by {
        let what =
            format!("residuals hang together: standard deviations were raised {factor:.1} times");
        findings
            .push(Finding::new("correlated", Verdict::Pass, "residuals", what).value(factor, ""));
    }
    findings.extend(halves.map(agreement));
    findings
}

/// How good a share of poses that fit is.
fn of_inliers(share: f64) -> Verdict {
    match share {
        share if share < LEAST_INLIERS.1 => Verdict::Fail,
        share => Verdict::Warn.unless(share >= LEAST_INLIERS.0),
    }
}

/// How bad it is that two halves differ, by standard deviations and by the differences of rotation, translation and clock themselves.
fn of_halves(sigmas: f64, apart: [f64; 3]) -> Verdict {
    let is_clear = apart.iter().zip(CLEARLY_APART).any(|(a, most)| *a > most);
    match is_clear {
        true => Verdict::Fail,
        false => Verdict::Warn,
    }
    .unless(sigmas <= MOST_APART)
}

/// Whether two halves of the walk say the same, as their standard deviations promise.
fn agreement(halves: Apart) -> Finding {
    let apart = [
        halves.rotation_deg,
        halves.translation_m,
        halves.offset_secs.abs(),
    ];
    let verdict = of_halves(halves.sigmas, apart);
    let what = format!(
        "the two halves of the walk differ by {:.1} mm, {:.3}° and {:.2} ms, {:.1} standard deviations",
        1000.0 * halves.translation_m,
        halves.rotation_deg,
        1000.0 * halves.offset_secs,
        halves.sigmas
    );
    Finding::new("halves", verdict, "halves", what)
        .value(halves.sigmas, "σ")
        .limit(Limit::AtMost(MOST_APART))
        .remedy("something moved between them: the mounting, a clock (--drift), or the estimate's scale; align the parts by themselves")
}

#[cfg(test)]
mod tests;
