//! How far the biases of an IMU wander in a walk, beside how far its noise says that they do.
//!
//! A sensor that was knocked, or warms up, has another bias than before. What the noise does not allow the solve takes for motion, and bends the path.
//! Estimated biases differ much less from one time to another than true ones do: little is known of them from moment to moment, and the noise holds
//! them together. So one that changes by more than a good part of what the noise allows is pulled, most where it changed: there it is given room.
//! Only in a map: without one a camera that is turned against its rig file pulls at biases too, and would hide in what changes.

use lsfb_geometry::Vector3;
use lsfb_types::Timestamp;
use serde::{Deserialize, Serialize};

use super::config::InertialPriors;
use super::walk::{FrameState, Walk};

/// Shortest time after which biases are compared, seconds; then after twice that, and so on.
const SHORTEST_SECS: f64 = 1.0;
/// A bias that changes by more than so much of what its noise allows is pulled. In right walks of simulated devices it is 0.2 to 0.6, of TUM VI up to 1.0, where an
/// accelerometer was knocked by 0.1 m/s² 2.4. (EuRoC's V1_01 has up to 4.3: its biases wander more than is stated.)
pub(super) const PULLED_SIGMAS: f64 = 1.5;
/// About where it changed it may wander so many times as much, for so long, seconds.
const ROOM: f64 = 50.0;
const ROOM_SECS: f64 = 2.0;
/// Biases change so often at most: what pulls at them everywhere is something else.
const MOST_CHANGES: usize = 3;

/// The most that a bias changes, by what its noise allows in as much time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BiasChange {
    /// In standard deviations of what the noise allows.
    pub sigmas: f64,
    /// Change of the axis that has it, rad/s or m/s².
    pub change: f64,
    /// Time from the walk's beginning to the middle of the change, seconds.
    pub at_secs: f64,
    /// Time that it took, seconds.
    pub within_secs: f64,
}

/// Of both sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BiasWander {
    /// Of the gyroscope's.
    pub gyro: BiasChange,
    /// Of the accelerometer's.
    pub accel: BiasChange,
}

impl BiasWander {
    /// In the states of a walk's first frames, by what its noise says.
    pub(super) fn of(walk: &Walk, states: &[FrameState]) -> Self {
        let [gyro, accel] = sensors(walk).map(|sensor| sensor.largest(walk, states, |_| 1.0));
        Self { gyro, accel }
    }
}

/// Where a bias that is pulled changed, if one is.
pub(super) fn next_change(
    walk: &Walk,
    states: &[FrameState],
    known: &InertialPriors,
) -> Option<Timestamp> {
    if known.bias_changes.len() >= MOST_CHANGES {
        return None;
    }
    let room = |frame| room_to_wander(walk, frame, known);
    let pulled = sensors(walk).map(|sensor| {
        let sigmas = sensor.largest(walk, states, room).sigmas;
        (sigmas, sensor)
    });
    let [gyro, accel] = pulled;
    let (sigmas, sensor) = if gyro.0 > accel.0 { gyro } else { accel };
    if sigmas <= PULLED_SIGMAS {
        return None;
    }
    let held = (0..states.len().saturating_sub(1)).filter(|k| room(*k) == 1.0);
    let rate = |k: usize| {
        let change = (sensor.bias)(&states[k + 1]) - (sensor.bias)(&states[k]);
        change.amax() / interval_secs(walk, k)
    };
    let fastest = held.max_by(|a, b| rate(*a).total_cmp(&rate(*b)))?;
    Some(walk.frames[fastest].time)
}

/// How many times as much as their noise says biases may wander after a frame.
pub(super) fn room_to_wander(walk: &Walk, frame: usize, known: &InertialPriors) -> f64 {
    let time = walk.frames[frame].time;
    let mut changes = known.bias_changes.iter();
    match changes.any(|change| change.secs_since(time).abs() <= 0.5 * ROOM_SECS) {
        true => ROOM,
        false => 1.0,
    }
}

/// Time to the next frame.
fn interval_secs(walk: &Walk, frame: usize) -> f64 {
    let [from, to] = [frame, frame + 1].map(|k| walk.frames[k].time);
    to.secs_since(from).max(f64::MIN_POSITIVE)
}

/// One of an IMU's two.
struct Sensor {
    /// Random walk of its bias, unit of the bias per √s.
    walk_per_sqrt_s: f64,
    bias: fn(&FrameState) -> Vector3<f64>,
}

fn sensors(walk: &Walk) -> [Sensor; 2] {
    let gyro = Sensor {
        walk_per_sqrt_s: walk.noise.gyro_bias_walk,
        bias: |state| state.bias.gyro_rad_s,
    };
    let accel = Sensor {
        walk_per_sqrt_s: walk.noise.accel_bias_walk,
        bias: |state| state.bias.accel_m_s2,
    };
    [gyro, accel]
}

impl Sensor {
    /// The largest change of its bias by what is allowed: the noise, and so many times that after each frame.
    fn largest(
        &self,
        walk: &Walk,
        states: &[FrameState],
        factor: impl Fn(usize) -> f64,
    ) -> BiasChange {
        let count = states.len();
        let (mut secs, mut variances) = (vec![0.0], vec![0.0]);
        for k in 0..count.saturating_sub(1) {
            let interval_secs = interval_secs(walk, k);
            let walked = factor(k) * self.walk_per_sqrt_s;
            secs.push(secs[k] + interval_secs);
            variances.push(variances[k] + walked * walked * interval_secs);
        }
        let mut largest = BiasChange::default();
        let mut span_secs = SHORTEST_SECS;
        while span_secs <= secs[secs.len() - 1] {
            let mut later = 0;
            for k in 0..count {
                while later < count && secs[later] - secs[k] < span_secs {
                    later += 1;
                }
                if later == count {
                    break;
                }
                let change = (self.bias)(&states[later]) - (self.bias)(&states[k]);
                let change = change[change.iamax()];
                let sigmas = change.abs() / (variances[later] - variances[k]).sqrt();
                if sigmas > largest.sigmas {
                    largest = BiasChange {
                        sigmas,
                        change,
                        at_secs: 0.5 * (secs[k] + secs[later]),
                        within_secs: secs[later] - secs[k],
                    };
                }
            }
            span_secs *= 2.0;
        }
        largest
    }
}
