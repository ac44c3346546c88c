//! The LiDAR and the IMU of an input that brings no rig.

use std::collections::BTreeMap;

use anyhow::Context as _;
use lsfb_datasets::{RosBag, Unread, pose_in};
use lsfb_geometry::{ImuNoiseModel, Rig, RigImu, RigLidar, Se3};
use lsfb_pipeline::odometry::{ImuSamples, OdometryConfig, OdometryRun};
use lsfb_types::Stamped;

use super::{Choice, InputReport};
use crate::context::Context;

/// Noise of an IMU of which nothing is known: a cheap one.
const UNKNOWN_IMU: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1e-3,
    accel_noise_density: 1e-2,
    gyro_bias_walk: 1e-4,
    accel_bias_walk: 1e-3,
};
/// Noise of one range of a LiDAR of which nothing is known, metres.
const UNKNOWN_RANGE_NOISE_M: f64 = 0.02;

/// The sensors of a foreign input, and what was said about them.
pub(super) struct Sensors {
    pub lidar: RigLidar,
    pub imu: Option<ImuSamples>,
}

impl Sensors {
    /// A LiDAR alone: as a rig file has it, else in its own frame.
    pub fn lidar_alone(choice: &Choice) -> anyhow::Result<Self> {
        let lidar = match choice.rig {
            Some(path) => {
                let rig = Rig::read(path)?;
                let lidar = rig.lidar().cloned();
                lidar.with_context(|| format!("{}: the rig has no LiDAR", path.display()))?
            }
            None => RigLidar {
                rig_from_lidar: Se3::identity(),
                range_noise_m: UNKNOWN_RANGE_NOISE_M,
            },
        };
        Ok(Self { lidar, imu: None })
    }

    /// As a rig file has them; without one what a bag says of them: the IMU is used only where its place on the LiDAR is known.
    pub fn of_bag(
        bag: &RosBag,
        choice: &Choice,
        lidar_frame: &str,
        said: &mut InputReport,
        context: &Context,
    ) -> anyhow::Result<Self> {
        let mut sensors = Self::lidar_alone(choice)?;
        let rig = choice.rig.map(Rig::read).transpose()?;
        if !bag.has_imu() && choice.imu.is_none() {
            return Ok(sensors);
        }
        let imu = match bag.imu(choice.imu) {
            Ok(imu) => imu,
            // Nobody asked for it.
            Err(error) if choice.imu.is_none() => {
                said.warnings.push(format!("the IMU is not used: {error}"));
                return Ok(sensors);
            }
            Err(error) => return Err(error.into()),
        };
        if rig.is_some() {
            said.extrinsic = Some("rig");
        } else if imu.frame == lidar_frame {
            said.extrinsic = Some("same frame");
        } else if let Some(pose) = pose_in(&imu.frame, lidar_frame, &bag.static_transforms()?) {
            sensors.lidar.rig_from_lidar = pose;
            said.extrinsic = Some("/tf_static");
        } else {
            let why = format!(
                "the pose of the LiDAR (frame {lidar_frame:?}) on the IMU (frame {:?}) is in neither --rig nor /tf_static",
                imu.frame
            );
            anyhow::ensure!(choice.imu.is_none(), "{}: {why}", choice.path.display());
            said.warnings.push(format!("the IMU is not used: {why}"));
            return Ok(sensors);
        }
        said.warnings.extend(about_unread(&imu.unread, context));
        said.imu_topic = Some(imu.topic);
        let noise = rig.as_ref().and_then(Rig::imu_noise).cloned();
        let mut samples: Vec<_> = imu
            .samples
            .into_iter()
            .map(|(time, sample)| Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample,
            })
            .collect();
        samples.sort_by_key(|s| s.time);
        sensors.imu = Some(ImuSamples {
            noise: noise.unwrap_or(UNKNOWN_IMU),
            samples,
        });
        Ok(sensors)
    }

    /// The rig file where there is one, else a rig of these.
    fn rig(&self, choice: &Choice) -> anyhow::Result<Rig> {
        if let Some(path) = choice.rig {
            return Ok(Rig::read(path)?);
        }
        let imus = self.imu.as_ref();
        Ok(Rig {
            lidars: self.lidar.clone().alone(),
            imus: imus.map_or_else(BTreeMap::new, |imu| RigImu::from(imu.noise.clone()).alone()),
            ..Rig::empty("input")
        })
    }

    pub fn start(self, choice: &Choice, config: &OdometryConfig) -> anyhow::Result<OdometryRun> {
        let rig = self.rig(choice)?;
        let mut run = OdometryRun::new(config, &self.lidar, self.imu)?;
        if let Some(path) = choice.keep {
            run = run.keeping_scans(path, &rig)?;
        }
        Ok(match choice.model {
            Some(_) => run.with_times_by_azimuth(),
            None => run,
        })
    }
}

/// What the odometry's reader should know of messages that could not be read: data is lost then.
pub(super) fn about_unread(unread: &Unread, context: &Context) -> Option<String> {
    let first = unread.first.as_ref()?;
    context.lose_data();
    Some(format!(
        "{} messages could not be read and are left out; the first: {first}",
        unread.count
    ))
}
