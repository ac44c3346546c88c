//! When a finding is one.
//!
//! Each check has two limits: from the first on it should be looked at, from the second on the rig is not that of the recording.
//! They say what does harm, not what can be seen: the standard deviation says that, and a finding must be clear of both.
//!
//! | check | limits | why |
//! | --- | --- | --- |
//! | time offset | 2, 4 ms | a rig that is carried turns by up to 1 rad/s: 2 ms are 2 mrad, a pixel at 500 px of focal length; what is calibrated well is known to 0.5 ms |
//! | rotation to the IMU | 0.5, 1° | the IMU carries the camera from image to image: 0.5° of its axes are 1 % of the motion, more than its scale errs by |
//! | rotation to the LiDAR | 0.4, 0.8° | 0.4° are two steps of the LiDAR in azimuth, and 2 cm at 3 m |
//! | both of these between parts of the recording | the same | a rig has one number for each: where it changes by more, that is wrong somewhere |
//! | epipolar | 1, 2 px | three times what corners are found to |

use lsfb_types::Verdict;

/// Standard deviations that chance explains.
const DEVIATIONS: f64 = 3.0;

/// The outcome of a size with limits. A limit that lies within what chance explains cannot be told from zero.
pub(super) fn judged(value: f64, sigma: f64, limits: [f64; 2]) -> Verdict {
    let chance = DEVIATIONS * sigma;
    if chance.is_nan() || (chance > limits[1] && value <= limits[1] + chance) {
        Verdict::Unknown
    } else if value <= limits[0].max(chance) {
        Verdict::Pass
    } else if value <= limits[1] || value <= limits[0] + chance {
        Verdict::Warn
    } else {
        Verdict::Fail
    }
}

/// What is said where an answer is too uncertain to be one.
pub(super) fn unclear(sigma: f64, unit: &str) -> String {
    format!(
        "standard deviation is {sigma:.1} {unit}, too large: rotate more, in front of objects with corners"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn findings_are_clear_of_their_limit_and_of_chance() {
        let limits = [2.0, 4.0];
        for (value, sigma, expected) in [
            (1.0, 0.3, Verdict::Pass),
            (2.4, 0.9, Verdict::Pass),
            (2.4, 0.3, Verdict::Warn),
            (4.6, 1.0, Verdict::Warn),
            (5.0, 0.4, Verdict::Fail),
            (1.0, 2.0, Verdict::Unknown),
            (30.0, 2.0, Verdict::Fail),
            (1.0, f64::NAN, Verdict::Unknown),
        ] {
            assert_eq!(judged(value, sigma, limits), expected, "{value} ± {sigma}");
        }
    }
}
