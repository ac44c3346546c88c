//! What a reader should know of the figures of an evaluation.

use lsfb_geometry::{Matrix3, Vector3};
use lsfb_types::{Finding, Limit, Verdict};

use super::Evaluation;
use crate::Error;
use crate::association::PosePair;

/// Share of the truth that an estimate should speak about.
const LEAST_COVERED: f64 = 0.9;
/// Share of the estimate's poses that should find one of the truth.
const LEAST_MATCHED: f64 = 0.5;
/// Share of the scatter of the truth's positions that an estimate must explain after its best alignment to be one of that walk.
const LEAST_EXPLAINED: f64 = 0.5;
/// Numbers that an alignment by Sim(3) chooses.
const SIM3_PARAMETERS: f64 = 7.0;
/// Positions that extend sideways by less than this share of their length lie on a line.
const LINE_RATIO: f64 = 0.01;
/// Mean NEES of six between which a covariance is called right.
const NEES_RANGE: std::ops::RangeInclusive<f64> = 1.5..=12.0;

/// How many times larger an estimate is that has other units of length, and which it has where the truth is in metres.
const OTHER_UNITS: [(f64, &str); 4] = [
    (1000.0, "millimetres"),
    (100.0, "centimetres"),
    (0.01, "hundreds of metres"),
    (0.001, "kilometres"),
];
/// Sizes that differ by less, as a share, are alike.
const ALIKE: f64 = 0.05;

/// Poses that repeat a stamp.
pub(super) fn duplicates(count: usize) -> Option<Finding> {
    let what = match count {
        0 => return None,
        1 => "one pose repeats the stamp of the pose before it; both count".to_owned(),
        n => format!("{n} poses repeat the stamp of the pose before them; all count"),
    };
    Some(Finding::new("duplicate-stamps", Verdict::Warn, "stamps", what).value(count as f64, ""))
}

/// A relative error that nobody asked for, and that does not exist.
pub(super) fn left_out(why: &Error) -> Finding {
    Finding::new("rpe", Verdict::Unknown, "relative error", why.to_string())
}

/// What the figures themselves tell.
pub(super) fn of(found: &Evaluation, pairs: &[PosePair]) -> Vec<Finding> {
    let mut findings = vec![coverage(found), matches(found)];
    findings.extend(follows(found, pairs));
    findings.extend(unit(found));
    findings.extend(line(pairs));
    findings.extend(covariance(found));
    findings
}

fn coverage(found: &Evaluation) -> Finding {
    let covered = found.coverage.fraction;
    let verdict = Verdict::Warn.unless(covered >= LEAST_COVERED);
    let what = format!("{:.1} % of the ground truth covered", 100.0 * covered);
    Finding::new("coverage", verdict, "coverage", what)
        .value(100.0 * covered, "%")
        .limit(Limit::AtLeast(100.0 * LEAST_COVERED))
        .remedy("compare it only with estimates that cover as much")
}

fn matches(found: &Evaluation) -> Finding {
    let fewer = found.truth_poses.min(found.estimate_poses).max(1);
    let share = found.matched_poses as f64 / fewer as f64;
    let verdict = Verdict::Warn.unless(share >= LEAST_MATCHED);
    let what = format!(
        "{} of {fewer} poses matched by their stamps",
        found.matched_poses
    );
    Finding::new("matches", verdict, "stamps", what)
        .value(100.0 * share, "%")
        .limit(Limit::AtLeast(100.0 * LEAST_MATCHED))
        .remedy("check that both have one clock, or raise the allowed difference of stamps")
}

/// Whether the estimate, in its best place and size, describes the truth's motion better than one that stands still: a trajectory of
/// another walk, on another clock, or of a system that was lost does not.
fn follows(found: &Evaluation, pairs: &[PosePair]) -> Option<Finding> {
    let best_m = found
        .ate_by_alignment
        .iter()
        .filter_map(|a| a.rmse_m)
        .min_by(f64::total_cmp)?;
    let count = pairs.len() as f64;
    let scatter_m = (scatter_m2(pairs).trace() / count).sqrt();
    // Few poses are met by an alignment that fits them alone.
    let free = (3.0 * count - SIM3_PARAMETERS).max(0.0) / (3.0 * count);
    let explained = 1.0 - (best_m / scatter_m).powi(2) / free;
    let verdict = Verdict::Fail.unless(explained >= LEAST_EXPLAINED);
    let what = match verdict {
        Verdict::Pass => "the estimate follows the truth's motion".to_owned(),
        _ => format!(
            "the estimate does not follow the ground truth: it misses by {best_m:.3} m rms in its best place and size, where the truth's positions scatter by {scatter_m:.3} m rms"
        ),
    };
    let finding = Finding::new("follows", verdict, "positions", what)
        .value(100.0 * explained, "%")
        .limit(Limit::AtLeast(100.0 * LEAST_EXPLAINED))
        .remedy("check that both are of one walk, and by `lsfb align` that both have one clock; else the system was lost");
    explained.is_finite().then_some(finding)
}

/// An estimate in another unit of length than the truth has errors as large as the walk, and no other sign of it.
fn unit(found: &Evaluation) -> Option<Finding> {
    let larger = 1.0 + found.scale_error_percent? / 100.0;
    let (_, unit) = OTHER_UNITS
        .iter()
        .find(|(times, _)| (larger / times - 1.0).abs() < ALIKE)?;
    let what = format!(
        "the estimate is {larger:.4} times as large as the ground truth: is it in {unit}, or the truth in another unit than metres?"
    );
    let finding = Finding::new("unit", Verdict::Warn, "positions", what).value(larger, "");
    Some(finding.remedy("write both in metres, and evaluate again"))
}

/// How the truth's matched positions scatter about their mean, summed, m².
fn scatter_m2(pairs: &[PosePair]) -> Matrix3<f64> {
    let places = || pairs.iter().map(|p| p.truth.world_from_rig.translation);
    let mean = places().sum::<Vector3<f64>>() / pairs.len().max(1) as f64;
    places().map(|p| (p - mean) * (p - mean).transpose()).sum()
}

/// A walk along a line leaves open how the estimate is turned about it: noise decides.
fn line(pairs: &[PosePair]) -> Option<Finding> {
    let mut extents: Vec<f64> = scatter_m2(pairs)
        .symmetric_eigenvalues()
        .iter()
        .map(|v| v.max(0.0).sqrt())
        .collect();
    extents.sort_by(|a, b| b.total_cmp(a));
    let ratio = extents[1] / extents[0];
    (ratio < LINE_RATIO).then(|| {
        let what =
            "the matched positions lie nearly on a line: the rotation about it follows from noise";
        Finding::new("line", Verdict::Warn, "alignment", what)
            .value(ratio, "")
            .limit(Limit::AtLeast(LINE_RATIO))
            .remedy("do not rely on rotation errors, or align by yaw")
    })
}

fn covariance(found: &Evaluation) -> Option<Finding> {
    let consistency = found.consistency?;
    let mean = consistency.nees_mean;
    let verdict = Verdict::Warn.unless(NEES_RANGE.contains(&mean));
    let what = match mean {
        mean if mean > *NEES_RANGE.end() => {
            format!("errors are larger than the covariance says (NEES {mean:.1}, 6 expected)")
        }
        mean if mean < *NEES_RANGE.start() => {
            format!("errors are smaller than the covariance says (NEES {mean:.2}, 6 expected)")
        }
        mean => format!("errors are as large as the covariance says (NEES {mean:.1}, 6 expected)"),
    };
    Some(Finding::new("consistency", verdict, "covariance", what).value(mean, ""))
}
