//! How each edge agrees with all others.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix6, Se3, Vector6};
use lsfb_types::{Finding, Limit, Verdict};
use nalgebra::{DMatrix, SMatrix};

use super::EdgeConsistency;
use super::edge_residual::GraphEdge;

/// Numbers in an edge.
const NUMBERS: f64 = 6.0;
/// Normal deviate of 0.999: one edge in a thousand is called an outlier by accident.
const RARE: f64 = 3.0902;
/// Normal deviate of 0.95, of the regions that covariances are read as.
const USUAL: f64 = 1.6449;
/// Degrees of freedom that stand for infinitely many.
const MANY: f64 = 1e6;
/// Loops that are closed worse have harmed: two steps of the LiDAR in azimuth, two centimetres at three metres, half of what the points
/// of a map may be off (`verify`). Weights that are relative hold any of it to be chance.
const LARGE_LOOP_DEG: f64 = 0.4;
const LARGE_LOOP_MM: f64 = 20.0;
/// Loops that are closed so many times worse than that are none: a transform in them is of other sensors or the other way round.
const BROKEN: f64 = 25.0;
/// Edges whose disagreement is the same within this share cannot be told apart: they lie in one loop only.
const ALIKE: f64 = 0.02;

/// The table, before judgement.
pub(super) fn table(
    graph: &[GraphEdge],
    names: &[&str],
    poses: &BTreeMap<&str, Se3>,
    joint: &DMatrix<f64>,
) -> Vec<EdgeConsistency> {
    let row = |name: &str| names.iter().position(|n| *n == name).map(|k| 6 * k);
    graph
        .iter()
        .map(|edge| {
            let (target, source) = edge.ends();
            let (e, [by_target, by_source]) = edge.error(&poses[target], &poses[source]);
            // What the adjusted poses leave of an edge varies by Σ − A Q Aᵀ.
            let mut by = SMatrix::<f64, 6, 12>::zeros();
            by.fixed_columns_mut::<6>(0).copy_from(&by_target);
            by.fixed_columns_mut::<6>(6).copy_from(&by_source);
            let at = [row(target), row(source)];
            let mut of_poses = SMatrix::<f64, 12, 12>::zeros();
            for (i, a) in at.iter().enumerate() {
                for (j, b) in at.iter().enumerate() {
                    if let (Some(a), Some(b)) = (a, b) {
                        of_poses
                            .fixed_view_mut::<6, 6>(6 * i, 6 * j)
                            .copy_from(&joint.fixed_view::<6, 6>(*a, *b));
                    }
                }
            }
            let left: Matrix6<f64> = edge.covariance - by * of_poses * by.transpose();
            let checked = predicted(&edge.covariance, &left, &e);
            EdgeConsistency {
                target: target.to_owned(),
                source: source.to_owned(),
                measured: edge.measured,
                loop_rotation_rad: checked.map(|c| c.0.fixed_rows::<3>(0).norm()),
                loop_translation_m: checked.map(|c| c.0.fixed_rows::<3>(3).norm()),
                chi_square: checked.map(|c| c.1),
                outlier: false,
                verdict: Verdict::Unknown,
            }
        })
        .collect()
}

/// Disagreement of an edge with the path through all others, and its squared size in expected ones.
fn predicted(
    covariance: &Matrix6<f64>,
    left: &Matrix6<f64>,
    error: &Vector6<f64>,
) -> Option<(Vector6<f64>, f64)> {
    // Whitened, so that "nothing is left" is a pure number.
    let whitening = covariance.cholesky()?.l().try_inverse()?;
    let share = whitening * left * whitening.transpose();
    let eigen = share.symmetric_eigen();
    if eigen.eigenvalues.min() < 1e-6 {
        return None;
    }
    let inverse = left.try_inverse()?;
    let disagreement = covariance * inverse * error;
    Some((disagreement, (error.transpose() * inverse * error)[0]))
}

/// Marks outliers, and says of every edge how it agrees with the others.
pub(super) fn judge(
    table: &mut [EdgeConsistency],
    graph: &[GraphEdge],
    chi_square: f64,
    redundancy: usize,
    relative: bool,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    // Measured covariances mean what they say also beside the paper's, which are too wide to make anything strange.
    let by_spread = graph.iter().all(|e| !e.measured);
    let strange = |own: f64| {
        let rest = redundancy as f64 - NUMBERS;
        if by_spread {
            // Against the spread that all others have among themselves.
            let others = (chi_square - own).max(1e-12) / rest;
            rest > 0.0 && own / NUMBERS / others > f_quantile(RARE, NUMBERS, rest)
        } else {
            own / NUMBERS > f_quantile(RARE, NUMBERS, MANY)
        }
    };
    let worst = table
        .iter()
        .filter_map(|e| e.chi_square)
        .fold(0.0, f64::max);
    if strange(worst) {
        // Others are strange because of the worst one: those are for the next run.
        for edge in table.iter_mut() {
            edge.outlier = edge.chi_square.is_some_and(|c| c > (1.0 - ALIKE) * worst);
        }
    }
    for edge in table.iter_mut() {
        edge.verdict = verdict(edge, relative);
    }
    findings.extend(contradictions(table));
    let others = table.iter().filter(|e| !e.outlier);
    findings.extend(others.map(|e| agreement(e, relative)));
    let factor = chi_square / redundancy.max(1) as f64;
    let most = f_quantile(RARE, redundancy as f64, MANY);
    let are_good = findings
        .iter()
        .all(|f: &Finding| f.verdict == Verdict::Pass);
    if !relative && redundancy > 0 && factor > most && are_good {
        let what = format!(
            "residuals of all transforms together are {:.1} times what their covariances predict",
            factor.sqrt()
        );
        let finding = Finding::new("variance", Verdict::Warn, "covariances", what)
            .value(factor, "")
            .limit(Limit::AtMost(most));
        findings
            .push(finding.remedy(
                "the covariance of one of the steps is too small: repeat that step with another recording",
            ));
    }
    if relative && graph.iter().any(|e| e.measured) {
        let without: Vec<String> = graph
            .iter()
            .zip(table.iter())
            .filter(|(g, _)| !g.measured)
            .map(|(_, e)| name(e))
            .collect();
        let what = format!(
            "{} without a measured covariance: the paper's covariance is so large that they hardly count beside the measured ones",
            without.join(", ")
        );
        let finding = Finding::new("weights", Verdict::Warn, "covariances", what);
        findings.push(finding.remedy("pass transforms of `lsfb calib`, which include covariances"));
    }
    findings
}

/// How an edge came out; where weights are `relative`, their spread says nothing of that, and the width of its loops does.
fn verdict(edge: &EdgeConsistency, relative: bool) -> Verdict {
    if edge.outlier {
        return Verdict::Fail;
    }
    if edge.chi_square.is_none() {
        return Verdict::Warn;
    }
    match wide_loop(edge, relative) {
        None => Verdict::Pass,
        Some(wide) if wide.value > BROKEN * wide.most => Verdict::Fail,
        Some(_) => Verdict::Warn,
    }
}

/// What an edge is off by around its loops, and what it may be.
struct LoopWidth {
    value: f64,
    unit: &'static str,
    most: f64,
}

fn loop_widths(edge: &EdgeConsistency) -> [LoopWidth; 2] {
    let turn_rad = edge.loop_rotation_rad.unwrap_or_default();
    let shift_m = edge.loop_translation_m.unwrap_or_default();
    [
        LoopWidth {
            value: turn_rad.to_degrees(),
            unit: "°",
            most: LARGE_LOOP_DEG,
        },
        LoopWidth {
            value: shift_m * 1e3,
            unit: "mm",
            most: LARGE_LOOP_MM,
        },
    ]
}

/// The first that is too much, where that is judged at all.
fn wide_loop(edge: &EdgeConsistency, relative: bool) -> Option<LoopWidth> {
    let is_wide = |width: &LoopWidth| relative && width.value > width.most;
    loop_widths(edge).into_iter().find(is_wide)
}

/// Edges that contradict all others; none where they follow each other in every loop, and nobody knows which.
fn contradictions(table: &[EdgeConsistency]) -> Option<Finding> {
    let outliers: Vec<&EdgeConsistency> = table.iter().filter(|e| e.outlier).collect();
    let words = |e: &EdgeConsistency| {
        format!(
            "{} (off by {:.2}°, {:.1} mm)",
            name(e),
            e.loop_rotation_rad.unwrap_or_default().to_degrees(),
            e.loop_translation_m.unwrap_or_default() * 1e3
        )
    };
    let finding = |subject: String, what: String| {
        let chi_square = outliers.first().and_then(|e| e.chi_square);
        let verdict = Verdict::worst(outliers.iter().map(|e| e.verdict));
        Finding::new("contradiction", verdict, subject, what)
            .value(chi_square.unwrap_or(f64::NAN), "")
            .limit(Limit::AtMost(NUMBERS * f_quantile(RARE, NUMBERS, MANY)))
    };
    let names: Vec<String> = outliers.iter().map(|e| words(e)).collect();
    match outliers.as_slice() {
        [] => None,
        [only] => Some(
            finding(
                name(only),
                format!("{} contradicts all others", words(only)),
            )
            .remedy("measure it again"),
        ),
        several => {
            let subjects: Vec<String> = several.iter().map(|e| name(e)).collect();
            let what = format!(
                "one of these contradicts all others: {}; every loop contains all of them, so that they cannot be told apart",
                names.join(" or ")
            );
            Some(finding(subjects.join(", "), what).remedy(
                "measure them again, or add a transform to another sensor that tells them apart",
            ))
        }
    }
}

/// How an edge that is no outlier agrees with the others.
fn agreement(edge: &EdgeConsistency, relative: bool) -> Finding {
    let subject = name(edge);
    let Some(chi_square) = edge.chi_square else {
        let what = format!("{subject} is unchecked: no other path connects the two sensors");
        return Finding::new("unchecked", edge.verdict, subject, what)
            .remedy("add a transform that closes a loop");
    };
    let [turn_deg, shift_mm] = loop_widths(edge).map(|width| width.value);
    let what = format!("closes its loops to {turn_deg:.3}° and {shift_mm:.2} mm");
    if let Some(wide) = wide_loop(edge, relative) {
        return Finding::new("wide-loop", edge.verdict, subject, what)
            .value(wide.value, wide.unit)
            .limit(Limit::AtMost(wide.most))
            .remedy("measure the transforms of these sensors again: the rig cannot be more accurate than its loops");
    }
    Finding::new("loop", edge.verdict, subject, what)
        .value(chi_square, "")
        .limit(Limit::AtMost(NUMBERS * f_quantile(RARE, NUMBERS, MANY)))
}

fn name(edge: &EdgeConsistency) -> String {
    format!("{}–{}", edge.target, edge.source)
}

/// The factor where it is more than accident, else 1.
pub(super) fn significant_factor(factor: f64, redundancy: usize) -> f64 {
    if redundancy > 0 && factor > f_quantile(RARE, redundancy as f64, MANY) {
        factor * widening(redundancy)
    } else {
        1.0
    }
}

/// By how much a covariance must be larger for its 95 % region to hold 95 % when its scale was found from so many numbers.
pub(super) fn widening(redundancy: usize) -> f64 {
    if redundancy == 0 {
        return 1.0;
    }
    f_quantile(USUAL, NUMBERS, redundancy as f64) / f_quantile(USUAL, NUMBERS, MANY)
}

/// Quantile of Fisher's F at a normal deviate, by Paulson's approximation.
fn f_quantile(deviate: f64, first: f64, second: f64) -> f64 {
    let (a, b) = (2.0 / (9.0 * first), 2.0 / (9.0 * second));
    let z2 = deviate * deviate;
    let (p, q) = (1.0 - a, 1.0 - b);
    let below = q * q - b * z2;
    if below <= 0.0 {
        return f64::INFINITY;
    }
    let root = (q * q * a + p * p * b - a * b * z2).max(0.0).sqrt();
    ((p * q + deviate * root) / below).powi(3)
}

#[cfg(test)]
mod tests {
    use super::{RARE, USUAL, f_quantile};

    /// SciPy 1.17: `scipy.stats.f.ppf(0.999, a, b)` and `0.95`. Near with many numbers left over, careful with few.
    #[test]
    fn quantiles_are_those_of_tables() {
        for (deviate, a, b, expected, within) in [
            (RARE, 6.0, 12.0, 8.378822, 0.25),
            (RARE, 6.0, 6.0, 20.029644, 0.25),
            (RARE, 6.0, 1e6, 3.742978, 0.02),
            (RARE, 18.0, 1e6, 2.350675, 0.02),
            (USUAL, 6.0, 6.0, 4.283866, 0.03),
            (USUAL, 6.0, 18.0, 2.661305, 0.01),
            (USUAL, 6.0, 1e6, 2.098607, 0.01),
        ] {
            let got = f_quantile(deviate, a, b);
            assert!((got / expected - 1.0).abs() < within, "{a} {b}: {got}");
        }
    }
}
