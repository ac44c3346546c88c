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

/// By which clock images are put together that are of one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ImageClock {
    /// The stamps as they are: who reads them knows what the rig adds to those of each camera.
    Stamps,
    /// The rig's: what it adds to a camera's stamps is added.
    Rig,
}

/// What the rig adds to the stamps of each of some cameras, nanoseconds.
pub(crate) fn clock_offsets_ns(rig: &Rig, cameras: &[&str]) -> Vec<i64> {
    let of = |name: &&str| {
        let camera = rig.cameras.get(*name);
        let offset_s = camera.map_or(0.0, |camera| camera.timing.rig_from_camera_s);
        (offset_s * 1e9).round() as i64
    };
    cameras.iter().map(of).collect()
}

/// The images of each of some instants of a walk, with the names of their cameras: of instants at `times`, ascending by the rig's clock,
/// those that are `chosen`. Damaged images are left out.
pub fn images_of_instants(
    recording: &Recording,
    rig: &Rig,
    times: &[Timestamp],
    chosen: &[usize],
) -> Result<Vec<Vec<(String, Image)>>, Error> {
    let cameras: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    let offsets_ns = clock_offsets_ns(rig, &cameras);
    let mut found: Vec<BTreeMap<usize, (Timestamp, Image)>> = vec![BTreeMap::new(); chosen.len()];
    for item in recording.images_of(&cameras)?.flatten() {
        let time = item.image.time.plus_nanos(offsets_ns[item.camera]);
        let Some(instant) = times.partition_point(|t| *t <= time).checked_sub(1) else {
            continue;
        };
        let is_of_it = time - times[instant] <= SAME_INSTANT_NS;
        let place = chosen.iter().position(|k| *k == instant);
        let Some(images) = place.filter(|_| is_of_it).and_then(|k| found.get_mut(k)) else {
            continue;
        };
        // As frames are read: the first of one stamp, the last of one instant.
        let there = images.get(&item.camera);
        if there.is_none_or(|(before, _)| *before < time) {
            images.insert(item.camera, (time, item.image.sample));
        }
    }
    let named = found.into_iter().map(|images| {
        let images = images.into_iter();
        images
            .map(|(camera, (_, image))| (cameras[camera].to_owned(), image))
            .collect()
    });
    Ok(named.collect())
}

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
    clock: ImageClock,
    detector: &FeatureDetector,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<ReadFrames, Error> {
    let cameras: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    let offsets_ns = match clock {
        ImageClock::Stamps => vec![0; cameras.len()],
        ImageClock::Rig => clock_offsets_ns(rig, &cameras),
    };
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
                let time = item.image.time.plus_nanos(offsets_ns[item.camera]);
                batch.push((time, item.camera, item.image.sample));
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

/// What was read of an IMU.
#[derive(Default)]
pub(crate) struct ReadImu {
    /// In order of time, each instant once.
    pub samples: Vec<Stamped<ImuSample>>,
    /// Messages that could not be read, or have the stamp of another measurement: nobody knows when these were made.
    pub damaged: u64,
    /// Messages that came once more: no loss, but something recorded them twice.
    pub repeated: u64,
}

/// [`read_imu`], or nothing where the recording has no IMU.
pub(crate) fn read_imu_if_any(recording: &Recording) -> Result<ReadImu, Error> {
    match read_imu(recording) {
        Err(Error::Recording(lsfb_recording::Error::NoSuchTopic { .. })) => Ok(ReadImu::default()),
        read => read,
    }
}

/// Reads all inertial samples.
pub(crate) fn read_imu(recording: &Recording) -> Result<ReadImu, Error> {
    let (mut samples, mut damaged) = (Vec::new(), 0);
    for sample in recording.imu()? {
        match sample {
            Ok(sample) => samples.push(sample),
            Err(_) => damaged += 1,
        }
    }
    samples.sort_by_key(|sample| sample.time);
    let read = samples.len();
    samples.dedup_by(|b, a| b.time == a.time && b.sample == a.sample);
    let told = samples.len();
    samples.dedup_by_key(|sample| sample.time);
    damaged += (told - samples.len()) as u64;
    Ok(ReadImu {
        samples,
        damaged,
        repeated: (read - told) as u64,
    })
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, CameraTiming, RigCamera, Se3};
    use lsfb_recording::{Writer, WriterConfig};
    use lsfb_types::no_progress;

    use super::*;
    use crate::features::SiftConfig;

    /// What the rig adds to the stamps of its second camera.
    const LATE_NS: i64 = 20_000_000;

    fn rig() -> Rig {
        let mut rig = Rig::empty("two");
        for (name, rig_from_camera_s) in [("cam0", 0.0), ("cam1", 1e-9 * LATE_NS as f64)] {
            let mounted = RigCamera {
                camera: Camera::pinhole(32, 32, [30.0; 2], [15.5; 2]),
                rig_from_camera: Se3::identity(),
                timing: CameraTiming {
                    rig_from_camera_s,
                    readout_s: 0.0,
                },
                sigmas: Default::default(),
            };
            rig.cameras.insert(name.to_owned(), mounted);
        }
        rig
    }

    /// Naively images of one stamp were one instant, and those of one instant two, where a rig's cameras have clocks apart.
    #[test]
    fn images_are_put_together_by_the_clock_of_the_rig() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("walk.mcap");
        let mut writer = Writer::create(&path, &WriterConfig::default()).expect("a file");
        let rig = rig();
        writer.attach_rig(&rig).expect("a rig");
        let at = |n: i64| Timestamp::from_nanos(1_700_000_000_000_000_000 + n * LATE_NS / 2);
        // Stamps in halves of what the clocks are apart: of the rig's instants 0, 2, 4 and 6 both cameras have the middle ones.
        for (stamp, camera, frame_id) in [
            (0, "cam0", 0),
            (0, "cam1", 2),
            (2, "cam0", 2),
            (2, "cam1", 4),
            (4, "cam0", 4),
            (4, "cam1", 6),
        ] {
            let image = Image {
                width: 32,
                height: 32,
                pixels: vec![frame_id as u8; 32 * 32],
                exposure_ns: 0,
                frame_id,
            };
            let stamped = Stamped {
                time: at(stamp),
                arrival: at(stamp),
                device_ticks: 0,
                sample: image,
            };
            writer.write_image(camera, &stamped).expect("an image");
        }
        writer.finish().expect("a file");
        let recording = Recording::open(&path).expect("a recording");
        let detector = FeatureDetector::sift(&SiftConfig::default()).expect("SIFT");
        let times = |clock| -> Vec<i64> {
            let stages = KeptStages::none();
            let read = read_frames(&recording, &rig, clock, &detector, &stages, &no_progress);
            let frames = read.expect("frames").frames;
            let begin = at(0);
            frames
                .iter()
                .map(|f| (f.time - begin) * 2 / LATE_NS)
                .collect()
        };
        assert_eq!(times(ImageClock::Stamps), [0, 2, 4]);
        assert_eq!(times(ImageClock::Rig), [0, 2, 4, 6]);

        let instants = [0, 2, 4, 6].map(at);
        let shown = images_of_instants(&recording, &rig, &instants, &[3, 1, 0]).expect("images");
        let shown: Vec<Vec<(&str, u8)>> = shown
            .iter()
            .map(|images| {
                let images = images.iter();
                images
                    .map(|(name, i)| (name.as_str(), i.pixels[0]))
                    .collect()
            })
            .collect();
        assert_eq!(shown[0], [("cam1", 6)]);
        assert_eq!(shown[1], [("cam0", 2), ("cam1", 2)]);
        assert_eq!(shown[2], [("cam0", 0)]);
    }
}
