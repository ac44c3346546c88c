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
    pub unit: String,
    /// What it must keep; without one it merely informs.
    pub threshold: Option<Threshold>,
}

/// A bound in the unit of its figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Threshold {
    /// This or less.
    AtMost(f64),
    /// This or more.
    AtLeast(f64),
}

/// How a figure stands to its threshold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Within.
    Pass,
    /// Beyond, or no number at all.
    Warn,
    /// There is no threshold.
    Informs,
}

impl Figure {
    /// A figure without threshold.
    pub fn new(name: &str, value: f64, unit: &str) -> Self {
        Self {
            name: name.to_owned(),
            value,
            unit: unit.to_owned(),
            threshold: None,
        }
    }

    /// The same figure, which must keep `threshold`.
    pub fn with(self, threshold: Threshold) -> Self {
        Self {
            threshold: Some(threshold),
            ..self
        }
    }

    /// How it stands to its threshold.
    pub fn standing(&self) -> Standing {
        let within = match self.threshold {
            None => return Standing::Informs,
            Some(Threshold::AtMost(limit)) => self.value <= limit,
            Some(Threshold::AtLeast(limit)) => self.value >= limit,
        };
        if within {
            Standing::Pass
        } else {
            Standing::Warn
        }
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
        Figure::new("Truth covered", covered, "%"),
        Figure::new("Longest gap", evaluation.coverage.longest_gap_secs, "s"),
        Figure::new(
            &format!("Poses matched, of {}", evaluation.estimate_poses),
            evaluation.matched_poses as f64,
            "",
        ),
        Figure::new("Path of the truth", evaluation.truth_path_m, "m"),
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
    fn nan_keeps_no_threshold() {
        let figure = |value| Figure::new("x", value, "m");
        let standing = |value, threshold| figure(value).with(threshold).standing();
        assert_eq!(standing(0.03, Threshold::AtMost(0.03)), Standing::Pass);
        assert_eq!(standing(0.031, Threshold::AtMost(0.03)), Standing::Warn);
        assert_eq!(standing(89.9, Threshold::AtLeast(90.0)), Standing::Warn);
        assert_eq!(standing(f64::NAN, Threshold::AtMost(1.0)), Standing::Warn);
        assert_eq!(standing(f64::NAN, Threshold::AtLeast(1.0)), Standing::Warn);
        assert_eq!(figure(1.0).standing(), Standing::Informs);
    }
}
