//! Which localized poses belong together: each votes for those that the IMU leads to from it.
//!
//! Between two instants the IMU gives the rotation, and the change of position up to the velocity at the first. A pair of
//! localized poses fixes that velocity, so that every third one between and after them can be foretold: what arrives there
//! agrees. Poses that agree, directly or through others, are a consistent set. A place that looks like another makes a set
//! of its own, however often it is found; poses found by chance make none.
//!
//! Without an IMU a body goes on as it did, more or less: only poses that follow one another closely can agree then.

use std::cmp::Reverse;

use lsfb_geometry::{Vector3, so3};
use rayon::prelude::*;

use super::GroundTruthConfig;
use super::dead_reckoning::DeadReckoning;
use super::inertial::{ANY_ACCELERATION_M_S2, ANY_TURN_RAD_S, any_motion};
use super::walk::{FrameState, LocalizedPose, Walk};
use lsfb_perception::imu::{ImuBias, NavState, PreintegratedImu, standard_gravity_m_s2};

/// Localized instants after one that it is compared with, at most.
const PARTNERS: usize = 12;
/// How long after it they may be, seconds: then nothing but the position of another room could be told from the right one.
const REACH_SECS: f64 = 3.0;
/// Standard deviations by which two that agree may differ.
const DEVIATIONS: f64 = 4.0;
/// A comparison that would let pass more than this says nothing, metres.
const LARGEST_TOLERANCE_M: f64 = 1.0;
/// Poses that must agree before they count: two always do, by the velocity that leads from one to the other.
const FEWEST: usize = 3;

/// Sets of frames whose localized poses agree through the IMU, each in order of time, the largest first; poses with which
/// no two others agree are in none.
pub(super) fn consistent_sets(
    walk: &Walk,
    imu: &DeadReckoning,
    config: &GroundTruthConfig,
) -> Vec<Vec<usize>> {
    let localized: Vec<usize> = (0..walk.frames.len())
        .filter(|k| walk.frames[*k].localized.is_some())
        .collect();
    let agreeing: Vec<Vec<usize>> = localized
        .par_iter()
        .map(|frame| most_that_agree(&foretold(walk, imu.intervals(), *frame, config)))
        .collect();
    let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); walk.frames.len()];
    for members in agreeing.iter().filter(|members| members.len() >= FEWEST) {
        for other in &members[1..] {
            neighbours[members[0]].push(*other);
            neighbours[*other].push(members[0]);
        }
    }
    let mut sets = connected(&neighbours);
    sets.retain(|set| set.len() >= FEWEST);
    // The sort is stable: of equals the one that begins first.
    sets.sort_by_key(|set| Reverse(set.len()));
    sets
}

/// The nodes of each connected part of a graph, in order.
fn connected(neighbours: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let mut reached = vec![false; neighbours.len()];
    let mut parts = Vec::new();
    for start in 0..neighbours.len() {
        let (mut part, mut next) = (Vec::new(), vec![start]);
        while let Some(node) = next.pop() {
            if !std::mem::replace(&mut reached[node], true) {
                part.push(node);
                next.extend(&neighbours[node]);
            }
        }
        part.sort_unstable();
        parts.push(part);
    }
    parts
}

/// A localized pose as seen from an earlier one.
struct Foretold {
    frame: usize,
    /// Time since the earlier one, seconds; zero for itself.
    after_secs: f64,
    /// Where it lies beyond what the earlier one's position, IMU and gravity explain: that must be its velocity times
    /// the time. Metres, in the world.
    moved_m: Vector3<f64>,
    /// Standard deviation of its position, metres.
    sigma_m: f64,
    /// Standard deviation of the acceleration that led to it, m/s².
    acceleration_sigma_m_s2: f64,
}

/// The localized pose of `first` itself, then those after it whose rotation is what the gyroscope leads to.
fn foretold(
    walk: &Walk,
    intervals: &[Option<PreintegratedImu>],
    first: usize,
    config: &GroundTruthConfig,
) -> Vec<Foretold> {
    let Some(from) = walk.frames[first].localized else {
        return Vec::new();
    };
    let mut state = NavState {
        world_from_rig: from.world_from_rig,
        velocity_m_s: Vector3::zeros(),
    };
    let mut found = vec![Foretold {
        frame: first,
        after_secs: 0.0,
        moved_m: Vector3::zeros(),
        sigma_m: sigma_m(&from, config),
        acceleration_sigma_m_s2: 0.0,
    }];
    let gravity = standard_gravity_m_s2();
    for (frame, interval) in intervals.iter().enumerate().skip(first) {
        let next = &walk.frames[frame + 1];
        let unmeasured = || {
            let from = FrameState {
                nav: state,
                bias: ImuBias::default(),
            };
            any_motion(&from, next.time.secs_since(walk.frames[frame].time))
        };
        let interval = match interval {
            Some(interval) => interval,
            None if walk.has_imu() => break,
            None => &unmeasured(),
        };
        state = interval.predict(&state, &ImuBias::default(), &gravity);
        let after_secs = next.time.secs_since(walk.frames[first].time);
        if after_secs > REACH_SECS || found.len() > PARTNERS {
            break;
        }
        let Some(to) = next.localized else { continue };
        let turned = state.world_from_rig.rotation.inverse() * to.world_from_rig.rotation;
        let (sigma, other) = (sigma_rad(&from, config), sigma_rad(&to, config));
        let (turn_rad_s, bias_m_s2) = match walk.has_imu() {
            true => (config.gyro_bias_sigma_rad_s, config.accel_bias_sigma_m_s2),
            false => (ANY_TURN_RAD_S, ANY_ACCELERATION_M_S2),
        };
        let drift_rad = turn_rad_s * after_secs;
        if so3::log(&turned).norm() > DEVIATIONS * sigma.hypot(other) + 2.0 * drift_rad {
            continue;
        }
        // A rotation that is off turns gravity into what an accelerometer feels.
        let tilt_rad = match walk.has_imu() {
            true => sigma + drift_rad,
            false => 0.0,
        };
        found.push(Foretold {
            frame: frame + 1,
            after_secs,
            moved_m: to.world_from_rig.translation - state.world_from_rig.translation,
            sigma_m: sigma_m(&to, config),
            acceleration_sigma_m_s2: bias_m_s2.hypot(gravity.norm() * tilt_rad),
        });
    }
    found
}

/// Most frames, the first among them, that one velocity explains.
fn most_that_agree(foretold: &[Foretold]) -> Vec<usize> {
    let Some((first, others)) = foretold.split_first() else {
        return Vec::new();
    };
    let mut most = Vec::new();
    for partner in others {
        let agrees =
            |other: &&Foretold| other.frame == partner.frame || confirms(first, partner, other);
        let members: Vec<usize> = std::iter::once(first.frame)
            .chain(others.iter().filter(agrees).map(|other| other.frame))
            .collect();
        if members.len() > most.len() {
            most = members;
        }
    }
    most
}

/// Whether `other` is where the velocity from `first` to `partner` leads to, as nearly as it can be told.
fn confirms(first: &Foretold, partner: &Foretold, other: &Foretold) -> bool {
    let share = other.after_secs / partner.after_secs;
    let seen_m = (first.sigma_m * (1.0 - share))
        .hypot(partner.sigma_m * share)
        .hypot(other.sigma_m);
    let acceleration = partner
        .acceleration_sigma_m_s2
        .max(other.acceleration_sigma_m_s2);
    let lever_s2 = 0.5 * other.after_secs * (other.after_secs - partner.after_secs).abs();
    let tolerance_m = DEVIATIONS * seen_m + 2.0 * acceleration * lever_s2;
    tolerance_m <= LARGEST_TOLERANCE_M
        && (other.moved_m - partner.moved_m * share).norm() <= tolerance_m
}

/// Standard deviation of a localized position, metres: what is claimed for this one, and what holds for all.
fn sigma_m(pose: &LocalizedPose, config: &GroundTruthConfig) -> f64 {
    let claimed = pose.covariance.fixed_view::<3, 3>(3, 3).trace();
    (claimed / 3.0)
        .max(0.0)
        .sqrt()
        .hypot(config.localization_sigma_m)
}

/// Standard deviation of a localized attitude, radians.
fn sigma_rad(pose: &LocalizedPose, config: &GroundTruthConfig) -> f64 {
    let claimed = pose.covariance.fixed_view::<3, 3>(0, 0).trace();
    (claimed / 3.0)
        .max(0.0)
        .sqrt()
        .hypot(config.localization_sigma_rad)
}
