//! What became of one walk, for JSON, the terminal and the page.

use std::fmt::Write as _;

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use super::rigs::{Rigs, SensorOff};
use super::trial::{Condition, OTHER_FLOOR, Walked};

/// A pose that is further off than this is wrong, metres.
pub const WRONG_M: f64 = 0.10;

/// One walk through one place with one device. Lengths that are not known, because a stage refused, are null.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Run {
    pub place: String,
    /// What became of the place between scan and walk.
    pub condition: String,
    pub device: String,
    pub seed: u64,
    /// The motion of Table VII.
    pub motion: String,
    /// Error of the scanner's trajectory after alignment, rms.
    pub scanner_ate_rms_m: Option<f64>,
    /// Mean error of the scanner's trajectory over ten metres of way, relative to them.
    pub drift_percent: Option<f64>,
    /// Of the map's observations, rms.
    pub reprojection_px: Option<f64>,
    /// Share of instants of the walk for which localization alone gave a pose.
    pub localized: Option<f64>,
    /// Share of instants whose pose was right: within 10 cm and 5°.
    pub localized_right: Option<f64>,
    /// Error of the walk's trajectory after an alignment of its own, rms and largest.
    pub ate_rms_m: Option<f64>,
    pub ate_max_m: Option<f64>,
    /// The same, placed by the map alone.
    pub in_map_rms_m: Option<f64>,
    /// Motion of the trajectory above 5 Hz that is not in the truth, rms.
    pub jitter_m: Option<f64>,
    /// Second difference of the errors of positions from image to image, rms: of images that were localized rightly one by one, and of the trajectory
    /// at the same images.
    pub jitter_localized_m: Option<f64>,
    pub jitter_solved_m: Option<f64>,
    /// So many times as much in images localized one by one as in the trajectory.
    pub jitter_ratio: Option<f64>,
    /// Error of the way from one image to the next, rms.
    pub between_frames_m: Option<f64>,
    pub between_frames_deg: Option<f64>,
    /// Of instants that localization alone placed rightly: error after an alignment of their own, rms.
    pub localized_ate_rms_m: Option<f64>,
    /// Share of the poses that are within the region of 95 % of their covariance, where the map places them.
    pub within_95: Option<f64>,
    /// Time at which the map is in view from where the device truly is, and that part of it with a pose; by the 40 instants.
    pub map_in_view_s: Option<f64>,
    pub answered_in_view_s: Option<f64>,
    /// Poses of the trajectory, and those of them that are more than 10 cm off where the map places them.
    pub exported: u64,
    pub exported_wrong: u64,
    /// Time of the walk that is left out of the trajectory.
    pub dropped_s: f64,
    /// Why there is no trajectory.
    pub refused: Option<String>,
    /// What `lsfb groundtruth` says is not as it should be.
    #[serde(rename = "doubts")]
    pub problem_codes: Vec<String>,
    /// Whether it says that the trajectory must not be used.
    pub failed: bool,
    /// Horizontal distance of the walk from the scanner's path: median, and what a tenth and nine tenths of it are nearer than.
    pub off_path_m: Option<f64>,
    pub off_path_p10_m: Option<f64>,
    pub off_path_p90_m: Option<f64>,
    /// Which rigs the estimators were given.
    pub rigs: Rigs,
    /// How far the rigs that the estimators were given are from the true ones.
    pub rigs_off: Vec<SensorOff>,
    /// The stages in the order in which they ran. Scan, map and calibration are shared by the runs of a place.
    pub stages_s: Vec<(String, f64)>,
    /// The most that the program held during each stage.
    pub stages_peak_rss_mb: Vec<(String, f64)>,
    /// During any of them.
    pub peak_rss_mb: f64,
    /// Whether stages of other places ran beside any of them, whose memory is counted with its own.
    pub beside_others: bool,
}

impl Run {
    /// Of which nothing is known yet.
    pub fn of(walked: &Walked, rigs: Rigs) -> Self {
        let scanned = &walked.scanned;
        Self {
            place: scanned.place.name().to_owned(),
            condition: walked.condition.name().to_owned(),
            device: walked.device.name().to_owned(),
            seed: scanned.seed,
            motion: scanned.motion().map_or("", |m| m.name).to_owned(),
            scanner_ate_rms_m: None,
            drift_percent: None,
            reprojection_px: None,
            localized: None,
            localized_right: None,
            ate_rms_m: None,
            ate_max_m: None,
            in_map_rms_m: None,
            jitter_m: None,
            jitter_localized_m: None,
            jitter_solved_m: None,
            jitter_ratio: None,
            between_frames_m: None,
            between_frames_deg: None,
            localized_ate_rms_m: None,
            within_95: None,
            map_in_view_s: None,
            answered_in_view_s: None,
            exported: 0,
            exported_wrong: 0,
            dropped_s: 0.0,
            refused: None,
            problem_codes: Vec::new(),
            failed: false,
            off_path_m: None,
            off_path_p10_m: None,
            off_path_p90_m: None,
            rigs,
            rigs_off: Vec::new(),
            stages_s: Vec::new(),
            stages_peak_rss_mb: Vec::new(),
            peak_rss_mb: 0.0,
            beside_others: false,
        }
    }

    /// Ends before the walk was looked at: all of it is left out.
    pub fn refuse(&mut self, why: &str, walked: &Walked) {
        (self.refused, self.dropped_s) = (Some(why.to_owned()), walked.duration_s());
    }

    /// What the run is called.
    pub fn name(&self) -> String {
        let condition = match self.condition.as_str() {
            "as-scanned" => String::new(),
            other => format!(" {other}"),
        };
        format!("{}{condition} {} {}", self.place, self.device, self.seed)
    }

    /// Whether the walk is where the map is: on another floor a refusal is the right answer.
    pub fn is_in_map(&self) -> bool {
        self.condition != OTHER_FLOOR
    }

    /// Whether the run is one of those that figures are asked of.
    pub fn is_standard(&self) -> bool {
        self.condition == Condition::AsScanned.name()
    }

    /// What is wrong with it, and what must not be used.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        if let Some(why) = &self.refused {
            let verdict = Verdict::Warn.unless(!self.is_in_map());
            findings.push(Finding::new(
                "refused",
                verdict,
                self.name(),
                format!("no trajectory: {why}"),
            ));
            return findings;
        }
        let (wrong, verdict) = match self.exported_wrong {
            0 => ("no pose is".to_owned(), Verdict::Pass),
            1 => ("1 pose is".to_owned(), Verdict::Fail),
            count => (format!("{count} poses are"), Verdict::Fail),
        };
        let what = format!(
            "of {} poses, {wrong} more than 10 cm off its true position in the map",
            self.exported
        );
        findings.push(
            Finding::new("exported-wrong", verdict, self.name(), what)
                .value(self.exported_wrong as f64, "")
                .limit(Limit::AtMost(0.0)),
        );
        if self.failed {
            let what = format!("do not use: {}", self.problem_codes.join(", "));
            findings.push(Finding::new("judgement", Verdict::Warn, self.name(), what));
        }
        findings
    }
}

/// A line for each run.
pub fn table(runs: &[Run]) -> String {
    let mut text = format!(
        "{:<38} {:>7} {:>6} {:>6} {:>6} {:>6} {:>7} {:>7} {:>7} {:>6} {:>6}",
        "",
        "scanner",
        "drift",
        "reproj",
        "local.",
        "right",
        "ATE rms",
        "ATE max",
        "in map",
        "wrong",
        "left"
    );
    text += &format!(
        "\n{:<38} {:>7} {:>6} {:>6} {:>6} {:>6} {:>7} {:>7} {:>7} {:>6} {:>6}",
        "", "cm", "%", "px", "%", "%", "cm", "cm", "cm", "poses", "out s"
    );
    for run in runs {
        let number = |value: Option<f64>, factor: f64, digits: usize| match value {
            Some(value) => format!("{:.digits$}", factor * value),
            None => "–".to_owned(),
        };
        let _ = write!(
            text,
            "\n{:<38} {:>7} {:>6} {:>6} {:>6} {:>6} {:>7} {:>7} {:>7} {:>6} {:>6.1}",
            run.name(),
            number(run.scanner_ate_rms_m, 100.0, 2),
            number(run.drift_percent, 1.0, 2),
            number(run.reprojection_px, 1.0, 2),
            number(run.localized, 100.0, 0),
            number(run.localized_right, 100.0, 0),
            number(run.ate_rms_m, 100.0, 2),
            number(run.ate_max_m, 100.0, 2),
            number(run.in_map_rms_m, 100.0, 2),
            run.exported_wrong,
            run.dropped_s,
        );
        if let Some(why) = &run.refused {
            let _ = write!(text, "\n  refused: {why}");
        }
        if !run.problem_codes.is_empty() {
            let _ = write!(text, "\n  {}", run.problem_codes.join(", "));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use lsfb_sim::{Device, Place};

    use super::super::trial::{Scanned, Size};
    use super::*;

    fn walked() -> Walked {
        let scanned = Scanned {
            place: Place::Stairs,
            seed: 1,
            size: Size::Quick,
        };
        Walked {
            scanned,
            condition: Condition::AsScanned,
            device: Device::Android,
        }
    }

    fn run(refused: Option<&str>) -> Run {
        Run {
            scanner_ate_rms_m: Some(0.01),
            ate_rms_m: refused.is_none().then_some(0.01),
            exported: 300,
            refused: refused.map(str::to_owned),
            ..Run::of(&walked(), Rigs::Calibrated)
        }
    }

    #[test]
    fn what_is_not_known_is_null() {
        let json = serde_json::to_value(run(Some("no map"))).expect("JSON");
        assert!(
            json["ate_rms_m"].is_null() && json["refused"] == "no map",
            "{json}"
        );
        assert!(table(&[run(Some("no map"))]).contains("refused: no map"));

        // Where there is no map, no image was localized, which is not to say that none can be.
        let mut unmapped = Run::of(&walked(), Rigs::Calibrated);
        unmapped.refuse("map: no loop closes", &walked());
        let json = serde_json::to_value(&unmapped).expect("JSON");
        assert!(json["localized"].is_null() && json["localized_right"].is_null());
        assert_eq!(json["dropped_s"], 10.0, "{json}");
    }
}
