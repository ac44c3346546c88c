//! How the rig moves between two scans.

use lsfb_geometry::{ImuNoiseModel, Se3, StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::KNOT_NS;
use lsfb_types::{ImuSample, Stamped, Timestamp};

use super::inertial::{InertialFilter, KnownBias};
use super::uncertainty::ConstantMotionCovariance;
use crate::{Error, Refusal};

/// How motion between scans is predicted.
#[derive(Clone, Debug)]
pub(super) enum Motion {
    /// From the IMU.
    Inertial(InertialMotion),
    /// As in the scan before.
    Constant {
        /// `[rotation, translation]` per second, in the rig frame.
        twist_per_s: Vector6<f64>,
        covariance: Box<ConstantMotionCovariance>,
    },
}

/// How fast a walk begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct StartVelocity {
    /// In the world, which is level and begins at the end of the first scan.
    pub velocity_m_s: Vector3<f64>,
    pub sigma_m_s: f64,
}

#[derive(Clone, Debug)]
pub(super) struct InertialMotion {
    pub noise: ImuNoiseModel,
    pub samples: Vec<Stamped<ImuSample>>,
    pub filter: Option<Box<InertialFilter>>,
    /// How fast the walk begins, where that is known by now.
    pub start: Option<StartVelocity>,
    /// The gyroscope's bias, where that is known by now.
    pub gyro_bias: Option<KnownBias>,
}

impl InertialMotion {
    /// Poses from the end of the last scan (or the start of the first) to `end`.
    pub fn predict(&mut self, start: Timestamp, end: Timestamp) -> Result<Vec<StampedPose>, Error> {
        if let Some(filter) = &mut self.filter {
            return Ok(filter.predict(&self.samples, end));
        }
        let before_end = self.samples.partition_point(|s| s.time <= end);
        let mut filter = InertialFilter::start(&self.samples[..before_end], start, &self.noise)
            .ok_or(Refusal::ImuMissing { time: end })?;
        if let Some(known) = self.start {
            filter.moves(known.velocity_m_s, known.sigma_m_s, end.secs_since(start));
        }
        if let Some(known) = &self.gyro_bias {
            filter.knows_bias(known);
        }
        let path = filter.predict(&self.samples, end);
        filter.become_origin();
        self.filter = Some(Box::new(filter));
        Ok(path)
    }
}

/// Where a path ends.
pub(super) fn end_pose(path: &[StampedPose]) -> Se3 {
    path.last()
        .map_or_else(Se3::identity, |end| end.world_from_rig)
}

/// A path of constant twist from the last pose through the scan's start to `end_pose` at `end`.
pub(super) fn constant_path(
    last: Option<StampedPose>,
    start: Timestamp,
    end: Timestamp,
    end_pose: &Se3,
) -> Vec<StampedPose> {
    let begin = last.unwrap_or(StampedPose {
        time: start,
        world_from_rig: *end_pose,
    });
    let twist = begin.world_from_rig.local(end_pose);
    let span_ns = end - begin.time;
    let steps = (span_ns / KNOT_NS).clamp(1, 100);
    (0..=steps)
        .map(|i| StampedPose {
            time: begin.time.plus_nanos(span_ns * i / steps),
            world_from_rig: begin
                .world_from_rig
                .retract(&(twist * (i as f64 / steps as f64))),
        })
        .collect()
}
