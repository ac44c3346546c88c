//! Whether the scans lie where the trajectory of a map has them, by the surfaces that other scans saw.
//!
//! Eq. (4) places keyframes. What was seen between them, before the first and behind the last has the motion of the start, and marks and images there have
//! its errors. So scans along the whole walk are put at their poses and held against the surfaces of keyframes near by that they had no part in: how far a
//! scan would have to be moved to fit is what the map is off by there.

use lsfb_geometry::{RigLidar, Trajectory};
use lsfb_types::{Progress, ProgressFn, Timestamp};
use rayon::prelude::*;

use super::MappingConfig;
use super::keyframe_scans::add_lidar_features;
use super::keyframes::Keyframe;
use super::scan_offsets::ScanOffsets;
use super::scan_source::{ScanSource, TakenScan};
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

/// Looks at the scans of a recording at the poses of its map; `None` where none can be held against anything.
pub(super) fn offsets_of_scans(
    source: ScanSource<'_>,
    total: u64,
    lidar: &RigLidar,
    keyframes: &mut [Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Option<ScanOffsets>, Error> {
    add_lidar_features(source, lidar, keyframes, trajectory, config, progress)?;
    let keyframes = &*keyframes;
    let off = |scan: &TakenScan<'_>| {
        let offset = offset_of(scan, lidar, keyframes, trajectory, config)?;
        Some((scan.time(), offset))
    };
    let (mut first, mut last) = (None, None);
    let mut waiting = Vec::new();
    let mut offsets: Vec<(Timestamp, ScanOffset)> = Vec::new();
    let mut look = |waiting: &mut Vec<TakenScan<'_>>, done: u64| {
        offsets.par_extend(waiting.par_iter().filter_map(off));
        waiting.clear();
        progress(Progress {
            stage: "scans in the map",
            done,
            total,
        })
    };
    // Damaged ones are told by the stages before.
    for (done, scan) in (0..).zip(source.scans()?.flatten()) {
        first.get_or_insert(scan.time());
        if last.is_some_and(|last| scan.time().secs_since(last) < EVERY_S) {
            continue;
        }
        last = Some(scan.time());
        waiting.push(scan);
        if waiting.len() >= BATCH {
            look(&mut waiting, done)?;
        }
    }
    look(&mut waiting, total)?;
    Ok(first.and_then(|first| ScanOffsets::of(first, &offsets)))
}

/// The less of what two keyframes near by say: what one alone sees otherwise has moved.
fn offset_of(
    scan: &TakenScan<'_>,
    lidar: &RigLidar,
    keyframes: &[Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
) -> Option<ScanOffset> {
    let scan = scan.at_one_instant(lidar, trajectory, config)?;
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
