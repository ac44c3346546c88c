//! The start of a walk, looked at again once its motion has told the gyroscope's bias.
//!
//! Nobody stands like a tripod: people sway by some milliradians, slowly, so the mean rate of a second or two of standing is the gyroscope's
//! bias to some milliradians a second only. Scans tell less in that time (see `first_second`), so what the first second of motion maps is turned by as
//! much, and all that is mapped later inherits it. After some seconds of motion scans have told the bias ten times better. The
//! walk is then begun again with it, beside the one that goes on, a few scans at a time, and takes its place once it has caught up.

use std::collections::VecDeque;

use lsfb_types::{ImuSample, LidarScan, Stamped, Timestamp};

use super::inertial::KnownBias;
use super::motion::Motion;
use super::{Odometry, OdometryStep, StepOutcome};

/// Who stands longer knows the bias well enough by that, seconds.
const LONG_STAND_S: f64 = 5.0;
/// Motion that tells the bias, seconds.
const TELLING_S: f64 = 3.0;
/// Motion that tells it no better than this tells too little, rad/s: scans are rare then, or see little.
const KNOWN_RAD_S: f64 = 0.002;
/// Scans taken anew with each that comes: so many times as long a scan takes until the walk has caught up.
const AT_A_TIME: usize = 2;

/// The walk as it was before its first scan, until it has been begun again.
#[derive(Clone, Debug)]
pub(super) struct LearnedStart {
    /// Before its first scan; once the bias is known, as far as it has caught up.
    begun: Box<Odometry>,
    stage: Stage,
    /// What standing said of the bias: what motion says of it must be that.
    at_rest: Option<KnownBias>,
    /// Scans that it has not taken.
    waiting: VecDeque<Stamped<LidarScan>>,
    /// What it made of those that it has.
    steps: Vec<OdometryStep>,
}

#[derive(Clone, Copy, Debug)]
enum Stage {
    /// Nothing has moved.
    Standing,
    /// In motion since then.
    Telling(Timestamp),
    CatchingUp,
}

impl LearnedStart {
    /// Before the first scan; `None` for a walk without an IMU.
    pub fn before(odometry: &Odometry) -> Option<Self> {
        matches!(&odometry.motion, Motion::Inertial(m) if m.gyro_bias.is_none()).then(|| Self {
            begun: Box::new(odometry.clone()),
            stage: Stage::Standing,
            at_rest: None,
            waiting: VecDeque::new(),
            steps: Vec::new(),
        })
    }

    /// Takes a sample that came after the first scan.
    pub fn push_imu(&mut self, sample: &Stamped<ImuSample>) {
        self.begun.push_imu(sample);
    }

    /// Looks at what a scan gave; gives what it gives in the walk begun again, where that has caught up.
    pub fn go_on(
        mut self,
        odometry: &mut Odometry,
        scan: &Stamped<LidarScan>,
        step: OdometryStep,
    ) -> OdometryStep {
        if step.outcome == StepOutcome::Lost {
            odometry.learned_start = Some(self);
            return step;
        }
        self.waiting.push_back(scan.clone());
        let Some(stage) = self.next_stage(odometry, step.time) else {
            return step;
        };
        self.stage = stage;
        if matches!(stage, Stage::CatchingUp) {
            if !self.catch_up() {
                return step;
            }
            if self.waiting.is_empty()
                && let Some(last) = self.steps.pop()
            {
                *odometry = *self.begun;
                return last.instead_of(self.steps);
            }
        }
        odometry.learned_start = Some(self);
        step
    }

    /// `None` where the walk is not to be begun again.
    fn next_stage(&mut self, odometry: &Odometry, now: Timestamp) -> Option<Stage> {
        let begun = self.waiting.front().map_or(now, |scan| scan.time);
        match self.stage {
            Stage::Standing if odometry.stands() => {
                self.at_rest = known_bias(odometry, begun);
                (now.secs_since(begun) < LONG_STAND_S).then_some(Stage::Standing)
            }
            // In motion from its first scan on.
            Stage::Standing if self.waiting.len() == 1 => None,
            Stage::Standing => Some(Stage::Telling(now)),
            Stage::Telling(since) if now.secs_since(since) < TELLING_S => Some(self.stage),
            Stage::Telling(_) => {
                let bias = known_bias(odometry, begun)?;
                // An axis that reads too much, or another's turns, looks like a bias while the carrier turns.
                if bias.sigma_rad_s.max() > KNOWN_RAD_S || !bias.agrees(&self.at_rest?) {
                    return None;
                }
                if let Motion::Inertial(motion) = &mut self.begun.motion {
                    motion.gyro_bias = Some(bias);
                }
                Some(Stage::CatchingUp)
            }
            Stage::CatchingUp => Some(Stage::CatchingUp),
        }
    }

    /// Takes some of the scans that wait; whether all found their place.
    fn catch_up(&mut self) -> bool {
        for _ in 0..AT_A_TIME {
            let Some(scan) = self.waiting.pop_front() else {
                break;
            };
            match self.begun.take_as_it_comes(&scan) {
                Ok(mut step) if step.outcome != StepOutcome::Lost => {
                    if step.begins_again() {
                        self.steps = std::mem::take(&mut step.anew);
                    }
                    self.steps.push(step);
                }
                _ => return false,
            }
        }
        true
    }
}

fn known_bias(odometry: &Odometry, begun: Timestamp) -> Option<KnownBias> {
    match &odometry.motion {
        Motion::Inertial(told) => Some(told.filter.as_ref()?.known_bias(begun)),
        Motion::Constant { .. } => None,
    }
}
