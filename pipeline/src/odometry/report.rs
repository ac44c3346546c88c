//! What the odometry says about its result.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use super::point_clock::DeskewReport;
use super::unseen::UnseenStretch;
use super::warning::{
    LEAST_AGREEMENT, MAX_SIGMA_M, OdometryWarning, RARE_SCANS_S, USUAL_AGREEMENT,
};

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
    /// The same of the pose that is known worst: when, seconds after the first scan, and how well, metres.
    #[serde(default)]
    pub largest_sigma: [f64; 2],
    /// Where scans agree least with the map over ten seconds: seconds after the first registered scan, mean share of their keypoints. Absent with few scans.
    #[serde(default)]
    pub least_agreement: Option<[f64; 2]>,
    /// How motion within scans was undone.
    #[serde(default)]
    pub deskew: DeskewReport,
    /// Scans left out: empty, out of order, or before the first inertial sample.
    pub skipped: u64,
    /// Scans that are the one before once more, number by number.
    #[serde(default)]
    pub repeated: u64,
    /// Where the IMU measured nothing for more than a quarter of a second, or the same again and again while the carrier moved: from and until when, seconds
    /// after the first scan. Empty without an IMU.
    #[serde(default)]
    pub imu_pauses: Vec<[f64; 2]>,
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

impl OdometryReport {
    /// Everything that was looked at, good or not.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        if self.lost == 0 && self.skipped == 0 && self.registered > 1 {
            let what = format!("all {} scans have a pose", self.scans);
            findings.push(
                Finding::new("registered", Verdict::Pass, "scans", what)
                    .value(self.registered as f64, ""),
            );
        }
        let [at_s, sigma_m] = self.largest_sigma;
        if sigma_m <= MAX_SIGMA_M && self.sigma_at_end_m <= MAX_SIGMA_M && self.registered > 1 {
            let what = format!(
                "every pose is known to {sigma_m:.3} m (one standard deviation; the worst at {at_s:.1} s)"
            );
            findings.push(
                Finding::new("known", Verdict::Pass, "poses", what)
                    .value(sigma_m, "m")
                    .limit(Limit::AtMost(MAX_SIGMA_M)),
            );
        }
        if self.imu_leads() && self.little_agreement().is_none() {
            let share_percent = 100.0 * self.mean_inlier_ratio;
            let what = format!("{share_percent:.0} % of a scan agrees with the map on average");
            findings.push(
                Finding::new("agreement", Verdict::Pass, "IMU and scans", what)
                    .value(share_percent, "%")
                    .limit(Limit::AtLeast(100.0 * USUAL_AGREEMENT)),
            );
        }
        findings.extend(self.warnings.iter().map(OdometryWarning::finding));
        findings
    }

    /// Whether what agrees with the map tells of the IMU.
    fn imu_leads(&self) -> bool {
        let leads = self.imu_samples > 0 && self.deskew.by_times > self.deskew.none;
        leads && self.registered >= 2
    }

    /// What an IMU that measures something else makes of a walk, or of a part of it, where it shows in nothing else.
    pub(super) fn little_agreement(&self) -> Option<OdometryWarning> {
        if !self.imu_leads() {
            return None;
        }
        let share = self.mean_inlier_ratio;
        if share < USUAL_AGREEMENT {
            return Some(OdometryWarning::LittleAgreement { share });
        }
        let [from_s, share] = self.least_agreement?;
        (share < LEAST_AGREEMENT).then_some(OdometryWarning::StretchDisagrees { from_s, share })
    }

    /// Whether nothing is left out: every message was read, every scan found its place, none stayed away for long, nor did the IMU, and every place is known.
    pub fn is_whole(&self) -> bool {
        let [_, largest_m] = self.largest_sigma;
        let is_known = self.sigma_at_end_m <= MAX_SIGMA_M && largest_m <= MAX_SIGMA_M;
        let is_measured = self.gaps.is_empty() && self.imu_pauses.is_empty();
        self.has_all_data() && is_measured && is_known
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

    /// Says where the IMU paused.
    pub(super) fn set_imu_pauses(&mut self, pauses: Vec<[f64; 2]>) {
        let said = pauses.iter();
        let said = said.map(|&[from_s, to_s]| OdometryWarning::ImuPause { from_s, to_s });
        self.warnings.extend(said);
        self.imu_pauses = pauses;
    }

    /// How well the poses are known, as that is or has become: at the end, and where they are known worst. What was said of it before is taken back.
    pub(super) fn set_sigmas(&mut self, at_end_m: f64, largest: [f64; 2]) {
        (self.sigma_at_end_m, self.largest_sigma) = (at_end_m, largest);
        let is_of_it = |w: &OdometryWarning| {
            matches!(
                w,
                OdometryWarning::EndUncertain { .. } | OdometryWarning::StretchUncertain { .. }
            )
        };
        self.warnings.retain(|w| !is_of_it(w));
        let [at_s, sigma_m] = largest;
        if at_end_m > MAX_SIGMA_M {
            let sigma_m = at_end_m;
            self.warnings
                .push(OdometryWarning::EndUncertain { sigma_m });
        } else if sigma_m > MAX_SIGMA_M {
            let uncertain = OdometryWarning::StretchUncertain { at_s, sigma_m };
            self.warnings.push(uncertain);
        }
    }

    /// Adds what follows from the counts, in the order of its weight.
    pub(super) fn add_warnings(&mut self) {
        let (lost, skipped, scans) = (self.lost, self.skipped, self.scans);
        if lost > 0 {
            self.warnings.push(OdometryWarning::Lost { lost, scans });
        }
        if self.registered == 1 {
            self.warnings.push(OdometryWarning::OnePose { scans });
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
        if self.repeated > 0 {
            let repeated = self.repeated;
            self.warnings
                .push(OdometryWarning::Repeated { repeated, scans });
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
        let codes = |report: &OdometryReport| -> Vec<_> {
            report.findings().into_iter().map(|f| f.code).collect()
        };
        assert_eq!(codes(&report), ["registered", "known", "agreement"]);
        // Nothing is good of which nothing is there.
        assert_eq!(codes(&OdometryReport::default()), [""; 0]);
        // Scans without times and without IMU agree less in streets.
        (report.mean_inlier_ratio, report.imu_samples) = (0.5, 0);
        assert_eq!(report.little_agreement(), None);
    }
}
