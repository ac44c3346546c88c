//! Poses of cameras on an IMU, their clocks, and the IMU's own errors: a continuous-time batch.
//!
//! The motion is a B-spline on SO(3) × R³ of order [`ORDER`], in the frame of the target. All cameras and the IMU are measured
//! against it at once. Furgale, Rehder, Siegwart, "Unified temporal and spatial calibration for multi-sensor systems",
//! IROS 2013.
//!
//! Real recordings contradict themselves where the model lacks something. What it takes for that:
//!
//! - The filters of an IMU delay its two triads differently: TUM VI's accelerometer measures 1.6 ms before its gyroscope. Without a
//!   delay between them the clocks of the cameras lie between the two, more or less as the motion has it, and so does the size of
//!   the board, and the cameras by a millimetre or two. The delay is searched with all else.
//! - Boards are bent by a millimetre or two and have hills, lenses are decentred. Few recordings tell these from a focal length:
//!   searched, they move it more than they mend. What they would move is found from the corners and is in the standard deviations
//!   (`residual_diagnosis`), unless the board is said to be bent.
//! - What is left over pulls parts of a recording in different directions: standard deviations come from the scatter of disjoint
//!   stretches of time where the weights do not explain it (`scatter`), and its two halves are compared (`halves`).

mod bend;
mod blocks;
mod board_size;
mod checks;
mod corner_residual;
mod effort;
mod gyro_alignment;
mod halves;
mod inertial;
mod input;
mod judgement;
mod knot_spacing;
mod outliers;
mod page;
mod parts;
mod posed_views;
mod problem;
mod report;
mod rig;
mod rolling;
mod samples;
mod start;
mod state;
mod table;
mod timed_view;
mod uncertainty;
mod view_residual;

use lsfb_geometry::{
    Camera, ImuNoiseModel, Matrix3, Matrix6, Se3, StampedPose, Trajectory, UnitQuaternion, Vector2,
    Vector3, spline,
};
use lsfb_types::{
    Bounds, Finding, ImuSample, Progress, ProgressFn, STANDARD_GRAVITY_M_S2, Timestamp,
};
use serde::{Deserialize, Serialize};

pub use halves::SplitEstimate;
pub use table::read_imu_table;
pub use uncertainty::JointCovariance;

use crate::Error;
use crate::board::Target;
use crate::camera::{CameraViews, Estimate};

/// Order of the spline: its angular velocity and its acceleration have continuous derivatives.
pub const ORDER: usize = 5;

/// A camera's clock: its offset in the middle of the recording (s) and by how much that grows in a second.
type Clock = Vector2<f64>;

/// A camera whose lens is known, if only nearly.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownCamera {
    /// What it saw; instants are its stamps, nanoseconds.
    pub views: CameraViews,
    /// Its lens.
    pub camera: Camera,
    /// Pose of the first camera in this one.
    pub camera_from_first: Se3,
    /// Time from the first row to one row below the last, seconds; 0 for a global shutter.
    pub readout_s: f64,
}

/// What the batch does with lenses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lenses {
    /// They are searched with all else, from those given: all views and the IMU have a say.
    #[default]
    Refined,
    /// They are those given.
    Known,
}

/// What the batch knows of the IMU's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axes {
    /// They are to scale and at right angles, as Kalibr has it by default. Where they are not, poses, clocks and lenses are off by
    /// more than they say.
    Ideal,
    /// They are as its maker calibrated them, to [`CameraImuConfig::axes_sigma`]: searched, with that known beforehand. The rig's
    /// axes lie between those of the two triads, and poses of cameras are known no better than those.
    #[default]
    NearlyIdeal,
    /// Nothing is known of scale and misalignment: needs a motion rich about and along all axes. The rig's x axis is the
    /// accelerometer's, and its y axis lies in the plane of the accelerometer's x and y.
    Estimated,
}

/// What the batch knows of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoardShape {
    /// It is what its file says; what a bent one would move is in the standard deviations where the views make it likely.
    #[default]
    Flat,
    /// It is a little bent, stretched and sheared: how is searched. For boards that are known not to be flat; it takes views from
    /// all sides to tell such a board from another lens.
    Bent,
}

/// What the batch knows of how much later than the gyroscope the accelerometer measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AccelDelay {
    /// It is searched: filters delay the two triads by up to several milliseconds, and seldom both alike.
    #[default]
    Estimated,
    /// There is none, as Kalibr has it. Where there is one all the same, poses and clocks are off by more than they say.
    Absent,
}

/// What the batch knows of rolling shutters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Readout {
    /// Readout times are those given.
    #[default]
    Known,
    /// Readout times are searched, for each camera.
    Estimated,
}

/// Settings of [`calibrate_camera_imu`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraImuConfig {
    /// Whether lenses are searched.
    pub lenses: Lenses,
    /// Whether the board may be bent.
    pub board: BoardShape,
    /// Whether scale and misalignment of the IMU are searched.
    pub axes: Axes,
    /// Standard deviation of each axis' scale (as a share) and of each angle by which it leans towards another (rad), where axes
    /// are nearly ideal. An IMU that its maker calibrated is within a tenth of a per cent and a milliradian (Xsens MTi manual:
    /// 0.05°); bare chips, within one or three per cent.
    pub axes_sigma: f64,
    /// Whether the accelerometer may measure later than the gyroscope.
    pub accel_delay: AccelDelay,
    /// Whether readout times are searched.
    pub readout: Readout,
    /// Least time between control points of the motion, seconds; up to twice that where the IMU's samples need no more of them.
    pub knot_spacing_s: f64,
    /// Time between control points of the biases, seconds.
    pub bias_spacing_s: f64,
    /// Standard deviation of a corner in one direction at the start, pixels; then what is left of each camera's errors.
    pub corner_sigma_px: f64,
    /// Largest offset of a camera's clock that is searched, seconds.
    pub max_offset_s: f64,
    /// Largest change of a camera's offset during the recording, seconds.
    pub max_drift_s: f64,
    /// Magnitude of gravity, m/s².
    pub gravity_m_s2: f64,
    /// Its standard deviation, m/s². Gravity is 9.780 at the equator and 9.832 at the poles: far from 45° of latitude that of the
    /// place should be given, or 0.03 here where nobody knows it.
    pub gravity_sigma_m_s2: f64,
    /// Least angular rate (rms) about each axis, rad/s.
    pub min_rate_rad_s: f64,
    /// Every n-th view is used.
    pub view_step: usize,
    /// Every n-th view is a holdout: it is only predicted, as a check, before all views are adjusted; 0 for no holdout.
    pub holdout_every: usize,
}

impl Default for CameraImuConfig {
    fn default() -> Self {
        Self {
            lenses: Lenses::Refined,
            board: BoardShape::Flat,
            axes: Axes::NearlyIdeal,
            axes_sigma: 1e-3,
            accel_delay: AccelDelay::Estimated,
            readout: Readout::Known,
            knot_spacing_s: 0.02,
            bias_spacing_s: 5.0,
            corner_sigma_px: 0.2,
            max_offset_s: 0.3,
            max_drift_s: 0.005,
            gravity_m_s2: STANDARD_GRAVITY_M_S2,
            gravity_sigma_m_s2: 1e-3,
            min_rate_rad_s: 0.1,
            view_step: 1,
            holdout_every: 10,
        }
    }
}

lsfb_types::bounds! {
    CameraImuConfig {
        lenses: any,
        board: any,
        axes: any,
        axes_sigma: number(Bounds::POSITIVE),
        accel_delay: any,
        readout: any,
        knot_spacing_s: number(Bounds::POSITIVE),
        bias_spacing_s: number(Bounds::POSITIVE),
        corner_sigma_px: number(Bounds::POSITIVE),
        max_offset_s: number(Bounds::POSITIVE),
        max_drift_s: number(Bounds::POSITIVE),
        gravity_m_s2: number(Bounds::POSITIVE),
        gravity_sigma_m_s2: number(Bounds::POSITIVE),
        min_rate_rad_s: number(Bounds::NOT_NEGATIVE),
        view_step: number(Bounds::AT_LEAST_ONE),
        holdout_every: any,
    }
}

/// A camera on the IMU.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraOnImu {
    /// Name in the rig.
    pub name: String,
    /// Size and lens.
    pub camera: Camera,
    /// The lens parameters with their standard deviations, zero where they were not searched.
    pub lens: Vec<Estimate>,
    /// Pose of the IMU (the rig) in the camera.
    #[serde(skip)]
    pub camera_from_rig: Se3,
    /// Covariance of [`CameraOnImu::camera_from_rig`], `[rotation, translation]`, by right perturbation.
    #[serde(skip)]
    pub covariance: Matrix6<f64>,
    /// Standard deviation of the camera's orientation about the axes of the rig, rad.
    pub rotation_sigma_rad: [f64; 3],
    /// Standard deviation of the camera's position along the axes of the rig, metres.
    pub position_sigma_m: [f64; 3],
    /// Added to the camera's stamps it gives the IMU's time, in the middle of the recording, seconds.
    pub rig_from_camera_s: f64,
    /// Its standard deviation, seconds.
    pub rig_from_camera_sigma_s: f64,
    /// By how much that grows in a second of the recording, seconds.
    pub clock_drift: f64,
    /// Its standard deviation.
    pub clock_drift_sigma: f64,
    /// Readout time, seconds.
    pub readout_s: f64,
    /// Its standard deviation, seconds; zero where it was not searched.
    pub readout_sigma_s: f64,
    /// Views used.
    pub views: usize,
    /// Root mean square of the reprojection error, outliers left out, pixels.
    pub rms_px: f64,
    /// The same over views that were held back and only predicted.
    pub holdout_rms_px: Option<f64>,
    /// Corners used.
    pub corners: usize,
    /// Corners left out.
    pub outliers: usize,
    /// Share of the image's cells (12 × 8) in which a corner was seen.
    pub coverage: f64,
    /// Corners per cell, by rows from the upper left.
    pub cells: Vec<u32>,
    /// Mean reprojection error (x, y) per cell, pixels.
    pub cell_errors_px: Vec<[f64; 2]>,
    /// Reprojection errors (x, y) of the corners used, pixels, in order.
    #[serde(skip)]
    pub errors_px: Vec<[f64; 2]>,
}

/// The IMU as found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FoundImu {
    /// Bias of the gyroscope in the middle of the recording, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// Its standard deviations.
    pub gyro_bias_sigma_rad_s: [f64; 3],
    /// Bias of the accelerometer in the middle of the recording, m/s².
    pub accel_bias_m_s2: [f64; 3],
    /// Its standard deviations.
    pub accel_bias_sigma_m_s2: [f64; 3],
    /// `measured = matrix · true + bias` of the gyroscope; one where axes were not searched.
    #[serde(skip)]
    pub gyro_matrix: Matrix3<f64>,
    /// The same of the accelerometer.
    #[serde(skip)]
    pub accel_matrix: Matrix3<f64>,
    /// Errors of the axes with their standard deviations, empty where they were not searched: `gyro xy` is the share of the
    /// rate about y in the sample of x.
    pub axes: Vec<Estimate>,
    /// How much later than the gyroscope the accelerometer measures, seconds.
    pub accel_delay_s: f64,
    /// Its standard deviation, seconds; zero where it was not searched.
    pub accel_delay_sigma_s: f64,
    /// Root mean square of the gyroscope's residual as a multiple of its stated noise.
    pub gyro_ratio: f64,
    /// The same of the accelerometer.
    pub accel_ratio: f64,
    /// Residuals of gyroscope and accelerometer as multiples of their stated noise, in bins of 0.25 from −5.
    pub gyro_histogram: Vec<u32>,
    /// The same of the accelerometer.
    pub accel_histogram: Vec<u32>,
    /// Angular rate about each axis, rms, rad/s.
    pub rate_rms_rad_s: [f64; 3],
    /// Specific force along each axis, rms about its mean, m/s².
    pub force_rms_m_s2: [f64; 3],
}

/// What [`calibrate_camera_imu`] found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraImuCalibration {
    /// By the order given.
    pub cameras: Vec<CameraOnImu>,
    /// The IMU.
    pub imu: FoundImu,
    /// Gravity in the target's frame, m/s².
    pub gravity_in_target_m_s2: [f64; 3],
    /// Its standard deviations.
    pub gravity_sigma_m_s2: [f64; 3],
    /// Whether its size is measured: not where something else keeps corners from being met.
    pub board_is_measured: bool,
    /// By how much all of the board is larger than said, as a share: by what the accelerometer says beside gravity.
    pub board_excess: f64,
    /// Its standard deviation.
    pub board_excess_sigma: f64,
    /// How far a corner lies out of the board's plane at most, metres.
    pub board_bend_m: f64,
    /// Its standard deviation, metres.
    pub board_bend_sigma_m: f64,
    /// The motion.
    #[serde(skip)]
    pub motion: Motion,
    /// How all of it varies together.
    #[serde(skip)]
    pub covariance: JointCovariance,
    /// What either half of the recording says for itself; empty where one of them does not determine everything.
    pub halves: Vec<SplitEstimate>,
    /// What was looked at, and how it came out.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

/// The motion as control points; times are seconds after `origin`.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Zero of its times.
    pub origin: Timestamp,
    /// Where the control points lie.
    pub knots: spline::UniformKnots,
    /// Orientation of the rig in the target's frame.
    pub rotations: Vec<UnitQuaternion<f64>>,
    /// Position of the rig in the target's frame, metres.
    pub positions: Vec<Vector3<f64>>,
}

impl Motion {
    /// Pose of the rig in the target's frame; `None` outside the recording.
    pub fn target_from_rig(&self, time: Timestamp) -> Option<Se3> {
        self.pose_at(time.secs_since(self.origin))
    }

    fn pose_at(&self, time_s: f64) -> Option<Se3> {
        let segment = self.knots.segment::<ORDER>(time_s, self.rotations.len())?;
        let range = segment.first..segment.first + ORDER;
        let rotation = spline::rotation(&segment.weights, self.rotations.get(range.clone())?)?;
        let position = spline::position(&segment.weights, self.positions.get(range)?)?;
        Some(Se3::new(rotation.rotation, position.position))
    }

    /// Poses of the rig in the target's frame, `interval_s` apart.
    pub fn trajectory(&self, interval_s: f64) -> Trajectory {
        let end_s = self.knots.end_s::<ORDER>(self.rotations.len());
        let count = ((end_s - self.knots.start_s) / interval_s.max(1e-4)) as usize;
        let poses = (0..count).filter_map(|k| {
            let time_s = self.knots.start_s + k as f64 * interval_s;
            Some(StampedPose {
                time: self.origin.plus_secs(time_s),
                world_from_rig: self.pose_at(time_s)?,
            })
        });
        Trajectory::new(poses.collect())
    }
}

/// Rounds of adjustment: times, and with them the control points that move a view, are set anew in each; so are outliers and the
/// spread of the corners. The last one uses the views that were held back.
const ROUNDS: usize = 3;

/// Poses and clocks of cameras on the IMU. `noise` weighs the IMU's samples. The result does not depend on the order of
/// cameras, views, corners and samples.
pub fn calibrate_camera_imu(
    target: &Target,
    cameras: &[KnownCamera],
    imu: &[(Timestamp, ImuSample)],
    noise: &ImuNoiseModel,
    config: &CameraImuConfig,
    progress: ProgressFn,
) -> Result<CameraImuCalibration, Error> {
    checks::before(target, cameras, noise, config)?;
    checks::units(cameras, imu)?;
    // Always in the order of names, so that sums round alike.
    let mut order: Vec<usize> = (0..cameras.len()).collect();
    order.sort_by(|a, b| cameras[*a].views.name.cmp(&cameras[*b].views.name));
    let sorted: Vec<KnownCamera> = order.iter().map(|k| cameras[*k].clone()).collect();
    let mut state = state::RigEstimate::new(&input::Input {
        target,
        cameras: &sorted,
        imu,
        noise,
        config,
    })?;
    let show = |round: usize| {
        progress(Progress {
            stage: "camera-IMU",
            done: round as u64,
            total: ROUNDS as u64 + 1,
        })
    };
    let mut holdout = vec![None; cameras.len()];
    for round in 0..ROUNDS {
        show(round)?;
        let last = round + 1 == ROUNDS;
        state.adjust(config, effort::Effort::of_round(round, last))?;
        if round + 2 == ROUNDS {
            holdout = state.holdout_rms_px();
        }
        if !last {
            state.find_outliers(target)?;
        }
    }
    show(ROUNDS)?;
    state.find_unmodelled(target, config);
    let uncertainty = state.uncertainty(config)?;
    let excess = state.board_excess(config)?;
    let mut calibration = state.report(target, config, &holdout, uncertainty, excess);
    // Back into the order given.
    let mut places: Vec<usize> = (0..order.len()).collect();
    places.sort_by_key(|k| order[*k]);
    calibration.cameras = places
        .into_iter()
        .map(|k| calibration.cameras[k].clone())
        .collect();
    Ok(calibration)
}
