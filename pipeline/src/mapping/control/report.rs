//! What control points say of a map, and it of them.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use crate::hd_map::UnplacedMark;

/// A blunder of a mark that could be larger without being seen is said, metres.
const UNSEEN_BLUNDER_M: f64 = 0.2;
/// A blunder of so many standard deviations is seen.
const SEEN_SIGMAS: f64 = 5.0;
/// A map that is so many times worse known than it says is said to be bent towards them.
pub(super) const USUAL_FACTOR: f64 = 4.0;
/// A map that control points hold lies at them as well as this, metres.
const FITS_M: f64 = 0.05;

/// What control points say of a map, and it of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ControlReport {
    /// Whether they hold the map: its world is then the frame of the site, but for a shift.
    pub holds: bool,
    /// Why they do not; empty where they do.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// Those that have a place in the map.
    pub marks: Vec<ControlMark>,
    /// Those that have none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unplaced: Vec<UnplacedMark>,
    /// Clicks in images whose pose is not known.
    pub clicks_without_pose: u64,
    /// How well was clicked, pixels in each direction, 1 σ.
    pub click_sigma_px: f64,
    /// By how much control points that agree were farther from the map that they did not hold than both were said to be known: 1 where that is right.
    pub map_factor: f64,
    /// How many times as large as the map their survey is, where the map is farther from it than both say and that explains most of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Angle between the z axis of their frame and the vertical of the walk, degrees.
    pub tilt_deg: f64,
}

/// A control point in a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ControlMark {
    /// Its name.
    pub name: String,
    /// Where it was surveyed, metres.
    pub surveyed_m: [f64; 3],
    /// Where the map has it in the frame of the survey, metres.
    pub map_m: [f64; 3],
    /// Clicks that agree.
    pub clicks: u64,
    /// Clicks that do not, and are left out.
    pub clicks_left_out: u64,
    /// How far the map that no control point held had it from where all others that hold say it is, metres along the axes of the survey.
    pub from_others_m: [f64; 3],
    /// How well that was known where it was known worst, 1 σ, metres; absent where nothing told it along some direction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_others_sigma_m: Option<f64>,
    /// How many standard deviations it is.
    pub from_others_sigmas: f64,
    /// Whether it holds the map.
    pub holds: bool,
    /// How far it was from where it was surveyed when the map was put in its place as it was, metres.
    pub before_m: f64,
    /// How far it is in the map that they hold, metres.
    pub after_m: f64,
}

impl ControlMark {
    fn off_the_others_cm(&self) -> f64 {
        100.0 * self.from_others_m.iter().map(|m| m * m).sum::<f64>().sqrt()
    }
}

impl ControlReport {
    /// Root mean square distances of those that hold from where they were surveyed, before and after, metres.
    pub fn rms_m(&self) -> [f64; 2] {
        let held = || self.marks.iter().filter(|mark| mark.holds);
        let rms = |squares: f64| (squares / held().count().max(1) as f64).sqrt();
        [
            rms(held().map(|mark| mark.before_m.powi(2)).sum()),
            rms(held().map(|mark| mark.after_m.powi(2)).sum()),
        ]
    }

    /// They do not hold the map in the end.
    pub(in crate::mapping) fn lost(&mut self) {
        self.holds = false;
        self.reason =
            "fewer than three remained in the map while it was adjusted to them".to_owned();
    }

    /// What is to be said of them.
    pub fn findings(&self) -> Vec<Finding> {
        let warn = |code: &'static str, subject: &str, what: String| {
            Finding::new(code, Verdict::Warn, subject, what)
        };
        let mut findings = vec![self.holding()];
        for mark in self.marks.iter().filter(|mark| !mark.holds && self.holds) {
            let what = format!(
                "is {:.1} cm ({:.0} σ) off the position predicted by the {} others, and is not used",
                mark.off_the_others_cm(),
                mark.from_others_sigmas,
                self.held()
            );
            let finding = warn("control-point-off", &mark.name, what)
                .value(0.01 * mark.off_the_others_cm(), "m");
            let finding = match mark.from_others_sigma_m {
                Some(sigma_m) => finding.sigma(sigma_m),
                None => finding,
            };
            findings.push(
                finding.remedy(
                    "measure it again, and check that its clicks are on the measured point",
                ),
            );
        }
        for mark in &self.unplaced {
            findings.push(
                warn(
                    "control-point-unplaced",
                    &mark.name,
                    format!("could not be placed in the map: {}", mark.reason),
                )
                .remedy("click it again, in three images or more, from several sides"),
            );
        }
        if self.holds && self.map_factor > USUAL_FACTOR {
            let scale = self.scale.map_or_else(String::new, |scale| {
                format!(", in its scale alone: the survey is {scale:.4} times as large, and one of the two is wrong")
            });
            let what = format!(
                "without control points its error was {:.1} times its standard deviations{scale}",
                self.map_factor
            );
            findings.push(
                warn("control-points-bend", "map", what)
                    .value(self.map_factor, "")
                    .limit(Limit::AtMost(USUAL_FACTOR))
                    .remedy("start from a better trajectory, walk loops, and survey marks along the whole walk: between them the map is unchanged"),
            );
        }
        let held = self.marks.iter().filter(|mark| mark.holds);
        let unseen = held.filter(|mark| {
            let sigma_m = mark.from_others_sigma_m;
            sigma_m.is_none_or(|sigma_m| SEEN_SIGMAS * sigma_m > UNSEEN_BLUNDER_M)
        });
        let unseen: Vec<&str> = unseen.map(|mark| mark.name.as_str()).collect();
        if self.holds && !unseen.is_empty() {
            let what = format!(
                "a blunder of {:.0} cm would hardly be noticed in {}",
                100.0 * UNSEEN_BLUNDER_M,
                unseen.join(", ")
            );
            findings.push(
                warn("control-points-unchecked", "control points", what)
                    .remedy("survey more marks, some of them off the line and the plane of the others, and click each in images taken far apart"),
            );
        }
        findings
    }

    fn held(&self) -> usize {
        self.marks.iter().filter(|mark| mark.holds).count()
    }

    fn holding(&self) -> Finding {
        if !self.holds {
            let scale = self.scale.map_or_else(String::new, |scale| {
                format!("; the survey is {scale:.4} times as large as the map: is it in metres?")
            });
            let what = format!(
                "are not used, and the map's origin is the start of the walk: {}{scale}",
                self.reason
            );
            return Finding::new("control-points", Verdict::Fail, "control points", what).remedy(
                "check names, units, axes and clicks; `lsfb map distances` shows the distances between marks in the map",
            );
        }
        let [before_m, after_m] = self.rms_m();
        let verdict = Verdict::Warn.unless(after_m <= FITS_M);
        let what = format!(
            "{} of {} are used, and the map is in their frame: error {:.1} mm rms, {:.1} mm before",
            self.held(),
            self.marks.len() + self.unplaced.len(),
            1e3 * after_m,
            1e3 * before_m
        );
        Finding::new("control-points", verdict, "control points", what)
            .value(after_m, "m")
            .limit(Limit::AtMost(FITS_M))
            .remedy("measure those with the largest errors again")
    }
}
