#![doc = include_str!("../README.md")]

mod error;
mod evaluation;
mod jacobian_check;
mod layout;
mod levenberg_marquardt;
mod manifold;
mod problem;
mod reduced;
mod residual;
mod robust;
mod schur;

pub use error::Error;
pub use jacobian_check::check_jacobians;
pub use levenberg_marquardt::{Iteration, Report, SolveConfig, Termination, solve, solve_observed};
pub use manifold::{Manifold, Shape};
pub use problem::{Block, BlockId, Problem, ResidualId};
pub use residual::{Linearization, Parameters, Residual, Undefined};
pub use robust::{Kernel, Robust};
