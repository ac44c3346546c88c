//! A scan reduced to a share of its points that has its planes and edges still.
//!
//! Points are not left out but averaged, over short pieces of a ring that end where it bends: the mean of points of a plane lies on it, with less noise than
//! each of them. Where scans are dense (a VLP-32C at ten turns a second) maps made of a fifth are as good to a few hundredths; a scanner with a quarter of the points
//! has planes 10 mm off where all of them give 6 mm. Edges are found before, in all points, and kept as they are.

use lsfb_geometry::Vector3;
use lsfb_perception::lidar::voxel_downsample;

use super::{Crease, LidarFeatureConfig, ScanFeatures, THINNING_M, creases_of_ring};

/// Pieces of a ring over which points are averaged: from this length on, each a tenth longer than the one before, up to the last, metres. Longer ones would
/// join what are different things.
const SHORTEST_M: f64 = 0.02;
const LONGER: f64 = 1.1;
const LONGEST_M: f64 = 0.25;
/// Where that is not enough, as for clouds without rings, voxels are, from this edge on, metres.
const SMALLEST_VOXEL_M: f64 = 0.05;
const LARGEST_VOXEL_M: f64 = 2.0;
/// Points that say where a ring bends.
pub const POINTS_PER_BEND: usize = 3;

/// A scan reduced, in the rig frame at the time it was deskewed to, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseScan {
    /// Means of points of one ring each, with the number of the ring.
    pub surfaces: Vec<(u16, Vector3<f64>)>,
    /// Where a ring bends: where its two straight pieces meet, and the middles of the one before and the one behind.
    pub bends: Vec<(u16, [Vector3<f64>; POINTS_PER_BEND])>,
}

impl SparseScan {
    /// Of a scan given ring by ring in firing order, seen from `sensor_in_rig`, to at most this share of its points (edges are kept in any case).
    pub fn of(
        rings: &[Vec<Vector3<f64>>],
        sensor_in_rig: &Vector3<f64>,
        range_noise_m: f64,
        config: &LidarFeatureConfig,
        share: f64,
    ) -> Self {
        let all: usize = rings.iter().map(Vec::len).sum();
        let mut bends = Vec::new();
        let mut pieces: Vec<(u16, &[Vector3<f64>])> = Vec::new();
        for (ring, points) in (0_u16..).zip(rings) {
            // What is one ring alone is a cloud without numbers of rings: neighbours in it may be of different beams.
            let found = match rings.len() {
                1 => Vec::new(),
                _ => creases_of_ring(points, sensor_in_rig, range_noise_m, config),
            };
            let mut rest = points.as_slice();
            for (index, bend) in found {
                bends.push((ring, bend));
                // The ring ends there, and another begins.
                let before = points.len() - rest.len();
                let (piece, behind) = rest.split_at(index.saturating_sub(before).min(rest.len()));
                pieces.push((ring, piece));
                rest = behind;
            }
            pieces.push((ring, rest));
        }
        let room = (share * all as f64) as usize;
        let room = room.saturating_sub(POINTS_PER_BEND * bends.len());
        // Each point by itself, where there is room for all.
        let mut length_m = 0.0;
        let mut surfaces = averaged(&pieces, length_m);
        while surfaces.len() > room && length_m < LONGEST_M {
            length_m = f64::max(LONGER * length_m, SHORTEST_M);
            surfaces = averaged(&pieces, length_m);
        }
        let mut voxel_m = SMALLEST_VOXEL_M;
        while surfaces.len() > room && voxel_m < LARGEST_VOXEL_M {
            let points: Vec<_> = surfaces.iter().map(|(_, point)| *point).collect();
            let thinned = voxel_downsample(&points, voxel_m);
            surfaces = thinned.into_iter().map(|point| (0, point)).collect();
            voxel_m *= LONGER;
        }
        Self { surfaces, bends }
    }

    /// What it adds to the keyframes around it.
    pub fn features(&self, sensor_in_rig: &Vector3<f64>) -> ScanFeatures {
        let points: Vec<_> = self.surfaces.iter().map(|(_, point)| *point).collect();
        let bends = self.bends.iter();
        ScanFeatures {
            points: voxel_downsample(&points, THINNING_M),
            creases: bends
                .map(|(ring, bend)| Crease {
                    ring: usize::from(*ring),
                    bend: *bend,
                })
                .collect(),
            sensor_in_rig: *sensor_in_rig,
        }
    }
}

/// Means of pieces no longer than so.
fn averaged(pieces: &[(u16, &[Vector3<f64>])], length_m: f64) -> Vec<(u16, Vector3<f64>)> {
    let mut means = Vec::new();
    for (ring, points) in pieces {
        let mut rest = *points;
        while let Some(first) = rest.first() {
            let near = |p: &Vector3<f64>| (p - first).norm() <= length_m;
            let count = rest.iter().take_while(|p| near(p)).count().max(1);
            let (these, behind) = rest.split_at(count.min(rest.len()));
            let sum: Vector3<f64> = these.iter().sum();
            means.push((*ring, sum / these.len() as f64));
            rest = behind;
        }
    }
    means
}
