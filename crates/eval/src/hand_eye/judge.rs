//! What of an alignment of two trajectories must not be trusted.

use lsfb_types::{Finding, Limit, Verdict};

use super::HandEye;
use super::refine::{Apart, Refined};

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
pub(super) const LEAST_INLIERS: (f64, f64) = (0.7, 0.5);
/// Standard deviations by which one number of two halves may differ.
pub(super) const MOST_APART: f64 = 4.0;
/// Halves that differ by so much as well, degrees, metres and seconds, are of two mountings or two clocks: one answer is wrong for both.
const CLEARLY_APART: [f64; 3] = [0.3, 0.005, 0.002];

/// What of an alignment must not be trusted. `sizes_m` is how the positions of the estimate and of the reference scatter.
pub(super) fn judge(
    found: &HandEye,
    refined: &Refined,
    halves: Option<Apart>,
    sizes_m: [f64; 2],
) -> Vec<Finding> {
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
            "clock offset",
            1000.0 * found.sigma_offset_secs,
            "ms",
            MOST_SIGMA[2],
        ),
    ];
    let mut findings: Vec<Finding> = limits
        .into_iter()
        .map(|(subject, sigma, unit, most)| {
            let verdict = Verdict::Fail.unless(sigma <= most);
            let what = format!("standard deviation {sigma:.2} {unit}");
            Finding::new("observability", verdict, subject, what)
                .value(sigma, unit)
                .limit(Limit::AtMost(most))
                .remedy("rotate the device about two axes, for longer")
        })
        .collect();
    let share = 1.0 - found.outliers as f64 / found.poses.max(1) as f64;
    let what = format!("{} of {} poses do not fit", found.outliers, found.poses);
    findings.push(
        Finding::new("outliers", of_inliers(share), "poses", what)
            .value(100.0 * share, "%")
            .limit(Limit::AtLeast(100.0 * LEAST_INLIERS.0))
            .remedy("check that both belong to one rigid body"),
    );
    // Residuals of neighbouring poses are alike: their standard deviations are then too small.
    if let Some(factor) = refined.correlated_by {
        let what = format!(
            "residuals are correlated: standard deviations were increased by a factor of {factor:.1}"
        );
        findings
            .push(Finding::new("correlated", Verdict::Pass, "residuals", what).value(factor, ""));
    }
    findings.extend(halves.map(agreement));
    findings.extend(other_unit(found, sizes_m).or_else(|| other_positions(found, sizes_m)));
    findings.extend(other_rotations(found));
    findings.extend(same(found));
    findings
}

/// How good a share of poses that fit is.
pub(super) fn of_inliers(share: f64) -> Verdict {
    match share {
        share if share < LEAST_INLIERS.1 => Verdict::Fail,
        share => Verdict::Warn.unless(share >= LEAST_INLIERS.0),
    }
}

/// How bad it is that two halves differ, by standard deviations and by the differences of rotation, translation and clock themselves.
pub(super) fn of_halves(sigmas: f64, apart: [f64; 3]) -> Verdict {
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
        .remedy("something moved between them: the mounting, a clock (--drift), or the estimate's scale; align the parts separately")
}

/// Positions that stay apart and extend differently are in different units.
fn other_unit(found: &HandEye, [estimate_m, reference_m]: [f64; 2]) -> Option<Finding> {
    let times = estimate_m / reference_m;
    let left_m = found.translation_m.rmse;
    let is_apart = left_m > MOST_LEFT * reference_m.min(estimate_m);
    (is_apart && !(1.0 / MOST_LARGER..MOST_LARGER).contains(&times)).then(|| {
        let what = format!(
            "the estimate's positions extend {times:.3} times as far as the reference's, and {left_m:.3} m rms remain between them"
        );
        Finding::new("unit", Verdict::Fail, "positions", what)
            .value(times, "")
            .remedy("write both in metres; a system without observable scale cannot be aligned")
    })
}

/// Positions that no place of body and world brings together.
fn other_positions(found: &HandEye, [estimate_m, reference_m]: [f64; 2]) -> Option<Finding> {
    let left_m = found.translation_m.rmse;
    let scatter_m = reference_m.min(estimate_m);
    (left_m > MOST_UNLIKE * scatter_m).then(|| {
        let what = format!(
            "positions differ by {left_m:.3} m rms after the best alignment, where they scatter by {scatter_m:.3} m"
        );
        Finding::new("positions", Verdict::Fail, "positions", what)
            .value(left_m, "m")
            .limit(Limit::AtMost(MOST_UNLIKE * scatter_m))
            .remedy("check that neither is a mirror image (left-handed axes, two swapped) or lost track; `lsfb eval` says which")
    })
}

/// A reference that was aligned to itself.
fn same(found: &HandEye) -> Option<Finding> {
    let left_m = found.translation_m.rmse;
    (left_m < LEAST_LEFT_M).then(|| {
        let what = format!(
            "both are the same trajectory: {left_m:.1e} m rms between them is less than two systems can reach"
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
            "orientations differ by {left_deg:.1}° rms after the best alignment"
        );
        Finding::new("orientations", Verdict::Fail, "orientations", what)
            .value(left_deg, "°")
            .limit(Limit::AtMost(MOST_LEFT_DEG))
            .remedy("check the order of the quaternion components (x y z w), and that they are of the body in the world and not inverted; `lsfb eval` says which")
    })
}
