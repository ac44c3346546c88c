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
    /// Whether the search ended: otherwise the errors are larger than these.
    pub settled: bool,
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
/// Keypoints below which nothing can be said.
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
                "its focal length is off by",
                1e2 * self.focal_share.abs(),
                1e2 * self.focal_sigma,
                FOCAL_LIMITS.map(|share| 1e2 * share),
                "%",
            ),
            self.finding(
                "camera-clock",
                "its clock is off by",
                1e3 * self.clock_s.abs(),
                1e3 * self.clock_sigma_s,
                CLOCK_LIMITS_S.map(|s| 1e3 * s),
                "ms",
            ),
        ];
        findings.push(self.points_finding());
        findings
    }

    /// Whether it is other than stated for sure, and its clock is right, so that what was found of it can be taken.
    pub(super) fn is_refinable(&self) -> bool {
        let is_off = |f: &Finding| matches!(f.verdict, Verdict::Warn | Verdict::Fail);
        let of_lens = ["camera-turn", "camera-shift", "camera-focal-length"];
        let mut off = self.findings();
        off.retain(is_off);
        self.settled && !off.is_empty() && off.iter().all(|f| of_lens.contains(&&*f.code))
    }

    /// That Eq. (4) was solved with the camera as found.
    pub(super) fn refined_finding(&self) -> Finding {
        let what = format!(
            "the estimate from the map's images is used, not the rig file: rotated by {:.2}°, shifted by {:.2} cm, focal length {:+.2} %",
            self.turn_deg,
            1e2 * self.shift_m,
            1e2 * self.focal_share
        );
        Finding::new("camera-refined", Verdict::Warn, &self.camera, what).remedy(
            "calibrate the rig; with refine_cameras = false in --config the rig file is used",
        )
    }

    /// Whether what matches shows points.
    fn points_finding(&self) -> Finding {
        let share = self.observations as f64 / self.tracked.max(1) as f64;
        let [warn, fail] = FEWEST_SHOW_A_POINT;
        let verdict = match share {
            _ if self.tracked < FEWEST_TRACKED => Verdict::Warn,
            share if share < fail => Verdict::Fail,
            share if share < warn => Verdict::Warn,
            _ => Verdict::Pass,
        };
        let what = format!(
            "{} of its {} keypoints with matches in two other images show a map point",
            self.observations, self.tracked
        );
        let finding = Finding::new("camera-points", verdict, &self.camera, what)
            .remedy("it does not point where the rig file says: check which camera is which, and calibrate the rig");
        match self.tracked < FEWEST_TRACKED {
            true => finding
                .value(self.tracked as f64, "keypoints")
                .limit(Limit::AtLeast(FEWEST_TRACKED as f64))
                .remedy("whether it points where the rig file says is unknown: map for longer, and check the rig file"),
            false => finding.value(1e2 * share, "%").limit(Limit::AtLeast(1e2 * warn)),
        }
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
        let uncertain = CERTAIN_SIGMAS * sigma;
        let at_least = value - uncertain;
        let [warn, fail] = limits;
        let verdict = match at_least {
            at_least if at_least > fail => Verdict::Fail,
            at_least if at_least > warn && !self.settled => Verdict::Fail,
            at_least if at_least > warn => Verdict::Warn,
            // An error that must not be would not have been noticed.
            _ if !(self.settled && value.is_finite() && uncertain < fail) => Verdict::Unknown,
            _ => Verdict::Pass,
        };
        let or_more = match self.settled {
            true => "",
            false => " or more",
        };
        let space = if unit == "°" { "" } else { " " };
        let what = format!(
            "{what} {value:.2}{space}{unit} ± {sigma:.2}{space}{unit}{or_more} relative to the rig file, according to the map's images"
        );
        Finding::new(code, verdict, &self.camera, what)
            .value(value, unit)
            .sigma(sigma)
            .limit(Limit::AtMost(warn))
            .remedy("the points that it sees are mapped in the wrong place: calibrate the rig and map again")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn right() -> CameraError {
        CameraError {
            camera: "cam0".to_owned(),
            tracked: 5000,
            observations: 3000,
            turn_deg: 0.05,
            turn_sigma_deg: 0.02,
            shift_m: 0.004,
            shift_sigma_m: 0.005,
            focal_share: 0.0003,
            focal_sigma: 0.0004,
            clock_s: 0.0003,
            clock_sigma_s: 0.0003,
            settled: true,
        }
    }

    fn verdict(error: &CameraError, code: &str) -> Option<Verdict> {
        let findings = error.findings();
        findings.iter().find(|f| f.code == code).map(|f| f.verdict)
    }

    #[test]
    fn what_could_not_have_been_noticed_does_not_pass() {
        assert!(
            right()
                .findings()
                .iter()
                .all(|f| f.verdict == Verdict::Pass)
        );
        for turn_sigma_deg in [5.7, f64::NAN, f64::INFINITY] {
            let unknown = CameraError {
                turn_sigma_deg,
                ..right()
            };
            assert_eq!(verdict(&unknown, "camera-turn"), Some(Verdict::Unknown));
        }
        let no_number = CameraError {
            clock_s: f64::NAN,
            ..right()
        };
        assert_eq!(verdict(&no_number, "camera-clock"), Some(Verdict::Unknown));
        let unmatched = CameraError {
            tracked: 0,
            observations: 0,
            ..right()
        };
        assert_eq!(verdict(&unmatched, "camera-points"), Some(Verdict::Warn));
    }

    /// A camera turned by 12° was said to be turned by 0.74 ± 0.03°, as the search ended before it was there.
    #[test]
    fn an_error_that_still_grows_fails() {
        let found = CameraError {
            turn_deg: 0.74,
            turn_sigma_deg: 0.03,
            ..right()
        };
        assert_eq!(verdict(&found, "camera-turn"), Some(Verdict::Warn));
        let grows = CameraError {
            settled: false,
            ..found
        };
        assert_eq!(verdict(&grows, "camera-turn"), Some(Verdict::Fail));
        assert_eq!(verdict(&grows, "camera-clock"), Some(Verdict::Unknown));
        let sentence = grows.findings()[0].what.clone();
        assert!(sentence.contains("or more"), "{sentence}");
    }
}
