//! Walks with less and less of their maps, and without loops, as in the paper's Tables IV and V: means over what is withheld, or over
//! walks, with their intervals.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use lsfb_types::{Finding, Judgement, Limit, Verdict};
use serde::Serialize;

use crate::alignment::AlignmentMode;

/// Parts that a map is cut into.
pub const QUADRANTS: usize = 4;
/// What the motion without a map is judged after, and all others with it.
pub const ALIGNMENT: AlignmentMode = AlignmentMode::Se3;

/// A trajectory that was asked for.
#[derive(Serialize)]
pub struct Run {
    /// Number of the walk among those given, from 1.
    pub walk: usize,
    /// Quadrants of the map that were withheld.
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

/// How a trajectory came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Method {
    /// Eq. 5, in the map.
    #[serde(rename = "ground truth")]
    GroundTruth,
    /// Images in the map, one by one.
    #[serde(rename = "single images")]
    Localization,
    /// No map.
    #[serde(rename = "motion without a map")]
    Motion,
}

/// What a row is of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Setting {
    /// How trajectories came about.
    pub method: Method,
    /// Share of the map that was left, percent.
    pub map_percent: u32,
    /// That of the map; absent without one.
    pub feature: Option<String>,
    /// Whether loops were closed; absent in a map, where none are.
    pub loops: Option<bool>,
}

impl Setting {
    fn label(&self) -> String {
        let of = self.feature.as_deref().unwrap_or("motion without a map");
        let how = match (self.method, self.loops) {
            (Method::Localization, _) => ", single images",
            (_, Some(false)) => ", no loops",
            _ => "",
        };
        format!("{:>3}% {of}{how}", self.map_percent)
    }
}

/// The runs of each setting.
#[derive(Default)]
pub struct Runs(Vec<(Setting, Vec<Run>)>);

impl Runs {
    /// Adds a run to those of its setting.
    pub fn add(&mut self, setting: Setting, run: Run) {
        match self.0.iter_mut().find(|(known, _)| *known == setting) {
            Some((_, runs)) => runs.push(run),
            None => self.0.push((setting, vec![run])),
        }
    }

    /// A row for each setting, in the order in which they came.
    pub fn rows(self) -> Vec<Row> {
        let rows = self.0.into_iter();
        rows.map(|(setting, runs)| summary(setting, runs)).collect()
    }
}

/// All runs of one setting.
#[derive(Serialize)]
pub struct Row {
    /// What it is of.
    #[serde(flatten)]
    pub setting: Setting,
    /// What trajectories were judged after.
    pub alignment: &'static str,
    /// How many walks the runs are of.
    pub walks: usize,
    /// Runs that gave a trajectory.
    pub given: usize,
    /// Runs that gave none.
    pub refused: usize,
    /// Of one walk the mean of its runs, of several that of their means.
    pub ate_rms_m: Option<f64>,
    /// Half of the 95 % interval of that mean, over the runs of one walk or over several walks; absent for fewer than two.
    pub ate_rms_interval_m: Option<f64>,
    /// The worst run's.
    pub worst_ate_rms_m: Option<f64>,
    /// Share of the walks' frames that have a pose, percent.
    pub poses_percent: f64,
    /// The least of any run that gave a trajectory.
    pub judged_percent: Option<f64>,
    /// All of them.
    pub runs: Vec<Run>,
}

/// Whose a run is: names of files.
#[derive(Serialize)]
pub struct Walk {
    /// The walk.
    pub recording: String,
    /// Its ground truth.
    pub truth: String,
    /// The map.
    pub map: String,
    /// Feature of the map.
    pub feature: String,
}

/// All walks, and a row for each setting.
#[derive(Serialize)]
pub struct Table {
    /// By their numbers.
    pub walks: Vec<Walk>,
    /// In the order in which they were asked for.
    pub rows: Vec<Row>,
}

impl Table {
    /// What the evaluation of each run found fault with, and whether there was anything to evaluate. Failed where a trajectory does not follow
    /// the ground truth that it was held against (another walk's, say), and where every walk was refused.
    pub fn judgement(&self) -> Judgement {
        let runs = || self.rows.iter().flat_map(|row| &row.runs);
        let (all, given) = (
            runs().count(),
            runs().filter(|r| r.ate_rms_m.is_some()).count(),
        );
        let what = match given {
            0 => "every walk was refused".to_owned(),
            given => format!("{given} of {all} trajectories were evaluated"),
        };
        let evaluated = Finding::new("evaluated", Verdict::Fail.unless(given > 0), "walks", what)
            .value(given as f64, "")
            .limit(Limit::AtLeast(1.0))
            .remedy("the runs say why: check that each walk shows the place of its map");
        let of_runs = runs().flat_map(|run| {
            run.findings.iter().map(|finding| Finding {
                subject: format!("{}: {}", self.name_of(run), finding.subject),
                ..finding.clone()
            })
        });
        Judgement::new(std::iter::once(evaluated).chain(of_runs).collect())
    }

    /// As people tell runs of a setting apart.
    fn name_of(&self, run: &Run) -> String {
        let withheld = &run.withheld_quadrants;
        match self.walks.len() {
            1 => format!("without {withheld:?}"),
            _ => format!("walk {}, without {withheld:?}", run.walk),
        }
    }

    /// For people.
    pub fn to_text(&self) -> String {
        let of = match &self.walks[..] {
            [one] => format!("{} against {}", one.recording, one.truth),
            several => format!("{} walks, ± over walks", several.len()),
        };
        let labels: Vec<String> = self.rows.iter().map(|row| row.setting.label()).collect();
        let widest = labels.iter().map(|label| label.chars().count()).max();
        let width = widest.unwrap_or_default().max(4);
        let mut text = format!(
            "{of}, ATE rms in cm after alignment by {}\n{:<width$}  walks  runs  refused      ATE   ± 95 %    worst   judged   frames with a pose\n",
            ALIGNMENT.label(),
            " map",
        );
        let cm =
            |value: Option<f64>| value.map_or("–".to_owned(), |m| format!("{:.2}", 100.0 * m));
        for (row, label) in self.rows.iter().zip(&labels) {
            // Writing into a string cannot fail.
            let _ = writeln!(
                text,
                "{label:<width$}  {:>5}  {:>4}  {:>7}  {:>7}  {:>7}  {:>7}  {:>6}   {:.1} %",
                row.walks,
                row.runs.len(),
                row.refused,
                cm(row.ate_rms_m),
                cm(row.ate_rms_interval_m),
                cm(row.worst_ate_rms_m),
                row.judged_percent
                    .map_or("–".to_owned(), |percent| format!("{percent:.0} %")),
                row.poses_percent,
            );
            for run in &row.runs {
                let name = self.name_of(run);
                if let Some(why) = &run.refused {
                    let _ = writeln!(text, "       {name}: {why}");
                }
                for finding in &run.findings {
                    let _ = writeln!(
                        text,
                        "       {name}: {}  {} {}",
                        finding.verdict, finding.subject, finding.what
                    );
                }
            }
        }
        text
    }
}

/// A row of the runs of one setting.
fn summary(setting: Setting, runs: Vec<Run>) -> Row {
    let given = |run: &Run| Some((run.walk, run.ate_rms_m?));
    let given: Vec<(usize, f64)> = runs.iter().filter_map(given).collect();
    let rms: Vec<f64> = given.iter().map(|(_, rms)| *rms).collect();
    let walks: BTreeSet<usize> = runs.iter().map(|run| run.walk).collect();
    let of_walk = |walk: &usize| {
        let own = given.iter().filter(|(other, _)| other == walk);
        mean(&own.map(|(_, rms)| *rms).collect::<Vec<_>>())
    };
    let samples = match walks.len() {
        1 => rms.clone(),
        // Choices of quadrants of one walk have all its luck in common.
        _ => walks.iter().filter_map(of_walk).collect(),
    };
    let shares = runs.iter().map(|run| run.poses_percent);
    let given = runs.iter().filter(|run| run.ate_rms_m.is_some());
    let judged = given.map(|run| run.judged_percent);
    Row {
        setting,
        alignment: ALIGNMENT.label(),
        walks: walks.len(),
        given: rms.len(),
        refused: runs.len() - rms.len(),
        ate_rms_m: mean(&samples),
        ate_rms_interval_m: interval(&samples),
        worst_ate_rms_m: rms.iter().copied().reduce(f64::max),
        poses_percent: shares.sum::<f64>() / runs.len().max(1) as f64,
        judged_percent: judged.reduce(f64::min),
        runs,
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Student's t for 95 % on both sides, from one degree of freedom on; with more than these it is less, by 4 % at most.
const STUDENT_95: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056,
    2.052, 2.048, 2.045, 2.042,
];

/// Half of the 95 % interval of the mean.
fn interval(values: &[f64]) -> Option<f64> {
    let freedom = values.len().checked_sub(1)?;
    let listed = freedom.min(STUDENT_95.len()).checked_sub(1)?;
    let student = STUDENT_95.get(listed)?;
    let middle = mean(values)?;
    let variance = values.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / freedom as f64;
    Some(student * (variance / values.len() as f64).sqrt())
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

    fn run(walk: usize, ate_rms_m: Option<f64>) -> Run {
        Run {
            walk,
            withheld_quadrants: vec![0],
            points_percent: 75.0,
            poses_percent: 100.0,
            judged_percent: 100.0,
            ate_rms_m,
            ate_max_m: ate_rms_m,
            findings: Vec::new(),
            refused: ate_rms_m.is_none().then(|| "no".to_owned()),
        }
    }

    /// Choices of one walk are no walks: 1, 1, 1 and 1 cm of one and 3, 3, 3 and 3 of the other are two samples, by hand 2 ± 12.706 cm, not
    /// eight, of which the naive interval is 2 ± 0.9.
    #[test]
    fn several_walks_have_intervals_over_walks() {
        let setting = |feature: &str| Setting {
            method: Method::GroundTruth,
            map_percent: 75,
            feature: Some(feature.to_owned()),
            loops: None,
        };
        let mut runs = Runs::default();
        for (walk, ate_m) in [(1, 0.01), (2, 0.03)] {
            for _ in 0..4 {
                runs.add(setting("sift"), run(walk, Some(ate_m)));
            }
        }
        runs.add(setting("xfeat"), run(3, Some(0.02)));
        runs.add(setting("xfeat"), run(3, None));
        let rows = runs.rows();
        let [sift, learned] = &rows[..] else {
            panic!("one row for each feature: {}", rows.len());
        };
        assert_eq!((sift.walks, sift.given, sift.refused), (2, 8, 0));
        let half_m = sift.ate_rms_interval_m.expect("two walks");
        assert!((half_m - 0.12706).abs() < 1e-5, "{half_m}");
        assert!((sift.ate_rms_m.expect("a mean") - 0.02).abs() < 1e-12);
        assert!((sift.worst_ate_rms_m.expect("a worst") - 0.03).abs() < 1e-12);
        assert_eq!((learned.walks, learned.given, learned.refused), (1, 1, 1));
        assert_eq!(learned.ate_rms_interval_m, None);
        let table = Table {
            walks: (1..4)
                .map(|k| Walk {
                    recording: format!("{k}.mcap"),
                    truth: String::new(),
                    map: String::new(),
                    feature: String::new(),
                })
                .collect(),
            rows,
        };
        let text = table.to_text();
        assert!(text.contains(" 75% xfeat"), "{text}");
        assert!(text.contains("walk 3, without [0]: no"), "{text}");
    }

    /// Two ground truths in the wrong order were two large errors and nothing else.
    #[test]
    fn what_does_not_follow_its_ground_truth_is_no_result() {
        let verdict_of = |run: Run| {
            let setting = Setting {
                method: Method::Motion,
                map_percent: 0,
                feature: None,
                loops: Some(true),
            };
            let rows = vec![summary(setting, vec![run])];
            let walks = Vec::new();
            Table { walks, rows }.judgement().verdict()
        };
        let found = |verdict| Run {
            findings: vec![Finding::new("follows", verdict, "orientations", "")],
            ..run(1, Some(0.01))
        };
        assert_eq!(verdict_of(found(Verdict::Warn)), Verdict::Warn);
        assert_eq!(verdict_of(found(Verdict::Fail)), Verdict::Fail);
        assert_eq!(verdict_of(run(1, None)), Verdict::Fail, "all refused");
    }
}
