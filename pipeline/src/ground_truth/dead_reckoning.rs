//! Where the IMU alone leads to, and what lies between what is known.

use std::ops::Range;

use lsfb_geometry::{Se3, Vector3, so3};

use super::walk::{Frame, FrameState, Walk};
use crate::Error;
use lsfb_perception::imu::{ImuBias, NavState, PreintegratedImu};

/// How a walk moves from each frame to the next; where the IMU says nothing, straight on.
pub(super) struct DeadReckoning {
    /// Between neighbouring frames.
    intervals: Vec<Option<PreintegratedImu>>,
    /// Times of the frames since the first one.
    secs: Vec<f64>,
}

impl DeadReckoning {
    pub fn of(walk: &Walk) -> Result<Self, Error> {
        let since_first = |frame: &Frame| frame.time.secs_since(walk.frames[0].time);
        Ok(Self {
            secs: walk.frames.iter().map(since_first).collect(),
            intervals: walk.preintegrate(0..walk.frames.len(), |_| ImuBias::default()),
        })
    }

    /// The IMU's sums between neighbouring frames, without a bias; `None` where samples are missing.
    pub fn intervals(&self) -> &[Option<PreintegratedImu>] {
        &self.intervals
    }

    /// Whether the IMU measured all of the interval after a frame; there is none after the last.
    pub fn is_measured(&self, frame: usize) -> bool {
        self.intervals.get(frame).is_some_and(Option::is_some)
    }

    /// Replaces the states outside of some frames by what the first and the last of these lead to.
    pub fn carry_on(
        &self,
        states: &mut [FrameState],
        from: Range<usize>,
        gravity_m_s2: &Vector3<f64>,
    ) {
        for k in (0..from.start).rev() {
            states[k] = self.before(k, &states[k + 1], gravity_m_s2);
        }
        for k in from.end.max(1)..states.len() {
            states[k] = self.after(k - 1, &states[k - 1], gravity_m_s2);
        }
    }

    /// States from one frame to another one whose poses are known, both among them: the IMU's motion with this bias, turned and moved so that it
    /// ends there.
    pub fn between(
        &self,
        [from, to]: [(usize, Se3); 2],
        bias: ImuBias,
        gravity_m_s2: &Vector3<f64>,
    ) -> Vec<FrameState> {
        let whole_secs = (self.secs[to.0] - self.secs[from.0]).max(f64::MIN_POSITIVE);
        // About an axis of the world: so the turns add up, however the body is turned.
        let along = |rate_rad_s: Vector3<f64>| {
            let mut states = vec![FrameState {
                nav: standing(from.1),
                bias,
            }];
            for k in from.0..to.0 {
                let mut next = self.after(k, &states[k - from.0], gravity_m_s2);
                let pose = &mut next.nav.world_from_rig;
                let turn = pose.rotation.inverse() * (rate_rad_s * self.step_secs(k));
                pose.rotation = so3::retract(&pose.rotation, &turn);
                states.push(next);
            }
            states
        };
        let end = |states: &[FrameState]| states[to.0 - from.0].nav.world_from_rig;
        let unturned = end(&along(Vector3::zeros())).rotation;
        let missing_rad = unturned * so3::local(&unturned, &to.1.rotation);
        let mut states = along(missing_rad / whole_secs);
        let missing_m_s = (to.1.translation - end(&states).translation) / whole_secs;
        for (state, secs) in states.iter_mut().zip(&self.secs[from.0..]) {
            state.nav.world_from_rig.translation += missing_m_s * (secs - self.secs[from.0]);
            state.nav.velocity_m_s += missing_m_s;
        }
        states
    }

    /// The state that follows this one of frame `k`.
    fn after(&self, k: usize, state: &FrameState, gravity_m_s2: &Vector3<f64>) -> FrameState {
        let FrameState { nav, bias } = *state;
        let nav = match &self.intervals[k] {
            Some(interval) => interval.predict(&nav, &bias, gravity_m_s2),
            None => {
                let Se3 {
                    rotation,
                    translation,
                } = nav.world_from_rig;
                let moved = nav.velocity_m_s * self.step_secs(k);
                NavState {
                    world_from_rig: Se3::new(rotation, translation + moved),
                    ..nav
                }
            }
        };
        FrameState { nav, bias }
    }

    /// The state of frame `k` that this one follows.
    fn before(&self, k: usize, next: &FrameState, gravity_m_s2: &Vector3<f64>) -> FrameState {
        let FrameState { nav, bias } = *next;
        let turn = self.intervals[k]
            .as_ref()
            .map_or_else(Default::default, |interval| {
                interval.corrected(&bias).rotation
            });
        let rotation = nav.world_from_rig.rotation * turn.inverse();
        // From rest there the interval leads to some velocity and place: what they lack was there before.
        let rest = FrameState {
            nav: standing(Se3::new(rotation, Vector3::zeros())),
            bias,
        };
        let led_to = self.after(k, &rest, gravity_m_s2).nav;
        let velocity_m_s = nav.velocity_m_s - led_to.velocity_m_s;
        let moved = led_to.world_from_rig.translation + velocity_m_s * self.step_secs(k);
        let world_from_rig = Se3::new(rotation, nav.world_from_rig.translation - moved);
        FrameState {
            nav: NavState {
                world_from_rig,
                velocity_m_s,
            },
            bias,
        }
    }

    fn step_secs(&self, k: usize) -> f64 {
        self.secs[k + 1] - self.secs[k]
    }
}

fn standing(world_from_rig: Se3) -> NavState {
    NavState {
        world_from_rig,
        velocity_m_s: Vector3::zeros(),
    }
}
