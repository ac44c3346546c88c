#![doc = include_str!("../README.md")]

mod bounds;
mod config;
mod conjugate_gradients;
mod converged;
mod covariance;
mod dense_jacobian;
mod diagnosis;
mod divide;
mod dogleg;
mod error;
mod evaluation;
mod factorization;
pub mod gauss_newton;
mod incremental;
mod influence;
mod jacobian_check;
mod kernels;
mod layout;
#[cfg(test)]
mod linear_residual;
mod linear_system;
mod manifold;
mod marginal;
mod minimise;
mod normal;
mod priors;
mod problem;
mod report;
mod residual;
mod robust;

pub use config::{Diagnosis, LinearSolver, Method, SolveConfig};
pub use converged::{solve_until_converged, solve_until_converged_controlled};
pub use covariance::{Covariance, covariance, covariance_of_groups};
pub use dense_jacobian::{DenseJacobian, dense_jacobian};
pub use error::Error;
pub use incremental::{Incremental, IncrementalConfig, UpdateReport};
pub use influence::{Influence, Influences, influences, undamped_step};
#[doc(hidden)]
pub use jacobian_check::check_jacobians;
pub use manifold::{Manifold, Shape, directions_across};
pub use marginal::{Marginal, marginal};
pub use minimise::{solve, solve_controlled};
pub use priors::{DirectionPrior, PosePrior, RotationPrior, VectorPrior};
pub use problem::{Block, BlockId, Problem, ResidualId};
pub use report::{Iteration, Report, Termination, Undetermined};
pub use residual::{Linearization, Parameters, Residual, ResidualSet, Undefined};
pub use robust::{Kernel, Robust};
