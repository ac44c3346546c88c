//! The numbers of a run, and what they must keep.

use lsfb_report::{significant, with_unit};
use lsfb_types::{Finding, Limit, Verdict};

use crate::evaluation::Evaluation;
use crate::relation::DeltaUnit;

/// One number of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// Its value in `unit`.
    pub value: f64,
    /// Unit; empty for a pure number.
    pub unit: &'static str,
    /// What it must keep; without one it merely informs.
    pub limit: Option<Limit>,
}

impl Figure {
    /// A figure without a limit.
    pub fn new(name: &str, value: f64, unit: &'static str) -> Self {
        Self {
            name: name.to_owned(),
            value,
            unit,
            limit: None,
        }
    }

    /// The same figure, which must keep `limit`.
    pub fn with(self, limit: Limit) -> Self {
        Self {
            limit: Some(limit),
            ..self
        }
    }

    /// Whether it keeps its limit; `None` where it has none.
    pub fn finding(&self) -> Option<Finding> {
        let limit = self.limit?;
        let verdict = Verdict::Warn.unless(limit.holds(self.value));
        let found = with_unit(&significant(self.value), self.unit);
        let finding = Finding::new("figure", verdict, self.name.clone(), found);
        Some(finding.value(self.value, self.unit).limit(limit))
    }
}

/// The figures of one judged trajectory.
pub(super) fn of_evaluation(evaluation: &Evaluation) -> Vec<Figure> {
    let translation = evaluation.ate_translation_m;
    let rotation = evaluation.ate_rotation_deg;
    let mut figures = vec![
        Figure::new("ATE translation rmse", translation.rmse, "m"),
        Figure::new("ATE translation mean", translation.mean, "m"),
        Figure::new("ATE translation median", translation.median, "m"),
        Figure::new("ATE translation max", translation.max, "m"),
        Figure::new("ATE rotation rmse", rotation.rmse, "°"),
        Figure::new("ATE rotation max", rotation.max, "°"),
    ];
    for rpe in &evaluation.rpe {
        let delta = match rpe.delta_unit {
            DeltaUnit::Degrees => format!("{}°", rpe.delta),
            unit => format!("{} {unit}", rpe.delta),
        };
        let (t, r) = (rpe.translation_m.rmse, rpe.rotation_deg.rmse);
        figures.push(Figure::new(
            &format!("RPE translation rmse per {delta}"),
            t,
            "m",
        ));
        figures.push(Figure::new(
            &format!("RPE rotation rmse per {delta}"),
            r,
            "°",
        ));
    }
    if let Some(percent) = evaluation.scale_error_percent {
        figures.push(Figure::new("Scale error", percent, "%"));
    }
    let covered = 100.0 * evaluation.coverage.fraction;
    figures.extend([
        Figure::new("Ground truth covered", covered, "%"),
        Figure::new("Longest gap", evaluation.coverage.longest_gap_secs, "s"),
        Figure::new(
            &format!("Poses matched, of {}", evaluation.estimate_poses),
            evaluation.matched_poses as f64,
            "",
        ),
        Figure::new("Length of the true path", evaluation.truth_path_m, "m"),
        Figure::new(
            &format!("Scale of the alignment ({})", evaluation.alignment),
            evaluation.alignment_scale,
            "",
        ),
    ]);
    figures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_keeps_no_limit() {
        let verdict = |value, limit| {
            let figure = Figure::new("x", value, "m").with(limit);
            figure.finding().map(|f| f.verdict)
        };
        assert_eq!(verdict(0.03, Limit::AtMost(0.03)), Some(Verdict::Pass));
        assert_eq!(verdict(0.031, Limit::AtMost(0.03)), Some(Verdict::Warn));
        assert_eq!(verdict(89.9, Limit::AtLeast(90.0)), Some(Verdict::Warn));
        assert_eq!(verdict(f64::NAN, Limit::AtMost(1.0)), Some(Verdict::Warn));
        assert_eq!(verdict(f64::NAN, Limit::AtLeast(1.0)), Some(Verdict::Warn));
        assert_eq!(Figure::new("x", 1.0, "m").finding(), None);
    }
}
