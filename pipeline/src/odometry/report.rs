//! What the odometry says about its result.

use serde::{Deserialize, Serialize};

use super::point_clock::DeskewReport;
use super::unseen::UnseenStretch;
use super::warning::OdometryWarning;

/// What the odometry says about its own result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OdometryReport {
    /// Scans in the recording.
    pub scans: u64,
    /// Scans registered to the map, the first included.
    pub registered: u64,
    /// Scans that found no place in the map: they have no pose.
    pub lost: u64,
    /// Lost scans behind the last registered one: the trajectory ends before them.
    #[serde(default)]
    pub lost_at_end: u64,
    /// Where no scan has a pose for more than a second and a half, and five times as long as scans are usually apart: from and until when, seconds after the
    /// first. The IMU alone has the motion there.
    #[serde(default)]
    pub gaps: Vec<[f64; 2]>,
    /// Stretches in which scans do not see all of the motion.
    #[serde(default)]
    pub unseen: Vec<UnseenStretch>,
    /// The largest standard deviation of the last pose's place, in any direction, relative to the first pose, metres.
    #[serde(default)]
    pub sigma_at_end_m: f64,
    /// How motion within scans was undone.
    #[serde(default)]
    pub deskew: DeskewReport,
    /// Scans left out: empty, out of order, or before the first inertial sample.
    pub skipped: u64,
    /// Inertial samples used.
    pub imu_samples: u64,
    /// Usual time from one registered scan to the next (median), seconds; 0 for a single scan.
    #[serde(default)]
    pub scan_interval_s: f64,
    /// Length of the path, metres.
    pub path_length_m: f64,
    /// Mean share of keypoints that agreed with the map.
    pub mean_inlier_ratio: f64,
    /// Root mean square distance of keypoints to the planes of the map, metres.
    pub plane_rms_m: f64,
    /// Gyroscope bias at the end, rad/s; absent without IMU.
    pub gyro_bias_rad_s: Option<[f64; 3]>,
    /// Accelerometer bias at the end, m/s²; absent without IMU.
    pub accel_bias_m_s2: Option<[f64; 3]>,
    /// What the reader should know: missing sensors, damage, lost stretches.
    pub warnings: Vec<OdometryWarning>,
}

/// Where the last pose may be farther off than this in one direction, the end is not found, metres.
const MAX_SIGMA_AT_END_M: f64 = 1.0;

/// Scans that are farther apart than this see too little in common for their covariances to be relied on, seconds.
const RARE_SCANS_S: f64 = 1.0;

/// Where scans are deskewed by times and an IMU leads, more of a scan than this agrees with the map: 0.84 and more in nine simulated places, 0.44 with
/// an accelerometer of the wrong sign.
const USUAL_AGREEMENT: f64 = 0.6;

impl OdometryReport {
    /// What an IMU that measures something else makes of a walk, where it shows in nothing else.
    pub(super) fn little_agreement(&self) -> Option<OdometryWarning> {
        let share = self.mean_inlier_ratio;
        let leads = self.imu_samples > 0 && self.deskew.by_times > self.deskew.none;
        (leads && self.registered > 1 && share < USUAL_AGREEMENT)
            .then_some(OdometryWarning::LittleAgreement { share })
    }

    /// Whether nothing is left out: every message was read, every scan found its place, none stayed away for long, and the place of the last is known.
    pub fn is_whole(&self) -> bool {
        self.has_all_data() && self.gaps.is_empty() && self.sigma_at_end_m <= MAX_SIGMA_AT_END_M
    }

    /// Whether every message was read and every scan found its place.
    pub fn has_all_data(&self) -> bool {
        let is_damaged = |w: &OdometryWarning| matches!(w, OdometryWarning::Damaged { .. });
        let is_damaged = self.warnings.iter().any(is_damaged);
        self.lost == 0 && self.skipped == 0 && !is_damaged
    }

    /// Whether scans are too rare for their covariances to be relied on.
    pub fn has_rare_scans(&self) -> bool {
        self.scan_interval_s > RARE_SCANS_S
    }

    /// How well the end is known once that has changed: what was said of it before is taken back.
    pub(super) fn set_sigma_at_end(&mut self, sigma_m: f64) {
        self.sigma_at_end_m = sigma_m;
        let is_of_end = |w: &OdometryWarning| matches!(w, OdometryWarning::EndUncertain { .. });
        self.warnings.retain(|w| !is_of_end(w));
        self.warnings.extend(self.end_uncertain());
    }

    fn end_uncertain(&self) -> Option<OdometryWarning> {
        let sigma_m = self.sigma_at_end_m;
        (sigma_m > MAX_SIGMA_AT_END_M).then_some(OdometryWarning::EndUncertain { sigma_m })
    }

    /// Adds what follows from the counts, in the order of its weight.
    pub(super) fn add_warnings(&mut self) {
        let (lost, skipped, scans) = (self.lost, self.skipped, self.scans);
        if lost > 0 {
            self.warnings.push(OdometryWarning::Lost { lost, scans });
        }
        if self.lost_at_end > 0 {
            let scans = self.lost_at_end;
            self.warnings.push(OdometryWarning::LostAtEnd { scans });
        }
        let gaps = self.gaps.iter();
        self.warnings
            .extend(gaps.map(|&[from_s, to_s]| OdometryWarning::LidarGap { from_s, to_s }));
        let unseen = self.unseen.iter().cloned();
        self.warnings
            .extend(unseen.map(|stretch| OdometryWarning::Unseen { stretch }));
        self.warnings.extend(self.end_uncertain());
        if self.has_rare_scans() {
            let interval_s = self.scan_interval_s;
            self.warnings
                .push(OdometryWarning::RareScans { interval_s });
        }
        self.warnings.extend(self.deskew.warnings());
        if skipped > 0 {
            self.warnings
                .push(OdometryWarning::Skipped { skipped, scans });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_accelerometer_of_the_wrong_sign_shows_in_what_agrees_with_the_map() {
        let mut report = OdometryReport {
            registered: 80,
            imu_samples: 1600,
            mean_inlier_ratio: 0.44,
            ..OdometryReport::default()
        };
        report.deskew.by_times = 80;
        let said = report.little_agreement().expect("said").finding();
        assert!(said.what.contains("44 %"), "{}", said.what);
        report.mean_inlier_ratio = 0.84;
        assert_eq!(report.little_agreement(), None);
        // Scans without times and without IMU agree less in streets.
        (report.mean_inlier_ratio, report.imu_samples) = (0.5, 0);
        assert_eq!(report.little_agreement(), None);
    }
}
