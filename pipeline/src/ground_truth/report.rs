use lsfb_solver::Termination;
use lsfb_types::Timestamp;
use serde::{Deserialize, Serialize};

use super::optimization::{fixed_error_px, local_error_px};
use super::walk::{LocalPoint, State, Walk};

/// A stretch of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Span {
    /// First instant, nanoseconds.
    pub from_ns: i64,
    /// Last instant, nanoseconds.
    pub to_ns: i64,
}

impl Span {
    pub(super) fn new(from: Timestamp, to: Timestamp) -> Self {
        Self {
            from_ns: from.nanos(),
            to_ns: to.nanos(),
        }
    }
}

/// Reprojection errors of one kind of observation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReprojectionErrors {
    /// Observations.
    pub count: u64,
    /// Root mean square, pixels.
    pub rms_px: f64,
    /// Number of errors per bin of [`ReprojectionErrors::BIN_PX`]; the last bin holds all larger ones.
    pub histogram: Vec<u64>,
}

impl ReprojectionErrors {
    /// Width of a bin, pixels.
    pub const BIN_PX: f64 = 0.25;
    const BINS: usize = 24;

    fn of(errors: impl Iterator<Item = f64>) -> Self {
        let mut result = Self {
            histogram: vec![0; Self::BINS],
            ..Self::default()
        };
        let mut squares = 0.0;
        for error in errors {
            result.count += 1;
            squares += error * error;
            let bin = ((error / Self::BIN_PX) as usize).min(Self::BINS - 1);
            result.histogram[bin] += 1;
        }
        result.rms_px = (squares / result.count.max(1) as f64).sqrt();
        result
    }
}

/// What the stage says about its own result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroundTruthReport {
    /// Instants with images in the recording.
    pub frames: u64,
    /// Features found in all images.
    pub features: u64,
    /// Frames that visual localization placed in the map.
    pub localized: u64,
    /// Localizations that disagreed with the IMU and the others, and were dropped.
    pub rejected_localizations: u64,
    /// Those among them that agree with the IMU and with one another at another place: the next best explanation of the walk.
    pub rival_localizations: u64,
    /// Frames in the trajectory.
    pub poses: u64,
    /// Frames in the trajectory that see too few map points to be placed alone: IMU and local points carry them.
    pub bridged: u64,
    /// Stretches left out of the trajectory, because too long without the map.
    pub left_out: Vec<Span>,
    /// Observations of map points added by the search after the first solve.
    pub guided_matching: u64,
    /// Observations not used because they are too far from where they should be.
    pub outliers: u64,
    /// Local points.
    pub local_points: u64,
    /// Errors of the map's points.
    pub map_errors: ReprojectionErrors,
    /// Errors of the local points.
    pub local_errors: ReprojectionErrors,
    /// Inertial samples.
    pub imu_samples: u64,
    /// Intervals between frames that lack inertial samples.
    pub imu_gaps: u64,
    /// Cost before the last solve.
    pub initial_cost: f64,
    /// Cost after it.
    pub final_cost: f64,
    /// Its iterations.
    pub iterations: u64,
    /// Why it stopped.
    pub termination: Termination,
    /// Gyroscope bias in the middle of the walk, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// Accelerometer bias in the middle of the walk, m/s².
    pub accel_bias_m_s2: [f64; 3],
    /// Length of the path, metres.
    pub path_length_m: f64,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

pub(super) fn map_errors(walk: &Walk, states: &[State]) -> ReprojectionErrors {
    ReprojectionErrors::of(walk.frames.iter().zip(states).flat_map(|(frame, state)| {
        frame
            .fixed
            .iter()
            .map(move |seen| fixed_error_px(&walk.cameras, state, seen))
    }))
}

pub(super) fn local_errors(
    walk: &Walk,
    states: &[State],
    points: &[LocalPoint],
) -> ReprojectionErrors {
    ReprojectionErrors::of(points.iter().flat_map(|point| {
        point
            .observations
            .iter()
            .filter(|seen| seen.used)
            .map(move |seen| local_error_px(walk, states, point, seen))
    }))
}
