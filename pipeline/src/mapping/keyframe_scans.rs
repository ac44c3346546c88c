//! The scans around each keyframe, joined into its LiDAR features.

use std::collections::VecDeque;

use lsfb_geometry::{RigLidar, Trajectory};
use lsfb_types::{Progress, ProgressFn, Stopped};
use rayon::prelude::*;

use super::MappingConfig;
use super::keyframes::Keyframe;
use super::scan_source::{MiddleScan, ScanSource, TakenScan};
use crate::Error;
use crate::lidar_features::{LidarFeatures, PlacedScan};
use crate::odometry::Damages;

/// Scans worked on at once: bounds the memory.
const BATCH: usize = 32;

/// Gives each keyframe the features of the scans around it.
pub(super) fn add_lidar_features(
    source: ScanSource<'_>,
    lidar: &RigLidar,
    keyframes: &mut [Keyframe],
    trajectory: &Trajectory,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<(), Error> {
    // The odometry has read the same scans, and named those that cannot be read.
    let mut damages = Damages::default();
    let mut window = ScanWindow {
        lidar,
        trajectory,
        config,
        scans: VecDeque::new(),
        next_keyframe: 0,
    };
    let mut waiting = Vec::new();
    for scan in source.scans()? {
        waiting.extend(damages.keep(scan));
        if waiting.len() >= BATCH {
            window.extract(&mut waiting);
            window.join_ready(keyframes, progress)?;
        }
    }
    window.extract(&mut waiting);
    window.join_ready(keyframes, progress)?;
    window.join_until(keyframes, keyframes.len(), progress)?;
    Ok(())
}

/// The scans that keyframes still to come may need.
struct ScanWindow<'a> {
    lidar: &'a RigLidar,
    trajectory: &'a Trajectory,
    config: &'a MappingConfig,
    scans: VecDeque<MiddleScan>,
    next_keyframe: usize,
}

impl ScanWindow<'_> {
    fn reach_ns(&self) -> i64 {
        (self.config.scan_window_secs * 1e9) as i64
    }

    fn extract(&mut self, waiting: &mut Vec<TakenScan<'_>>) {
        let scans: Vec<Option<MiddleScan>> = waiting
            .par_iter()
            .map(|scan| scan.at_one_instant(self.lidar, self.trajectory, self.config))
            .collect();
        self.scans.extend(scans.into_iter().flatten());
        waiting.clear();
    }

    /// Joins the keyframes whose scans have all come.
    fn join_ready(
        &mut self,
        keyframes: &mut [Keyframe],
        progress: ProgressFn<'_>,
    ) -> Result<(), Stopped> {
        let Some(newest) = self.scans.back().map(|s| s.time) else {
            return Ok(());
        };
        let complete = newest.plus_nanos(-self.reach_ns());
        let end = keyframes.partition_point(|k| k.time < complete);
        self.join_until(keyframes, end, progress)
    }

    fn join_until(
        &mut self,
        keyframes: &mut [Keyframe],
        end: usize,
        progress: ProgressFn<'_>,
    ) -> Result<(), Stopped> {
        let total = keyframes.len() as u64;
        let Some(ready) = keyframes.get_mut(self.next_keyframe..end) else {
            return Ok(());
        };
        ready.par_iter_mut().for_each(|k| k.lidar = self.join(k));
        self.next_keyframe = end;
        let oldest = keyframes
            .get(end)
            .map(|k| k.time.plus_nanos(-self.reach_ns()));
        while let (Some(scan), Some(oldest)) = (self.scans.front(), oldest)
            && scan.time < oldest
        {
            self.scans.pop_front();
        }
        progress(Progress {
            stage: "lidar features",
            done: end as u64,
            total,
        })
    }

    /// `None` where no scan is near.
    fn join(&self, keyframe: &Keyframe) -> Option<LidarFeatures> {
        let keyframe_from_world = keyframe.world_from_rig.inverse();
        let placed: Vec<PlacedScan> = self
            .scans
            .iter()
            .filter(|s| (s.time - keyframe.time).abs() <= self.reach_ns())
            .map(|s| PlacedScan {
                keyframe_from_scan: keyframe_from_world * s.world_from_rig,
                scan: &s.features,
            })
            .collect();
        (!placed.is_empty()).then(|| {
            let noise_m = self.lidar.range_noise_m;
            LidarFeatures::join(&placed, noise_m, &self.config.lidar_features)
        })
    }
}
