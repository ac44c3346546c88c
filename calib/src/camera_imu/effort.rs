//! How far the batch goes, and what it searches.

use lsfb_solver::{Diagnosis, SolveConfig};

/// What is believed of the board's size.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum BoardSize {
    AsSaid,
    /// It is searched, and so is the scale of the accelerometer, which gravity tells.
    Searched,
}

/// What the models of lens and board do not know, and pixels are moved by.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Moved {
    Nothing,
    /// What it is likely to be.
    Likely,
    /// One standard deviation of that, along one of the directions in which it is uncertain.
    Along(usize),
}

/// How far to go.
#[derive(Clone, Copy)]
pub(super) struct Effort {
    pub cost_tolerance: f64,
    /// Whether views that are held back take part.
    pub all_views: bool,
    pub size: BoardSize,
    /// By what pixels are moved.
    pub moved: Moved,
}

impl Effort {
    pub fn of_round(round: usize, last: bool) -> Self {
        Self {
            cost_tolerance: match (round, last) {
                (_, true) => 1e-12,
                (0, false) => 1e-4,
                (_, false) => 1e-7,
            },
            all_views: last,
            size: BoardSize::AsSaid,
            moved: Moved::Nothing,
        }
    }

    /// Of the solver.
    pub fn settings(self) -> SolveConfig {
        SolveConfig {
            max_iterations: 40,
            cost_tolerance: self.cost_tolerance,
            diagnosis: Diagnosis::Off,
            ..SolveConfig::default()
        }
    }

    /// What it takes to measure the board.
    pub fn of_size() -> Self {
        Self {
            cost_tolerance: 1e-9,
            all_views: true,
            size: BoardSize::Searched,
            moved: Moved::Nothing,
        }
    }

    /// What it takes to say how well all is known.
    pub fn of_uncertainty() -> Self {
        Self {
            moved: Moved::Likely,
            ..Self::of_round(0, true)
        }
    }
}
