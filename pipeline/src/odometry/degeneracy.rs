//! What a scan does not see is said, left to the prediction, and counts for nothing in the covariance of the pose.

use lsfb_geometry::{Matrix6, Se3, StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::{Direction, PosePrior, Registration, ScanFinder, observability};
use serde::{Deserialize, Serialize};

use super::motion::{Motion, end_pose};
use super::uncertainty::once_seen;
use super::{Estimate, MIN_GATE_M, Odometry, ReducedScan};

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
    /// Where it does not see all.
    pub seen_alone: Option<SeenAlone>,
}

/// What a scan says of the pose in the directions that it sees, and in no others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SeenAlone {
    information: Matrix6<f64>,
    /// Takes a gradient to its part along the directions that are not seen.
    of_unseen: Matrix6<f64>,
}

impl SeenAlone {
    /// A pose that was found with all that the scan seems to say, without what it says of directions that it does not see: there the prediction
    /// stands.
    pub fn estimate(&self, prior: &PosePrior, found: &Se3) -> Estimate {
        // Where both are balanced the prior pulls as hard as the scan, the other way.
        let pull = prior.information * prior.world_from_rig.local(found);
        let both = (self.information + prior.information).cholesky();
        Estimate {
            world_from_rig: both.map_or(*found, |both| {
                found.retract(&-both.solve(&(self.of_unseen * pull)))
            }),
            information: self.information,
        }
    }
}

impl Odometry {
    /// What a registered scan sees.
    pub(super) fn see(&self, reduced: &ReducedScan, found: &Registration) -> ScanInformation {
        if self.stands() {
            // Rings lie on rings because nothing moves: what holds the scan holds it where it is.
            return ScanInformation {
                unseen: None,
                lasting: found.information / self.config.correlated_scans,
                seen_alone: None,
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
        // In the first second scans count little in all directions, and what they do not see as much as the rest.
        let seen_alone = worst.filter(|_| self.shared_by <= 1.0).map(|_| SeenAlone {
            information: seen.without(&found.information, is_unseen),
            of_unseen: seen.part(is_unseen),
        });
        ScanInformation {
            unseen: worst.map(|d| Unseen::of(d, &found.world_from_rig)),
            lasting: seen.information_of(|d| !is_unseen(d)) / self.config.correlated_scans,
            seen_alone,
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

#[cfg(test)]
mod tests {
    use lsfb_perception::lidar::Observability;

    use super::*;

    /// Naively nearest points draw the pose a little along what is not seen, with every scan, and the velocity is learned from that.
    #[test]
    fn what_is_not_seen_is_left_to_the_prediction() {
        let usual_range_m = 5.0;
        // Along z the scan seems to know something, to 5 cm.
        let of_scan = Vector6::new(25e6, 25e6, 25e6, 1e6, 1e6, 400.0);
        let directions = std::array::from_fn(|k| Direction {
            along: Vector6::ith(k, 1.0),
            information_per_m2: if k < 3 { of_scan[k] / 25.0 } else { of_scan[k] },
            seen: 1.0,
        });
        let seen = Observability {
            usual_range_m,
            directions,
        };
        let is_unseen = |d: &Direction| d.seen_per_m2() < LEAST_SEEN_PER_M2;
        let prior = PosePrior {
            world_from_rig: Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, 3.0)),
            information: Matrix6::identity() * 1e4,
        };
        // Where both are balanced, of a scan that lies that far off.
        let by_scan = Vector6::new(0.0, 0.001, 0.0, 0.02, 0.0, 0.3);
        let balanced = by_scan.zip_map(&of_scan, |off, of_scan| off * of_scan / (of_scan + 1e4));
        let found = prior.world_from_rig.retract(&balanced);
        let information = Matrix6::from_diagonal(&of_scan);
        let seen_alone = SeenAlone {
            information: seen.without(&information, is_unseen),
            of_unseen: seen.part(is_unseen),
        };
        let estimate = seen_alone.estimate(&prior, &found);
        let off = prior.world_from_rig.local(&estimate.world_from_rig);
        let mut expected = balanced;
        expected[5] = 0.0;
        assert!((off - expected).norm() < 1e-4, "{off}");
        assert!(off[5].abs() < 1e-4 && balanced[5] > 0.01, "{off}");
        let mut seen = of_scan;
        seen[5] = 0.0;
        assert!((estimate.information - Matrix6::from_diagonal(&seen)).norm() < 1e-6);
    }
}
