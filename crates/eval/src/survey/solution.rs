//! What is known of a survey once it is solved.

use lsfb_geometry::Vector2;
use lsfb_types::Finding;
use serde::Serialize;

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
