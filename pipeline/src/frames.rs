//! The images of a walk in groups of one instant, their features, and the IMU.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use lsfb_geometry::Rig;
use lsfb_recording::Recording;
use lsfb_types::{Image, ImuSample, Progress, ProgressFn, Stamped, Timestamp};
use rayon::prelude::*;

use crate::Error;
use crate::features::{FeatureDetector, Features, FrameFeatures};
use crate::kept_stages::KeptStages;

/// Features of all images of one instant, in the order of the rig's cameras; an image that is missing has none.
pub(crate) struct FeatureFrame {
    pub time: Timestamp,
    pub features: Vec<FrameFeatures>,
}

impl FeatureFrame {
    /// Features of all its images.
    pub fn feature_count(&self) -> u64 {
        self.features.iter().map(|f| f.features.len() as u64).sum()
    }
}

/// What was read, and what could not be.
pub(crate) struct ReadFrames {
    pub frames: Vec<FeatureFrame>,
    /// Damaged messages.
    pub damaged: u64,
    /// Images with the stamp of an earlier one of their camera: the first was taken.
    pub repeated_stamps: u64,
}

/// Images of one trigger carry one time; this much apart is another.
pub(crate) const SAME_INSTANT_NS: i64 = 2_000_000;

/// The first of some times, those at least so much later than the one before, and the last.
pub(crate) fn times_apart(times: &[Timestamp], secs: f64) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for (k, time) in times.iter().enumerate() {
        let is_due = chosen
            .last()
            .is_none_or(|last| time.secs_since(times[*last]) >= secs || k + 1 == times.len());
        if is_due {
            chosen.push(k);
        }
    }
    chosen
}

/// Images decoded at a time: enough for all threads, little enough to hold.
const BATCH: usize = 32;

/// Finds the features of all images of the rig's cameras; what is found is kept batch by batch.
pub(crate) fn read_frames(
    recording: &Recording,
    rig: &Rig,
    detector: &FeatureDetector,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<ReadFrames, Error> {
    let cameras: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    let total: u64 = recording
        .topics()
        .iter()
        .filter(|t| t.topic.ends_with("/image"))
        .map(|t| t.messages)
        .sum();
    let mut found: BTreeMap<(Timestamp, usize), Features> = BTreeMap::new();
    let (mut damaged, mut repeated_stamps, mut batches) = (0, 0, 0);
    let mut batch: Vec<(Timestamp, usize, Image)> = Vec::with_capacity(BATCH);
    let mut flush = |batch: &mut Vec<(Timestamp, usize, Image)>| -> Result<(), Error> {
        let features: Vec<Features> = stages.once(&format!("features_{batches:05}"), || {
            let detected = batch.par_iter().map_init(
                || detector.clone(),
                |detector, (_, _, image)| detector.detect(image),
            );
            Ok(detected.collect())
        })?;
        batches += 1;
        for ((time, camera, _), features) in batch.drain(..).zip(features) {
            match found.entry((time, camera)) {
                Entry::Vacant(free) => {
                    free.insert(features);
                }
                Entry::Occupied(_) => repeated_stamps += 1,
            }
        }
        progress(Progress {
            stage: "image features",
            done: found.len() as u64,
            total,
        })?;
        Ok(())
    };
    for item in recording.images_of(&cameras)? {
        match item {
            Ok(item) => {
                check_size(recording, rig, cameras[item.camera], &item.image.sample)?;
                batch.push((item.image.time, item.camera, item.image.sample));
            }
            Err(_) => damaged += 1,
        }
        if batch.len() == BATCH {
            flush(&mut batch)?;
        }
    }
    flush(&mut batch)?;

    let mut frames: Vec<FeatureFrame> = Vec::new();
    for ((time, camera), features) in found {
        let begins = frames
            .last()
            .is_none_or(|frame| time - frame.time > SAME_INSTANT_NS);
        if begins {
            frames.push(FeatureFrame {
                time,
                features: empty(&cameras),
            });
        }
        if let Some(frame) = frames.last_mut() {
            frame.features[camera].features = features;
        }
    }
    Ok(ReadFrames {
        frames,
        damaged,
        repeated_stamps,
    })
}

/// Refuses images of another size than the rig says: its intrinsics are not theirs.
pub(crate) fn check_size(
    recording: &Recording,
    rig: &Rig,
    camera: &str,
    image: &Image,
) -> Result<(), Error> {
    let found_px = [image.width, image.height];
    let expected_px = rig
        .cameras
        .get(camera)
        .map_or(found_px, |m| [m.camera.width, m.camera.height]);
    if found_px == expected_px {
        return Ok(());
    }
    Err(Error::ImageSize {
        path: recording.path().to_owned(),
        camera: camera.to_owned(),
        expected_px,
        found_px,
    })
}

fn empty(cameras: &[&str]) -> Vec<FrameFeatures> {
    cameras
        .iter()
        .map(|camera| FrameFeatures {
            camera: (*camera).to_owned(),
            features: Features::default(),
        })
        .collect()
}

/// [`read_imu`], or nothing where the recording has no IMU.
pub(crate) fn read_imu_if_any(
    recording: &Recording,
) -> Result<(Vec<Stamped<ImuSample>>, u64), Error> {
    match read_imu(recording) {
        Err(Error::Recording(lsfb_recording::Error::NoSuchTopic { .. })) => Ok((Vec::new(), 0)),
        read => read,
    }
}

/// Inertial samples in order of time, each instant once, and the number of messages that could not be read, or have the stamp of another.
pub(crate) fn read_imu(recording: &Recording) -> Result<(Vec<Stamped<ImuSample>>, u64), Error> {
    let (mut samples, mut damaged) = (Vec::new(), 0);
    for sample in recording.imu()? {
        match sample {
            Ok(sample) => samples.push(sample),
            Err(_) => damaged += 1,
        }
    }
    samples.sort_by_key(|sample| sample.time);
    // A message that came twice is no loss; another measurement with its stamp is one, as nobody knows when it was made.
    samples.dedup_by(|b, a| b.time == a.time && b.sample == a.sample);
    let told = samples.len();
    samples.dedup_by_key(|sample| sample.time);
    damaged += (told - samples.len()) as u64;
    Ok((samples, damaged))
}
