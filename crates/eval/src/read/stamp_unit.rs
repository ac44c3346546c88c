//! In which unit a file gives its stamps.

use lsfb_geometry::{StampedPose, path_length_m};
use lsfb_types::{StampUnit, median};

/// Poses come faster than the one and slower than the other wherever stamps are what they seem.
const RATES_HZ: std::ops::RangeInclusive<f64> = 0.5..=5000.0;
/// Poses so far apart are none of one walk, if these are seconds.
const ABSURD_STEP_SECS: f64 = 1000.0;
/// Poses so far apart may be those of keyframes, or milliseconds.
const DOUBTFUL_STEP_SECS: f64 = 10.0;
/// Poses so far apart in seconds come slower than any device's but keyframes' and those of a survey, or are milliseconds at 2 kHz and below.
const SLOW_STEP_SECS: f64 = 0.5;
/// A body that moves is at least so fast, m/s, and one that is carried, rides or flies at most.
const SPEEDS_M_S: std::ops::RangeInclusive<f64> = 0.1..=10.0;
/// Slower than this it rests, m/s.
const RESTING_M_S: f64 = 0.02;

/// What stamps are judged by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StampSize {
    /// Largest magnitude.
    pub largest: f64,
    /// Median of the steps that are not zero; zero where there is none.
    pub step: f64,
}

impl StampSize {
    pub(super) fn of(stamps: &[f64]) -> Self {
        let mut steps: Vec<f64> = stamps.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        steps.retain(|step| *step > 0.0 && step.is_finite());
        Self {
            largest: stamps.iter().fold(0.0, |most, s| most.max(s.abs())),
            step: median(steps).unwrap_or(0.0),
        }
    }

    /// The unit that follows: stamps since 1970 tell it by their size, others by how often poses come. `Err` with the units
    /// that are possible where that is not one.
    pub(super) fn unit(self) -> Result<StampUnit, Vec<StampUnit>> {
        match self.largest {
            size if size >= 1e17 => Ok(StampUnit::Nanoseconds),
            size if size >= 1e14 => Ok(StampUnit::Microseconds),
            size if size >= 1e11 => Ok(StampUnit::Milliseconds),
            _ if self.step < ABSURD_STEP_SECS => Ok(StampUnit::Seconds),
            _ => {
                let possible =
                    |unit: &StampUnit| RATES_HZ.contains(&(1.0 / (self.step * unit.secs())));
                let units: Vec<StampUnit> = StampUnit::ALL.into_iter().filter(possible).collect();
                match units.as_slice() {
                    [unit] => Ok(*unit),
                    _ => Err(units),
                }
            }
        }
    }

    /// Median time between poses where that is doubtful in this unit.
    pub(super) fn doubtful_step_secs(self, unit: StampUnit) -> Option<f64> {
        let step_secs = self.step * unit.secs();
        let is_fine = step_secs == 0.0 || (1e-5..DOUBTFUL_STEP_SECS).contains(&step_secs);
        (!is_fine).then_some(step_secs)
    }
}

/// Speed in milliseconds, m/s, of a path whose stamps were read as seconds, where in seconds it is slower than a body that moves, and in
/// milliseconds it is not: poses every 5 ms come every five seconds then, as those of keyframes do.
pub(super) fn speed_in_milliseconds_m_s(poses: &[StampedPose]) -> Option<f64> {
    let secs: Vec<f64> = poses
        .windows(2)
        .map(|w| w[1].time.secs_since(w[0].time))
        .collect();
    let speed_m_s = path_length_m(poses) / secs.iter().sum::<f64>();
    let faster_m_s = 1000.0 * speed_m_s;
    let is_slow = median(secs).is_some_and(|step| step >= SLOW_STEP_SECS);
    (is_slow && speed_m_s < RESTING_M_S && SPEEDS_M_S.contains(&faster_m_s)).then_some(faster_m_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(first: f64, step: f64) -> Result<StampUnit, Vec<StampUnit>> {
        let stamps: Vec<f64> = (0..50).map(|i| first + step * f64::from(i)).collect();
        StampSize::of(&stamps).unit()
    }

    #[test]
    fn stamps_since_1970_tell_by_their_size() {
        use StampUnit::*;
        for (scale, expected) in [
            (1.0, Seconds),
            (1e3, Milliseconds),
            (1e6, Microseconds),
            (1e9, Nanoseconds),
        ] {
            assert_eq!(unit(1.403_636_579e9 * scale, 0.05 * scale), Ok(expected));
        }
    }

    #[test]
    fn stamps_since_a_start_tell_by_their_steps() {
        use StampUnit::*;
        for rate_hz in [1.0, 10.0, 20.0, 200.0] {
            assert_eq!(unit(0.0, 1.0 / rate_hz), Ok(Seconds));
        }
        assert_eq!(unit(3e9, 5e7), Ok(Nanoseconds));
        assert_eq!(unit(0.0, 5e4), Ok(Microseconds));
        // A million is a millisecond or a second: nobody can tell.
        assert_eq!(unit(0.0, 1e6), Err(vec![Microseconds, Nanoseconds]));
        assert_eq!(unit(0.0, 1000.0), Err(vec![Milliseconds, Microseconds]));
    }

    #[test]
    fn what_may_be_milliseconds_is_doubted() {
        let size = StampSize::of(&[0.0, 33.0, 67.0, 100.0]);
        assert_eq!(size.unit(), Ok(StampUnit::Seconds));
        assert_eq!(size.doubtful_step_secs(StampUnit::Seconds), Some(33.0));
        assert_eq!(size.doubtful_step_secs(StampUnit::Milliseconds), None);
        assert_eq!(StampSize::of(&[]).unit(), Ok(StampUnit::Seconds));
    }
}
