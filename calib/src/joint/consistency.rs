//! How each edge agrees with all others.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix6, Se3, Vector6};
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

/// Marks outliers and says what to look at.
pub(super) fn judge(
    table: &mut [EdgeConsistency],
    graph: &[GraphEdge],
    chi_square: f64,
    redundancy: usize,
    relative: bool,
) -> Vec<String> {
    let mut warnings = Vec::new();
    let unchecked: Vec<String> = table
        .iter()
        .filter(|e| e.chi_square.is_none())
        .map(name)
        .collect();
    if !unchecked.is_empty() {
        warnings.push(format!(
            "nothing checks {}: no other path joins its ends",
            unchecked.join(", ")
        ));
    }
    let strange = |own: f64| {
        let rest = redundancy as f64 - NUMBERS;
        if relative {
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
        let mut named = Vec::new();
        for edge in table.iter_mut() {
            if edge.chi_square.is_some_and(|c| c > (1.0 - ALIKE) * worst) {
                edge.outlier = true;
                named.push(format!(
                    "{} (off by {:.2}°, {:.1} mm)",
                    name(edge),
                    edge.loop_rotation_rad.unwrap_or_default().to_degrees(),
                    edge.loop_translation_m.unwrap_or_default() * 1e3
                ));
            }
        }
        warnings.push(if named.len() == 1 {
            format!("{} contradicts all others: measure it again", named[0])
        } else {
            format!(
                "one of these contradicts all others: {}; they follow each other in every loop: measure them again, or add a transform to another sensor that tells which",
                named.join(" or ")
            )
        });
    }
    if !relative && redundancy > 0 {
        let factor = chi_square / redundancy as f64;
        if factor > f_quantile(RARE, redundancy as f64, MANY) && warnings.is_empty() {
            warnings.push(format!(
                "all edges together miss by {:.1} times what their covariances say: one of the steps is too sure of itself",
                factor.sqrt()
            ));
        }
    }
    if relative && graph.iter().any(|e| e.measured) {
        let without: Vec<String> = graph
            .iter()
            .zip(table.iter())
            .filter(|(g, _)| !g.measured)
            .map(|(_, e)| name(e))
            .collect();
        warnings.push(format!(
            "{} without measured covariance: the paper's is so wide that it hardly counts beside those that are measured",
            without.join(", ")
        ));
    }
    warnings
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
