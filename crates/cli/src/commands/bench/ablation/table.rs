//! The rows of an ablation: means over what is withheld, with their intervals.

use std::fmt::Write as _;

use lsfb_eval::alignment::AlignmentMode;
use lsfb_types::Finding;
use serde::Serialize;

/// Parts that a map is cut into.
pub const QUADRANTS: usize = 4;
/// What the motion without a map is judged after, and all others with it.
pub const ALIGNMENT: AlignmentMode = AlignmentMode::Se3;

/// One choice of quadrants.
#[derive(Serialize)]
pub struct Run {
    /// Those that were withheld.
    pub withheld_quadrants: Vec<usize>,
    /// Share of the map's points that was left, percent.
    pub points_percent: f64,
    /// Share of the walk's frames that have a pose, percent.
    pub poses_percent: f64,
    /// Share of those poses that meet one of the ground truth, percent: the others are not judged.
    pub judged_percent: f64,
    /// After alignment; absent where the walk was refused.
    pub ate_rms_m: Option<f64>,
    /// The largest error of a position after alignment.
    pub ate_max_m: Option<f64>,
    /// What the evaluation found fault with: half a ground truth, other clocks, other axes.
    pub findings: Vec<Finding>,
    /// Why the walk was refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

/// All choices of one share.
#[derive(Serialize)]
pub struct Row {
    pub map_percent: u32,
    pub method: &'static str,
    pub alignment: &'static str,
    /// Choices that gave a trajectory.
    pub given: usize,
    pub refused: usize,
    pub ate_rms_m: Option<f64>,
    /// Half of the 95 % interval of that mean; absent for fewer than two choices.
    pub ate_rms_interval_m: Option<f64>,
    /// The worst choice's.
    pub worst_ate_rms_m: Option<f64>,
    pub poses_percent: f64,
    /// The least of any choice that gave a trajectory.
    pub judged_percent: Option<f64>,
    pub runs: Vec<Run>,
}

#[derive(Serialize)]
pub struct Table {
    pub walk: String,
    pub truth: String,
    pub rows: Vec<Row>,
}

/// A row of the runs of one share.
pub fn summary(percent: u32, runs: Vec<Run>) -> Row {
    let rms: Vec<f64> = runs.iter().filter_map(|run| run.ate_rms_m).collect();
    let shares = runs.iter().map(|run| run.poses_percent);
    let given = runs.iter().filter(|run| run.ate_rms_m.is_some());
    let judged = given.map(|run| run.judged_percent);
    Row {
        map_percent: percent,
        method: match percent {
            0 => "motion without a map",
            _ => "ground truth",
        },
        alignment: ALIGNMENT.label(),
        given: rms.len(),
        refused: runs.len() - rms.len(),
        ate_rms_m: mean(&rms),
        ate_rms_interval_m: interval(&rms),
        worst_ate_rms_m: rms.iter().copied().reduce(f64::max),
        poses_percent: shares.sum::<f64>() / runs.len().max(1) as f64,
        judged_percent: judged.reduce(f64::min),
        runs,
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Student's t for 95 % on both sides, with one, two and three degrees of freedom.
const STUDENT_95: [f64; QUADRANTS - 1] = [12.706, 4.303, 3.182];

/// Half of the 95 % interval of the mean.
fn interval(values: &[f64]) -> Option<f64> {
    let freedom = values.len().checked_sub(1)?;
    let student = STUDENT_95.get(freedom.checked_sub(1)?)?;
    let middle = mean(values)?;
    let variance = values.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / freedom as f64;
    Some(student * (variance / values.len() as f64).sqrt())
}

/// The table for people.
pub fn text(table: &Table) -> String {
    let mut text = format!(
        "{} against {}, ATE rms in cm after alignment by {}\n  map  runs  refused      ATE   ± 95 %    worst   judged   frames with a pose\n",
        table.walk,
        table.truth,
        ALIGNMENT.label()
    );
    let cm = |value: Option<f64>| value.map_or("–".to_owned(), |m| format!("{:.2}", 100.0 * m));
    for row in &table.rows {
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{:>4}%  {:>4}  {:>7}  {:>7}  {:>7}  {:>7}  {:>6}   {:.1} %{}",
            row.map_percent,
            row.runs.len(),
            row.refused,
            cm(row.ate_rms_m),
            cm(row.ate_rms_interval_m),
            cm(row.worst_ate_rms_m),
            row.judged_percent
                .map_or("–".to_owned(), |percent| format!("{percent:.0} %")),
            row.poses_percent,
            match row.map_percent {
                0 => " (motion without a map)",
                _ => "",
            }
        );
        for run in &row.runs {
            if let Some(why) = &run.refused {
                let _ = writeln!(text, "       without {:?}: {why}", run.withheld_quadrants);
            }
            for finding in &run.findings {
                let _ = writeln!(
                    text,
                    "       without {:?}: {}  {} {}",
                    run.withheld_quadrants, finding.verdict, finding.subject, finding.what
                );
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: mean 4.31, s = 1.3776, t = 3.182, n = 4.
    #[test]
    fn interval_is_students() {
        let values = [3.0, 5.5, 5.5, 3.24];
        let half = interval(&values).expect("four values");
        assert!((half - 2.1917).abs() < 1e-3, "{half}");
        assert_eq!(interval(&values[..1]), None);
    }
}
