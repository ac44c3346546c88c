//! What is said of how scans lie in a map.

use lsfb_perception::statistics::median;
use lsfb_types::{Finding, Limit, Timestamp, Verdict};
use serde::{Deserialize, Serialize};

use crate::lidar_features::ScanOffset;

/// One scan may be of a crowd: of so many in a row the middle counts.
const IN_A_ROW: usize = 3;

/// What a map of some centimetres bears, metres, and what it does not.
const LIMITS_M: [f64; 2] = [0.02, 0.05];

/// How far scans lie off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanOffsets {
    /// Scans that were looked at and share enough with keyframes that they have no part in.
    pub scans: u64,
    /// How far their points would have to be moved, in the middle of all scans, metres.
    pub median_m: f64,
    /// The same of the worst part of the walk, metres.
    pub worst_m: f64,
    /// When that is, seconds after the first scan.
    pub worst_after_secs: f64,
    /// By how much it is turned there, degrees.
    pub turn_deg: f64,
    /// By how much it is shifted there, metres.
    pub shift_m: f64,
}

impl ScanOffsets {
    /// Of scans, by when they are and when the first of all is; `None` without any.
    pub(super) fn of(first: Timestamp, offsets: &[(Timestamp, ScanOffset)]) -> Option<Self> {
        let in_a_row = IN_A_ROW.min(offsets.len()).max(1);
        let middles = offsets.windows(in_a_row).filter_map(|row| {
            let mut row: Vec<&(Timestamp, ScanOffset)> = row.iter().collect();
            row.sort_by(|a, b| a.1.moved_m.total_cmp(&b.1.moved_m));
            row.get(row.len() / 2).copied()
        });
        let (time, worst) = middles.max_by(|a, b| a.1.moved_m.total_cmp(&b.1.moved_m))?;
        Some(Self {
            scans: offsets.len() as u64,
            median_m: median(offsets.iter().map(|(_, o)| o.moved_m).collect())?,
            worst_m: worst.moved_m,
            worst_after_secs: time.secs_since(first),
            turn_deg: worst.correction.rotation.angle().to_degrees(),
            shift_m: worst.correction.translation.norm(),
        })
    }

    /// As every command and page says it.
    pub fn finding(&self) -> Finding {
        let [warn, fail] = LIMITS_M;
        let verdict = match self.worst_m {
            worst if worst > fail => Verdict::Fail,
            worst if worst > warn => Verdict::Warn,
            _ => Verdict::Pass,
        };
        let what = format!(
            "{:.1} s after the first scan, scans lie {:.1} cm from where surfaces of other keyframes have them (turned by {:.2}°, shifted by {:.1} cm; {:.1} cm in the middle of {} scans)",
            self.worst_after_secs,
            1e2 * self.worst_m,
            self.turn_deg,
            1e2 * self.shift_m,
            1e2 * self.median_m,
            self.scans
        );
        Finding::new("scans-off", verdict, "trajectory", what)
            .value(1e2 * self.worst_m, "cm")
            .limit(Limit::AtMost(1e2 * warn))
            .remedy("the map or its trajectory is bent there: start from a better trajectory, give images without pauses, and walk that part again")
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Se3, Vector3};

    use super::*;

    fn walk(off_m: impl Fn(i64) -> f64) -> ScanOffsets {
        let offset = |k: i64| {
            let shift_m = off_m(k);
            let offset = ScanOffset {
                correction: Se3::new(Default::default(), Vector3::x() * shift_m),
                moved_m: shift_m,
            };
            (Timestamp::from_nanos(k * 250_000_000), offset)
        };
        let offsets: Vec<_> = (0..40).map(offset).collect();
        ScanOffsets::of(Timestamp::from_nanos(0), &offsets).expect("scans")
    }

    #[test]
    fn a_part_of_a_walk_that_is_off_is_named_and_one_scan_is_not() {
        let right = walk(|_| 0.002);
        assert_eq!(right.finding().verdict, Verdict::Pass);
        let one = walk(|k| if k == 20 { 0.3 } else { 0.002 });
        assert_eq!(one, right);
        let end = walk(|k| if k > 36 { 0.03 } else { 0.002 });
        assert_eq!(end.finding().verdict, Verdict::Warn);
        assert!(end.worst_after_secs > 9.0 && end.median_m == 0.002);
        let bent = walk(|k| 0.002 * k as f64);
        let finding = bent.finding();
        assert_eq!(finding.verdict, Verdict::Fail);
        assert!(finding.sentence().contains("7.6 cm"), "{finding:?}");
        assert_eq!(ScanOffsets::of(Timestamp::from_nanos(0), &[]), None);
    }
}
