//! How a place looks to a scan, whichever way it is turned: Scan Context.
//!
//! Kim and Kim, "Scan Context: egocentric spatial descriptor for place recognition within 3D point cloud map" (IROS 2018): a polar grid
//! around the sensor with the greatest height of the points of each cell (eq. 4); two are compared by the mean cosine distance
//! of their columns, at the heading where that is least (eq. 6, 7), and few are compared at all: those whose
//! means over each ring are near. Scans are made level first, and heights count from the sensor.

use lsfb_geometry::{RigLidar, Se3, UnitQuaternion, Vector3};

use super::keyframes;
use crate::odometry::DeskewedCloud;

const RINGS: usize = 20;
const SECTORS: usize = 60;
/// Range of the outermost ring, metres: rooms and corridors, not streets, tell places apart.
const RANGE_M: f64 = 30.0;
/// Lifts heights, so that an empty cell is the lowest of all, metres.
const LIFT_M: f64 = 5.0;

/// Greatest lifted height by sector and ring.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Descriptor {
    columns: Vec<[f32; RINGS]>,
    norms: Vec<f32>,
    /// Mean of each ring, which no heading changes.
    ring_key: [f32; RINGS],
}

impl Descriptor {
    /// Of a scan.
    pub fn of(cloud: &DeskewedCloud, world_from_rig: &Se3, lidar: &RigLidar) -> Self {
        let sensor_in_rig = lidar.rig_from_lidar.translation;
        Self::new(keyframes::points(cloud), world_from_rig, &sensor_in_rig)
    }

    /// Of points in the rig's frame.
    pub fn new(
        points_in_rig: impl Iterator<Item = Vector3<f64>>,
        world_from_rig: &Se3,
        sensor_in_rig: &Vector3<f64>,
    ) -> Self {
        let rotation = level(world_from_rig);
        let mut columns = vec![[0.0_f32; RINGS]; SECTORS];
        for point in points_in_rig {
            let p = rotation * (point - sensor_in_rig);
            let range = p.x.hypot(p.y);
            if !(range < RANGE_M) {
                continue;
            }
            let ring = (range / RANGE_M * RINGS as f64) as usize;
            let turn = p.y.atan2(p.x).rem_euclid(std::f64::consts::TAU);
            let sector = (turn / std::f64::consts::TAU * SECTORS as f64) as usize;
            let cell = &mut columns[sector % SECTORS][ring.min(RINGS - 1)];
            *cell = cell.max((p.z + LIFT_M).max(0.0) as f32);
        }
        let norm = |column: &[f32; RINGS]| column.iter().map(|h| h * h).sum::<f32>().sqrt();
        let norms = columns.iter().map(norm).collect();
        let mean = |ring: usize| columns.iter().map(|c| c[ring]).sum::<f32>() / SECTORS as f32;
        let ring_key = std::array::from_fn(mean);
        Self {
            columns,
            norms,
            ring_key,
        }
    }

    /// How far the ring keys are apart: quick to say, and small for places that are alike.
    pub fn key_distance(&self, other: &Self) -> f64 {
        let pairs = self.ring_key.iter().zip(&other.ring_key);
        f64::from(pairs.map(|(a, b)| (a - b).abs()).sum::<f32>())
    }

    /// Distance to another at the heading where it is least, from 0 (alike) to 1.
    pub fn distance(&self, other: &Self) -> f64 {
        let distances = (0..SECTORS).map(|shift| self.distance_at(other, shift));
        distances.fold(1.0, f64::min)
    }

    /// Mean cosine distance of the columns, with the other turned by so many sectors.
    fn distance_at(&self, other: &Self, shift: usize) -> f64 {
        let (mut sum, mut count) = (0.0_f64, 0_u32);
        for (sector, column) in self.columns.iter().enumerate() {
            let from = (sector + SECTORS - shift) % SECTORS;
            let norms = self.norms[sector] * other.norms[from];
            if norms > 0.0 {
                let pairs = column.iter().zip(&other.columns[from]);
                let dot: f32 = pairs.map(|(a, b)| a * b).sum();
                sum += 1.0 - f64::from(dot / norms);
                count += 1;
            }
        }
        if count == 0 {
            1.0
        } else {
            sum / f64::from(count)
        }
    }
}

/// Takes the rig's frame to a level one with the rig's heading.
fn level(world_from_rig: &Se3) -> UnitQuaternion<f64> {
    let rotation = world_from_rig.rotation;
    let forward = rotation * Vector3::x();
    let heading = forward.y.atan2(forward.x);
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -heading) * rotation
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;

    use super::*;

    /// A room of 8 × 5 m whose corner is cut off by a cupboard, seen from a place in it.
    fn room() -> Vec<Vector3<f64>> {
        let edge = |k: u32| f64::from(k) * 0.1;
        let mut points = Vec::new();
        for k in 0..80 {
            for h in 0..20 {
                let z = edge(h) - 1.0;
                points.push(Vector3::new(edge(k) - 3.0, -2.0, z));
                points.push(Vector3::new(edge(k) - 3.0, 3.0, z));
                if k < 50 {
                    points.push(Vector3::new(-3.0, edge(k) - 2.0, z));
                    points.push(Vector3::new(
                        if k < 20 { 3.5 } else { 5.0 },
                        edge(k) - 2.0,
                        z,
                    ));
                }
            }
        }
        points
    }

    #[test]
    fn a_place_is_known_from_any_heading_and_tilt() {
        let sensor = Vector3::new(0.1, 0.0, 0.2);
        let here = Se3::identity();
        let turned = Se3::exp(&Vector6::new(0.0, 0.0, 2.0, 0.0, 0.0, 0.0))
            * Se3::exp(&Vector6::new(0.1, -0.15, 0.0, 0.0, 0.0, 0.0));
        // Both see the same points from the same place, each in its own frame.
        let seen_from = |pose: &Se3| {
            let to_rig = pose.rotation.inverse();
            room()
                .into_iter()
                .map(move |p| to_rig * p + sensor)
                .collect::<Vec<_>>()
        };
        let first = Descriptor::new(seen_from(&here).into_iter(), &here, &sensor);
        let second = Descriptor::new(seen_from(&turned).into_iter(), &turned, &sensor);
        let distance = first.distance(&second);
        assert!(distance < 0.06, "{distance}");
        // Another place is not.
        let elsewhere: Vec<_> = room().iter().map(|p| p * 0.4 + sensor).collect();
        let other = Descriptor::new(elsewhere.into_iter(), &here, &sensor);
        assert!(first.distance(&other) > 0.2);
    }
}
