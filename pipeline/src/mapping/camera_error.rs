//! By how much a camera differs from the rig file, and what a map bears of it.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

/// By how much a camera differs from the rig file, as the map's images show it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraError {
    /// Its name.
    pub camera: String,
    /// Keypoints in its images that match in two others or more.
    pub tracked: u64,
    /// Those of them that show a point of the map.
    pub observations: u64,
    /// Turn of the camera frame, degrees.
    pub turn_deg: f64,
    /// Its standard deviation, in its own direction.
    pub turn_sigma_deg: f64,
    /// Shift of the camera frame, metres.
    pub shift_m: f64,
    /// Its standard deviation, in its own direction.
    pub shift_sigma_m: f64,
    /// Share by which the focal length is larger.
    pub focal_share: f64,
    /// Its standard deviation.
    pub focal_sigma: f64,
    /// To be added to the camera's stamps, seconds.
    pub clock_s: f64,
    /// Its standard deviation, seconds.
    pub clock_sigma_s: f64,
}

/// What a map of some centimetres bears of an error, and what it does not: at five metres 0.3° and 0.5 % move a point by 2.6 cm,
/// and somebody who walks and turns by 40° a second moves it by as much in 5 ms.
pub(super) const TURN_LIMITS_DEG: [f64; 2] = [0.3, 1.0];
pub(super) const SHIFT_LIMITS_M: [f64; 2] = [0.03, 0.1];
pub(super) const FOCAL_LIMITS: [f64; 2] = [0.005, 0.02];
pub(super) const CLOCK_LIMITS_S: [f64; 2] = [0.005, 0.015];
/// Standard deviations beyond a limit that are not chance.
const CERTAIN_SIGMAS: f64 = 4.0;
/// Of keypoints that match from image to image most show a point; of a camera that looks another way than the file says, hardly any does.
const FEWEST_SHOW_A_POINT: [f64; 2] = [0.3, 0.15];
/// Keypoints below which nothing is said.
const FEWEST_TRACKED: u64 = 200;

impl CameraError {
    /// As every command and page says it.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = vec![
            self.finding(
                "camera-turn",
                "turned by",
                self.turn_deg,
                self.turn_sigma_deg,
                TURN_LIMITS_DEG,
                "°",
            ),
            self.finding(
                "camera-shift",
                "shifted by",
                1e2 * self.shift_m,
                1e2 * self.shift_sigma_m,
                SHIFT_LIMITS_M.map(|m| 1e2 * m),
                "cm",
            ),
            self.finding(
                "camera-focal-length",
                "its focal length off by",
                1e2 * self.focal_share.abs(),
                1e2 * self.focal_sigma,
                FOCAL_LIMITS.map(|share| 1e2 * share),
                "%",
            ),
            self.finding(
                "camera-clock",
                "its clock off by",
                1e3 * self.clock_s.abs(),
                1e3 * self.clock_sigma_s,
                CLOCK_LIMITS_S.map(|s| 1e3 * s),
                "ms",
            ),
        ];
        if self.tracked >= FEWEST_TRACKED {
            let share = self.observations as f64 / self.tracked as f64;
            let [warn, fail] = FEWEST_SHOW_A_POINT;
            let verdict = [(fail, Verdict::Fail), (warn, Verdict::Warn)]
                .into_iter()
                .find(|(limit, _)| share < *limit)
                .map_or(Verdict::Pass, |(_, verdict)| verdict);
            let what = format!(
                "{} of its {} keypoints that match in two other images show a point of the map",
                self.observations, self.tracked
            );
            findings.push(
                Finding::new("camera-points", verdict, &self.camera, what)
                    .value(1e2 * share, "%")
                    .limit(Limit::AtLeast(1e2 * warn))
                    .remedy("it does not look where the rig file says: check which camera is which, and calibrate the rig"),
            );
        }
        findings
    }

    fn finding(
        &self,
        code: &'static str,
        what: &str,
        value: f64,
        sigma: f64,
        limits: [f64; 2],
        unit: &'static str,
    ) -> Finding {
        let at_least = value - CERTAIN_SIGMAS * sigma;
        let [warn, fail] = limits;
        let verdict = match at_least {
            at_least if at_least > fail => Verdict::Fail,
            at_least if at_least > warn => Verdict::Warn,
            _ => Verdict::Pass,
        };
        let space = if unit == "°" { "" } else { " " };
        let what = format!(
            "{what} {value:.2}{space}{unit} ± {sigma:.2}{space}{unit} against the rig file, as the map's images show it"
        );
        Finding::new(code, verdict, &self.camera, what)
            .value(value, unit)
            .sigma(sigma)
            .limit(Limit::AtMost(warn))
            .remedy("points that it sees are mapped in the wrong place: calibrate the rig and map again")
    }
}
