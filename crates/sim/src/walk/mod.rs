//! How the rigs move: smooth, known exactly, at rest at both ends.

mod balance;
pub(crate) mod off_path;
mod paper_motion;
mod passers;
mod plan;
mod tour;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use lsfb_geometry::Se3;

use crate::config::WalkConfig;
use crate::noise::{stream, uniform};
use crate::spline::QuinticSpline;
use crate::world::FloorPlan;
pub use paper_motion::PaperMotion;
pub(crate) use passers::Passers;
pub(crate) use plan::{Gait, Gaze, WalkPlan};
use tour::Tour;

/// Spacing of the knots of the motion, seconds.
const KNOT_S: f64 = 0.1;
/// Speeding up and slowing down, m/s².
const ACCELERATION_M_S2: f64 = 0.6;

/// Who walks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walker {
    /// Carries the backpack, looks where they go.
    Backpack,
    /// Wears the glasses, looks around.
    Glasses,
}

/// Pose, velocities and acceleration of a rig at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Pose.
    pub world_from_rig: Se3,
    /// Velocity in the world, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Acceleration in the world, without gravity, m/s².
    pub acceleration_m_s2: Vector3<f64>,
    /// Angular velocity in the rig frame, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
}

/// A walk: the rig's motion as a function of time.
#[derive(Clone, Debug)]
pub struct Walk {
    duration_s: f64,
    /// x, y, z, metres; yaw, pitch, roll, radians.
    curve: QuinticSpline<6>,
}

impl Walk {
    /// The walk of one wearer through a building.
    pub fn new(plan: &FloorPlan, walker: Walker, config: &WalkConfig, seed: u64) -> Self {
        let tour = Tour::new(plan, seed);
        let rng = stream(seed, "gait", u64::from(walker == Walker::Glasses));
        let phase = || f64::from(uniform(&rng, 0.0, std::f32::consts::TAU));
        let phases: [f64; 8] = std::array::from_fn(|_| phase());
        let start = match walker {
            Walker::Backpack => 0.0,
            // On the way back, in the corridor: the glasses see both places in half a lap.
            Walker::Glasses => 0.55 * tour.length_m(),
        };
        let travel = Travel::new(&tour, config, start);
        let bob_m = match walker {
            Walker::Backpack => 0.03,
            Walker::Glasses => 0.02,
        };
        let curve = QuinticSpline::following(config.duration_s, KNOT_S, |t| {
            let (s, speed) = travel.at(t);
            let pace = speed / config.speed_m_s;
            // One step covers 0.62 m; the body rises once a step and sways once in two.
            let step = std::f64::consts::TAU * (s - start) / 0.62;
            let [x, y, z] = tour.point(s);
            let heading = tour.heading(s + 0.1);
            let sway = 0.025 * pace * (0.5 * step + phases[0]).sin();
            // What grows in within a second of setting off, and dies away before standing still.
            let awake = smooth_step((t - config.rest_s) / 1.0)
                * smooth_step((config.duration_s - config.final_rest_s - t) / 1.0);
            let wave = |hz: f64, p: f64| (std::f64::consts::TAU * hz * t + p).sin();
            let (look_yaw, look_pitch) = match walker {
                Walker::Backpack => (0.05 * wave(0.31, phases[1]), 0.02 * wave(0.23, phases[2])),
                Walker::Glasses => (
                    0.42 * wave(0.13, phases[1]) + 0.2 * wave(0.29, phases[2]),
                    0.06 + 0.1 * wave(0.17, phases[3]) + 0.05 * wave(0.37, phases[4]),
                ),
            };
            let roll =
                0.022 * pace * (0.5 * step + phases[5]).sin() + 0.02 * awake * wave(0.4, phases[6]);
            let pitch = 0.02 * pace * (step + phases[7]).sin() + awake * look_pitch;
            [
                x - sway * heading.sin(),
                y + sway * heading.cos(),
                z + config.height_m + bob_m * pace * step.sin(),
                heading + 0.03 * pace * (0.5 * step + phases[3]).sin() + awake * look_yaw,
                pitch,
                roll,
            ]
        });
        Self {
            duration_s: config.duration_s,
            curve,
        }
    }

    /// How long it lasts, seconds.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The motion `time_s` after the start; at rest before and after.
    pub fn at(&self, time_s: f64) -> Motion {
        let jet = self.curve.at(time_s);
        let [x, y, z, yaw, pitch, roll] = jet.value;
        let [vx, vy, vz, yaw_rate, pitch_rate, roll_rate] = jet.rate;
        let [ax, ay, az, ..] = jet.acceleration;
        // R = Rz(yaw) Ry(pitch) Rx(roll)
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let (sr, cr) = roll.sin_cos();
        let (sp, cp) = pitch.sin_cos();
        let body_by_rates = Matrix3::new(
            1.0,
            0.0,
            -sp, //
            0.0,
            cr,
            sr * cp, //
            0.0,
            -sr,
            cr * cp,
        );
        Motion {
            world_from_rig: Se3::new(rotation, Vector3::new(x, y, z)),
            velocity_m_s: Vector3::new(vx, vy, vz),
            acceleration_m_s2: Vector3::new(ax, ay, az),
            angular_velocity_rad_s: body_by_rates * Vector3::new(roll_rate, pitch_rate, yaw_rate),
        }
    }
}

impl Motion {
    /// The motion `dt_s` later if both velocities stayed as they are: for the microseconds between two firings.
    pub fn coasted(&self, dt_s: f64) -> Se3 {
        Se3::new(
            self.world_from_rig.rotation
                * UnitQuaternion::from_rotation_matrix(&Rotation3::new(
                    self.angular_velocity_rad_s * dt_s,
                )),
            self.world_from_rig.translation + self.velocity_m_s * dt_s,
        )
    }
}

fn wave(t: f64, hz: f64, phase: f64) -> f64 {
    (std::f64::consts::TAU * hz * t + phase).sin()
}

/// 0 up to 0, 1 from 1 on, twice differentiable.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - x * (15.0 - 6.0 * x))
}

/// Distance along the tour over time.
struct Travel {
    positions: Vec<f64>,
    speeds: Vec<f64>,
}

const TRAVEL_STEP_S: f64 = 0.005;

impl Travel {
    /// Walks at the configured speed, slower in bends, starting and stopping gently.
    fn new(tour: &Tour, config: &WalkConfig, start: f64) -> Self {
        let reach = config.speed_m_s * config.duration_s + 1.0;
        let spacing = 0.01;
        let mut allowed: Vec<f64> = (0..(reach / spacing) as usize)
            .map(|k| {
                let bend = tour.curvature(start + k as f64 * spacing).abs();
                config
                    .speed_m_s
                    .min(config.turn_rate_rad_s / bend.max(1e-6))
            })
            .collect();
        // No faster than one can have become since, or can still get rid of.
        let gain = 2.0 * ACCELERATION_M_S2 * spacing;
        for k in 1..allowed.len() {
            allowed[k] = allowed[k].min((allowed[k - 1].powi(2) + gain).sqrt());
        }
        for k in (1..allowed.len()).rev() {
            allowed[k - 1] = allowed[k - 1].min((allowed[k].powi(2) + gain).sqrt());
        }
        let end = config.duration_s - config.final_rest_s;
        let mut travel = Self {
            positions: vec![start],
            speeds: vec![0.0],
        };
        let mut s = start;
        for k in 1..=(config.duration_s / TRAVEL_STEP_S) as usize {
            let t = k as f64 * TRAVEL_STEP_S;
            let index = (((s - start) / spacing) as usize).min(allowed.len() - 1);
            let gate = smooth_step((t - config.rest_s) / 1.2) * smooth_step((end - t) / 1.2);
            let speed = gate * allowed[index];
            s += speed * TRAVEL_STEP_S;
            travel.positions.push(s);
            travel.speeds.push(speed);
        }
        travel
    }

    /// Position and speed at a time.
    fn at(&self, time_s: f64) -> (f64, f64) {
        let last = self.positions.len() - 1;
        let x = (time_s / TRAVEL_STEP_S).clamp(0.0, last as f64);
        let i = (x as usize).min(last.saturating_sub(1));
        let u = x - i as f64;
        let next = (i + 1).min(last);
        let blend = |v: &[f64]| v[i] + u * (v[next] - v[i]);
        (blend(&self.positions), blend(&self.speeds))
    }
}

#[cfg(test)]
mod tests;
