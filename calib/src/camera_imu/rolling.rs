//! Rolling shutters at the start, where each view has one pose: a board that is read row by row while the camera moves looks as if it were
//! turned, and the camera does not turn as the gyroscope does.

use lsfb_types::Timestamp;

use super::gyro_alignment::GyroAlignment;
use super::input::Input;
use super::posed_views::look;
use super::samples::samples_of;
use super::state::{RigEstimate, Sample};
use super::{KnownCamera, Readout};
use crate::{Error, JoinProblem};

/// Readout times that are tried, and their step, seconds. Those of phones are 10 to 35 ms; one that is read from below is negative.
const LONGEST_S: f64 = 0.05;
const STEP_S: f64 = 0.005;
/// Share of the turning that must agree with one of them: clocks that drift or jump agree a little more with any.
const LEAST_AGREEMENT: f64 = 0.85;

impl RigEstimate {
    /// With the readout times that are known. Where views and gyroscope contradict each other with these, others are tried: to start from,
    /// if they are to be searched, else to name the cause.
    pub fn new(input: &Input) -> Result<Self, Error> {
        let known_s: Vec<f64> = input.cameras.iter().map(|c| c.readout_s).collect();
        let refused = match Self::with_readouts(input, &known_s) {
            Err(error) if may_be_rolling(&error) => error,
            result => return result,
        };
        let Some(readouts_s) = readouts_s(input) else {
            return Err(refused);
        };
        let Ok(state) = Self::with_readouts(input, &readouts_s) else {
            return Err(refused);
        };
        if input.config.readout == Readout::Estimated {
            return Ok(state);
        }
        let differs = |k: &usize| (readouts_s[*k] - known_s[*k]).abs() > 0.5 * STEP_S;
        let Some(k) = (0..readouts_s.len()).find(differs) else {
            return Err(refused);
        };
        Err(Error::NotJoined {
            first: input.cameras[k].views.name.clone(),
            second: "the IMU".into(),
            cause: JoinProblem::RollingShutter {
                known_s: known_s[k],
                found_s: readouts_s[k],
            },
        })
    }
}

/// Whether a readout time that is not known can be the cause.
fn may_be_rolling(error: &Error) -> bool {
    match error {
        Error::DoesNotFit { .. } => true,
        Error::NotJoined { cause, .. } => matches!(
            cause,
            JoinProblem::TurnApart { .. } | JoinProblem::ClocksDrift { .. }
        ),
        _ => false,
    }
}

/// The readout time of each camera with which it turns most as the gyroscope does; `None` where one does not with any.
fn readouts_s(input: &Input) -> Option<Vec<f64>> {
    let (origin, samples) = samples_of(input.imu, input.cameras).ok()?;
    let steps = (LONGEST_S / STEP_S).round() as i32;
    let of_camera = |known: &KnownCamera| {
        (-steps..=steps)
            .map(|k| f64::from(k) * STEP_S)
            .filter_map(|readout_s| {
                let agreement = agreement(input, known, readout_s, &samples, origin)?;
                Some((readout_s, agreement))
            })
            .max_by(|a, b| a.1.total_cmp(&b.1))
            // At the end of what is tried nothing is found.
            .filter(|(readout_s, agreement)| {
                *agreement > LEAST_AGREEMENT && readout_s.abs() < LONGEST_S - 0.5 * STEP_S
            })
            .map(|(readout_s, _)| readout_s)
    };
    input.cameras.iter().map(of_camera).collect()
}

fn agreement(
    input: &Input,
    known: &KnownCamera,
    readout_s: f64,
    samples: &[Sample],
    origin: Timestamp,
) -> Option<f64> {
    let seen = look(input, known, readout_s, 0, origin).ok()?;
    let turned = GyroAlignment::new(samples, &seen.poses);
    let aligned = turned.solve(&known.views.name, input.config).ok()?;
    Some(aligned.agreement)
}
