use lsfb_geometry::ImuNoiseModel;
use lsfb_solver::SolveConfig;
use lsfb_types::{Bounds, Timestamp};
use serde::{Deserialize, Serialize};

use crate::features::matching::MatchConfig;
use crate::features::triangulation::TriangulationConfig;
use crate::features::{LearnedConfig, SiftConfig};
use crate::inertial_blocks;
use crate::localization::LocalizerConfig;
use crate::residuals::{CameraCorrection, MovingCamera, entry};

/// Standard deviations of what is known beforehand beyond which a camera, or the IMU, is not as it is said to be.
pub(super) const UNLIKELY_SIGMAS: f64 = 3.0;

/// Those beyond which a camera bends the motion: what is known beforehand draws it back, away from where it is.
pub(super) const BENDING_SIGMAS: f64 = 10.0;

/// What a calibration does not know: how far a camera that is carried about has gone since, by warmth and knocks, and what it and a map share of an error; standard
/// deviations, radians, metres, share of the focal length, seconds. Rigs calibrated in the standard trial are off by up to 0.9 mrad, 1 mm and 0.4 ms.
const SINCE_RAD: f64 = 1e-3;
const SINCE_M: f64 = 1e-3;
const SINCE_FOCAL: f64 = 1e-3;
const SINCE_CLOCK_S: f64 = 5e-4;

/// Parameters of the ground truth of a walk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GroundTruthConfig {
    /// Features of the walk's images; the map must have been made with the same.
    pub features: SiftConfig,
    /// A network that finds features instead, where the map was made with one.
    pub learned: Option<LearnedConfig>,
    /// Matching of features from image to image.
    pub matching: MatchConfig,
    /// Triangulation of local points.
    pub triangulation: TriangulationConfig,
    /// Localization of each instant.
    pub localization: LocalizerConfig,
    /// Frames that are localized on their own are at least this far apart, seconds, but where one of them is not found: the others are matched where the walk
    /// leads, which costs much less.
    pub localize_every_secs: f64,
    /// Fewest frames that must be localized in the map.
    pub min_localized_frames: usize,
    /// Least share of the localized frames that must agree with one another through the IMU.
    pub min_agreeing_share: f64,
    /// Least share of the frames that must be recognised on their own where too little of the map was mapped from where the walk went to check the
    /// place by what should be in view: the others are matched where they are expected, and agree with whatever is expected.
    pub min_recognised_share: f64,
    /// How many times as many localized frames must agree as with any other explanation of the walk that contradicts it.
    pub min_rival_margin: f64,
    /// How many times as many points must be found where the walk is said to be as if all of it were where it fits next best, unless what should
    /// be in view there speaks against that place.
    pub min_place_margin: f64,
    /// Standard deviation of a localized position beyond what its matches say, metres.
    pub localization_sigma_m: f64,
    /// Standard deviation of a localized attitude beyond what its matches say, radians.
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
    /// Standard deviation of gravity in the map, in direction, m/s².
    pub gravity_sigma_m_s2: f64,
    /// Standard deviation of the cameras' attitudes in the rig file, radians, where that does not say how well they are known.
    pub extrinsics_sigma_rad: f64,
    /// Standard deviation of the cameras' positions in the rig file, metres, where that does not say.
    pub extrinsics_sigma_m: f64,
    /// Standard deviation of focal lengths in the rig file, as a share of them, where that does not say.
    pub focal_sigma: f64,
    /// Standard deviation of the cameras' clocks in the rig file, seconds, where that does not say.
    pub camera_clock_sigma_s: f64,
    /// Standard deviation of readout times in the rig file, seconds, where that does not say: many do not state the times, and mean zero by it.
    pub readout_sigma_s: f64,
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
    /// Largest standard deviation, in its worst direction, of a position that is exported, metres.
    pub max_position_sigma_m: f64,
    /// How far half of the map's points may move a position that is exported, metres.
    pub max_disagreement_m: f64,
    /// Largest share of what is said by the map's points that should be in view that is that they are not there: beyond, the place has changed, or
    /// is another that is built alike.
    pub max_absent_share: f64,
    /// Whether a map that failed when it was made (a camera turned against the rig file, say) is used all the same.
    pub accept_failed_map: bool,
    /// The solver.
    pub solve: SolveConfig,
    /// What may be wrong of the IMU beside its biases, and of gravity.
    pub inertial: InertialPriors,
}

/// What may be wrong of the IMU beside its biases, and of gravity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InertialPriors {
    /// Standard deviation of the gyroscope's scale, each axis by itself, as a share.
    pub gyro_scale_sigma: f64,
    /// Standard deviation of the accelerometer's scale, each axis by itself, as a share.
    pub accel_scale_sigma: f64,
    /// Standard deviation of the share of one axis that another reads too, of both sensors.
    pub shear_sigma: f64,
    /// Standard deviation of how the accelerometer's axes are turned on the gyroscope's, about each axis, radians.
    pub accel_turn_sigma_rad: f64,
    /// Standard deviation of how much later the accelerometer's readings are than the gyroscope's, seconds.
    pub accel_delay_sigma_s: f64,
    /// Standard deviation of the map's scale, as a share.
    pub map_scale_sigma: f64,
    /// Standard deviation of gravity's size about the standard, m/s².
    pub gravity_size_sigma_m_s2: f64,
    /// Times about which its biases may change by more than its noise says; the walk itself tells them.
    #[serde(skip)]
    pub bias_changes: Vec<Timestamp>,
}

impl Default for InertialPriors {
    fn default() -> Self {
        Self {
            // As data sheets of calibrated parts have it.
            gyro_scale_sigma: 5e-3,
            accel_scale_sigma: 5e-3,
            // Cross-axis sensitivity of 1 %, two standard deviations of it.
            shear_sigma: 5e-3,
            accel_turn_sigma_rad: 5e-3,
            // Low-pass filters of one part differ by so much.
            accel_delay_sigma_s: 2e-3,
            // A LiDAR's ranges, and what odometry and adjustment make of them.
            map_scale_sigma: 3e-3,
            // Between pole and equator it differs by 0.05.
            gravity_size_sigma_m_s2: 0.02,
            bias_changes: Vec::new(),
        }
    }
}

lsfb_types::bounds! {
    InertialPriors {
        gyro_scale_sigma: number(Bounds::POSITIVE),
        accel_scale_sigma: number(Bounds::POSITIVE),
        shear_sigma: number(Bounds::POSITIVE),
        accel_turn_sigma_rad: number(Bounds::POSITIVE),
        accel_delay_sigma_s: number(Bounds::POSITIVE),
        map_scale_sigma: number(Bounds::POSITIVE),
        gravity_size_sigma_m_s2: number(Bounds::POSITIVE),
        bias_changes: any,
    }
}

impl Default for GroundTruthConfig {
    fn default() -> Self {
        Self {
            features: SiftConfig::default(),
            learned: None,
            matching: MatchConfig::default(),
            triangulation: TriangulationConfig::default(),
            localization: LocalizerConfig::default(),
            localize_every_secs: 0.095,
            min_localized_frames: 5,
            min_agreeing_share: 0.3,
            min_recognised_share: 0.2,
            min_rival_margin: 2.0,
            min_place_margin: 1.2,
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
            imu_noise_factor: inertial_blocks::USUAL_NOISE_FACTOR,
            gyro_bias_sigma_rad_s: inertial_blocks::USUAL_GYRO_BIAS_RAD_S,
            accel_bias_sigma_m_s2: inertial_blocks::USUAL_ACCEL_BIAS_M_S2,
            gravity_sigma_m_s2: 0.05,
            extrinsics_sigma_rad: 2e-3,
            extrinsics_sigma_m: 2e-3,
            focal_sigma: 2e-3,
            camera_clock_sigma_s: 2e-3,
            readout_sigma_s: 0.02,
            guided_matching_window_secs: 1.0,
            guided_matching_radius_px: 4.0,
            min_map_points: 6,
            max_bridge_secs: 3.0,
            max_extrapolation_secs: 1.0,
            max_position_sigma_m: 0.03,
            max_disagreement_m: 0.08,
            // Three-second walks on another floor that is built alike came to 0.03 at least; right ones to 0.006, and one of 24 s to 0.015.
            max_absent_share: 0.06,
            accept_failed_map: false,
            solve: SolveConfig {
                cost_tolerance: 1e-9,
                // Neighbours are held together far more firmly than to the map: damping by a share of that would hold the
                // whole.
                initial_damping: 1e-12,
                ..SolveConfig::default()
            },
            inertial: InertialPriors::default(),
        }
    }
}

lsfb_types::bounds! {
    GroundTruthConfig {
        features: section,
        learned: any,
        matching: section,
        triangulation: section,
        localization: section,
        localize_every_secs: number(Bounds::NOT_NEGATIVE),
        min_localized_frames: number(Bounds::AtLeast(2.0)),
        min_agreeing_share: number(Bounds::Within(0.0, 1.0)),
        min_recognised_share: number(Bounds::Within(0.0, 1.0)),
        min_rival_margin: number(Bounds::AtLeast(1.0)),
        min_place_margin: number(Bounds::AtLeast(1.0)),
        localization_sigma_m: number(Bounds::POSITIVE),
        localization_sigma_rad: number(Bounds::POSITIVE),
        track_steps: each(Bounds::AT_LEAST_ONE),
        epipolar_tolerance_deg: number(Bounds::POSITIVE),
        min_track_images: any,
        local_points_per_image: any,
        map_sigma_px: number(Bounds::POSITIVE),
        local_sigma_px: number(Bounds::POSITIVE),
        kernel_scale: number(Bounds::POSITIVE),
        max_error_px: number(Bounds::POSITIVE),
        imu_noise_factor: number(Bounds::POSITIVE),
        gyro_bias_sigma_rad_s: number(Bounds::POSITIVE),
        accel_bias_sigma_m_s2: number(Bounds::POSITIVE),
        gravity_sigma_m_s2: number(Bounds::POSITIVE),
        extrinsics_sigma_rad: number(Bounds::POSITIVE),
        extrinsics_sigma_m: number(Bounds::POSITIVE),
        focal_sigma: number(Bounds::POSITIVE),
        camera_clock_sigma_s: number(Bounds::POSITIVE),
        readout_sigma_s: number(Bounds::POSITIVE),
        guided_matching_window_secs: number(Bounds::NOT_NEGATIVE),
        guided_matching_radius_px: number(Bounds::POSITIVE),
        min_map_points: any,
        max_bridge_secs: number(Bounds::NOT_NEGATIVE),
        max_extrapolation_secs: number(Bounds::NOT_NEGATIVE),
        max_position_sigma_m: number(Bounds::POSITIVE),
        max_disagreement_m: number(Bounds::POSITIVE),
        accept_failed_map: any,
        max_absent_share: number(Bounds::Within(0.0, 1.0)),
        solve: section,
        inertial: section,
    }
}

/// Share of the cost by which a step lowers it less where the solution is looked at by millimetres, or solved again. Where a walk sees all in
/// one direction 1e-6 lets halves of the map seem nearer to each other by 2 mm; this by 0.01 mm.
const ROUGH_TOLERANCE: f64 = 1e-8;

impl GroundTruthConfig {
    /// For what need not be solved to the last digit.
    pub(super) fn roughly(&self) -> Self {
        let mut rough = self.clone();
        rough.solve.cost_tolerance = rough.solve.cost_tolerance.max(ROUGH_TOLERANCE);
        rough
    }

    /// The IMU's noise as the optimisation takes it.
    pub(super) fn inflated(&self, noise: &ImuNoiseModel) -> ImuNoiseModel {
        inertial_blocks::inflated(noise, self.imu_noise_factor)
    }

    /// Standard deviations of what the rig file says of a camera, entry by entry: its own, where it has them, and what no calibration knows.
    pub(super) fn calibration_sigmas(&self, camera: &MovingCamera) -> CameraCorrection {
        let stated = camera.sigmas();
        let known = |stated: Option<f64>, unsaid: f64, since: f64| {
            stated.map_or(unsaid, |sigma| sigma.hypot(since))
        };
        let mut sigmas = CameraCorrection::zeros();
        for axis in 0..3 {
            sigmas[entry::TURN + axis] = known(
                stated.rotation_rad.map(|s| s[axis]),
                self.extrinsics_sigma_rad,
                SINCE_RAD,
            );
            sigmas[entry::SHIFT + axis] = known(
                stated.translation_m.map(|s| s[axis]),
                self.extrinsics_sigma_m,
                SINCE_M,
            );
        }
        sigmas[entry::FOCAL] = known(stated.focal_share, self.focal_sigma, SINCE_FOCAL);
        sigmas[entry::CLOCK] = known(
            stated.rig_from_camera_s,
            self.camera_clock_sigma_s,
            SINCE_CLOCK_S,
        );
        sigmas[entry::READOUT] = known(stated.readout_s, self.readout_sigma_s, SINCE_CLOCK_S);
        sigmas
    }
}
