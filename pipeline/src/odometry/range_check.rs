//! Whether the coordinates of clouds can be metres: most of what a LiDAR sees lies within its range.

use lsfb_perception::statistics::median;
use lsfb_types::LidarScan;
use serde::{Deserialize, Serialize};

use super::OdometryConfig;

/// Points of a scan that are looked at, at most.
const POINTS: usize = 500;
/// A scan of which a larger share lies outside is not in metres, or sees nothing.
const MOST_OUTSIDE: f64 = 0.9;
/// Scans so far beyond the farthest range are in a unit that is smaller, as a factor.
const FAR_BEYOND: f64 = 2.0;

/// Scans of which next to nothing lies within the ranges that are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeReport {
    /// How many.
    pub scans: u64,
    /// Of how many.
    pub of: u64,
    /// Their usual range: the median of theirs, metres if coordinates are metres.
    pub usual_m: f64,
}

/// Gathers it.
#[derive(Clone, Debug, Default)]
pub(super) struct RangeCheck {
    scans: u64,
    medians_m: Vec<f64>,
}

impl RangeCheck {
    /// Looks at a scan.
    pub fn take(&mut self, scan: &LidarScan, config: &OdometryConfig) {
        let every = scan.points.len().div_ceil(POINTS).max(1);
        let ranges_m = scan.points.iter().step_by(every).filter_map(|p| {
            let squared: f64 = p.position_m.iter().map(|c| f64::from(*c).powi(2)).sum();
            // Drivers write no return as zeros or NaN.
            (squared > 0.0 && squared.is_finite()).then(|| squared.sqrt())
        });
        let ranges_m: Vec<f64> = ranges_m.collect();
        if ranges_m.is_empty() {
            return;
        }
        self.scans += 1;
        let used = config.min_range_m..=config.max_range_m;
        let outside = ranges_m.iter().filter(|r| !used.contains(r)).count();
        if outside as f64 > MOST_OUTSIDE * ranges_m.len() as f64 {
            self.medians_m.extend(median(ranges_m));
        }
    }

    /// What came of it, where a scan is outside.
    pub fn finish(self) -> Option<RangeReport> {
        let scans = self.medians_m.len() as u64;
        Some(RangeReport {
            scans,
            of: self.scans,
            usual_m: median(self.medians_m)?,
        })
    }
}

impl RangeReport {
    /// As a sentence.
    pub(super) fn sentence(&self, config: &OdometryConfig) -> String {
        let Self { scans, of, usual_m } = self;
        let (low_m, high_m) = (config.min_range_m, config.max_range_m);
        let why = match () {
            () if *usual_m > 10.0 * FAR_BEYOND * high_m => {
                "are their coordinates in millimetres? They must be in metres"
            }
            () if *usual_m > FAR_BEYOND * high_m => {
                "are their coordinates in centimetres or millimetres? They must be in metres"
            }
            () if *usual_m > high_m => "use --outdoor outdoors, or set max_range_m",
            () if *usual_m < low_m => {
                "are their coordinates in kilometres, or is the sensor covered? They must be in metres"
            }
            () => "there are no points in that range",
        };
        format!(
            "{scans} of {of} scans have hardly any points between {low_m} and {high_m} m, where points are used; their typical range is {usual_m:.3} m: {why}"
        )
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::LidarPoint;

    use super::*;

    fn scan(range: f32) -> LidarScan {
        let point = |k: usize| LidarPoint {
            position_m: [range * (k as f32).cos(), range * (k as f32).sin(), 0.1],
            ..LidarPoint::default()
        };
        LidarScan {
            points: (0..2000).map(point).collect(),
        }
    }

    #[test]
    fn other_units_than_metres_are_named() {
        let config = OdometryConfig::default();
        for (range, words) in [
            (4000.0, "in millimetres"),
            (400.0, "centimetres"),
            (100.0, "--outdoor"),
            (0.004, "kilometres"),
        ] {
            let mut check = RangeCheck::default();
            check.take(&scan(5.0), &config);
            check.take(&scan(range), &config);
            let found = check.finish().expect("outside");
            assert_eq!((found.scans, found.of), (1, 2));
            let sentence = found.sentence(&config);
            assert!(sentence.contains(words), "{sentence}");
        }
        let mut check = RangeCheck::default();
        check.take(&scan(5.0), &config);
        assert_eq!(check.finish(), None);
    }
}
