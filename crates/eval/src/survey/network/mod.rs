//! The adjustment of a survey: Eq. (6) of the paper, with what each measurement is checked by.

use lsfb_geometry::Vector2;
use lsfb_solver::{Kernel, Problem, SolveConfig, solve};
use lsfb_types::Finding;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::file::{Survey, Tape, TapeKind};
use super::initial::{Edge, mirrored, places};
use super::observation::{Observation, Quantity};
use super::snooping;
use crate::Error;

/// Eigenvalues of the normal matrix below this share of the largest are of directions that nothing measures.
const LEAST_EIGENVALUE: f64 = 1e-10;
/// A second place of a mark counts where it fits about as well: by this much of the sum of weighted squares.
const SAME_FIT: f64 = 4.0;

/// A mark that was computed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mark {
    /// Its name.
    pub name: String,
    /// Along horizontal lines, metres from the first mark.
    pub x_m: f64,
    /// Along vertical lines, metres from the first mark.
    pub y_m: f64,
    /// Standard deviation of x, metres, relative to the first mark.
    pub sigma_x_m: f64,
    /// Standard deviation of y, metres.
    pub sigma_y_m: f64,
}

/// What became of one measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObservationReport {
    /// `p1–p2`, `p1–p2 same y`.
    pub what: String,
    /// What was read, metres; absent for lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_m: Option<f64>,
    /// Computed less read, metres.
    pub residual_m: f64,
    /// Standard deviation that was stated, metres.
    pub sigma_m: f64,
    /// Share of an error here that shows in its residual, 0 to 1; zero where nothing checks it.
    pub redundancy: f64,
    /// Residual over its own standard deviation; absent where nothing checks it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub w: Option<f64>,
    /// Smallest blunder that would be found four times of five, metres; absent where nothing checks it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smallest_blunder_m: Option<f64>,
    /// Left out of the solution as a blunder; its residual is then that against the others.
    pub left_out: bool,
}

/// Root mean squares of the three terms of Eq. (6), metres; absent where there are none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TermRms {
    /// Distances.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<f64>,
    /// Deviations from horizontal lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizontal_m: Option<f64>,
    /// Deviations from vertical lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertical_m: Option<f64>,
}

/// A survey that was solved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SurveySolution {
    /// The marks.
    pub marks: Vec<Mark>,
    /// Every measurement, distances and lines as the file has them.
    pub observations: Vec<ObservationReport>,
    /// Root mean squares by term, of what was used.
    pub rms: TermRms,
    /// Measurements used less unknowns.
    pub degrees_of_freedom: usize,
    /// By which factor residuals are larger than the stated standard deviations say; absent where nothing is checked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma0: Option<f64>,
    /// Blunders, measurements that nothing checks, and whether standard deviations are right.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

impl SurveySolution {
    /// Place of a mark, metres.
    pub fn place(&self, name: &str) -> Option<Vector2<f64>> {
        let mark = self.marks.iter().find(|m| m.name == name)?;
        Some(Vector2::new(mark.x_m, mark.y_m))
    }
}

/// What the adjustment knows of the measurements it used.
pub(super) struct Adjusted {
    pub places: Vec<Vector2<f64>>,
    /// Covariance of x and y of all marks, by the stated standard deviations; zero for what is held.
    pub covariance: DMatrix<f64>,
    /// Weighted residuals, in the order of the observations.
    pub weighted: Vec<f64>,
    /// Redundancy numbers, in the same order.
    pub redundancy: Vec<f64>,
}

impl Adjusted {
    /// Sum of weighted squares.
    pub fn cost(&self) -> f64 {
        self.weighted.iter().map(|v| v * v).sum()
    }
}

/// Computes the marks, names blunders and leaves them out.
pub fn solve_survey(survey: &Survey) -> Result<SurveySolution, Error> {
    let names = survey.marks();
    let observations = observations(survey, &names);
    let start = places(&names, &edges(survey, &names))?;
    let start = best_sides(&names, &observations, start)?;
    snooping::without_blunders(&names, &observations, start)
}

fn index(names: &[&str], name: &str) -> usize {
    // Every end of a tape is one of the names.
    names.iter().position(|n| *n == name).unwrap_or_default()
}

fn edges(survey: &Survey, names: &[&str]) -> Vec<Edge> {
    let edge = |tape: &Tape| Edge {
        kind: tape.kind,
        ends: [index(names, &tape.ends[0]), index(names, &tape.ends[1])],
        distance_m: tape.distance_m,
    };
    survey.tapes.iter().map(edge).collect()
}

fn observations(survey: &Survey, names: &[&str]) -> Vec<Observation> {
    let mut all = Vec::new();
    for (tape, (edge, read)) in edges(survey, names).iter().zip(&survey.tapes).enumerate() {
        let mut add = |quantity, sigma_m| {
            all.push(Observation {
                quantity,
                ends: edge.ends,
                sigma_m,
                tape,
            });
        };
        add(Quantity::Distance(read.distance_m), read.sigma_m);
        match read.kind {
            TapeKind::Horizontal => add(Quantity::SameY, survey.line_sigma_m),
            TapeKind::Vertical => add(Quantity::SameX, survey.line_sigma_m),
            TapeKind::Free => {}
        }
    }
    all
}

/// The marks that best fit the observations. Held are the origin and, without lines, the y of the second mark of the first distance.
pub(super) fn adjust(
    names: &[&str],
    observations: &[Observation],
    start: &[Vector2<f64>],
) -> Result<Adjusted, Error> {
    let mut problem = Problem::new();
    let blocks: Vec<_> = start
        .iter()
        .map(|place| problem.add_block(*place))
        .collect();
    let held = held(observations, start);
    for (mark, components) in held.chunks_exact(2).enumerate() {
        let components: Vec<usize> = (0..2).filter(|k| components[*k]).collect();
        if !components.is_empty() {
            problem.set_constant_components(blocks[mark], &components)?;
        }
    }
    for observation in observations {
        let [a, b] = observation.ends.map(|end| blocks[end].id());
        problem.add_residual(*observation, &[a, b], Kernel::Squared)?;
    }
    let config = SolveConfig {
        cost_tolerance: 1e-14,
        step_tolerance: 1e-13,
        max_iterations: 200,
        ..SolveConfig::default()
    };
    solve(&mut problem, &config)?;
    let places: Vec<Vector2<f64>> = blocks.iter().map(|block| problem.value(*block)).collect();
    covariance(names, observations, places, &held)
}

/// Which coordinates define where the survey lies: x and y of each mark.
fn held(observations: &[Observation], start: &[Vector2<f64>]) -> Vec<bool> {
    let mut held = vec![false; 2 * start.len()];
    let has_line = observations
        .iter()
        .any(|o| !matches!(o.quantity, Quantity::Distance(_)));
    let origin = start
        .iter()
        .position(|p| *p == Vector2::zeros())
        .unwrap_or_default();
    held[2 * origin] = true;
    held[2 * origin + 1] = true;
    if !has_line {
        let on_x = (0..start.len()).find(|i| *i != origin && start[*i].y == 0.0);
        held[2 * on_x.unwrap_or_default() + 1] = true;
    }
    held
}

/// Covariance and redundancies of adjusted marks: the normal matrix is inverted as a whole, so that what is not measured is named.
fn covariance(
    names: &[&str],
    observations: &[Observation],
    places: Vec<Vector2<f64>>,
    held: &[bool],
) -> Result<Adjusted, Error> {
    let free: Vec<usize> = (0..held.len()).filter(|k| !held[*k]).collect();
    let mut jacobian = DMatrix::zeros(observations.len(), held.len());
    let mut weighted = DVector::zeros(observations.len());
    for (row, observation) in observations.iter().enumerate() {
        let [a, b] = observation.ends;
        let (off_m, by_b) = observation
            .linearize(&places[a], &places[b])
            .ok_or_else(|| Error::UndeterminedMark {
                mark: names[b].to_owned(),
            })?;
        weighted[row] = off_m / observation.sigma_m;
        for k in 0..2 {
            jacobian[(row, 2 * a + k)] = -by_b[k] / observation.sigma_m;
            jacobian[(row, 2 * b + k)] = by_b[k] / observation.sigma_m;
        }
    }
    let jacobian = jacobian.select_columns(&free);
    let normal = (jacobian.transpose() * &jacobian).symmetric_eigen();
    let largest = normal.eigenvalues.max();
    let smallest = normal.eigenvalues.imin();
    if !(normal.eigenvalues[smallest] > LEAST_EIGENVALUE * largest) {
        let loose = normal.eigenvectors.column(smallest).icamax();
        return Err(Error::UndeterminedMark {
            mark: names[free[loose] / 2].to_owned(),
        });
    }
    let inverse = &normal.eigenvectors
        * DMatrix::from_diagonal(&normal.eigenvalues.map(|v| 1.0 / v))
        * normal.eigenvectors.transpose();
    let explained = (&jacobian * &inverse).component_mul(&jacobian).column_sum();
    let mut covariance = DMatrix::zeros(held.len(), held.len());
    for (i, row) in free.iter().enumerate() {
        for (j, column) in free.iter().enumerate() {
            covariance[(*row, *column)] = inverse[(i, j)];
        }
    }
    Ok(Adjusted {
        places,
        covariance,
        weighted: weighted.iter().copied().collect(),
        redundancy: explained
            .iter()
            .map(|e| (1.0 - e).clamp(0.0, 1.0))
            .collect(),
    })
}

/// Marks that only free distances place may lie on either side: the side that fits, or an error where both do.
fn best_sides(
    names: &[&str],
    observations: &[Observation],
    start: Vec<Vector2<f64>>,
) -> Result<Vec<Vector2<f64>>, Error> {
    let mut best = adjust(names, observations, &start)?;
    for mark in 0..names.len() {
        let own = || observations.iter().filter(|o| o.ends.contains(&mark));
        let is_free = own().all(|o| matches!(o.quantity, Quantity::Distance(_)));
        let neighbours: Vec<Vector2<f64>> = own()
            .map(|o| best.places[o.ends[usize::from(o.ends[0] == mark)]])
            .collect();
        // In a triangle alone the side is a matter of how one looks at it.
        let is_open = is_free && names.len() > 3 && best.places[mark] != Vector2::zeros();
        let Some(other) = mirrored(&best.places[mark], &neighbours).filter(|_| is_open) else {
            continue;
        };
        let mut flipped = best.places.clone();
        if (other - flipped[mark]).norm() < 1e-3 {
            continue;
        }
        flipped[mark] = other;
        let Ok(flipped) = adjust(names, observations, &flipped) else {
            continue;
        };
        let moved_m = (flipped.places[mark] - best.places[mark]).norm();
        if flipped.cost() < best.cost() - SAME_FIT {
            best = flipped;
        } else if flipped.cost() < best.cost() + SAME_FIT && moved_m > 0.01 {
            return Err(Error::TwoPlaces {
                mark: names[mark].to_owned(),
                apart_m: moved_m,
            });
        }
    }
    Ok(best.places)
}

#[cfg(test)]
mod tests;
