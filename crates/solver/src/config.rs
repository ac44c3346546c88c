use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// How steps are found and limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Steps shortened by damping, which is solved for anew after each refused step.
    #[default]
    LevenbergMarquardt,
    /// Steps within a radius, on Powell's path from the steepest descent to the Gauss–Newton step: a refused step costs
    /// no further solve. Not for problems with free gauge.
    Dogleg,
}

/// How the reduced system is solved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinearSolver {
    /// Dense where the matrix is nearly full, sparse where it is not, iterative where it outgrows
    /// [`SolveConfig::max_matrix_bytes`].
    #[default]
    Auto,
    /// Dense Cholesky.
    Dense,
    /// Sparse Cholesky in a fill-reducing order.
    Sparse,
    /// Conjugate gradients that never form the matrix, preconditioned with its diagonal blocks.
    Iterative,
}

/// What is found out about the problem after it is solved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Diagnosis {
    /// Nothing.
    Off,
    /// Condition, and the names of parameters that the data does not determine: about one iteration's work.
    #[default]
    Full,
}

/// When to stop, and how steps are found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolveConfig {
    /// Linearizations at most.
    pub max_iterations: usize,
    /// Stop once a step lowers the cost by less than this share.
    pub cost_tolerance: f64,
    /// Stop once no entry of the gradient is larger.
    pub gradient_tolerance: f64,
    /// Stop once a step is shorter than this share of the values.
    pub step_tolerance: f64,
    /// First damping, as a share of the normal matrix's diagonal; with dogleg the inverse of the first radius.
    pub initial_damping: f64,
    /// How steps are found.
    pub method: Method,
    /// How the reduced system is solved.
    pub linear_solver: LinearSolver,
    /// Bytes of reduced matrix and factor from which on [`LinearSolver::Auto`] is iterative.
    pub max_matrix_bytes: usize,
    /// Residual of the iterative solver, as a share of the right side's norm. It also ends once its steps hardly lower
    /// the quadratic model any more.
    pub iterative_tolerance: f64,
    /// Steps of the iterative solver at most.
    pub max_iterative_steps: usize,
    /// Factor by which graduated non-convexity narrows Geman–McClure kernels in each iteration, 1.01 or more: they begin
    /// so wide that the problem is nearly quadratic, and end at their own scale. 1.4 is usual; 0 leaves them as they are.
    pub graduation: f64,
    /// What is found out after solving.
    pub diagnosis: Diagnosis,
}

impl Default for SolveConfig {
    fn default() -> Self {
        Self {
            max_iterations: 50,
            cost_tolerance: 1e-6,
            gradient_tolerance: 1e-10,
            step_tolerance: 1e-8,
            initial_damping: 1e-4,
            method: Method::default(),
            linear_solver: LinearSolver::default(),
            max_matrix_bytes: 2 << 30,
            iterative_tolerance: 1e-2,
            max_iterative_steps: 500,
            graduation: 0.0,
            diagnosis: Diagnosis::default(),
        }
    }
}

lsfb_types::bounds! {
    SolveConfig {
        max_iterations: any,
        cost_tolerance: number(Bounds::NOT_NEGATIVE),
        gradient_tolerance: number(Bounds::NOT_NEGATIVE),
        step_tolerance: number(Bounds::NOT_NEGATIVE),
        initial_damping: number(Bounds::POSITIVE),
        method: any,
        linear_solver: any,
        max_matrix_bytes: any,
        iterative_tolerance: number(Bounds::Between(0.0, 1.0)),
        max_iterative_steps: any,
        graduation: number(Bounds::ZeroOr(1.01, f64::INFINITY)),
        diagnosis: any,
    }
}
