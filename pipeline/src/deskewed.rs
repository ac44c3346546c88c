//! Recorded scans at one instant, by a trajectory that is known.

use lsfb_geometry::{RigLidar, Se3, Trajectory, Vector3};
use lsfb_perception::lidar::{MotionKnot, deskew_rings};
use lsfb_types::{LidarScan, Stamped, Timestamp};

use crate::odometry::OdometryConfig;

/// A scan in the rig at one instant.
pub(crate) struct Deskewed {
    /// Where the rig was then.
    pub world_from_rig: Se3,
    /// Its points ring by ring, in firing order, metres.
    pub rings: Vec<Vec<Vector3<f64>>>,
}

impl Deskewed {
    /// Of a scan at `time`, by the motion at some offsets from the scan's stamp, in their order, nanoseconds; those outside the trajectory are left out. `None` where
    /// `time` itself is outside.
    pub fn at(
        time: Timestamp,
        scan: &Stamped<LidarScan>,
        lidar: &RigLidar,
        trajectory: &Trajectory,
        offsets_ns: impl Iterator<Item = i64>,
        config: &OdometryConfig,
    ) -> Option<Self> {
        let world_from_rig = trajectory.at(time)?;
        let rig_from_world = world_from_rig.inverse();
        let knots: Vec<MotionKnot> = offsets_ns
            .filter_map(|offset_ns| {
                let pose = trajectory.at(scan.time.plus_nanos(offset_ns))?;
                Some(MotionKnot {
                    offset_ns,
                    reference_from_rig: rig_from_world * pose,
                })
            })
            .collect();
        Some(Self {
            world_from_rig,
            rings: deskew_rings(&scan.sample, &lidar.rig_from_lidar, &knots, config.ranges()),
        })
    }
}
