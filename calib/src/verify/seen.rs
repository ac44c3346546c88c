//! What is kept of a camera's images: how it turned from one to the next, and the images nearest to scans.

use lsfb_geometry::{Rig, RigCamera};
use lsfb_recording::Recording;
use lsfb_types::{Image, Progress, ProgressFn, Stamped};
use rayon::prelude::*;

use super::frame::Frame;
use super::scans::ScanInRig;
use super::time_offset::{Turn, turn};
use super::{VerifyConfig, seconds, unreadable};
use crate::Error;

/// Images read before they are looked at together.
const AT_ONCE: usize = 32;
/// Images that are compared are about this far apart, seconds: long enough for the turning to stand out of the noise of
/// corners, short enough for it to be one motion; and at most so far.
const APART_S: f64 = 0.15;
const MOST_APART_S: f64 = 0.35;
/// An image of a scan's time is at most this far from its middle, seconds.
const BESIDE_S: f64 = 0.06;

/// An image of a scan's time.
#[derive(Clone)]
pub(super) struct NearScan {
    /// In the rig's time.
    pub time_s: f64,
    pub time_ns: i64,
    pub image: Image,
}

pub(super) struct Seen {
    pub turns: Vec<Turn>,
    /// By scan.
    pub near_scan: Vec<Option<NearScan>>,
}

/// The rig's cameras that a recording has, by name.
pub(super) fn present<'a>(recording: &Recording, rig: &'a Rig) -> Vec<(&'a str, &'a RigCamera)> {
    rig.cameras
        .iter()
        .filter(|(name, _)| recording.images(name).is_ok())
        .map(|(name, camera)| (name.as_str(), camera))
        .collect()
}

impl Seen {
    pub fn read(
        recording: &Recording,
        (name, mounted): (&str, &RigCamera),
        scans: &[ScanInRig],
        config: &VerifyConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let offset_s = mounted.timing.rig_from_camera_s;
        let mut near_scan: Vec<Option<NearScan>> = vec![None; scans.len()];
        let mut turns = Turns::default();
        let mut batch: Vec<Stamped<Image>> = Vec::with_capacity(AT_ONCE);
        let mut looked = 0;
        for image in recording.images(name).map_err(unreadable(recording))? {
            let image = image.map_err(unreadable(recording))?;
            expect_size(recording, name, mounted, &image.sample)?;
            let time_s = seconds(image.time.nanos(), recording) + offset_s;
            for (scan, near) in scans.iter().zip(&mut near_scan) {
                let off = (time_s - scan.middle_s).abs();
                let nearer = near
                    .as_ref()
                    .is_none_or(|n| off < (n.time_s - scan.middle_s).abs());
                if off < BESIDE_S && nearer {
                    *near = Some(NearScan {
                        time_s,
                        time_ns: image.time.nanos(),
                        image: image.sample.clone(),
                    });
                }
            }
            if looked < config.max_frames {
                batch.push(image);
                looked += 1;
            }
            if batch.len() == AT_ONCE {
                turns.add(recording, mounted, &mut batch);
                progress(Progress {
                    stage: "images",
                    done: looked as u64,
                    total: config.max_frames as u64,
                });
            }
        }
        turns.add(recording, mounted, &mut batch);
        Ok(Self {
            turns: turns.found,
            near_scan,
        })
    }
}

fn expect_size(
    recording: &Recording,
    name: &str,
    mounted: &RigCamera,
    image: &Image,
) -> Result<(), Error> {
    let size = (image.width, image.height);
    if size == (mounted.camera.width, mounted.camera.height) {
        return Ok(());
    }
    Err(Error::Parse {
        path: recording.path().display().to_string(),
        problem: format!(
            "camera {name}: images of {} × {} pixels, the rig's lens is for {} × {}",
            size.0, size.1, mounted.camera.width, mounted.camera.height
        ),
    })
}

/// Turns so far, and the last images, at which the next ones begin.
#[derive(Default)]
struct Turns {
    found: Vec<Turn>,
    last: Vec<Frame>,
    /// How many images farther on the other one of a pair is; unknown at first.
    apart: Option<usize>,
}

impl Turns {
    /// Looks at a batch of images and empties it.
    fn add(&mut self, recording: &Recording, mounted: &RigCamera, batch: &mut Vec<Stamped<Image>>) {
        let offset_s = mounted.timing.rig_from_camera_s;
        let made = batch.par_iter().map(|i| {
            let time_s = seconds(i.time.nanos(), recording) + offset_s;
            Frame::new(time_s, &i.sample, &mounted.camera)
        });
        let mut frames = std::mem::take(&mut self.last);
        frames.extend(made.collect::<Vec<Frame>>());
        batch.clear();
        let apart = *self.apart.get_or_insert_with(|| apart(&frames));
        let turns: Vec<Option<Turn>> = frames
            .par_windows(apart + 1)
            .map(|w| turn(&w[0], &w[apart]).filter(|t| t.to_s - t.from_s < MOST_APART_S))
            .collect();
        self.found.extend(turns.into_iter().flatten());
        self.last = frames.split_off(frames.len().saturating_sub(apart));
    }
}

/// How many images make up the time that those of a pair are apart.
fn apart(frames: &[Frame]) -> usize {
    let mut gaps: Vec<f64> = frames
        .windows(2)
        .map(|w| w[1].time_s - w[0].time_s)
        .collect();
    gaps.sort_by(f64::total_cmp);
    let usual = gaps.get(gaps.len() / 2).copied().unwrap_or(APART_S);
    ((APART_S / usual.max(1e-3)).round() as usize).clamp(1, 30)
}
