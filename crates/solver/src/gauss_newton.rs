//! Least squares over a handful of unknowns by Gauss and Newton.
//!
//! The unknowns are any [`Manifold`]; they are moved here alone, through [`Manifold::plus`], so that every tangent vector is
//! perturbed on the right. Many unknowns, or blocks of them, are a [`crate::Problem`].

use nalgebra::{Const, DimMin, SMatrix, SVector};

use crate::Manifold;

/// The sum of all terms at one place: `½ δᵀ H δ + gᵀ δ`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalEquations<const N: usize> {
    /// `H = Σ Jᵀ W J`.
    pub information: SMatrix<f64, N, N>,
    /// `g = Σ Jᵀ W r`.
    pub gradient: SVector<f64, N>,
}

/// What follows a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Another step.
    Iterate,
    /// The minimum is found.
    Settled,
    /// The search leads elsewhere.
    Abandoned,
}

/// Where a search ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Minimum<M, const N: usize> {
    /// The unknowns.
    pub value: M,
    /// Information of the terms, and of what was known before, at the last step.
    pub information: SMatrix<f64, N, N>,
    /// Whether it settled before the last iteration.
    pub settled: bool,
    /// Steps taken.
    pub iterations: u32,
}

impl<const N: usize> Default for NormalEquations<N> {
    fn default() -> Self {
        Self {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
        }
    }
}

impl<const N: usize> NormalEquations<N> {
    /// Adds a residual of one number with its derivative.
    pub fn add(&mut self, residual: f64, derivative: &SVector<f64, N>, weight: f64) {
        self.information += derivative * (derivative.transpose() * weight);
        self.gradient += derivative * (residual * weight);
    }

    /// Adds a residual of several numbers, all with one weight.
    pub fn add_block<const R: usize>(
        &mut self,
        residual: &SVector<f64, R>,
        jacobian: &SMatrix<f64, R, N>,
        weight: f64,
    ) {
        self.information += jacobian.transpose() * (jacobian * weight);
        self.gradient += jacobian.transpose() * (residual * weight);
    }

    /// Adds what was known before: how far the unknowns are from it, and its information.
    pub fn add_prior(&mut self, deviation: &SVector<f64, N>, information: &SMatrix<f64, N, N>) {
        self.information += information;
        self.gradient += information * deviation;
    }

    /// Adds other terms.
    pub fn add_all(&mut self, other: &Self) {
        self.information += other.information;
        self.gradient += other.gradient;
    }

    /// The step to the minimum; `None` where the terms do not determine one.
    pub fn step(&self) -> Option<SVector<f64, N>>
    where
        Const<N>: DimMin<Const<N>, Output = Const<N>>,
    {
        Some(-self.information.cholesky()?.solve(&self.gradient))
    }

    /// The step, shortened by a share of what is known of each unknown alone; one of which nothing is known stays.
    fn damped_step(&self, damping: f64) -> Option<SVector<f64, N>>
    where
        Const<N>: DimMin<Const<N>, Output = Const<N>>,
    {
        // Unknowns in units of their own information: these may differ by many powers of ten.
        let known = self.information.diagonal();
        let scale = known.map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
        let mut scaled = self.information;
        for (k, factor) in scale.iter().enumerate() {
            scaled.row_mut(k).scale_mut(*factor);
            scaled.column_mut(k).scale_mut(*factor);
        }
        scaled.fill_diagonal(1.0 + damping);
        let step = scaled
            .cholesky()?
            .solve(&self.gradient.component_mul(&scale));
        Some(-step.component_mul(&scale))
    }
}

/// Steps from `start` until `inspect` says that it is enough, at most so many. `inspect` sees each step before it is taken, and may
/// shorten it. `None` where the terms do not determine a step, where they have no value, or where the search is abandoned.
pub fn minimise<M: Manifold, const N: usize>(
    start: M,
    max_iterations: u32,
    mut terms: impl FnMut(&M) -> Option<NormalEquations<N>>,
    mut inspect: impl FnMut(&mut SVector<f64, N>) -> Next,
) -> Option<Minimum<M, N>>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    const { assert!(N == M::TANGENT) };
    let mut found = Minimum {
        value: start,
        information: SMatrix::zeros(),
        settled: false,
        iterations: 0,
    };
    while found.iterations < max_iterations {
        let equations = terms(&found.value)?;
        let mut step = equations.step()?;
        let next = inspect(&mut step);
        found.value = found.value.plus(step.as_slice());
        found.information = equations.information;
        found.iterations += 1;
        match next {
            Next::Iterate => {}
            Next::Settled => {
                found.settled = true;
                break;
            }
            Next::Abandoned => return None,
        }
    }
    Some(found)
}

/// Damping at first, its least and its most, as shares of what is known of each unknown.
const DAMPING: [f64; 3] = [1e-3, 1e-12, 1e10];
/// Factors of the damping after a step that lowered the cost, and after one that did not.
const EASED: f64 = 0.2;
const TIGHTENED: f64 = 5.0;
/// A step that lowers the cost by less than this share is the last.
const RESTS: f64 = 1e-10;

/// Steps that lower `cost`, damped until they do (Levenberg and Marquardt): for starts from which [`minimise`] would not arrive.
/// `terms` are those of the cost, twice; where that is infinite nobody goes. Gives where it ends, with the cost there.
pub fn minimise_damped<M: Manifold, const N: usize>(
    start: M,
    max_trials: u32,
    mut terms: impl FnMut(&M) -> NormalEquations<N>,
    mut cost: impl FnMut(&M) -> f64,
) -> (M, f64)
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    const { assert!(N == M::TANGENT) };
    let [mut damping, least_damping, most_damping] = DAMPING;
    let mut least = cost(&start);
    let mut equations = terms(&start);
    let mut value = start;
    for _ in 0..max_trials {
        let Some(step) = equations.damped_step(damping) else {
            break;
        };
        let trial = value.plus(step.as_slice());
        let next = cost(&trial);
        if next < least {
            let share = (least - next) / least;
            (value, least) = (trial, next);
            if share < RESTS {
                break;
            }
            damping = (damping * EASED).max(least_damping);
            equations = terms(&value);
        } else {
            damping *= TIGHTENED;
            if damping > most_damping {
                break;
            }
        }
    }
    (value, least)
}

/// [`Next::Settled`] after a step shorter than this, else [`Next::Iterate`].
pub fn until_shorter_than<const N: usize>(shortest: f64) -> impl Fn(&mut SVector<f64, N>) -> Next {
    move |step| {
        if step.norm() < shortest {
            Next::Settled
        } else {
            Next::Iterate
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Matrix3, UnitQuaternion, Vector3, so3};

    use super::*;

    /// Directions `b = R a + t`, seen exactly.
    #[test]
    fn a_rotation_and_a_shift_are_found_together() {
        let truth = (so3::exp(&Vector3::new(0.4, -0.3, 0.8)), Vector3::x() * 0.3);
        let seen = [Vector3::x(), Vector3::y(), Vector3::new(1.0, 2.0, -0.5)];
        let start = (UnitQuaternion::identity(), Vector3::zeros());
        let found = minimise::<_, 6>(
            start,
            30,
            |(rotation, shift)| {
                let mut terms = NormalEquations::default();
                for a in &seen {
                    let error = rotation * a + shift - (truth.0 * a + truth.1);
                    let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
                    let by_turn = -(rotation.to_rotation_matrix() * so3::hat(a));
                    jacobian.fixed_columns_mut::<3>(0).copy_from(&by_turn);
                    jacobian
                        .fixed_columns_mut::<3>(3)
                        .copy_from(&Matrix3::identity());
                    terms.add_block(&error, &jacobian, 1.0);
                }
                Some(terms)
            },
            until_shorter_than(1e-12),
        );
        let found = found.expect("determined");
        assert!(found.settled && found.iterations < 12);
        assert!(so3::local(&found.value.0, &truth.0).norm() < 1e-12);
        assert!((found.value.1 - truth.1).norm() < 1e-12);
    }

    /// Rosenbrock's valley, from where undamped steps climb; a third number that nothing depends on.
    #[test]
    fn a_bent_valley_is_followed_and_what_nothing_depends_on_stays() {
        let residuals = |p: &Vector3<f64>| [10.0 * (p.y - p.x * p.x), 1.0 - p.x];
        let terms = |p: &Vector3<f64>| {
            let [a, b] = residuals(p);
            let mut terms = NormalEquations::<3>::default();
            terms.add(a, &Vector3::new(-20.0 * p.x, 10.0, 0.0), 1.0);
            terms.add(b, &Vector3::new(-1.0, 0.0, 0.0), 1.0);
            terms
        };
        let cost = |p: &Vector3<f64>| residuals(p).iter().map(|r| r * r).sum();
        let start = Vector3::new(-1.9, 2.0, 7.0);
        let (found, left) = minimise_damped(start, 60, terms, cost);
        assert!(left < 1e-12, "{found} {left}");
        assert!(
            (found - Vector3::new(1.0, 1.0, 7.0)).norm() < 1e-6,
            "{found}"
        );
        // Nobody goes where the cost is infinite.
        let fenced = |p: &Vector3<f64>| if p.x > 0.0 { f64::INFINITY } else { cost(p) };
        let (found, _) = minimise_damped(start, 60, terms, fenced);
        assert!(found.x <= 0.0, "{found}");
    }

    #[test]
    fn what_is_not_determined_is_not_found() {
        let blind = |_: &Vector3<f64>| {
            let mut terms = NormalEquations::<3>::default();
            terms.add(1.0, &Vector3::x(), 1.0);
            Some(terms)
        };
        assert!(minimise(Vector3::zeros(), 5, blind, until_shorter_than(1e-9)).is_none());
    }
}
