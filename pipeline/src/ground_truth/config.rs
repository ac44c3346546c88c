use lsfb_solver::SolveConfig;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::features::SiftConfig;
use crate::features::matching::MatchConfig;
use crate::features::triangulation::TriangulationConfig;
use crate::localization::LocalizerConfig;

/// Parameters of the ground truth of a walk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GroundTruthConfig {
    /// Features of the walk's images; the map must have been made with the same.
    pub features: SiftConfig,
    /// Matching of features from image to image.
    pub matching: MatchConfig,
    /// Triangulation of local points.
    pub triangulation: TriangulationConfig,
    /// Localization of each instant.
    pub localization: LocalizerConfig,
    /// Fewest frames that must be localized in the map.
    pub min_localized_frames: usize,
    /// Standard deviation of a localized position, metres.
    pub localization_sigma_m: f64,
    /// Standard deviation of a localized attitude, radians.
    pub localization_sigma_rad: f64,
    /// Steps in frames over which features are followed.
    pub track_steps: Vec<usize>,
    /// Largest angle of a feature to its epipolar plane, degrees.
    pub epipolar_tolerance_deg: f64,
    /// Fewest images in which a local point is seen.
    pub min_track_images: usize,
    /// Longest tracks are taken first, until each of their images has this many.
    pub local_points_per_image: usize,
    /// Standard deviation of a map point's pixel, the map's own error included, pixels.
    pub map_sigma_px: f64,
    /// Standard deviation of a local point's pixel, pixels.
    pub local_sigma_px: f64,
    /// Scale of the robust (Cauchy) kernel, in standard deviations.
    pub kernel_scale: f64,
    /// Observations farther off after a solve are taken out, pixels.
    pub max_error_px: f64,
    /// The IMU's noise is taken this much larger than the rig file says: densities leave out scale errors and vibration.
    pub imu_noise_factor: f64,
    /// Standard deviation of the gyroscope's first bias about zero, rad/s.
    pub gyro_bias_sigma_rad_s: f64,
    /// Standard deviation of the accelerometer's first bias about zero, m/s².
    pub accel_bias_sigma_m_s2: f64,
    /// Standard deviation of gravity in the map, in size and direction, m/s².
    pub gravity_sigma_m_s2: f64,
    /// Map points recognised this long before or after are looked for again, seconds.
    pub guided_matching_window_secs: f64,
    /// How far from the predicted pixel they are looked for, pixels.
    pub guided_matching_radius_px: f64,
    /// A frame with fewer map points is carried by its neighbours.
    pub min_map_points: usize,
    /// Longest stretch of frames carried by IMU and local points, seconds; longer ones are left out.
    pub max_bridge_secs: f64,
    /// Longest such stretch at the beginning and end, seconds.
    pub max_extrapolation_secs: f64,
    /// The solver.
    pub solve: SolveConfig,
}

impl Default for GroundTruthConfig {
    fn default() -> Self {
        Self {
            features: SiftConfig::default(),
            matching: MatchConfig::default(),
            triangulation: TriangulationConfig::default(),
            localization: LocalizerConfig::default(),
            min_localized_frames: 5,
            localization_sigma_m: 0.03,
            localization_sigma_rad: 0.01,
            track_steps: vec![1, 3],
            epipolar_tolerance_deg: 0.6,
            min_track_images: 4,
            local_points_per_image: 100,
            map_sigma_px: 1.5,
            local_sigma_px: 1.0,
            kernel_scale: 2.0,
            max_error_px: 5.0,
            imu_noise_factor: 2.0,
            gyro_bias_sigma_rad_s: 0.05,
            accel_bias_sigma_m_s2: 0.3,
            gravity_sigma_m_s2: 0.05,
            guided_matching_window_secs: 1.0,
            guided_matching_radius_px: 4.0,
            min_map_points: 6,
            max_bridge_secs: 3.0,
            max_extrapolation_secs: 1.0,
            solve: SolveConfig::default(),
        }
    }
}

impl GroundTruthConfig {
    pub(super) fn check(&self) -> Result<(), Error> {
        let positive = [
            (
                "ground_truth.localization_sigma_m",
                self.localization_sigma_m,
            ),
            (
                "ground_truth.localization_sigma_rad",
                self.localization_sigma_rad,
            ),
            (
                "ground_truth.epipolar_tolerance_deg",
                self.epipolar_tolerance_deg,
            ),
            ("ground_truth.map_sigma_px", self.map_sigma_px),
            ("ground_truth.local_sigma_px", self.local_sigma_px),
            ("ground_truth.kernel_scale", self.kernel_scale),
            ("ground_truth.max_error_px", self.max_error_px),
            ("ground_truth.imu_noise_factor", self.imu_noise_factor),
            (
                "ground_truth.gyro_bias_sigma_rad_s",
                self.gyro_bias_sigma_rad_s,
            ),
            (
                "ground_truth.accel_bias_sigma_m_s2",
                self.accel_bias_sigma_m_s2,
            ),
            ("ground_truth.gravity_sigma_m_s2", self.gravity_sigma_m_s2),
            (
                "ground_truth.guided_matching_radius_px",
                self.guided_matching_radius_px,
            ),
        ];
        for (field, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::Config {
                    field,
                    value: value.to_string(),
                    expected: "more than 0",
                });
            }
        }
        if self.min_localized_frames < 2 {
            return Err(Error::Config {
                field: "ground_truth.min_localized_frames",
                value: self.min_localized_frames.to_string(),
                expected: "at least 2",
            });
        }
        Ok(())
    }
}
