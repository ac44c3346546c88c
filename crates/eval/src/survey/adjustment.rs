//! Least squares over the marks, and what each measurement is checked by.

use lsfb_geometry::Vector2;
use lsfb_solver::{Kernel, Problem, SolveConfig, solve_until_converged};
use nalgebra::{DMatrix, DVector};

use super::observation::{Observation, Quantity};
use crate::Error;

/// Eigenvalues of the normal matrix below this share of the largest are of directions that nothing measures.
const LEAST_EIGENVALUE: f64 = 1e-10;

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
    solve_until_converged(&mut problem, &config)?;
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
