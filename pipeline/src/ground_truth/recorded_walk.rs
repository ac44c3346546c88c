//! What is read of a walk before any map is asked.

use std::path::PathBuf;

use lsfb_geometry::{ImuNoiseModel, Rig};
use lsfb_recording::Recording;
use lsfb_types::{ImuSample, ProgressFn, Stamped};

use super::{GroundTruthConfig, frozen_images, frozen_samples};
use crate::Error;
use crate::features::{Feature, FeatureDetector};
use crate::frames::{ImageClock, ReadFrames, ReadImu, read_frames, read_imu_if_any};
use crate::kept_stages::KeptStages;
use lsfb_perception::imu::NO_WEIGHT;

/// What a walk's images and its IMU hold, read once: it can be solved in several maps, or in parts of one.
pub struct RecordedWalk {
    pub(super) path: PathBuf,
    pub(super) rig: Rig,
    pub(super) noise: ImuNoiseModel,
    /// None of a walk of images alone.
    pub(super) imu: Vec<Stamped<ImuSample>>,
    pub(super) damaged_samples: u64,
    /// Samples that were recorded once more.
    pub(super) repeated_samples: u64,
    /// For how long a sensor of the IMU repeated itself while the device moved, seconds.
    pub(super) frozen_secs: f64,
    pub(super) read: ReadFrames,
    /// Images that were sent once more while the device was turned.
    pub(super) frozen: u64,
    /// What its features are.
    pub(super) feature: Feature,
}

impl RecordedWalk {
    /// Reads samples and images, and finds the features that the settings name.
    ///
    /// [`Error::SensorMissing`] without cameras, and where the rig file does not have the IMU that was recorded; [`crate::Refusal::FrozenSensor`] where the IMU repeats itself.
    pub fn read(
        recording: &Recording,
        config: &GroundTruthConfig,
        progress: ProgressFn<'_>,
    ) -> Result<Self, Error> {
        Self::read_in_stages(recording, config, &KeptStages::none(), progress)
    }

    /// [`RecordedWalk::read`], going on behind the features that are kept.
    pub(super) fn read_in_stages(
        recording: &Recording,
        config: &GroundTruthConfig,
        stages: &KeptStages,
        progress: ProgressFn<'_>,
    ) -> Result<Self, Error> {
        config.check_bounds("ground_truth")?;
        let rig = recording.rig()?;
        let missing = |sensor| Error::SensorMissing {
            sensor,
            rig: rig.name.clone(),
        };
        if rig.cameras.is_empty() {
            return Err(missing("camera"));
        }
        let ReadImu {
            samples: mut imu,
            damaged: damaged_samples,
            repeated: repeated_samples,
        } = read_imu_if_any(recording)?;
        let noise = match rig.imu_noise() {
            Some(noise) => noise.clone(),
            None if imu.is_empty() => NO_WEIGHT,
            None => return Err(missing("IMU")),
        };
        let frozen_secs = match imu.is_empty() {
            true => 0.0,
            false => frozen_samples::take_out(&mut imu)?,
        };
        let detector = FeatureDetector::new(&config.features, config.learned.as_ref())?;
        let clock = ImageClock::Stamps;
        let mut read = read_frames(recording, &rig, clock, &detector, stages, progress)?;
        let frozen = frozen_images::take_out(&mut read.frames, &imu);
        Ok(Self {
            path: recording.path().to_owned(),
            noise,
            rig,
            imu,
            damaged_samples,
            repeated_samples,
            frozen_secs,
            read,
            frozen,
            feature: detector.feature(),
        })
    }
}
