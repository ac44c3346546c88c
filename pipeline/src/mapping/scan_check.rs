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
use super::scan_offsets::{Beside, HeldScan, ScanOffsets};
use super::scan_pairs::REVISIT_GAP;
use super::scan_source::{ScanSource, TakenScan};
use crate::Error;

/// Scans that are looked at are so far apart, seconds.
const EVERY_S: f64 = 0.25;
/// A scan takes up to so long: one that is this much outside a keyframe's window has no part in it, seconds.
const SCAN_S: f64 = 0.1;
/// Which of the keyframes before a scan, and of those behind it, it is held against: the next few, and some far ahead, as a map may be bent by
/// little everywhere.
const NEXT: [usize; 3] = [0, 1, 2];
const FAR: [usize; 2] = [5, 9];
/// And so many of other visits, the nearest.
const REVISITS: usize = 2;
/// Scans at once: bounds the memory.
const BATCH: usize = 32;

/// Looks at the scans of a recording at the poses of its map; `None` where it has none.
pub(super) fn offsets_of_scans(
    source: ScanSource<'_>,
    total: u64,
    lidar: &RigLidar,
    keyframes: &mut [Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Option<ScanOffsets>, Error> {
    let (first, held) = hold_scans(
        source, total, lidar, keyframes, trajectory, config, progress,
    )?;
    Ok(first.map(|first| ScanOffsets::of(first, &held)))
}

/// When the first scan is, and each scan beside the keyframes that it is held against, in order of time.
fn hold_scans(
    source: ScanSource<'_>,
    total: u64,
    lidar: &RigLidar,
    keyframes: &mut [Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<(Option<Timestamp>, Vec<HeldScan>), Error> {
    add_lidar_features(source, lidar, keyframes, trajectory, config, progress)?;
    let keyframes = &*keyframes;
    let hold = |scan: &TakenScan<'_>| hold_scan(scan, lidar, keyframes, trajectory, config);
    let (mut first, mut last) = (None, None);
    let mut waiting = Vec::new();
    let mut held: Vec<HeldScan> = Vec::new();
    let mut look = |waiting: &mut Vec<TakenScan<'_>>, done: u64| {
        held.par_extend(waiting.par_iter().flat_map_iter(hold));
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
    Ok((first, held))
}

/// A scan beside all keyframes that it is held against.
fn hold_scan(
    scan: &TakenScan<'_>,
    lidar: &RigLidar,
    keyframes: &[Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
) -> Vec<HeldScan> {
    let Some(scan) = scan.at_one_instant(lidar, trajectory, config) else {
        return Vec::new();
    };
    let strangers_s = config.scan_window_secs + SCAN_S;
    let before = keyframes.partition_point(|k| scan.time.secs_since(k.time) > strangers_s);
    let behind = keyframes.partition_point(|k| k.time.secs_since(scan.time) <= strangers_s);
    let pose_in = |k: &Keyframe| k.world_from_rig.inverse() * scan.world_from_rig;
    let own = keyframes.get(before..behind).unwrap_or_default();
    let own = own.iter().filter_map(|k| {
        let features = k.lidar.as_ref()?;
        Some(features.share_on_surfaces(&scan.features, &pose_in(k)))
    });
    let expected = own.fold(0.0, f64::max);
    let mut others: Vec<(Beside, usize)> = Vec::new();
    let next = NEXT.map(|place| (Beside::Next, place));
    let far = FAR.map(|place| (Beside::Far(place), place));
    for (beside, place) in next.into_iter().chain(far) {
        let after = Some(behind + place).filter(|k| *k < keyframes.len());
        let both = [before.checked_sub(1 + place), after];
        others.extend(both.into_iter().flatten().map(|k| (beside, k)));
    }
    let here = scan.world_from_rig.translation;
    let visits = keyframes
        .iter()
        .enumerate()
        .filter(|(k, _)| k + REVISIT_GAP < before || *k > behind + REVISIT_GAP);
    let mut visits: Vec<(f64, usize)> = visits
        .map(|(k, keyframe)| ((keyframe.world_from_rig.translation - here).norm(), k))
        .filter(|(distance_m, _)| *distance_m < config.revisit_distance_m)
        .collect();
    visits.sort_by(|a, b| a.0.total_cmp(&b.0));
    others.extend(
        visits
            .iter()
            .take(REVISITS)
            .map(|(_, k)| (Beside::Revisit, *k)),
    );
    let held = others.into_iter().filter_map(|(beside, k)| {
        let keyframe = &keyframes[k];
        let features = keyframe.lidar.as_ref()?;
        // Far away much of it lies on no surface though it is right, and elsewhere another stair fits as well.
        let searched = match beside {
            Beside::Next => expected,
            Beside::Far(_) | Beside::Revisit => 0.0,
        };
        Some(HeldScan {
            scan: scan.time,
            keyframe: keyframe.time,
            beside,
            expected,
            offset: features.offset_of(&scan.features, &pose_in(keyframe), searched),
        })
    });
    let mut held: Vec<HeldScan> = held.collect();
    let next = held.iter().filter(|h| h.beside == Beside::Next);
    let shared = next.filter_map(|h| Some(h.offset?.on_surfaces));
    let expected = shared.fold(expected, f64::max);
    held.iter_mut().for_each(|h| h.expected = expected);
    held
}
