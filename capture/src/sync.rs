//! Camera groups: images of one trigger, from units that know nothing of each other.

use std::collections::BTreeMap;

use lsfb_types::Timestamp;
use serde::Serialize;

/// Images of one trigger lie this close; far below half a period at 20 Hz (protocol notes on the four-camera rig).
const TOLERANCE_NS: i64 = 2_000_000;
/// Groups that wait for their last image, at most: minutes, since the links of two units may run far apart.
const OPEN_GROUPS: usize = 4096;

/// How the images of the cameras fit together.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct GroupReport {
    /// Triggers of which every camera delivered its image.
    pub complete: u64,
    /// Triggers of which an image is missing. The others are recorded all the same.
    pub incomplete: u64,
    /// Images missing in incomplete groups, by camera.
    pub missing_by_camera: BTreeMap<String, u64>,
}

/// Matches images by synchronized time, never by order of arrival.
#[derive(Debug)]
pub(crate) struct Groups {
    cameras: Vec<String>,
    open: BTreeMap<Timestamp, Vec<bool>>,
    report: GroupReport,
}

impl Groups {
    pub(crate) fn new(cameras: Vec<String>) -> Self {
        Self {
            cameras,
            open: BTreeMap::new(),
            report: GroupReport::default(),
        }
    }

    /// Notes an image. Cameras that belong to no group are passed over.
    pub(crate) fn note(&mut self, camera: &str, time: Timestamp) {
        let Some(index) = self.cameras.iter().position(|c| c == camera) else {
            return;
        };
        let window = time.plus_nanos(-TOLERANCE_NS)..=time.plus_nanos(TOLERANCE_NS);
        let near = self
            .open
            .range(window)
            .min_by_key(|(t, _)| (**t - time).abs())
            .map(|(t, _)| *t);
        let key = near.unwrap_or(time);
        let seen = self
            .open
            .entry(key)
            .or_insert_with(|| vec![false; self.cameras.len()]);
        if let Some(flag) = seen.get_mut(index) {
            *flag = true;
        }
        if seen.iter().all(|&s| s) {
            self.open.remove(&key);
            self.report.complete += 1;
        } else if self.open.len() > OPEN_GROUPS
            && let Some((_, seen)) = self.open.pop_first()
        {
            self.judge(&seen);
        }
    }

    /// Judges what is still open.
    pub(crate) fn finish(mut self) -> GroupReport {
        for seen in std::mem::take(&mut self.open).into_values() {
            self.judge(&seen);
        }
        self.report
    }

    fn judge(&mut self, seen: &[bool]) {
        if seen.iter().all(|&s| s) {
            self.report.complete += 1;
            return;
        }
        self.report.incomplete += 1;
        for (camera, _) in self.cameras.iter().zip(seen).filter(|(_, seen)| !**seen) {
            *self
                .report
                .missing_by_camera
                .entry(camera.clone())
                .or_default() += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_unit_completes_its_group_and_a_silent_one_is_named() {
        let mut groups = Groups::new(vec!["cam0".into(), "cam2".into()]);
        let at = |ms: i64| Timestamp::from_nanos(ms * 1_000_000);
        for trigger in 0..20 {
            groups.note("cam0", at(trigger * 100));
            // The second unit is three triggers late, one millisecond off, and misses trigger 5.
            if trigger >= 3 && trigger != 8 {
                groups.note("cam2", at((trigger - 3) * 100 + 1));
            }
        }
        let report = groups.finish();
        assert_eq!((report.complete, report.incomplete), (16, 4));
        assert_eq!(
            report.missing_by_camera,
            BTreeMap::from([("cam2".to_owned(), 4)])
        );
    }

    #[test]
    fn units_whose_links_run_far_apart_still_meet() {
        let mut groups = Groups::new(vec!["cam0".into(), "cam2".into()]);
        for camera in ["cam0", "cam2"] {
            for trigger in 0..3_000 {
                groups.note(camera, Timestamp::from_nanos(trigger * 100_000_000));
            }
        }
        let report = groups.finish();
        assert_eq!((report.complete, report.incomplete), (3_000, 0));
    }
}
