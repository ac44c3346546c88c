//! What is kept of a camera's images: corners followed from one to the next, and the images nearest to scans.

use lsfb_geometry::RigCamera;
use lsfb_perception::image::{Frame, Pair};
use lsfb_recording::Recording;
use lsfb_types::{Image, Progress, ProgressFn, Stamped};
use rayon::prelude::*;

use super::VerifyConfig;
use super::scans::ScanInRig;
use crate::Error;
use crate::recorded::{expect_size, seconds, unreadable};

/// Images read before they are looked at together.
const AT_ONCE: usize = 32;
/// Images that are compared are at least this far apart, a tenth of a second at most rates: there noise of corners is below the
/// gyroscope's, and corners are still found; and at most so far.
const APART_S: f64 = 0.09;
const MOST_APART_S: f64 = 0.35;
/// Images that are looked at come from so many parts of the recording, as far from each other as can be: clocks drift, and mounts are knocked, on the way.
pub(super) const PARTS: usize = 5;
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

/// What is kept of a camera's images.
pub(super) struct CameraImages {
    pub pairs: Vec<Pair>,
    /// By scan.
    pub near_scan: Vec<Option<NearScan>>,
}

impl CameraImages {
    pub fn read(
        recording: &Recording,
        (name, mounted): (&str, &RigCamera),
        scans: &[ScanInRig],
        config: &VerifyConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let offset_s = mounted.timing.rig_from_camera_s;
        let mut near_scan: Vec<Option<NearScan>> = vec![None; scans.len()];
        let mut pairs = Pairs::default();
        let mut batch: Vec<Stamped<Image>> = Vec::with_capacity(AT_ONCE);
        let (mut looked, mut last_s) = (0, None::<f64>);
        let spread = Spread::over(recording, config.max_frames);
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
            let due = last_s.is_none_or(|last| time_s - last > APART_S);
            if due && looked < spread.allowed(time_s) {
                batch.push(image);
                last_s = Some(time_s);
                looked += 1;
            }
            if batch.len() == AT_ONCE {
                pairs.add(recording, mounted, &mut batch);
                progress(Progress {
                    stage: "images",
                    done: looked as u64,
                    total: config.max_frames as u64,
                })?;
            }
        }
        pairs.add(recording, mounted, &mut batch);
        Ok(Self {
            pairs: pairs.found,
            near_scan,
        })
    }
}

/// Which images are looked at: as many in each part of a recording, in a row from where the part begins.
struct Spread {
    /// From where a part begins to where the next one does, seconds.
    step_s: f64,
    most: usize,
}

impl Spread {
    fn over(recording: &Recording, most: usize) -> Self {
        let range = recording.arrival_range();
        let lasts_s = range.map_or(0.0, |range| range.end.secs_since(range.start));
        // Ten images a second, as they are chosen.
        let part_s = 0.1 * (most / PARTS) as f64;
        Self {
            step_s: ((lasts_s - part_s) / (PARTS - 1) as f64).max(0.0),
            most,
        }
    }

    /// Images that may have been looked at once so much of the recording has passed.
    fn allowed(&self, time_s: f64) -> usize {
        let begun = 1
            + (1..PARTS)
                .filter(|k| time_s >= self.step_s * *k as f64)
                .count();
        begun * self.most / PARTS
    }
}

/// Pairs so far, and the last image, at which the next one begins.
#[derive(Default)]
struct Pairs {
    found: Vec<Pair>,
    last: Option<Frame>,
}

impl Pairs {
    /// Looks at a batch of images and empties it.
    fn add(&mut self, recording: &Recording, mounted: &RigCamera, batch: &mut Vec<Stamped<Image>>) {
        let offset_s = mounted.timing.rig_from_camera_s;
        let made = batch.par_iter().map(|i| {
            let time_s = seconds(i.time.nanos(), recording) + offset_s;
            Frame::new(time_s, &i.sample, &mounted.camera)
        });
        let made: Vec<Frame> = made.collect();
        batch.clear();
        let frames: Vec<Frame> = self.last.take().into_iter().chain(made).collect();
        let pairs: Vec<Option<Pair>> = frames
            .par_windows(2)
            .filter(|w| w[1].time_s > w[0].time_s && w[1].time_s - w[0].time_s < MOST_APART_S)
            .map(|w| Pair::new(&w[0], &w[1]))
            .collect();
        self.found.extend(pairs.into_iter().flatten());
        self.last = frames.into_iter().next_back();
    }
}
