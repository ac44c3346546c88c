//! Device ticks to [`Timestamp`]: nothing else in the workspace does this.
//!
//! Disciplined devices (PPS and NMEA, external time, UTC) name the second themselves, so that their time does not depend on
//! when bytes arrived. For the others [`OneWayClock`] fits the device's counter to host time from below: delays are never
//! negative, so only the lower envelope of arrivals tells the clock (Zhang, Liu, Xia, "Clock synchronization algorithms
//! for network measurements", INFOCOM 2002).

mod envelope;
mod judgement;
mod lidar;
pub(crate) mod model_topic;
mod one_way;
mod recorded;

use lsfb_types::Timestamp;

pub use lidar::{LidarClock, PositionFix};
pub use one_way::{ClockEstimate, ClockStep, OneWayClock, StampPair, fit_pairs};
pub use recorded::{
    ClockConfig, ClockEpoch, ClockReport, DeviceClock, Exchange, ExchangedClock, ExchangedTime,
    ResidualSample, StampOrder, estimate_clocks,
};

const HOUR_NS: i64 = 3_600_000_000_000;

/// The absolute time nearest to `reference` whose time past the hour is `toh_ns`. Real sensors send values slightly above
/// an hour (ros-drivers/velodyne issue 218); they wrap.
pub fn nearest_hour(toh_ns: i64, reference: Timestamp) -> Timestamp {
    let phase = (toh_ns - reference.nanos()).rem_euclid(HOUR_NS);
    let ahead = if phase > HOUR_NS / 2 {
        phase - HOUR_NS
    } else {
        phase
    };
    reference.plus_nanos(ahead)
}

/// Continues a counter beyond its wrap.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unwrap {
    last: Option<i64>,
}

impl Unwrap {
    /// The continued value of `value`, which wraps at `period`; small steps backward stay steps backward.
    pub fn unwrap(&mut self, value: i64, period: i64) -> i64 {
        let Some(last) = self.last else {
            self.last = Some(value);
            return value;
        };
        let step = value.saturating_sub(last).rem_euclid(period.max(1));
        let step = if step > period / 2 {
            step - period
        } else {
            step
        };
        let continued = last.saturating_add(step);
        self.last = Some(continued);
        continued
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_past_the_hour_takes_the_hour_of_its_reference() {
        let noon = Timestamp::from_nanos(1_772_366_400_000_000_000);
        assert_eq!(nearest_hour(5, noon), noon.plus_nanos(5));
        assert_eq!(nearest_hour(HOUR_NS - 7, noon), noon.plus_nanos(-7));
        assert_eq!(
            nearest_hour(HOUR_NS + 60_000_000, noon),
            noon.plus_nanos(60_000_000)
        );
    }

    #[test]
    fn unwraps_in_both_directions() {
        let mut unwrap = Unwrap::default();
        let values = [98, 1, 99, 3, 40, 60].map(|v| unwrap.unwrap(v, 100));
        assert_eq!(values, [98, 101, 99, 103, 140, 160]);
    }
}
