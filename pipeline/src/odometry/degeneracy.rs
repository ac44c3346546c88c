//! What a scan does not see is said, and counts for nothing in the covariance of its pose.

use lsfb_geometry::{Matrix6, Se3, StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::{Direction, Registration, ScanFinder, observability};
use serde::{Deserialize, Serialize};

use super::motion::{Motion, end_pose};
use super::uncertainty::once_seen;
use super::{MIN_GATE_M, Odometry, ReducedScan};

/// A motion that a scan does not see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unseen {
    /// Unit vector in the world: the direction of the motion, or the axis of the turn.
    pub direction_in_world: Vector3<f64>,
    /// Which of the two.
    pub kind: MotionKind,
}

/// A motion along a direction, or about an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionKind {
    /// Along it.
    Shift,
    /// About it.
    Turn,
}

/// A direction that one scan determines less well than this is unseen, metres: normals that lean by a few degrees look like so much.
const UNSEEN_SIGMA_M: f64 = 0.03;
/// The same as information.
pub(super) const LEAST_SEEN_PER_M2: f64 = 1.0 / (UNSEEN_SIGMA_M * UNSEEN_SIGMA_M);
/// Until one scan determines it so much better again, as a factor of information: what leans leans differently in each scan.
const SEEN_AGAIN: f64 = 2.0;
/// Points that tell from which places the surfaces around were first seen, at most.
const POINTS: usize = 600;

/// What a registered scan sees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ScanInformation {
    /// The motion that it sees least, where it does not see all.
    pub unseen: Option<Unseen>,
    /// Information on the pose that it adds to the scans before it, with which it shares the faults of the surfaces they all see.
    pub lasting: Matrix6<f64>,
}

impl Odometry {
    /// What a registered scan sees. The pose is left as it was found: what holds it in directions that no plane tells of is little, and may
    /// be right.
    pub(super) fn see(&self, reduced: &ReducedScan, found: &Registration) -> ScanInformation {
        if self.stands() {
            // Rings lie on rings because nothing moves: what holds the scan holds it where it is.
            return ScanInformation {
                unseen: None,
                lasting: found.information / self.config.correlated_scans,
            };
        }
        let config = self.registration(MIN_GATE_M);
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        let shift_m = 0.5 * self.config.finest_cell_m();
        let points = &reduced.keypoints;
        let seen = observability(points, found, &config, shift_m, |points, pose, gate_m| {
            let mut finder = ScanFinder::new(&self.map, points, &sensor_in_rig);
            finder.find_planes(pose, gate_m)
        });
        let Some(seen) = seen else {
            return ScanInformation::default();
        };
        let again = if self.unseen { SEEN_AGAIN } else { 1.0 };
        let least_per_m2 = again * LEAST_SEEN_PER_M2;
        let is_unseen = |d: &Direction| d.seen_per_m2() < least_per_m2;
        let unseen = seen.directions.iter().filter(|d| is_unseen(d));
        let worst = unseen.min_by(|a, b| a.seen_per_m2().total_cmp(&b.seen_per_m2()));
        ScanInformation {
            unseen: worst.map(|d| Unseen::of(d, &found.world_from_rig)),
            lasting: seen.information_of(|d| !is_unseen(d)) / self.config.correlated_scans,
        }
    }

    /// Covariance of the pose that a scan led to; `lasting` is what the scan added, nothing where it was not registered.
    pub(super) fn covariance_of(
        &mut self,
        reduced: &ReducedScan,
        path: &[StampedPose],
        predicted: &Matrix6<f64>,
        lasting: &Matrix6<f64>,
    ) -> Matrix6<f64> {
        let world_from_rig = end_pose(path);
        let with_scan = once_seen(predicted, lasting).unwrap_or(*predicted);
        let gain = with_scan * lasting;
        let sensor = world_from_rig * self.lidar.rig_from_lidar.translation;
        let every = reduced.keypoints.len().div_ceil(POINTS).max(1);
        let points = reduced.keypoints.iter().step_by(every);
        let first_seen_from: Vec<u32> = points
            .filter_map(|p| {
                let in_world = world_from_rig * *p;
                self.map.first_seen_from(&in_world, &(sensor - in_world))
            })
            .collect();
        self.uncertainty
            .take(&world_from_rig, &with_scan, &gain, &first_seen_from)
    }

    /// Covariance of the predicted pose, as if the map were exact.
    pub(super) fn predicted_covariance(&self) -> Matrix6<f64> {
        match &self.motion {
            Motion::Inertial(inertial) => inertial
                .filter
                .as_ref()
                .map_or_else(Matrix6::zeros, |filter| filter.reported_covariance()),
            Motion::Constant { covariance, .. } => covariance.of_pose(),
        }
    }
}

impl Unseen {
    fn of(direction: &Direction, world_from_rig: &Se3) -> Self {
        let turn: Vector3<f64> = direction.along.fixed_rows::<3>(0).into();
        let shift: Vector3<f64> = direction.along.fixed_rows::<3>(3).into();
        let (kind, in_rig) = if turn.norm() > shift.norm() {
            (MotionKind::Turn, turn)
        } else {
            (MotionKind::Shift, shift)
        };
        Self {
            direction_in_world: world_from_rig.rotation * in_rig.normalize(),
            kind,
        }
    }

    /// Standard deviation of a pose along or about it: metres or radians.
    pub fn sigma(&self, world_from_rig: &Se3, covariance: &Matrix6<f64>) -> f64 {
        let in_rig = world_from_rig.rotation.inverse() * self.direction_in_world;
        let mut along = Vector6::zeros();
        let at = match self.kind {
            MotionKind::Turn => 0,
            MotionKind::Shift => 3,
        };
        along.fixed_rows_mut::<3>(at).copy_from(&in_rig);
        along.dot(&(covariance * along)).max(0.0).sqrt()
    }
}
