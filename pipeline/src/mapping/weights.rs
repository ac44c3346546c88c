//! Standard deviations of the terms of Eq. (4), from the scatter of their residuals.

use lsfb_geometry::{StampedPose, so3};

use super::MappingConfig;
use super::config::CorrelationConfig;
use super::keyframes::Keyframe;
use super::residuals::LidarResiduals;
use super::scan_pairs::Compared;
use lsfb_perception::statistics::median;

/// Median length of a two-dimensional normal error in units of its standard deviation in one direction, √(2 ln 2).
const MEDIAN_PER_SIGMA: f64 = 1.177_410_022_515_474_7;
/// No sensor is better than this.
const MIN_SIGMA_M: f64 = 1e-4;
const MIN_SIGMA_PX: f64 = 0.05;

/// Standard deviations of the terms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Weights {
    pub plane_sigma_m: f64,
    pub edge_sigma_m: f64,
    pub pixel_sigma_px: f64,
    pub contradicted: Contradicted,
}

/// How much wider than the settings say the motion between keyframes is taken, as a factor of its standard deviations of rotation and translation: scans and
/// images that contradict a start show that it is not known so well. 1 where they do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Contradicted {
    pub rotation: f64,
    pub translation: f64,
}

impl Default for Contradicted {
    fn default() -> Self {
        Self {
            rotation: 1.0,
            translation: 1.0,
        }
    }
}

impl Contradicted {
    /// From the motion that Eq. (4) found between keyframes, against that of the start. It only grows: what was contradicted once
    /// must not hold a later round back.
    pub fn seen(self, start: &[StampedPose], now: &[StampedPose], config: &MappingConfig) -> Self {
        let (mut turns, mut shifts, mut count) = (0.0, 0.0, 0);
        for (was, is) in start.windows(2).zip(now.windows(2)) {
            let motion =
                |pair: &[StampedPose]| pair[0].world_from_rig.inverse() * pair[1].world_from_rig;
            let off = motion(was).inverse() * motion(is);
            let secs = was[1].time.secs_since(was[0].time).max(1e-3);
            turns += so3::log(&off.rotation).norm_squared() / secs;
            shifts += off.translation.norm_squared() / secs;
            count += 3;
        }
        if count == 0 {
            return self;
        }
        let rms = |squares: f64, sigma: f64| (squares / f64::from(count)).sqrt() / sigma;
        let turn_rad = config.odometry_rotation_sigma_deg.to_radians();
        Self {
            rotation: self.rotation.max(rms(turns, turn_rad)),
            translation: self
                .translation
                .max(rms(shifts, config.odometry_translation_sigma_m)),
        }
    }
}

impl Weights {
    /// Scatter of the residuals at the current poses, times how many of them share their errors.
    pub fn estimate(
        lidar: &LidarResiduals,
        reprojection_errors_px: &[f64],
        correlation: &CorrelationConfig,
    ) -> Self {
        let plane_m = lidar.plane_rms_m * correlation.planes_per_independent.sqrt();
        // An edge has errors in two directions across it.
        let edge_m = lidar.edge_rms_m * (0.5 * correlation.edges_per_independent).sqrt();
        let median_px = median(reprojection_errors_px.to_vec()).unwrap_or(0.0);
        let pixel_px =
            median_px / MEDIAN_PER_SIGMA * correlation.observations_per_independent.sqrt();
        Self {
            plane_sigma_m: plane_m.max(MIN_SIGMA_M),
            edge_sigma_m: edge_m.max(MIN_SIGMA_M),
            pixel_sigma_px: pixel_px.max(MIN_SIGMA_PX),
            contradicted: Contradicted::default(),
        }
    }
}

/// How far apart corresponding LiDAR features lie at the current poses.
pub(super) fn lidar_residuals<'a>(
    keyframes: &[Keyframe],
    scans: impl IntoIterator<Item = &'a Compared>,
) -> LidarResiduals {
    let mut sums = LidarResiduals::default();
    let (mut plane_squares, mut edge_squares) = (0.0, 0.0);
    for (pair, found) in scans {
        let m_from_world = keyframes[pair.m].world_from_rig.inverse();
        let m_from_n = m_from_world * keyframes[pair.n].world_from_rig;
        for f in &found.planes {
            let f = f.residual(1.0);
            let off = m_from_n * f.point_in_n - f.point_in_m;
            plane_squares += f.normal_in_m.dot(&off).powi(2);
        }
        for f in &found.edges {
            let off = m_from_n * f.point_in_n - f.edge_in_m.point;
            edge_squares += f.edge_in_m.direction.cross(&off).norm_squared();
        }
        sums.plane_matches += found.planes.len() as u64;
        sums.edge_matches += found.edges.len() as u64;
    }
    let rms = |squares: f64, count: u64| (squares / count.max(1) as f64).sqrt();
    LidarResiduals {
        plane_rms_m: rms(plane_squares, sums.plane_matches),
        edge_rms_m: rms(edge_squares, sums.edge_matches),
        ..sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_follow_the_sensors_at_hand() {
        let correlation = CorrelationConfig {
            planes_per_independent: 4.0,
            edges_per_independent: 2.0,
            observations_per_independent: 1.0,
        };
        let lidar = |noise: f64| LidarResiduals {
            plane_matches: 100,
            plane_rms_m: noise,
            edge_matches: 10,
            edge_rms_m: 3.0 * noise,
        };
        // Errors of a normal distribution of 0.5 px, and a few that are wrong.
        let errors_px = [0.1, 0.3, 0.5 * MEDIAN_PER_SIGMA, 0.9, 40.0];
        let weights = Weights::estimate(&lidar(0.01), &errors_px, &correlation);
        assert!((weights.plane_sigma_m - 0.02).abs() < 1e-12, "{weights:?}");
        assert!((weights.edge_sigma_m - 0.03).abs() < 1e-12, "{weights:?}");
        assert!((weights.pixel_sigma_px - 0.5).abs() < 1e-6, "{weights:?}");
        let better = Weights::estimate(&lidar(0.005), &errors_px, &correlation);
        assert!((better.plane_sigma_m - 0.01).abs() < 1e-12, "{better:?}");
        // Without residuals no weight is infinite.
        let nothing = Weights::estimate(&LidarResiduals::default(), &[], &correlation);
        assert_eq!(nothing.plane_sigma_m, MIN_SIGMA_M);
        assert_eq!(nothing.pixel_sigma_px, MIN_SIGMA_PX);
    }
}
