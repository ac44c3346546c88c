//! Settings of the odometry.

use lsfb_geometry::RigLidar;
use lsfb_perception::lidar::{LocalMapConfig, RangeWindow, RegistrationConfig, Weighting};
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// Parameters of the odometry. The defaults suit rooms and corridors; outdoors take cells of 2 m and keypoints of 1 m.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OdometryConfig {
    /// Nearest range used, metres: nearer returns are the carrier.
    pub min_range_m: f64,
    /// Farthest range used, metres; the map is kept to 1.5 times as far.
    pub max_range_m: f64,
    /// Edge of the largest map cell, metres.
    pub cell_size_m: f64,
    /// Number of cell sizes, each half the one before.
    pub cell_levels: u32,
    /// Edge of the voxels a scan is reduced to for registration, metres.
    pub keypoint_voxel_m: f64,
    /// Edge of the voxels a scan is reduced to for insertion into the map, metres.
    pub insert_voxel_m: f64,
    /// Farthest correspondence while the motion is still unknown, metres.
    pub initial_gate_m: f64,
    /// Gauss–Newton iterations per scan at most.
    pub max_iterations: u32,
    /// How many neighbouring points share their errors and count as one measurement.
    pub points_per_independent: f64,
    /// Share of points that must agree with the map; below it the scan is reported as lost.
    pub min_inlier_ratio: f64,
    /// How many scans in a row share the faults of the surfaces that they see: the covariance counts them as one.
    pub correlated_scans: f64,
}

impl OdometryConfig {
    /// For streets and car-mounted LiDARs: far ranges, coarse cells.
    pub fn outdoor() -> Self {
        Self {
            min_range_m: 3.0,
            max_range_m: 100.0,
            cell_size_m: 2.0,
            keypoint_voxel_m: 1.0,
            insert_voxel_m: 0.25,
            ..Self::default()
        }
    }

    /// Which returns are used.
    pub(crate) fn ranges(&self) -> RangeWindow {
        RangeWindow {
            min_m: self.min_range_m,
            max_m: self.max_range_m,
        }
    }

    /// The map of the surroundings, for a LiDAR.
    pub(crate) fn local_map(&self, lidar: &RigLidar) -> LocalMapConfig {
        LocalMapConfig {
            cell_size_m: self.cell_size_m,
            levels: self.cell_levels,
            range_noise_m: lidar.range_noise_m.max(LEAST_NOISE_M),
        }
    }

    /// How scans of a LiDAR are registered to it.
    pub(crate) fn registration(&self, lidar: &RigLidar, gate_m: f64) -> RegistrationConfig {
        let noise_m = lidar.range_noise_m.max(LEAST_NOISE_M);
        RegistrationConfig {
            max_iterations: self.max_iterations,
            gate_m,
            min_kernel_m: (3.0 * noise_m).max(0.03),
            range_noise_m: noise_m,
            point_noise_m: noise_m.hypot(0.3 * self.finest_cell_m()),
            points_per_independent: self.points_per_independent,
            weighting: Weighting::Tightening,
        }
    }

    /// Edge of the smallest map cell, metres.
    pub(super) fn finest_cell_m(&self) -> f64 {
        self.cell_size_m / f64::from(1u32 << (self.cell_levels - 1))
    }
}

/// No LiDAR is better than this, whatever its rig says, metres.
const LEAST_NOISE_M: f64 = 0.005;

impl Default for OdometryConfig {
    fn default() -> Self {
        Self {
            min_range_m: 0.7,
            max_range_m: 80.0,
            cell_size_m: 1.0,
            cell_levels: 3,
            keypoint_voxel_m: 0.2,
            insert_voxel_m: 0.05,
            initial_gate_m: 2.0,
            max_iterations: 30,
            points_per_independent: 4.0,
            min_inlier_ratio: 0.2,
            correlated_scans: 10.0,
        }
    }
}

lsfb_types::bounds! {
    OdometryConfig {
        min_range_m: number(Bounds::NOT_NEGATIVE),
        max_range_m: number(Bounds::POSITIVE),
        cell_size_m: number(Bounds::POSITIVE),
        cell_levels: number(Bounds::Within(1.0, 8.0)),
        keypoint_voxel_m: number(Bounds::POSITIVE),
        insert_voxel_m: number(Bounds::POSITIVE),
        initial_gate_m: number(Bounds::POSITIVE),
        max_iterations: number(Bounds::AT_LEAST_ONE),
        points_per_independent: number(Bounds::POSITIVE),
        min_inlier_ratio: number(Bounds::Within(0.0, 1.0)),
        correlated_scans: number(Bounds::AT_LEAST_ONE),
    }
}
