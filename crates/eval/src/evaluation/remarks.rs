//! What a reader should know of the figures of an evaluation.

use lsfb_geometry::{Matrix3, Vector3};
use lsfb_types::{Finding, Limit, Verdict};

use super::{Evaluation, conventions, odd_poses, relative};
use crate::alignment::AlignmentMode;
use crate::association::PosePair;
use crate::read::NO_STAMPS;
use crate::{Error, TrajectoryFile};

/// Share of the truth that an estimate should speak about.
const LEAST_COVERED: f64 = 0.9;
/// Share of the poses of the shorter file that should find one of the longer.
const LEAST_MATCHED: f64 = 0.5;
/// With a smaller share of them the two are of different times or clocks, and what they share is no result.
const LEAST_SHARED: f64 = 0.1;
/// Numbers that errors must be made of beyond those that the alignment chose: their root mean square is then known to a tenth of itself.
const LEAST_FREEDOM: f64 = 50.0;
/// Share of the scatter of the truth's positions that an estimate must explain after its best alignment to be one of that walk.
const LEAST_EXPLAINED: f64 = 0.5;
/// Numbers that an alignment by Sim(3) chooses.
const SIM3_PARAMETERS: f64 = 7.0;
/// Positions that extend sideways by less than this share of their length lie on a line.
const LINE_RATIO: f64 = 0.01;
/// No estimate is so near the truth, metres: it is the truth.
const LEAST_ERROR_M: f64 = 1e-6;
/// So many poses that are the truth's, and such a share of them, are no chance.
const LEAST_COPIED: usize = 20;
const COPIED_SHARE: f64 = 0.1;
/// Share of poses that differ from the truth by no more than their last digit: an estimate as good as a tenth of that has fewer.
const ROUNDED_SHARE: f64 = 0.99;
/// Mean NEES, as a multiple of its degrees of freedom, between which a covariance is called right.
const NEES_RATIO: std::ops::RangeInclusive<f64> = 0.25..=2.0;

/// How many times larger an estimate is that has other units of length, and which it has where the truth is in metres.
const OTHER_UNITS: [(f64, &str); 4] = [
    (1000.0, "millimetres"),
    (100.0, "centimetres"),
    (0.01, "hundreds of metres"),
    (0.001, "kilometres"),
];
/// An estimate that is larger or smaller by more, as a share, is of another size.
const MOST_SCALE: f64 = 0.05;
/// By how much a scale must lessen its errors to be named.
const LESS: f64 = 0.5;
/// Sizes that differ by less, as a share, are alike.
const ALIKE: f64 = 0.05;

/// Poses that repeat a stamp.
pub(super) fn duplicates(count: usize) -> Option<Finding> {
    let what = match count {
        0 => return None,
        1 => "one pose repeats the stamp of the previous pose".to_owned(),
        n => format!("{n} poses repeat the stamp of the previous pose"),
    };
    Some(Finding::new("duplicate-stamps", Verdict::Warn, "stamps", what).value(count as f64, ""))
}

/// A relative error that nobody asked for, and that does not exist.
pub(super) fn left_out(why: &Error) -> Finding {
    Finding::new("rpe", Verdict::Unknown, "relative error", why.to_string())
}

/// Rows without stamps belong together by their numbers, where none is missing in either file.
pub(super) fn rows_by_number(truth: &TrajectoryFile, estimate: &TrajectoryFile) -> Option<Finding> {
    let is_numbered = |file: &TrajectoryFile| file.findings.iter().any(|f| f.code == NO_STAMPS);
    let [all, own] = [truth, estimate].map(|file| file.poses.len());
    (is_numbered(truth) && is_numbered(estimate) && all != own).then(|| {
        let what = format!(
            "neither file has stamps, and the estimate has {own} rows, the truth {all}: poses cannot be matched"
        );
        Finding::new(NO_STAMPS, Verdict::Fail, "stamps", what)
            .remedy("write both with stamps (TUM), or one row for every frame")
    })
}

/// Covariances none of which can be one: ROS has zeros where nothing is known.
pub(super) fn no_covariance(count: usize) -> Finding {
    let what = format!(
        "none of the {count} covariances is positive definite: the consistency of the errors is unknown"
    );
    Finding::new("consistency", Verdict::Unknown, "covariance", what)
}

/// What the figures themselves tell. `parameters` are the numbers that the alignment took from the matched poses.
pub(super) fn of(
    found: &Evaluation,
    pairs: &[PosePair],
    aligned: &[PosePair],
    parameters: usize,
) -> Vec<Finding> {
    let mut findings = vec![coverage(found), matches(found)];
    let few = few_poses(found, parameters);
    if few.is_none() {
        let followed = follows(found, pairs);
        let is_lost = followed
            .as_ref()
            .is_some_and(|f| f.verdict == Verdict::Fail);
        findings.extend(followed);
        let errors = found.ate_by_alignment.iter().filter_map(|a| a.rmse_m);
        let best_m = errors.min_by(f64::total_cmp);
        // Of the truth itself, errors are those of rounding.
        if let Some(best_m) = best_m.filter(|best_m| *best_m >= LEAST_ERROR_M) {
            findings.extend(conventions::mirrored(pairs, best_m));
            let has_rotations = found.ate_rotation_deg.is_some();
            findings.extend(
                has_rotations
                    .then(|| conventions::inverse(pairs, best_m))
                    .flatten(),
            );
            let named = (!is_lost)
                .then(|| one_cause(found, pairs, best_m))
                .flatten();
            let is_late = named.as_ref().is_some_and(|f| f.code == "clock");
            findings.extend(named);
            let turns = has_rotations && !is_lost && !is_late;
            findings.extend(turns.then(|| conventions::late_turns(aligned)).flatten());
        }
        if let Some(rotation) = found.ate_rotation_deg.filter(|_| !is_lost) {
            findings.extend(conventions::orientations(pairs, aligned, rotation.rmse));
        }
        let errors_m: Vec<f64> = found.errors.iter().map(|e| e.translation_m).collect();
        let held = odd_poses::held(pairs);
        // Errors of rounding have no outliers.
        let has_errors = best_m.is_some_and(|best_m| best_m >= LEAST_ERROR_M);
        let outliers = || odd_poses::outliers(pairs, &errors_m).filter(|_| has_errors);
        findings.extend(held.or_else(outliers));
    }
    findings.extend(found.rpe.iter().filter_map(relative::deltas));
    findings.extend(few);
    let has_rotations = found.ate_rotation_deg.is_some();
    findings.extend(same(found).or_else(|| copied(pairs)).or_else(|| {
        has_rotations
            .then(|| conventions::copied_orientations(aligned))
            .flatten()
    }));
    findings.extend(unit(found).or_else(|| scale(found)));
    findings.extend(line(pairs));
    findings.extend(covariance(found));
    findings.extend(bad_covariances(found));
    findings
}

/// The one cause, if there is one, that explains most of the errors.
fn one_cause(found: &Evaluation, pairs: &[PosePair], best_m: f64) -> Option<Finding> {
    let turns = found.ate_rotation_deg.is_some();
    let of_turns = |cause: fn(&[PosePair], f64) -> Option<Finding>| {
        turns.then(|| cause(pairs, best_m)).flatten()
    };
    conventions::clock(pairs, best_m)
        .or_else(|| of_turns(conventions::lever))
        .or_else(|| conventions::axes(pairs, best_m))
        .or_else(|| of_turns(conventions::running_clock))
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
    let verdict = match share {
        share if share < LEAST_SHARED => Verdict::Fail,
        share => Verdict::Warn.unless(share >= LEAST_MATCHED),
    };
    let what = format!(
        "{} of {fewer} poses matched by their stamps",
        found.matched_poses
    );
    Finding::new("matches", verdict, "stamps", what)
        .value(100.0 * share, "%")
        .limit(Limit::AtLeast(100.0 * LEAST_MATCHED))
        .remedy("check that both use one clock, or raise the allowed stamp difference")
}

/// Through few poses everything fits: their errors say nothing, however small.
fn few_poses(found: &Evaluation, parameters: usize) -> Option<Finding> {
    let freedom = (3 * found.matched_poses) as f64 - parameters as f64;
    let what = format!(
        "only {} poses match: too few for a result; aligned by {}, their errors have {freedom} degrees of freedom",
        found.matched_poses, found.alignment
    );
    let finding = Finding::new("few-poses", Verdict::Fail, "stamps", what)
        .value(freedom, "")
        .limit(Limit::AtLeast(LEAST_FREEDOM))
        .remedy("check that both are of the same time; evaluate a longer part, or every frame instead of keyframes only");
    (freedom < LEAST_FREEDOM).then_some(finding)
}

/// Whether the estimate, in its best place and size, describes the truth's motion better than one that stands still: a trajectory of
/// another walk, on another clock, or of a system that was lost does not. And better than one that goes straight on at an even speed: of
/// a walk that is nearly so, any other such walk is as good an estimate.
fn follows(found: &Evaluation, pairs: &[PosePair]) -> Option<Finding> {
    let best_m = found
        .ate_by_alignment
        .iter()
        .filter_map(|a| a.rmse_m)
        .min_by(f64::total_cmp)?;
    let count = pairs.len() as f64;
    let free = 1.0 - SIM3_PARAMETERS / (3.0 * count);
    let explained = |scatter_m2: f64| 1.0 - best_m * best_m * count / scatter_m2 / free;
    let scatter_m = (scatter_m2(pairs).trace() / count).sqrt();
    let of_all = explained(scatter_m * scatter_m * count);
    let of_bends = explained(bends_m2(pairs));
    let finding = |verdict, explained: f64, what: String| {
        Finding::new("follows", verdict, "positions", what)
            .value(100.0 * explained, "%")
            .limit(Limit::AtLeast(100.0 * LEAST_EXPLAINED))
    };
    if scatter_m < LEAST_ERROR_M {
        let what = format!(
            "the ground truth stays in one place: errors of {best_m:.3} m rms only show how far the estimate is from it, and not that they belong to the same walk"
        );
        return Some(
            Finding::new("follows", Verdict::Warn, "positions", what)
                .value(scatter_m, "m")
                .remedy(
                    "check that this is the right ground truth, and which of its columns are the position",
                ),
        );
    }
    if !of_all.is_finite() {
        return None;
    }
    if of_all < LEAST_EXPLAINED {
        let what = format!(
            "the estimate does not follow the ground truth: its error is {best_m:.3} m rms after the best alignment with scale, where the truth's positions scatter by {scatter_m:.3} m rms"
        );
        return Some(finding(Verdict::Fail, of_all, what).remedy("check that both belong to one walk, and with `lsfb align` that they use one clock; otherwise the system lost track"));
    }
    // Exactly straight and even, there are no bends to explain.
    if !(of_bends >= LEAST_EXPLAINED) {
        let what = format!(
            "the walk is nearly straight and uniform, and any other such walk fits as well: errors of {best_m:.3} m rms do not show that the estimate belongs to this one"
        );
        let of_bends = if of_bends.is_finite() { of_bends } else { 0.0 };
        return Some(
            finding(Verdict::Warn, of_bends, what).remedy("evaluate a longer part, with turns"),
        );
    }
    let what = "the estimate follows the truth's motion".to_owned();
    Some(finding(Verdict::Pass, of_bends, what))
}

/// A truth that was evaluated in place of an estimate, also one that was moved or scaled.
fn same(found: &Evaluation) -> Option<Finding> {
    let errors = found.ate_by_alignment.iter().filter_map(|a| a.rmse_m);
    let best_m = errors.min_by(f64::total_cmp)?;
    (best_m < LEAST_ERROR_M).then(|| {
        let what = format!(
            "the estimate looks like the ground truth itself: {best_m:.1e} m rms is below the error of any real estimate"
        );
        Finding::new("same", Verdict::Warn, "positions", what)
            .value(best_m, "m")
            .limit(Limit::AtLeast(LEAST_ERROR_M))
            .remedy("check which file was evaluated, and that the system cannot read the truth")
    })
}

/// Poses of the truth among those of an estimate, or all of it with fewer digits. Where the truth rests nothing is copied: it may stay
/// where both begin.
fn copied(pairs: &[PosePair]) -> Option<Finding> {
    let places = |p: &PosePair| [p.truth, p.estimate].map(|pose| pose.world_from_rig.translation);
    let moving: Vec<[Vector3<f64>; 2]> = pairs
        .windows(2)
        .map(|w| [places(&w[0]), places(&w[1])])
        .filter(|[before, now]| (now[0] - before[0]).norm() > LEAST_ERROR_M)
        .map(|[_, now]| now)
        .collect();
    let all = moving.len();
    let is_many =
        |count: usize, share: f64| count >= LEAST_COPIED && count as f64 >= share * all as f64;
    let off = |[truth, estimate]: &[Vector3<f64>; 2]| (truth - estimate).amax();
    let equal = moving.iter().filter(|p| off(p) < LEAST_ERROR_M).count();
    let finding = |what: String, count: usize| {
        Finding::new("same", Verdict::Warn, "positions", what)
            .value(count as f64, "")
            .remedy("check which file was evaluated, and that the system cannot read the truth")
    };
    if is_many(equal, COPIED_SHARE) {
        let what =
            format!("{equal} of {all} poses of the estimate are identical to the ground truth");
        return Some(finding(what, equal));
    }
    let digits = (1..=6).find(|digits| {
        let size = 10f64.powi(*digits);
        // Far from the origin the last bits of the number itself are in it.
        let is_printed = |v: &f64| {
            let last = v * size;
            (last - last.round()).abs() < 1e-6 + 1e-15 * last.abs()
        };
        let is_rounded =
            |p: &&[Vector3<f64>; 2]| p[1].iter().all(is_printed) && off(p) * size <= 0.5 + 1e-6;
        let rounded = moving.iter().filter(is_rounded).count();
        is_many(rounded, ROUNDED_SHARE)
    })?;
    let what = format!("the estimate is the ground truth rounded to {digits} decimals");
    Some(finding(what, all))
}

/// An estimate in another unit of length than the truth has errors as large as the walk, and no other sign of it.
fn unit(found: &Evaluation) -> Option<Finding> {
    let larger = 1.0 + found.scale_error_percent? / 100.0;
    let (_, unit) = OTHER_UNITS
        .iter()
        .find(|(times, _)| (larger / times - 1.0).abs() < ALIKE)?;
    let what = format!(
        "the estimate is {larger:.4} times as large as the ground truth: is it in {unit}, or is the truth not in metres?"
    );
    let finding = Finding::new("unit", Verdict::Warn, "positions", what).value(larger, "");
    Some(finding.remedy("write both in metres, and evaluate again"))
}

/// An estimate of another size, aligned as if it had that of the truth: its errors are of its size.
fn scale(found: &Evaluation) -> Option<Finding> {
    let larger = 1.0 + found.scale_error_percent? / 100.0;
    let free = AlignmentMode::Sim3.label();
    let of_free = found.ate_by_alignment.iter().find(|a| a.alignment == free);
    let free_m = of_free?.rmse_m?;
    let own_m = found.ate_translation_m.rmse;
    let is_of_size = found.alignment != free && free_m < LESS * own_m;
    (is_of_size && !(1.0 - MOST_SCALE..1.0 + MOST_SCALE).contains(&larger)).then(|| {
        let what = format!(
            "the estimate is {larger:.4} times as large as the ground truth: aligned with a scale, its error is {free_m:.4} m rms instead of {own_m:.4} m"
        );
        Finding::new("scale", Verdict::Warn, "positions", what)
            .value(larger, "")
            .remedy("align by sim3 if the system cannot observe scale; otherwise look for another unit (a foot is 0.3048 m, a yard 0.9144 m)")
    })
}

/// How the truth's matched positions scatter about their mean, summed, m².
fn scatter_m2(pairs: &[PosePair]) -> Matrix3<f64> {
    let places = || pairs.iter().map(|p| p.truth.world_from_rig.translation);
    let mean = places().sum::<Vector3<f64>>() / pairs.len().max(1) as f64;
    places().map(|p| (p - mean) * (p - mean).transpose()).sum()
}

/// How the truth's matched positions scatter about an even motion along a line, summed, m².
fn bends_m2(pairs: &[PosePair]) -> f64 {
    let Some(first) = pairs.first() else {
        return 0.0;
    };
    let count = pairs.len() as f64;
    let secs = |p: &PosePair| p.truth.time.secs_since(first.truth.time);
    let place = |p: &PosePair| p.truth.world_from_rig.translation;
    let mean_secs = pairs.iter().map(secs).sum::<f64>() / count;
    let mean = pairs.iter().map(place).sum::<Vector3<f64>>() / count;
    let (mut along, mut spread) = (Vector3::zeros(), 0.0);
    for pair in pairs {
        along += (place(pair) - mean) * (secs(pair) - mean_secs);
        spread += (secs(pair) - mean_secs).powi(2);
    }
    let speed = along / spread;
    let off = |p: &PosePair| place(p) - mean - speed * (secs(p) - mean_secs);
    pairs.iter().map(|p| off(p).norm_squared()).sum()
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
            "the matched positions are nearly on a line: the rotation about it is determined by noise";
        Finding::new("line", Verdict::Warn, "alignment", what)
            .value(ratio, "")
            .limit(Limit::AtLeast(LINE_RATIO))
            .remedy("do not rely on rotation errors, or align by yaw")
    })
}

/// Errors beside the covariance, of the parts as well: where one is far too small and the other right, their sum may look right.
fn covariance(found: &Evaluation) -> Option<Finding> {
    let consistency = found.consistency?;
    let parts = [
        ("errors", consistency.nees_mean, 6.0),
        ("rotation errors", consistency.rotation_nees_mean, 3.0),
        ("translation errors", consistency.translation_nees_mean, 3.0),
    ];
    let is_right = |(_, mean, expected): &(&str, f64, f64)| NEES_RATIO.contains(&(mean / expected));
    let wrong = parts.iter().find(|part| !is_right(part));
    let (whose, mean, expected) = *wrong.unwrap_or(&parts[0]);
    let verdict = Verdict::Warn.unless(wrong.is_none());
    let size = match mean / expected {
        ratio if ratio > *NEES_RATIO.end() => "larger than",
        ratio if ratio < *NEES_RATIO.start() => "smaller than",
        _ => "as large as",
    };
    let mut what =
        format!("{whose} are {size} the covariance predicts (NEES {mean:.3}, {expected} expected)");
    for (whose, mean, unit, times) in [
        (parts[1].0, parts[1].1, "square degrees", 57.3_f64.powi(2)),
        (parts[2].0, parts[2].1, "square centimetres", 1e4),
        (parts[2].0, parts[2].1, "square millimetres", 1e6),
    ] {
        // Numbers in the smaller unit make the covariance so many times too large; to within a factor of four.
        if (times * mean / 3.0).log2().abs() < 2.0 {
            what += &format!("; for {whose} it may be in {unit}");
        }
    }
    Some(Finding::new("consistency", verdict, "covariance", what).value(mean, ""))
}

/// Covariances that are none are not tried, and the others alone count.
fn bad_covariances(found: &Evaluation) -> Option<Finding> {
    let consistency = found.consistency?;
    let bad = consistency.bad_covariances;
    (bad > 0).then(|| {
        let all = bad + consistency.poses;
        let what = format!(
            "{bad} of {all} covariances are not positive definite: these poses are left out"
        );
        Finding::new("bad-covariances", Verdict::Warn, "covariance", what).value(bad as f64, "")
    })
}
