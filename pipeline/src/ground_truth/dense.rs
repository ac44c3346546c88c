//! What the device did between images: the IMU leads from frame to frame, and what it then misses the next one by is spread over the way.

use lsfb_geometry::{Se3, Vector3};
use lsfb_types::Timestamp;

use super::optimization::Optimized;
use super::walk::{FrameState, Walk};
use crate::Error;
use lsfb_perception::imu::{ImuBias, NavState, PreintegratedImu};

/// Motion of the device at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenseState {
    /// When.
    pub time: Timestamp,
    /// Pose and velocity of the IMU in the map's world.
    pub nav: NavState,
    /// Of the IMU, as it is subtracted from what it reads.
    pub bias: ImuBias,
    /// How fast it turns, without bias, in its own frame, rad/s.
    pub turn_rate_rad_s: Vector3<f64>,
}

/// The states of some frames, in order, and of every inertial sample between two that are neighbours in the walk.
///
/// Of images alone there are the states of the frames. Errors of a few samples between two frames are the IMU's noise over so long; on the whole
/// they are those of the frames.
pub(super) fn dense_states(
    walk: &Walk,
    solved: &Optimized,
    frames: &[usize],
) -> Result<Vec<DenseState>, Error> {
    let states = &solved.estimate.states;
    let mut dense = Vec::new();
    for (n, &k) in frames.iter().enumerate() {
        dense.push(at_frame(walk, solved, k));
        if frames.get(n + 1) != Some(&(k + 1)) {
            continue;
        }
        let (from, to) = (walk.frames[k].time, walk.frames[k + 1].time);
        let begin = walk.imu.partition_point(|s| s.time <= from);
        let end = walk.imu.partition_point(|s| s.time < to);
        let way = Way {
            walk,
            solved,
            from,
            state: &states[k],
        };
        let Some(led) = way.at(to) else {
            continue;
        };
        let next = &states[k + 1].nav;
        let missed = (led.world_from_rig.inverse() * next.world_from_rig).log();
        let missed_m_s = next.velocity_m_s - led.velocity_m_s;
        for sample in &walk.imu[begin..end] {
            let Some(led) = way.at(sample.time) else {
                continue;
            };
            let share = sample.time.secs_since(from) / to.secs_since(from);
            let bias = between(&states[k].bias, &states[k + 1].bias, share);
            dense.push(DenseState {
                time: sample.time,
                nav: NavState {
                    world_from_rig: led.world_from_rig * Se3::exp(&(missed * share)),
                    velocity_m_s: led.velocity_m_s + missed_m_s * share,
                },
                bias,
                turn_rate_rad_s: turn_rate(
                    solved,
                    &sample.sample.angular_velocity_rad_s.into(),
                    &bias,
                ),
            });
        }
    }
    Ok(dense)
}

/// The state of a frame; how fast it turns by the samples beside it.
fn at_frame(walk: &Walk, solved: &Optimized, k: usize) -> DenseState {
    let FrameState { nav, bias } = solved.estimate.states[k];
    let time = walk.frames[k].time;
    if !walk.has_imu() {
        return DenseState {
            time,
            nav,
            bias,
            turn_rate_rad_s: solved.estimate.motions[k].turn_rate_rad_s,
        };
    }
    let after = walk.imu.partition_point(|s| s.time < time);
    let read = |at: usize| {
        let sample = walk.imu.get(at)?;
        Some((
            sample.time,
            Vector3::from(sample.sample.angular_velocity_rad_s),
        ))
    };
    let read = match (after.checked_sub(1).and_then(read), read(after)) {
        (Some((from, a)), Some((to, b))) if to > from => {
            a + (b - a) * (time.secs_since(from) / to.secs_since(from))
        }
        (Some((_, a)), _) | (None, Some((_, a))) => a,
        (None, None) => Vector3::zeros(),
    };
    DenseState {
        time,
        nav,
        bias,
        turn_rate_rad_s: turn_rate(solved, &read, &bias),
    }
}

fn turn_rate(solved: &Optimized, read: &Vector3<f64>, bias: &ImuBias) -> Vector3<f64> {
    solved.imu_errors.true_turn_rate(&(read - bias.gyro_rad_s))
}

fn between(a: &ImuBias, b: &ImuBias, share: f64) -> ImuBias {
    ImuBias {
        gyro_rad_s: a.gyro_rad_s.lerp(&b.gyro_rad_s, share),
        accel_m_s2: a.accel_m_s2.lerp(&b.accel_m_s2, share),
    }
}

/// What the IMU makes of the motion from a frame on.
struct Way<'a> {
    walk: &'a Walk,
    solved: &'a Optimized,
    from: Timestamp,
    state: &'a FrameState,
}

impl Way<'_> {
    /// `None` where samples are missing.
    fn at(&self, time: Timestamp) -> Option<NavState> {
        let FrameState { nav, bias } = self.state;
        let (imu, noise) = (&self.walk.imu, &self.walk.noise);
        let sum = PreintegratedImu::integrate(imu, self.from, time, *bias, noise).ok()?;
        let errors = &self.solved.imu_errors;
        let change = sum.corrected_by(bias, errors);
        let (dt, rotation) = (sum.duration_secs, nav.world_from_rig.rotation);
        let gravity = self.solved.gravity_m_s2;
        // The IMU's metres are `1 - s` of the world's.
        let enlarged = (1.0 - errors.world_scale).recip();
        let gained = (gravity * dt + rotation * change.velocity_m_s) * enlarged;
        let moved = (gravity * (0.5 * dt * dt) + rotation * change.position_m) * enlarged;
        Some(NavState {
            world_from_rig: Se3::new(
                rotation * change.rotation,
                nav.world_from_rig.translation + nav.velocity_m_s * dt + moved,
            ),
            velocity_m_s: nav.velocity_m_s + gained,
        })
    }
}
