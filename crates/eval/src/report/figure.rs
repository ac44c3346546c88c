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
        let found = with_unit(&significant(self.value), self.unit);
        let finding = Finding::new("figure", Verdict::Warn, self.name.clone(), found);
        Some(finding.judged(self.value, self.unit, limit))
    }
}

/// The figures of one judged trajectory.
pub(super) fn of_evaluation(evaluation: &Evaluation) -> Vec<Figure> {
    let translation = evaluation.ate_translation_m;
    let mut figures = vec![
        Figure::new("ATE translation rmse", translation.rmse, "m"),
        Figure::new("ATE translation mean", translation.mean, "m"),
        Figure::new("ATE translation median", translation.median, "m"),
        Figure::new("ATE translation max", translation.max, "m"),
    ];
    if let Some(rotation) = evaluation.ate_rotation_deg {
        figures.push(Figure::new("ATE rotation rmse", rotation.rmse, "°"));
        figures.push(Figure::new("ATE rotation max", rotation.max, "°"));
    }
    let others = evaluation.ate_by_alignment.iter();
    for other in others.filter(|o| o.alignment != evaluation.alignment) {
        if let Some(rmse_m) = other.rmse_m {
            let name = format!("ATE translation rmse, alignment {}", other.alignment);
            figures.push(Figure::new(&name, rmse_m, "m"));
        }
    }
    figures.extend(relative(evaluation));
    if let Some(percent) = evaluation.scale_error_percent {
        figures.push(Figure::new("Scale error", percent, "%"));
    }
    for found in &evaluation.recall {
        let threshold = found.threshold;
        let name = format!(
            "Recall within {}°, {} m",
            threshold.rotation_deg, threshold.translation_m
        );
        figures.push(Figure::new(&name, 100.0 * found.of_truth, "%"));
    }
    figures.extend(shaking(evaluation));
    if let Some(consistency) = evaluation.consistency {
        figures.push(Figure::new(
            "NEES mean (6 expected)",
            consistency.nees_mean,
            "",
        ));
    }
    let coverage = evaluation.coverage;
    figures.extend([
        Figure::new("Ground truth covered", 100.0 * coverage.fraction, "%"),
        Figure::new("Longest gap", coverage.longest_gap_secs, "s"),
        Figure::new(
            "Starts after the ground truth by",
            coverage.initialisation_secs,
            "s",
        ),
        Figure::new(
            &format!("Poses matched, of {}", evaluation.estimate_poses),
            evaluation.matched_poses as f64,
            "",
        ),
        Figure::new("True path length", evaluation.truth_path_m, "m"),
        Figure::new(
            &format!("Scale of the alignment ({})", evaluation.alignment),
            evaluation.alignment_scale,
            "",
        ),
    ]);
    figures
}

fn relative(evaluation: &Evaluation) -> Vec<Figure> {
    let mut figures = Vec::new();
    for rpe in &evaluation.rpe {
        let delta = match rpe.delta_unit {
            DeltaUnit::Degrees => format!("{}°", rpe.delta),
            unit => format!("{} {unit}", rpe.delta),
        };
        match (rpe.translation_m, rpe.rotation_deg) {
            (Some(t), Some(r)) => {
                let name = |part: &str| format!("RPE {part} rmse per {delta}");
                figures.push(Figure::new(&name("translation"), t.rmse, "m"));
                figures.push(Figure::new(&name("rotation"), r.rmse, "°"));
            }
            _ => {
                let name = format!("RPE distance rmse per {delta}");
                figures.push(Figure::new(&name, rpe.distance_m.rmse, "m"));
            }
        }
    }
    figures
}

fn shaking(evaluation: &Evaluation) -> Vec<Figure> {
    let mut figures = Vec::new();
    let both = evaluation.smoothness;
    for (whose, of) in [("estimate", both.estimate), ("ground truth", both.truth)] {
        let Some(of) = of else { continue };
        let name = |what: &str| format!("{what} of the {whose}, rms");
        figures.push(Figure::new(&name("Jerk"), of.jerk_rms_m_s3, "m/s³"));
        if let Some(fast_m) = of.above_5_hz_rms_m {
            figures.push(Figure::new(
                &name("Motion above 5 Hz"),
                1000.0 * fast_m,
                "mm",
            ));
        }
    }
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
