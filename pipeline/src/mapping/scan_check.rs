//! Whether the scans lie where the trajectory of a map has them, by the surfaces that other scans saw.
//!
//! Eq. (4) places keyframes. What was seen between them, before the first and behind the last has the motion of the start, and marks and images there have
//! its errors. So scans along the whole walk are put at their poses and held against the surfaces of keyframes near by that they had no part in: how far a
//! scan would have to be moved to fit is what the map is off by there.

use lsfb_geometry::{RigLidar, Trajectory};
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_types::{Finding, LidarScan, Limit, Progress, ProgressFn, Stamped, Timestamp, Verdict};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::MappingConfig;
use super::keyframe_scans::{add_lidar_features, deskewed};
use super::keyframes::Keyframe;
use crate::Error;
use crate::lidar_features::ScanOffset;

/// Scans that are looked at are so far apart, seconds.
const EVERY_S: f64 = 0.25;
/// A scan takes up to so long: one that is this much outside a keyframe's window has no part in it, seconds.
const SCAN_S: f64 = 0.1;
/// Keyframes that a scan is held against, of so many nearest.
const HELD_AGAINST: usize = 2;
const NEAREST: usize = 5;
/// Scans at once: bounds the memory.
const BATCH: usize = 32;
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

/// Looks at the scans of a recording at the poses of its map; `None` where none can be held against anything.
pub(super) fn scan_offsets(
    recording: &Recording,
    lidar: &RigLidar,
    keyframes: &mut [Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Option<ScanOffsets>, Error> {
    add_lidar_features(recording, lidar, keyframes, trajectory, config, progress)?;
    let keyframes = &*keyframes;
    let off = |scan: &Stamped<LidarScan>| {
        let offset = offset_of(scan, lidar, keyframes, trajectory, config)?;
        Some((scan.time, offset))
    };
    let (mut first, mut last, mut done) = (None, None, 0);
    let mut waiting = Vec::new();
    let mut offsets: Vec<(Timestamp, ScanOffset)> = Vec::new();
    let mut look = |waiting: &mut Vec<Stamped<LidarScan>>| {
        done += waiting.len() as u64;
        offsets.par_extend(waiting.par_iter().filter_map(off));
        waiting.clear();
        progress(Progress {
            stage: "scans in the map",
            done,
            total: done,
        })
    };
    // Damaged ones are told by the stages before.
    for scan in recording.scans()?.flatten() {
        first.get_or_insert(scan.time);
        if last.is_some_and(|last| scan.time.secs_since(last) < EVERY_S) {
            continue;
        }
        last = Some(scan.time);
        waiting.push(scan);
        if waiting.len() >= BATCH {
            look(&mut waiting)?;
        }
    }
    look(&mut waiting)?;
    Ok(first.and_then(|first| summary(first, &offsets)))
}

/// The less of what two keyframes near by say: what one alone sees otherwise has moved.
fn offset_of(
    scan: &Stamped<LidarScan>,
    lidar: &RigLidar,
    keyframes: &[Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
) -> Option<ScanOffset> {
    let scan = deskewed(scan, lidar, trajectory, config)?;
    let strangers_s = config.scan_window_secs + SCAN_S;
    let mut near: Vec<(f64, &Keyframe)> = keyframes
        .iter()
        .filter(|k| k.time.secs_since(scan.time).abs() > strangers_s)
        .map(|k| {
            let off = k.world_from_rig.translation - scan.world_from_rig.translation;
            (off.norm(), k)
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let found = near.iter().take(NEAREST).filter_map(|(_, k)| {
        let keyframe_from_scan = k.world_from_rig.inverse() * scan.world_from_rig;
        let features = k.lidar.as_ref()?;
        features.offset_of(&scan.features, &keyframe_from_scan)
    });
    found
        .take(HELD_AGAINST)
        .min_by(|a, b| a.moved_m.total_cmp(&b.moved_m))
}

fn summary(first: Timestamp, offsets: &[(Timestamp, ScanOffset)]) -> Option<ScanOffsets> {
    let in_a_row = IN_A_ROW.min(offsets.len()).max(1);
    let middles = offsets.windows(in_a_row).filter_map(|row| {
        let mut row: Vec<&(Timestamp, ScanOffset)> = row.iter().collect();
        row.sort_by(|a, b| a.1.moved_m.total_cmp(&b.1.moved_m));
        row.get(row.len() / 2).copied()
    });
    let (time, worst) = middles.max_by(|a, b| a.1.moved_m.total_cmp(&b.1.moved_m))?;
    Some(ScanOffsets {
        scans: offsets.len() as u64,
        median_m: median(offsets.iter().map(|(_, o)| o.moved_m).collect())?,
        worst_m: worst.moved_m,
        worst_after_secs: time.secs_since(first),
        turn_deg: worst.correction.rotation.angle().to_degrees(),
        shift_m: worst.correction.translation.norm(),
    })
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
        summary(Timestamp::from_nanos(0), &offsets).expect("scans")
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
        assert_eq!(summary(Timestamp::from_nanos(0), &[]), None);
    }
}
