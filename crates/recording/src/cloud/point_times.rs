//! Times of the points of a cloud, from a field of any usual name, unit and beginning.

use lsfb_types::Timestamp;

/// Where the times of a cloud's points come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PointTimes {
    /// The cloud has no field of times.
    Absent,
    /// From this field.
    Field {
        /// As the cloud calls it.
        name: String,
        /// When the offsets of the points are zero.
        begins: TimesBegin,
    },
    /// There is such a field, but in no unit are its numbers times within one scan.
    Unusable {
        /// As the cloud calls it.
        name: String,
    },
}

/// Which instant the times of a cloud's points count from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimesBegin {
    /// So many nanoseconds after the stamp of the cloud: negative where the stamp is that of the last point.
    AfterStamp {
        /// Nanoseconds.
        nanos: i64,
    },
    /// At this reading of a clock, whatever it counts from: 1970, a week's begin, the sensor's own start.
    At(Timestamp),
}

impl PointTimes {
    /// When the offsets of the points are zero, in a cloud with this stamp. A clock's reading agrees with the stamp to a scan, or is
    /// that of another clock than the stamp's: then the stamp holds.
    pub fn begins(&self, stamp: Timestamp) -> Timestamp {
        match self {
            Self::Field { begins, .. } => match begins {
                TimesBegin::AfterStamp { nanos } => stamp.plus_nanos(*nanos),
                TimesBegin::At(time) if is_same_clock(*time, stamp) => *time,
                TimesBegin::At(_) => stamp,
            },
            Self::Absent | Self::Unusable { .. } => stamp,
        }
    }

    /// Whether the points have times of another clock than the stamp.
    pub fn has_two_clocks(&self, stamp: Timestamp) -> bool {
        matches!(self, Self::Field { begins: TimesBegin::At(time), .. } if !is_same_clock(*time, stamp))
    }
}

impl TimesBegin {
    /// The instant, where it is a time since 1970.
    pub fn since_1970(&self) -> Option<Timestamp> {
        match self {
            Self::At(time) if *time > EPOCH => Some(*time),
            Self::At(_) | Self::AfterStamp { .. } => None,
        }
    }
}

fn is_same_clock(time: Timestamp, stamp: Timestamp) -> bool {
    time.secs_since(stamp).abs() < SAME_CLOCK_S
}

/// Names of fields of times in lower case without `_`: Ouster, Velodyne, Hesai, RoboSense and Livox drivers, and their conversions.
const NAMES: [&str; 12] = [
    "t",
    "time",
    "times",
    "timestamp",
    "timestamps",
    "stamp",
    "offsettime",
    "timeoffset",
    "pointtime",
    "reltime",
    "dt",
    "gpstime",
];
/// Units of times, seconds.
const UNITS_S: [f64; 4] = [1.0, 1e-3, 1e-6, 1e-9];
/// Shortest and longest time that the points of one scan may take, seconds.
const SPAN_S: [f64; 2] = [0.004, 1.5];
/// Farther than this from zero no scan begins after its stamp, seconds: it is the reading of a clock. The longest scan; one whose stamp
/// is that of its last point begins so much before it.
const FARTHEST_OFFSET_S: f64 = SPAN_S[1];
/// A scan and the way of its message to the recorder take less, seconds.
const SAME_CLOCK_S: f64 = 2.0;
/// No clock counts so far, seconds: the year 2255.
const LATEST_S: f64 = 9e9;
/// Later than this a clock counts from 1970 (three years later), and neither from a week's begin nor from a start.
const EPOCH: Timestamp = Timestamp::from_nanos(100_000_000_000_000_000);

/// Whether a field's name is that of times.
pub(super) fn is_time(name: &str) -> bool {
    let plain: String = name.chars().filter(|c| *c != '_').collect();
    let plain = plain.to_lowercase();
    // CloudCompare writes `scalar_` before the names of fields that it does not know.
    let plain = plain.strip_prefix("scalar").unwrap_or(&plain);
    NAMES.contains(&plain)
}

/// Nanoseconds after the earliest point for each value, and where they come from; none where no unit makes them times of one scan.
/// A thousand lies between units, less between the shortest and the longest scan: one unit fits at most, whatever the kind of number.
pub(super) fn point_times(
    name: &str,
    values: &[f64],
    is_return: impl Fn(usize) -> bool,
) -> (Vec<u32>, PointTimes) {
    let name = name.to_owned();
    // Rows without a return hold zeros, which are no times.
    let returns = || (0..).zip(values).filter(|(k, _)| is_return(*k));
    let first = returns().map(|(_, v)| *v).fold(f64::INFINITY, f64::min);
    let last = returns().map(|(_, v)| *v).fold(f64::NEG_INFINITY, f64::max);
    let fits = |unit_s: &&f64| {
        (SPAN_S[0]..=SPAN_S[1]).contains(&((last - first) * **unit_s))
            && (first * **unit_s).abs() < LATEST_S
    };
    let all_known = returns().all(|(_, v)| v.is_finite());
    let Some(unit_s) = UNITS_S.iter().find(fits).filter(|_| all_known) else {
        return (Vec::new(), PointTimes::Unusable { name });
    };
    let offsets_ns = values
        .iter()
        .map(|v| ((v.clamp(first, last) - first) * unit_s * 1e9).round() as u32)
        .collect();
    let begins_s = first * unit_s;
    let begins = if begins_s.abs() > FARTHEST_OFFSET_S {
        TimesBegin::At(Timestamp::from_secs_f64(begins_s))
    } else {
        TimesBegin::AfterStamp {
            nanos: (begins_s * 1e9).round() as i64,
        }
    };
    (offsets_ns, PointTimes::Field { name, begins })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_time_of_a_scan_is_not_used() {
        for values in [
            &[0.0, 0.0, 0.0][..],
            &[3.0, 3.0],
            &[0.0, f64::NAN, 0.1],
            &[],
            &[0.0, 1e15],
            &[1e15, 1e15 + 0.125],
        ] {
            let (offsets, times) = point_times("t", values, |_| true);
            let name = "t".to_owned();
            assert_eq!((offsets.len(), times), (0, PointTimes::Unusable { name }));
        }
    }

    #[test]
    fn units_and_epochs_are_told_apart() {
        let of = |values: &[f64]| point_times("time", values, |_| true);
        for unit_s in UNITS_S {
            for (first_s, nanos) in [(0.0, 0), (-0.1, -100_000_000)] {
                let values = [0.05, 0.0, 0.1].map(|s| (s + first_s) / unit_s);
                let (offsets, times) = of(&values);
                assert_eq!(offsets, [50_000_000, 0, 100_000_000], "{unit_s}");
                let name = "time".to_owned();
                let begins = TimesBegin::AfterStamp { nanos };
                assert_eq!(times, PointTimes::Field { name, begins });
            }
        }
        let (_, times) = of(&[1.7e18, 1.7e18 + 1e8]);
        let begins = TimesBegin::At(Timestamp::from_nanos(1_700_000_000_000_000_000));
        let name = "time".to_owned();
        assert_eq!(times, PointTimes::Field { name, begins });
        assert!(is_time("Offset_Time") && is_time("timestamp") && !is_time("intensity"));
    }

    /// Naively 302 400 s after a week's begin, or 100 s after a start, were added to the stamp, which is of the same clock.
    #[test]
    fn readings_of_a_clock_are_no_offsets() {
        let s = Timestamp::from_secs_f64;
        for (first_s, stamp_s, begins_s, two_clocks) in [
            (302_400.0, 302_400.1, 302_400.0, false),
            (100.0, 100.1, 100.0, false),
            (302_400.0, 1.7e9, 1.7e9, true),
            (100.0, 1.7e9, 1.7e9, true),
            (-100.0, 1.7e9, 1.7e9, true),
            (-0.1, 1.7e9, 1.7e9 - 0.1, false),
            (0.07, 100.0, 100.07, false),
        ] {
            for unit_s in UNITS_S {
                let values = [0.0, 0.1].map(|t| (first_s + t) / unit_s);
                let (offsets, times) = point_times("timestamp", &values, |_| true);
                assert!(offsets[0] == 0 && offsets[1].abs_diff(100_000_000) < 300);
                let late_s = times.begins(s(stamp_s)).secs_since(s(begins_s));
                assert!(late_s.abs() < 1e-6, "{first_s} at {stamp_s}: {late_s}");
                assert_eq!(times.has_two_clocks(s(stamp_s)), two_clocks, "{first_s}");
            }
        }
    }

    /// Naively the zeros of rows without a return stretched the scan over fifty years, and no unit fitted.
    #[test]
    fn rows_without_a_return_have_no_time() {
        let values = [0.0, 1.7e9, 1.7e9 + 0.1];
        let (offsets, _) = point_times("timestamp", &values, |k| k > 0);
        assert_eq!(offsets.len(), 3);
        assert!(offsets[0] == 0 && offsets[2].abs_diff(100_000_000) < 300);
    }
}
