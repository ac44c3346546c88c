//! Whether a sensor's axes, signs and units are right: the matrix and the bias that make what was measured otherwise of its readings, by robust
//! linear least squares. The matrix is one where all is right.

use lsfb_geometry::{Matrix3, Vector3};
use lsfb_perception::statistics::median;
use lsfb_solver::gauss_newton::NormalEquations;
use nalgebra::{SMatrix, SVector};

/// Standard deviation of the matrix about one, so loose that it only matters for an axis along which nothing is read.
const LOOSE: f64 = 1.0;
/// What is farther off than so many medians counts less.
const ROBUST_MEDIANS: f64 = 3.0;
const ROUNDS: usize = 8;
/// An axis is wrong where it is so far from one: far beyond what a device that is turned against its rig file does.
const WRONG: f64 = 0.6;

/// The matrix row by row, then the bias.
pub(super) type Unknowns = SVector<f64, 12>;

/// What was measured otherwise, and how it follows from the unknowns.
pub(super) struct Measured {
    pub value: Vector3<f64>,
    pub by_unknowns: SMatrix<f64, 3, 12>,
}

impl Measured {
    fn left(&self, unknowns: &Unknowns) -> f64 {
        (self.value - self.by_unknowns * unknowns).norm()
    }
}

/// A matrix of one, no bias.
pub(super) fn as_it_is() -> Unknowns {
    let mut unknowns = Unknowns::zeros();
    for axis in 0..3 {
        unknowns[4 * axis] = 1.0;
    }
    unknowns
}

/// The usual size of what they leave.
pub(super) fn usually_left(measured: &[Measured], unknowns: &Unknowns) -> Option<f64> {
    median(measured.iter().map(|m| m.left(unknowns)).collect())
}

/// The unknowns that leave least. `sigmas`: of a measured value and of the bias.
pub(super) fn fit(measured: &[Measured], [sigma, bias_sigma]: [f64; 2]) -> Option<Unknowns> {
    let prior = as_it_is();
    let mut sigmas = Unknowns::repeat(LOOSE);
    sigmas.fixed_rows_mut::<3>(9).fill(bias_sigma);
    let known = SMatrix::from_diagonal(&sigmas.map(|sigma| sigma.powi(-2)));
    let mut found = prior;
    let mut weights = vec![1.0; measured.len()];
    for _ in 0..ROUNDS {
        let mut equations = NormalEquations::default();
        for (m, weight) in measured.iter().zip(&weights) {
            let residual = m.by_unknowns * found - m.value;
            equations.add_block(&residual, &m.by_unknowns, weight * sigma.powi(-2));
        }
        equations.add_prior(&(found - prior), &known);
        found += equations.step()?;
        let sizes: Vec<f64> = measured.iter().map(|m| m.left(&found)).collect();
        let usual = median(sizes.clone())?.max(f64::EPSILON);
        let share = |size: &f64| (ROBUST_MEDIANS * usual / size.max(f64::EPSILON)).min(1.0);
        weights = sizes.iter().map(share).collect();
    }
    Some(found)
}

/// The axis that is farthest from one, where that is wrong, and what was measured where it reads 1.
pub(super) fn wrong_axis(unknowns: &Unknowns) -> Option<(char, [f64; 3])> {
    let matrix = Matrix3::from_fn(|row, column| unknowns[3 * row + column]);
    let off = matrix - Matrix3::identity();
    let worst = (0..3).max_by(|a, b| off.column(*a).norm().total_cmp(&off.column(*b).norm()))?;
    let is_wrong = off.column(worst).norm() > WRONG;
    is_wrong.then(|| {
        (
            ['x', 'y', 'z'][worst],
            matrix.column(worst).into_owned().into(),
        )
    })
}
