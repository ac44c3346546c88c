//! Times of the points of a cloud, from a field of any usual name, unit and beginning.

use lsfb_types::Timestamp;

/// Where the times of a cloud's points come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PointTimes {
    /// The file has no field of times.
    Absent,
    /// From this field.
    Field {
        /// As the file calls it.
        name: String,
        /// When the first point was measured, where the field counts from an epoch.
        first: Option<Timestamp>,
    },
    /// There is such a field, but in no unit are its numbers times within one scan.
    Unusable {
        /// As the file calls it.
        name: String,
    },
}

/// What a field holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Numbers {
    Real,
    Whole,
}

/// Names of fields of times in lower case without `_`: Ouster, Velodyne and Hesai drivers, Livox, and their conversions.
const NAMES: [&str; 8] = [
    "t",
    "time",
    "times",
    "timestamp",
    "stamp",
    "offsettime",
    "timeoffset",
    "pointtime",
];
/// Shortest and longest time that the points of one scan may take, seconds.
const SPAN_S: [f64; 2] = [0.004, 1.5];
/// Later than this after its beginning, a clock counts from an epoch, seconds.
const EPOCH_S: f64 = 1e8;

/// Whether a field's name is that of times.
pub(crate) fn is_time(name: &str) -> bool {
    let plain: String = name.chars().filter(|c| *c != '_').collect();
    NAMES.contains(&plain.to_lowercase().as_str())
}

/// Nanoseconds after the earliest point for each value, and where they come from; none where no unit makes them times of one scan.
/// Whole numbers are read as nanoseconds before larger units, others as seconds before smaller ones: a thousand lies between
/// units, less between the shortest and the longest scan.
pub(crate) fn point_times(name: &str, numbers: Numbers, values: &[f64]) -> (Vec<u32>, PointTimes) {
    let units_s = match numbers {
        Numbers::Whole => [1e-9, 1e-6, 1e-3, 1.0],
        Numbers::Real => [1.0, 1e-3, 1e-6, 1e-9],
    };
    let name = name.to_owned();
    let first = values.iter().copied().fold(f64::INFINITY, f64::min);
    let last = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let fits = |unit_s: &&f64| (SPAN_S[0]..=SPAN_S[1]).contains(&((last - first) * **unit_s));
    let all_known = values.iter().all(|v| v.is_finite());
    let Some(unit_s) = units_s.iter().find(fits).filter(|_| all_known) else {
        return (Vec::new(), PointTimes::Unusable { name });
    };
    let offsets_ns = values.iter().map(|v| ((v - first) * unit_s * 1e9).round());
    let since_epoch_s = first * unit_s;
    let first = (since_epoch_s > EPOCH_S).then(|| Timestamp::from_secs_f64(since_epoch_s));
    (
        offsets_ns.map(|ns| ns as u32).collect(),
        PointTimes::Field { name, first },
    )
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
        ] {
            let (offsets, times) = point_times("t", Numbers::Real, values);
            let name = "t".to_owned();
            assert_eq!((offsets.len(), times), (0, PointTimes::Unusable { name }));
        }
    }

    #[test]
    fn units_and_epochs_are_told_apart() {
        let of = |numbers, values: &[f64]| point_times("time", numbers, values);
        for (numbers, unit_s) in [
            (Numbers::Real, 1.0),
            (Numbers::Real, 1e-3),
            (Numbers::Real, 1e-9),
            (Numbers::Whole, 1e-9),
            (Numbers::Whole, 1e-6),
        ] {
            let (offsets, times) = of(numbers, &[0.05 / unit_s, 0.0, 0.1 / unit_s]);
            assert_eq!(offsets, [50_000_000, 0, 100_000_000], "{unit_s}");
            assert!(matches!(times, PointTimes::Field { first: None, .. }));
        }
        let (_, times) = of(Numbers::Whole, &[1.7e18, 1.7e18 + 1e8]);
        let first = Some(Timestamp::from_nanos(1_700_000_000_000_000_000));
        let name = "time".to_owned();
        assert_eq!(times, PointTimes::Field { name, first });
        assert!(is_time("Offset_Time") && is_time("timestamp") && !is_time("intensity"));
    }
}
