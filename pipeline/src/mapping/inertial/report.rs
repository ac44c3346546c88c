//! What is said of the IMU's term.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

/// What the IMU's term of Eq. (4) was made of, and how well the map agrees with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InertialReport {
    /// Keyframes that the IMU ties to the next.
    pub factors: u64,
    /// Keyframes that it does not: the next is too long after them, or samples between them are missing.
    pub left_out: u64,
    /// How far the keyframes are from what the samples say, root mean square in standard deviations of the noise in the rig file.
    pub rms_sigmas: f64,
}

/// A scanner that stands has keyframes a long time apart, but not so many, per cent.
const MOST_LEFT_OUT_PERCENT: f64 = 25.0;
/// What densities leave out doubles the noise; more is another sensor than the rig file says, or a clock.
const MOST_SIGMAS: f64 = 6.0;

impl InertialReport {
    /// As every command and page says it.
    pub(in crate::mapping) fn findings(&self) -> [Finding; 2] {
        let all = self.factors + self.left_out;
        let percent = 1e2 * self.left_out as f64 / all.max(1) as f64;
        let verdict = |is_right: bool| match is_right {
            true => Verdict::Pass,
            false => Verdict::Warn,
        };
        let left_out = Finding::new(
            "imu-left-out",
            verdict(percent <= MOST_LEFT_OUT_PERCENT),
            "IMU",
            format!(
                "it connects {} of {all} keyframes to the next; for {} samples are missing, or the next is too late",
                self.factors, self.left_out
            ),
        )
        .value(percent, "%")
        .limit(Limit::AtMost(MOST_LEFT_OUT_PERCENT))
        .remedy("look for gaps of the IMU with `lsfb doctor`");
        let off = Finding::new(
            "imu-off",
            verdict(self.rms_sigmas <= MOST_SIGMAS),
            "IMU",
            format!(
                "keyframes differ from the IMU by {:.1} standard deviations of its noise (rms)",
                self.rms_sigmas
            ),
        )
        .value(self.rms_sigmas, "σ")
        .limit(Limit::AtMost(MOST_SIGMAS))
        .remedy("check its noise in the rig file (`lsfb calib imu-noise`), or map without it: imu = false under [terms]");
        [left_out, off]
    }
}
