//! Whether the numbers of an IMU can be what they are taken for: m/s² and rad/s.

use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2, Stamped};

/// What a carrier feels on average lies so near to gravity, as a share of it: nobody falls or is thrown for a whole recording.
const NEAR_GRAVITY: std::ops::RangeInclusive<f64> = 0.8..=1.3;
/// What turns faster than this all the time is no carrier of a LiDAR, rad/s.
const MAX_RATE_RAD_S: f64 = 8.0;
/// Which of the turn rates in order of size is looked at: faster ones may be knocks.
const RATE_QUANTILE: f64 = 0.95;

/// What was found about the units of an IMU.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ImuUnits {
    /// As they should be.
    Right,
    /// The accelerometer measures in gravities; the samples were made m/s².
    Gravities,
    /// No known unit.
    Wrong {
        /// What is wrong with them.
        problem: String,
    },
}

/// Looks at the samples, and makes those of an accelerometer in gravities m/s².
pub(crate) fn mend_units(samples: &mut [Stamped<ImuSample>]) -> ImuUnits {
    let norm = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let count = samples.len().max(1) as f64;
    let forces = samples.iter().map(|s| norm(s.sample.specific_force_m_s2));
    let mean = forces.sum::<f64>() / count;
    let mut rates: Vec<f64> = samples
        .iter()
        .map(|s| norm(s.sample.angular_velocity_rad_s))
        .collect();
    rates.sort_by(f64::total_cmp);
    let rate = rates.get((rates.len() as f64 * RATE_QUANTILE) as usize);
    if let Some(rate) = rate.filter(|rate| **rate > MAX_RATE_RAD_S) {
        return ImuUnits::Wrong {
            problem: format!(
                "it would rotate at {rate:.0} rad/s: is its gyroscope in degrees per second?"
            ),
        };
    }
    if NEAR_GRAVITY.contains(&(mean / STANDARD_GRAVITY_M_S2)) {
        ImuUnits::Right
    } else if NEAR_GRAVITY.contains(&mean) {
        for sample in samples {
            sample.sample.specific_force_m_s2 = sample
                .sample
                .specific_force_m_s2
                .map(|c| c * STANDARD_GRAVITY_M_S2);
        }
        ImuUnits::Gravities
    } else {
        ImuUnits::Wrong {
            problem: format!(
                "its accelerometer measures {mean:.2} on average, where gravity is 9.81 m/s² (or 1 in units of g): was gravity subtracted?"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::Timestamp;

    use super::*;

    fn samples(force: f64, rate: f64) -> Vec<Stamped<ImuSample>> {
        let sample = |i: i64| Stamped {
            time: Timestamp::from_nanos(i * 5_000_000),
            arrival: Timestamp::from_nanos(i * 5_000_000),
            device_ticks: 0,
            sample: ImuSample {
                angular_velocity_rad_s: [0.0, rate, 0.0],
                specific_force_m_s2: [0.0, 0.6 * force, -0.8 * force],
            },
        };
        (0..100).map(sample).collect()
    }

    #[test]
    fn gravities_become_metres_per_second_squared() {
        let mut in_gravities = samples(1.01, 1.0);
        assert_eq!(mend_units(&mut in_gravities), ImuUnits::Gravities);
        let force = in_gravities[0].sample.specific_force_m_s2;
        assert!((force[2] + 0.8 * 1.01 * STANDARD_GRAVITY_M_S2).abs() < 1e-9);
        let mut right = samples(10.3, 3.0);
        assert_eq!(mend_units(&mut right), ImuUnits::Right);
        assert_eq!(right, samples(10.3, 3.0));
    }

    #[test]
    fn what_no_imu_measures_is_named() {
        for (force, rate, words) in [
            (0.1, 0.1, "was gravity subtracted?"),
            (981.0, 0.1, "measures 981"),
            (f64::NAN, 0.1, "measures NaN"),
            (9.8, 57.0, "degrees per second"),
        ] {
            let ImuUnits::Wrong { problem } = mend_units(&mut samples(force, rate)) else {
                panic!("{force} {rate} were taken for right")
            };
            assert!(problem.contains(words), "{problem}");
        }
    }
}
