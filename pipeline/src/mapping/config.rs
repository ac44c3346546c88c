use lsfb_solver::SolveConfig;
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use super::control::ControlConfig;
use crate::features::{LearnedConfig, SiftConfig};
use crate::hd_map::{HdMapConfig, ReconstructionConfig};
use crate::inertial_blocks::USUAL_NOISE_FACTOR;
use crate::lidar_features::LidarFeatureConfig;
use crate::odometry::OdometryConfig;

/// Parameters of the mapping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MappingConfig {
    /// The odometry.
    pub odometry: OdometryConfig,
    /// Whether loops are looked for and closed before anything is mapped.
    pub close_loops: bool,
    /// Distance between keyframes, metres.
    pub keyframe_distance_m: f64,
    /// Angle between keyframes, degrees.
    pub keyframe_angle_deg: f64,
    /// Image features.
    pub sift: SiftConfig,
    /// A network that finds features instead.
    pub learned: Option<LearnedConfig>,
    /// Image pairs, matching and triangulation.
    pub reconstruction: ReconstructionConfig,
    /// Descriptors and index of the map.
    pub map: HdMapConfig,
    /// LiDAR features and correspondences.
    pub lidar_features: LidarFeatureConfig,
    /// How control points hold the map, where there are any.
    pub control: ControlConfig,
    /// Whether cameras that the images show for sure to be turned, shifted or of another focal length than the rig file says are taken as the images
    /// show them, and Eq. (4) is solved once more. What is thought possible beforehand is a tenth of a radian, a decimetre and a tenth of the focal length.
    pub refine_cameras: bool,
    /// Which measurements Eq. (4) takes.
    pub terms: TermConfig,
    /// How far errors of one kind go together in Eq. (4).
    pub correlation: CorrelationConfig,
    /// Scans this long before and after a keyframe make its LiDAR features, seconds.
    pub scan_window_secs: f64,
    /// Keyframes of earlier visits that its scan is compared with.
    pub scan_revisits: usize,
    /// Farthest such keyframe, metres.
    pub revisit_distance_m: f64,
    /// Standard deviation of the odometry's rotation, degrees per square root of a second.
    pub odometry_rotation_sigma_deg: f64,
    /// Standard deviation of the odometry's translation, metres per square root of a second.
    pub odometry_translation_sigma_m: f64,
    /// By how much the IMU's noise is taken larger than the rig file says, where `terms.imu` asks for it: densities leave out scale errors and vibration.
    pub imu_noise_factor: f64,
    /// How often correspondences are sought anew at most: until the keyframes rest, and with them matches and cost; ten times at least from a
    /// trajectory that is given to start from.
    pub outer_iterations: usize,
    /// Largest reprojection error of an observation in the map, pixels.
    pub max_reprojection_px: f64,
    /// When each minimisation stops.
    pub solver: SolveConfig,
}

/// Which measurements Eq. (4) takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TermConfig {
    /// Distances from planes.
    pub planes: bool,
    /// Distances from edges.
    pub edges: bool,
    /// Reprojections of map points. Without them points are triangulated with the poses that the LiDAR gives.
    pub images: bool,
    /// What the IMU says of the motion from each keyframe to the next. The start has it from the odometry already; it is for walks on which scans stay away, see too
    /// little, or another program's start is far off. The recording must have an IMU.
    pub imu: bool,
}

impl Default for TermConfig {
    fn default() -> Self {
        Self {
            planes: true,
            edges: true,
            images: true,
            imu: false,
        }
    }
}

lsfb_types::bounds! {
    TermConfig {
        planes: any,
        edges: any,
        images: any,
        imu: any,
    }
}

/// How many measurements of one kind share their errors and count as one.
///
/// The standard deviation of a term is the scatter of its residuals times the square root of this number: weights follow the sensors at
/// hand instead of being set for one of them. The numbers are those with which the scatter explains the errors of whole scans and images
/// on simulated walks (`README.md` of the module).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CorrelationConfig {
    /// Plane correspondences: patches of one wall lean the same way, and one patch is compared with many keyframes.
    pub planes_per_independent: f64,
    /// Edge correspondences.
    pub edges_per_independent: f64,
    /// Observations of map points.
    pub observations_per_independent: f64,
}

impl Default for CorrelationConfig {
    fn default() -> Self {
        Self {
            planes_per_independent: 9.0,
            edges_per_independent: 3.0,
            observations_per_independent: 10.0,
        }
    }
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            odometry: OdometryConfig::default(),
            close_loops: false,
            keyframe_distance_m: 0.35,
            keyframe_angle_deg: 20.0,
            sift: SiftConfig::default(),
            learned: None,
            reconstruction: ReconstructionConfig::default(),
            map: HdMapConfig::default(),
            lidar_features: LidarFeatureConfig::default(),
            control: ControlConfig::default(),
            refine_cameras: false,
            terms: TermConfig::default(),
            correlation: CorrelationConfig::default(),
            scan_window_secs: 0.35,
            scan_revisits: 3,
            revisit_distance_m: 2.0,
            odometry_rotation_sigma_deg: 0.2,
            odometry_translation_sigma_m: 0.01,
            imu_noise_factor: USUAL_NOISE_FACTOR,
            outer_iterations: 10,
            max_reprojection_px: 3.0,
            solver: SolveConfig {
                max_iterations: 20,
                cost_tolerance: 1e-5,
                ..SolveConfig::default()
            },
        }
    }
}

lsfb_types::bounds! {
    CorrelationConfig {
        planes_per_independent: number(Bounds::AT_LEAST_ONE),
        edges_per_independent: number(Bounds::AT_LEAST_ONE),
        observations_per_independent: number(Bounds::AT_LEAST_ONE),
    }
}

lsfb_types::bounds! {
    MappingConfig {
        odometry: section,
        close_loops: any,
        keyframe_distance_m: number(Bounds::POSITIVE),
        keyframe_angle_deg: number(Bounds::POSITIVE),
        sift: section,
        learned: any,
        reconstruction: section,
        map: section,
        lidar_features: section,
        control: section,
        refine_cameras: any,
        terms: section,
        correlation: section,
        scan_window_secs: number(Bounds::NOT_NEGATIVE),
        scan_revisits: any,
        revisit_distance_m: number(Bounds::NOT_NEGATIVE),
        odometry_rotation_sigma_deg: number(Bounds::POSITIVE),
        odometry_translation_sigma_m: number(Bounds::POSITIVE),
        imu_noise_factor: number(Bounds::POSITIVE),
        outer_iterations: any,
        max_reprojection_px: number(Bounds::POSITIVE),
        solver: section,
    }
}
