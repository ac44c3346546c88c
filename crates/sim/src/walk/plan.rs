//! Walks along a route with a gait and a way of looking, of a given length in a given time.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::balance::Balance;
use super::tour::Tour;
use super::{KNOT_S, Travel, Walk, smooth_step, wave};
use crate::config::WalkConfig;
use crate::noise::{stream, uniform};
use crate::spline::QuinticSpline;

/// Images per second of all three devices of the paper.
pub(super) const FRAME_RATE_HZ: f64 = 30.0;

/// Where one looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Gaze {
    Ahead,
    /// Ahead like somebody who carries a scanner.
    Steady,
    AroundSlow,
    AroundFast,
    /// To the left of where one goes.
    Left,
    Right,
    /// All around, on the spot.
    Turning,
    /// At a board along +x, moving in all ways.
    Facing,
    /// The same, four sides of the rig facing the board in turn.
    Board,
}

/// How one moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gait {
    /// Length of a step, metres.
    pub step_m: f64,
    /// Rise and fall with each step, metres.
    pub bob_m: f64,
    /// To and fro sideways with two steps, metres.
    pub sway_m: f64,
    /// Pitching with each step, radians.
    pub nod_rad: f64,
    /// How fast one turns at most, rad/s.
    pub turn_rate_rad_s: f64,
}

impl Gait {
    pub(crate) const WALK: Self = Self {
        step_m: 0.62,
        bob_m: 0.02,
        sway_m: 0.022,
        nod_rad: 0.015,
        turn_rate_rad_s: 0.9,
    };
    pub(crate) const RUN: Self = Self {
        step_m: 0.95,
        bob_m: 0.035,
        sway_m: 0.03,
        nod_rad: 0.03,
        turn_rate_rad_s: 2.2,
    };
    pub(crate) const STAND: Self = Self {
        step_m: 0.4,
        bob_m: 0.004,
        sway_m: 0.006,
        nod_rad: 0.006,
        turn_rate_rad_s: 4.0,
    };

    /// A walk that turns in bends as fast as the settings let it.
    pub(crate) fn walk_at(config: &WalkConfig) -> Self {
        Self {
            turn_rate_rad_s: config.turn_rate_rad_s,
            ..Self::WALK
        }
    }
}

/// A walk to be made.
#[derive(Clone, Debug)]
pub(crate) struct WalkPlan {
    /// Corners of a closed route on the floor, metres.
    pub corners: Vec<[f64; 3]>,
    /// Duration and rests; a duration of 0 is as long as the route, or `length_m`, takes at the speed given.
    pub config: WalkConfig,
    /// Length of the path; without, as far as the speed carries.
    pub length_m: Option<f64>,
    pub gaze: Gaze,
    pub gait: Gait,
}

impl Walk {
    /// Makes the walk; `seed` varies gait and gaze.
    pub(crate) fn of(plan: &WalkPlan, seed: u64) -> Self {
        let tour = Tour::along(&plan.corners);
        let mut config = plan.config.clone();
        config.turn_rate_rad_s = plan.gait.turn_rate_rad_s;
        if config.duration_s == 0.0 {
            let length = plan.length_m.unwrap_or(1.03 * tour.length_m());
            let rests = config.rest_s + config.final_rest_s;
            // Bends take longer than straight stretches.
            config.duration_s = (rests + 2.5 + 1.12 * length / config.speed_m_s).ceil();
        }
        let Some(wanted) = plan.length_m else {
            return Self::at_speed(plan, &tour, &config, seed);
        };
        // What bob and sway add to the path is found by trying.
        let mut along = wanted;
        let mut walk = Self::at_speed(plan, &tour, &config, seed);
        for _ in 0..2 {
            config.speed_m_s = speed_for(&tour, &config, along);
            walk = Self::at_speed(plan, &tour, &config, seed);
            along *= wanted / walk.length_m().max(0.1);
        }
        walk
    }

    fn at_speed(plan: &WalkPlan, tour: &Tour, config: &WalkConfig, seed: u64) -> Self {
        let rng = stream(seed, "gait", plan.gait.step_m.to_bits());
        let phases: [f64; 10] =
            std::array::from_fn(|_| f64::from(uniform(&rng, 0.0, std::f32::consts::TAU)));
        let travel = Travel::new(tour, config, 0.0);
        let gait = plan.gait;
        let on_the_spot = matches!(plan.gaze, Gaze::Turning | Gaze::Facing | Gaze::Board);
        let balance = (!on_the_spot).then(|| Balance::of(seed, plan.gait.step_m.to_bits()));
        let curve = QuinticSpline::following(config.duration_s, KNOT_S, |t| {
            let (s, speed) = travel.at(t);
            let pace = (speed / 1.0).min(1.0);
            let step = TAU * s / gait.step_m;
            let [x, y, z] = tour.point(s);
            let heading = tour.heading(s + 0.1);
            let awake = smooth_step((t - config.rest_s) / 1.0)
                * smooth_step((config.duration_s - config.final_rest_s - t) / 1.0);
            let sway = gait.sway_m * pace * (0.5 * step + phases[0]).sin();
            let roll = 0.022 * pace * (0.5 * step + phases[5]).sin()
                + 0.02 * awake * wave(t, 0.4, phases[6]);
            let mut pose = [
                x - sway * heading.sin(),
                y + sway * heading.cos(),
                z + config.height_m + gait.bob_m * pace * step.sin(),
                heading + 0.03 * pace * (0.5 * step + phases[3]).sin(),
                gait.nod_rad * pace * (step + phases[7]).sin(),
                roll,
            ];
            let look = look(plan.gaze, t, config, awake, &phases);
            for (value, turned) in pose.iter_mut().zip(look) {
                *value += turned;
            }
            if let Some(balance) = &balance {
                let leans = balance.at(t, heading, config);
                for (value, leant) in pose.iter_mut().zip(leans) {
                    *value += leant;
                }
            }
            if on_the_spot {
                // On the spot the way one happens to shuffle does not turn the head.
                pose[3] -= heading;
            }
            pose
        });
        Self {
            duration_s: config.duration_s,
            curve,
        }
    }

    /// Length of the path of the rig, metres, at the rate of the images.
    pub fn length_m(&self) -> f64 {
        let steps = (self.duration_s * FRAME_RATE_HZ) as usize;
        let place = |k: usize| {
            let time_s = k as f64 / FRAME_RATE_HZ;
            self.at(time_s).world_from_rig.translation
        };
        let mut length = 0.0;
        let mut last = place(0);
        for k in 1..=steps {
            let next = place(k);
            length += (next - last).norm();
            last = next;
        }
        length
    }
}

/// What a way of looking adds to x, y, z, yaw, pitch and roll.
fn look(gaze: Gaze, t: f64, config: &WalkConfig, awake: f64, p: &[f64; 10]) -> [f64; 6] {
    let head = |yaw: f64, pitch: f64| [0.0, 0.0, 0.0, yaw, awake * pitch, 0.0];
    let w = |hz: f64, k: usize| wave(t, hz, p[k]);
    match gaze {
        Gaze::Steady => head(awake * 0.05 * w(0.31, 1), 0.02 * w(0.23, 2)),
        Gaze::Ahead => head(
            awake * (0.10 * w(0.13, 1) + 0.05 * w(0.29, 2)),
            0.05 + 0.05 * w(0.17, 3),
        ),
        Gaze::AroundSlow => head(
            awake * (0.75 * w(0.085, 1) + 0.22 * w(0.21, 2)),
            0.05 + 0.13 * w(0.11, 3) + 0.05 * w(0.31, 4),
        ),
        Gaze::AroundFast => head(
            awake * (0.95 * w(0.24, 1) + 0.3 * w(0.53, 2)),
            0.05 + 0.2 * w(0.27, 3) + 0.07 * w(0.6, 4),
        ),
        Gaze::Left => head(
            FRAC_PI_2 + awake * 0.12 * w(0.15, 1),
            0.04 + 0.05 * w(0.2, 3),
        ),
        Gaze::Right => head(
            -FRAC_PI_2 + awake * 0.12 * w(0.15, 1),
            -0.1 + 0.1 * w(0.2, 3),
        ),
        Gaze::Turning => {
            let turn = (t - config.rest_s).max(0.0) * TAU / 14.0;
            let swing = 0.5 * awake * w(0.22, 2);
            head(awake * turn + swing, 0.12 * w(0.13, 3) + 0.05 * w(0.4, 4))
        }
        Gaze::Facing => board(t, config, awake, p, 1.0),
        Gaze::Board => board(t, config, awake, p, 4.0),
    }
}

/// Hand-held in front of a board: every axis moves, at rates that no two share; each of some sides of the rig faces
/// the board for its part of the time.
fn board(t: f64, config: &WalkConfig, awake: f64, p: &[f64; 10], sides: f64) -> [f64; 6] {
    let w = |hz: f64, k: usize| awake * wave(t, hz, p[k]);
    let active = config.duration_s - config.rest_s - config.final_rest_s;
    let share = ((t - config.rest_s) / active).clamp(0.0, 1.0) * sides;
    let side = share.floor().min(sides - 1.0);
    // Turned within the last two seconds of each part.
    let part_s = active / sides;
    let turning = smooth_step(1.0 - (side + 1.0 - share) * part_s / 2.0);
    let faced = side + if side + 1.0 < sides { turning } else { 0.0 };
    [
        0.18 * w(0.31, 0) + 0.1 * w(0.83, 1),
        0.28 * w(0.37, 2) + 0.1 * w(0.71, 3),
        0.22 * w(0.43, 4) + 0.07 * w(0.91, 5),
        -FRAC_PI_2 * faced + 0.3 * w(0.29, 6) + 0.12 * w(0.67, 7),
        0.2 * w(0.34, 8) + 0.08 * w(0.77, 9),
        0.32 * w(0.26, 1) + 0.1 * w(0.59, 0),
    ]
}

/// The speed on the straight at which a walk gets as far as wanted in its time.
fn speed_for(tour: &Tour, config: &WalkConfig, length_m: f64) -> f64 {
    let mean = length_m / config.duration_s;
    let (mut slow, mut fast) = (0.5 * mean, 4.0 * mean);
    for _ in 0..12 {
        let speed_m_s = 0.5 * (slow + fast);
        let trial = WalkConfig {
            speed_m_s,
            ..config.clone()
        };
        if Travel::new(tour, &trial, 0.0).at(config.duration_s).0 < length_m {
            slow = speed_m_s;
        } else {
            fast = speed_m_s;
        }
    }
    0.5 * (slow + fast)
}
