//! Scans of a walk, and how far one lies on planes from where it is said to be.

use lsfb_geometry::{RigLidar, Se3, StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::{Match, Registration, RegistrationConfig, observability};

use crate::odometry::OdometryConfig;
use crate::odometry::degeneracy::LEAST_SEEN_PER_M2;

/// Farthest correspondences, metres.
pub(super) const GATE_M: f64 = 1.0;

/// Scans and where the trajectory has them.
#[derive(Clone, Copy, Debug)]
pub(in crate::odometry) struct Scans<'a> {
    pub poses: &'a [StampedPose],
    /// Points of each in the rig, metres.
    pub clouds: &'a [&'a [[f32; 3]]],
    pub lidar: &'a RigLidar,
}

impl Scans<'_> {
    /// Points of a scan in its rig.
    pub(super) fn points(&self, k: usize) -> Option<Vec<Vector3<f64>>> {
        let points = self.clouds.get(k)?.iter();
        Some(points.map(|p| Vector3::from(p.map(f64::from))).collect())
    }

    /// Where the trajectory has a scan, seen from another.
    pub(super) fn seen_from(&self, reference: usize, k: usize) -> Se3 {
        self.poses[reference].world_from_rig.inverse() * self.poses[k].world_from_rig
    }
}

/// How far a scan was found from where it is said to be, along the directions that it sees, metres.
pub(super) fn seen_off_m(
    points: &[Vector3<f64>],
    stated: &Se3,
    found: &Registration,
    settings: &RegistrationConfig,
    config: &OdometryConfig,
    planes: impl FnMut(&[Vector3<f64>], &Se3, f64) -> Vec<Option<Match>>,
) -> Option<f64> {
    let shift_m = 0.5 * config.finest_cell_m();
    let seen = observability(points, found, settings, shift_m, planes)?;
    let r = seen.usual_range_m;
    let off = stated.local(&found.world_from_rig);
    let off_m = off.component_mul(&Vector6::new(r, r, r, 1.0, 1.0, 1.0));
    let directions = seen.directions.iter();
    let directions = directions.filter(|d| d.seen_per_m2() > LEAST_SEEN_PER_M2);
    let off_m: Vector6<f64> = directions.map(|d| d.along * d.along.dot(&off_m)).sum();
    Some(off_m.fixed_rows::<3>(3).norm())
}
