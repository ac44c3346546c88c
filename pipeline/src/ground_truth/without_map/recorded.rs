//! A recorded walk without a map: its images followed, its motion found, and what of it can be believed.

use lsfb_geometry::{Matrix6, Rig, Se3, StampedPose, Trajectory};
use lsfb_recording::Recording;
use lsfb_types::{Image, ImuSample, Progress, ProgressFn, Stamped, Timestamp};

use super::measured::{Measured, longest_measured};
use super::report::{LeftOut, MotionReport, Read, left_out};
use super::turns::check_turns;
use super::{
    FrontEnd, MotionConfig, Sight, TrackedFrame, TrackedWalk, WalkView, motion_without_map,
};
use crate::frames::{ReadImu, SAME_INSTANT_NS, check_size, read_imu};
use crate::ground_truth::frozen_images::has_turned;
use crate::ground_truth::frozen_samples;
use crate::ground_truth::report::GroundTruthWarning;
use crate::kept_stages::{KeptStages, keep_fields};
use crate::{Error, Refusal};

/// The motion of a recorded walk, where it can be believed.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedMotion {
    /// Pose of the rig at each frame that is not left out. The world is level; its origin is the first of them.
    pub trajectory: Trajectory,
    /// Covariance of each pose relative to the first, tangent `[rotation, translation]` on the right, rad² and m².
    pub covariances: Vec<Matrix6<f64>>,
    /// How it came about, and how far to trust it.
    pub report: MotionReport,
}

/// Where the device was relative to its first pose, by its images and its IMU alone. Of the recording's cameras those of `rig` are used.
///
/// [`Error::SensorMissing`] without cameras or IMU, [`Refusal::NoBeginning`] where nothing tells scale and gravity,
/// [`Refusal::TracksContradict`] where images and IMU do not agree, [`Refusal::NothingFollowed`] where no pose can be believed and
/// [`Refusal::UnknownCovariance`] where that is not known; [`Refusal::GyroContradicts`] where images turn another way than the gyroscope says,
/// [`Refusal::FrozenSensor`] where a sensor of the IMU repeats itself, and [`Refusal::ImuGap`] where pauses of the IMU leave no part of the walk that is long enough.
pub fn motion_of_recording(
    recording: &Recording,
    rig: &Rig,
    config: &MotionConfig,
    progress: ProgressFn<'_>,
) -> Result<RecordedMotion, Error> {
    motion_of_recording_in_stages(recording, rig, config, &KeptStages::none(), progress)
}

/// [`motion_of_recording`], going on behind what is kept of it: what was followed through the images.
pub fn motion_of_recording_in_stages(
    recording: &Recording,
    rig: &Rig,
    config: &MotionConfig,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<RecordedMotion, Error> {
    config.check_bounds("motion")?;
    let (walk, read) = follow(recording, rig, config, stages, progress)?;
    let frames = walk.frames.len();
    let first = walk.frames.first().map(|f| f.time);
    let Measured {
        walk,
        left_out: not_measured,
        pauses,
    } = longest_measured(walk, config)?;
    check_turns(&walk)?;
    let mut motion = motion_without_map(&walk, None, config, progress)?;
    for (camera, name) in motion.cameras.iter_mut().zip(rig.cameras.keys()) {
        camera.camera.clone_from(name);
    }
    let LeftOut { reasons, mut spans } = left_out(&walk, &motion, config);
    spans.extend(not_measured);
    spans.sort_by_key(|span| span.from_ns);
    let all = motion.trajectory.poses();
    let origin = all.get(motion.first).map(|p| p.world_from_rig.translation);
    let given = reasons.iter().zip(all.iter().zip(&motion.covariances));
    let given = given.filter(|(reason, _)| reason.is_none());
    let (poses, covariances): (Vec<StampedPose>, Vec<Matrix6<f64>>) = given
        .map(|(_, (pose, covariance))| {
            let Se3 {
                rotation,
                translation,
            } = pose.world_from_rig;
            let from_origin = translation - origin.unwrap_or_default();
            let moved = StampedPose {
                world_from_rig: Se3::new(rotation, from_origin),
                ..*pose
            };
            (moved, *covariance)
        })
        .unzip();
    if poses.is_empty() {
        return Err(Refusal::NothingFollowed {
            frames,
            min_sights: config.min_sights,
            limit_m: config.max_position_sigma_m,
        }
        .into());
    }
    let trajectory = Trajectory::new(poses);
    let mut report = MotionReport::new(
        &read,
        &walk,
        &motion,
        &trajectory,
        &covariances,
        spans,
        config,
    );
    report.frames = frames as u64;
    let pauses = pauses
        .iter()
        .map(|[from, to]| GroundTruthWarning::ImuPause {
            after_secs: first.map_or(0.0, |first| from.secs_since(first)),
            secs: to.secs_since(*from),
            longest_secs: config.max_imu_gap_secs,
        });
    report.warnings.extend(pauses);
    Ok(RecordedMotion {
        trajectory,
        covariances,
        report,
    })
}

/// Reads all images of the rig's cameras and follows what they show.
fn follow(
    recording: &Recording,
    rig: &Rig,
    config: &MotionConfig,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<(TrackedWalk, Read), Error> {
    let missing = |sensor| Error::SensorMissing {
        sensor,
        rig: rig.name.clone(),
    };
    let noise = rig.imu_noise().ok_or_else(|| missing("IMU"))?;
    let names: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    if names.is_empty() {
        return Err(missing("camera"));
    }
    let ReadImu {
        samples: mut imu,
        damaged: damaged_samples,
        repeated: repeated_samples,
    } = read_imu(recording)?;
    if imu.is_empty() {
        return Err(missing("IMU"));
    }
    let frozen_secs = frozen_samples::take_out(&mut imu)?;
    let mut read = Read {
        damaged_samples,
        repeated_samples,
        frozen_secs,
        ..Read::default()
    };
    let cameras: Vec<_> = rig.cameras.values().cloned().collect();
    let noise = noise.clone();
    let (frames, views, read) = stages.once("followed", || {
        let (cameras, imu) = (cameras.clone(), imu.clone());
        let front_end = FrontEnd::new(cameras, imu, noise.clone(), config.frame_secs);
        let mut front_end = front_end.keeping_views(&config.revisits)?;
        follow_images(recording, rig, &names, &mut front_end, &mut read, progress)?;
        let walk = front_end.finish();
        Ok((walk.frames, walk.views, read))
    })?;
    let walk = TrackedWalk {
        cameras,
        frames,
        imu,
        noise,
        views,
    };
    Ok((walk, read))
}

keep_fields! {
    Sight { track, camera, pixel }
    TrackedFrame { time, sights }
    WalkView { frame, camera, features }
    Read { images, damaged_images, damaged_samples, repeated_samples, repeated_stamps, frozen_images, frozen_secs }
}

/// Pushes the images of each instant into the front end.
fn follow_images(
    recording: &Recording,
    rig: &Rig,
    names: &[&str],
    front_end: &mut FrontEnd,
    read: &mut Read,
    progress: ProgressFn<'_>,
) -> Result<(), Error> {
    let total = total_images(recording, names);
    let mut last: Vec<Option<(Timestamp, Image)>> = vec![None; names.len()];
    let mut instant: Option<Instant> = None;
    for item in recording.images_of(names)? {
        let Ok(item) = item else {
            read.damaged_images += 1;
            continue;
        };
        let (camera, time, image) = (item.camera, item.image.time, item.image.sample);
        check_size(recording, rig, names[camera], &image)?;
        read.images += 1;
        progress(Progress {
            stage: "tracking features",
            done: read.images,
            total,
        })?;
        // The time of one that stands behind a later one cannot be right.
        if instant
            .as_ref()
            .is_some_and(|now| now.time - time > SAME_INSTANT_NS)
        {
            read.damaged_images += 1;
            continue;
        }
        // An image that is left out still is an instant at which nothing is seen.
        let shown = match is_frozen(last[camera].as_ref(), time, &image, front_end.imu()) {
            true => {
                read.frozen_images += 1;
                None
            }
            false => {
                last[camera] = Some((time, image.clone()));
                Some(image)
            }
        };
        if let Some(now) = &mut instant
            && time - now.time <= SAME_INSTANT_NS
        {
            match &mut now.images[camera] {
                Some(_) => read.repeated_stamps += 1,
                free => *free = shown,
            }
            continue;
        }
        let mut next = Instant {
            time,
            images: vec![None; names.len()],
        };
        next.images[camera] = shown;
        if let Some(done) = instant.replace(next) {
            done.push_into(front_end);
        }
    }
    if let Some(done) = instant {
        done.push_into(front_end);
    }
    Ok(())
}

/// Images of one trigger.
struct Instant {
    time: Timestamp,
    /// One for each camera.
    images: Vec<Option<Image>>,
}

impl Instant {
    fn push_into(self, front_end: &mut FrontEnd) {
        let images: Vec<Option<&Image>> = self.images.iter().map(Option::as_ref).collect();
        front_end.push(self.time, &images);
    }
}

fn total_images(recording: &Recording, cameras: &[&str]) -> u64 {
    let topics = recording.topics().iter();
    let of_cameras = topics.filter(|topic| {
        let is_of = |camera: &&str| topic.topic.ends_with(&format!("{camera}/image"));
        cameras.iter().any(is_of)
    });
    of_cameras.map(|topic| topic.messages).sum()
}

/// Whether an image is the one before once more, though the device was turned in between: no two images of a sensor with noise are the
/// same, but for those that are all black or all white.
fn is_frozen(
    last: Option<&(Timestamp, Image)>,
    time: Timestamp,
    image: &Image,
    imu: &[Stamped<ImuSample>],
) -> bool {
    let is_uniform = image.pixels.windows(2).all(|pair| pair[0] == pair[1]);
    let is_same = |before: &Image| before.pixels == image.pixels && !is_uniform;
    last.is_some_and(|(since, before)| is_same(before) && has_turned(imu, *since, time))
}
