use lsfb_types::{Finding, Verdict};

/// What is wrong with a problem. Values stay as they were before the call that failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A residual names a block of another problem.
    #[error(
        "block {block} is not in this problem, which has {blocks}: use the handles that its own add functions returned"
    )]
    UnknownBlock {
        /// Index of the block.
        block: usize,
        /// Blocks in the problem.
        blocks: usize,
    },
    /// A component that a block's tangent does not have.
    #[error("block {block} has no component {component}: its tangent has {components}")]
    UnknownComponent {
        /// Index of the block.
        block: usize,
        /// Component asked for.
        component: usize,
        /// Components of the tangent.
        components: usize,
    },
    /// Bounds that no value keeps.
    #[error("component {component} of block {block} cannot be bounded by {lower} and {upper}")]
    EmptyBounds {
        /// Index of the block.
        block: usize,
        /// Component.
        component: usize,
        /// Lowest value.
        lower: f64,
        /// Highest value.
        upper: f64,
    },
    /// A residual was given another number of blocks than it reads.
    #[error("residual {residual} reads {expected} blocks but was given {got}")]
    BlockCount {
        /// Index of the residual.
        residual: usize,
        /// Blocks it reads.
        expected: usize,
        /// Blocks given.
        got: usize,
    },
    /// A residual was given a block of another type than it reads.
    #[error(
        "residual {residual} reads a block of {expected:?} at position {position} but was given {got:?}"
    )]
    BlockShape {
        /// Index of the residual.
        residual: usize,
        /// Position among its blocks.
        position: usize,
        /// What it reads.
        expected: crate::Shape,
        /// What was given.
        got: crate::Shape,
    },
    /// A residual without rows.
    #[error("residual {residual} has dimension 0: leave it out")]
    EmptyResidual {
        /// Index of the residual.
        residual: usize,
    },
    /// The same block twice in one residual.
    #[error(
        "residual {residual} was given block {block} twice: write it as a residual of the distinct blocks"
    )]
    RepeatedBlock {
        /// Index of the residual.
        residual: usize,
        /// Index of the block.
        block: usize,
    },
    /// Two eliminated points in one residual, which the Schur complement by points excludes.
    #[error(
        "residual {residual} touches two eliminated points, {first} and {second}: add one of them with add_block"
    )]
    TwoEliminated {
        /// Index of the residual.
        residual: usize,
        /// Index of a block.
        first: usize,
        /// Index of the other block.
        second: usize,
    },
    /// A block starts at NaN or infinity.
    #[error("block {block} starts at a value that is not finite: check its initial value")]
    BlockNotFinite {
        /// Index of the block.
        block: usize,
    },
    /// A residual is NaN or infinite at the starting values or, with its Jacobian, at an accepted step.
    #[error(
        "residual {residual} (blocks {blocks:?}) is not finite: its measurement or weight is not finite, or its domain check is missing"
    )]
    ResidualNotFinite {
        /// Index of the residual.
        residual: usize,
        /// Indices of its blocks.
        blocks: Vec<usize>,
    },
    /// A setting lies outside its bounds.
    #[error("solver: {0}")]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// The reduced system has more entries than memory allows.
    #[error(
        "the reduced system of dimension {dimension} with {entries} entries could not be set up: eliminate points, or solve in parts"
    )]
    TooLarge {
        /// Rows of the reduced system.
        dimension: usize,
        /// Entries of its lower triangle.
        entries: usize,
    },
    /// The normal matrix has no inverse, so that there is no covariance.
    #[error(
        "{} of {dimension} reduced dimensions are not determined, so that there is no covariance: {first}; hold a block or add a prior",
        parameters
    )]
    Undetermined {
        /// Rows of the reduced system.
        dimension: usize,
        /// Parameters that are not determined.
        parameters: usize,
        /// The first of them.
        first: String,
    },
    /// Covariance was asked of a block that has none.
    #[error("{name} is constant, removed or without residuals: it has no covariance")]
    NoCovariance {
        /// Name of the block.
        name: String,
    },
    /// An analytic Jacobian differs from the numeric one.
    #[error(
        "residual {residual}, block at position {position}: Jacobian entry ({row}, {column}) is {analytic}, but {numeric} by differences"
    )]
    JacobianMismatch {
        /// Index of the residual.
        residual: usize,
        /// Position among its blocks.
        position: usize,
        /// Row.
        row: usize,
        /// Column.
        column: usize,
        /// What the residual wrote.
        analytic: f64,
        /// Central difference.
        numeric: f64,
    },
    /// It goes on and on.
    #[error(
        "did not converge within {iterations} iterations: the measurements hardly determine the unknowns, or contradict each other"
    )]
    NotConverged {
        /// Iterations in all.
        iterations: usize,
    },
    /// A residual is undefined where its Jacobian should be checked.
    #[error(
        "residual {residual} is undefined at or near its values: check Jacobians inside the domain"
    )]
    Undefined {
        /// Index of the residual.
        residual: usize,
    },
}

impl Error {
    /// What was found, where what was measured is to blame, not how the problem was put.
    pub fn finding(&self) -> Option<Finding> {
        let code = match self {
            Self::NotConverged { .. } => "not-converged",
            Self::Undetermined { .. } => "undetermined",
            _ => return None,
        };
        let found = Finding::new(code, Verdict::Fail, "", self.to_string());
        Some(found.remedy("check stamps, axes and intrinsics, and record more, from more sides"))
    }
}
