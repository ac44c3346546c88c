//! Stretches of a walk in which scans do not see all of the motion.

use lsfb_geometry::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::OdometryStep;
use super::degeneracy::MotionKind;

/// Stretches that are nearer to each other are one, seconds.
const JOINED_S: f64 = 1.0;
/// Directions within this of each other are one: cosine of 30°.
const SAME_DIRECTION: f64 = 0.866;
/// Shorter ones are no news, seconds: the next scans see what these did not.
const LEAST_S: f64 = 0.3;
/// Stretches after which the pose is known better than this are no news: metres and radians.
const LEAST_SHIFT_M: f64 = 0.05;
const LEAST_TURN_RAD: f64 = 0.02;

/// A stretch in which scans do not see a motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnseenStretch {
    /// First and last scan, seconds after the first scan of all.
    pub from_s: f64,
    /// See `from_s`.
    pub to_s: f64,
    /// Scans that do not see it.
    pub scans: u64,
    /// Whether it is a shift or a turn.
    pub motion: MotionKind,
    /// Its direction or axis in the world.
    pub direction_in_world: [f64; 3],
    /// Standard deviation of the last pose along or about it, relative to the first pose: metres or radians.
    pub sigma_at_end: f64,
}

/// Gathers them, scan by scan.
#[derive(Clone, Debug, Default)]
pub(super) struct UnseenStretches {
    first_scan: Option<lsfb_types::Timestamp>,
    all: Vec<UnseenStretch>,
}

impl UnseenStretches {
    pub fn take(&mut self, step: &OdometryStep) {
        let start = *self.first_scan.get_or_insert(step.time);
        let Some(unseen) = &step.unseen else {
            return;
        };
        let at_s = step.time.secs_since(start);
        let sigma_at_end = unseen.sigma(&step.world_from_rig, &step.covariance);
        let continued = self.all.iter_mut().rev().find(|s| {
            let direction = Vector3::from(s.direction_in_world);
            at_s - s.to_s < JOINED_S
                && s.motion == unseen.kind
                && direction.dot(&unseen.direction_in_world).abs() > SAME_DIRECTION
        });
        match continued {
            Some(stretch) => {
                stretch.to_s = at_s;
                stretch.scans += 1;
                stretch.sigma_at_end = sigma_at_end;
            }
            None => self.all.push(UnseenStretch {
                from_s: at_s,
                to_s: at_s,
                scans: 1,
                motion: unseen.kind,
                direction_in_world: positive(&unseen.direction_in_world),
                sigma_at_end,
            }),
        }
    }

    /// Those that leave a pose uncertain, in a world turned by `level`.
    pub fn finish(self, level: &UnitQuaternion<f64>) -> Vec<UnseenStretch> {
        let lasting = self.all.into_iter().filter(|s| {
            let least = match s.motion {
                MotionKind::Shift => LEAST_SHIFT_M,
                MotionKind::Turn => LEAST_TURN_RAD,
            };
            s.to_s - s.from_s > LEAST_S && s.sigma_at_end > least
        });
        lasting
            .map(|s| UnseenStretch {
                direction_in_world: positive(&(level * Vector3::from(s.direction_in_world))),
                ..s
            })
            .collect()
    }
}

/// Of a direction and its opposite the one whose largest component is positive.
fn positive(direction: &Vector3<f64>) -> [f64; 3] {
    let largest = direction[direction.iamax()];
    (direction * largest.signum()).into()
}

impl UnseenStretch {
    /// How uncertain the last pose is: metres or degrees.
    pub(super) fn sigma_with_unit(&self) -> (f64, &'static str) {
        match self.motion {
            MotionKind::Shift => (self.sigma_at_end, "m"),
            MotionKind::Turn => (self.sigma_at_end.to_degrees(), "°"),
        }
    }
}

/// As a sentence.
impl std::fmt::Display for UnseenStretch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.direction_in_world;
        let (word, sigma) = match self.motion {
            MotionKind::Shift => ("along", format!("{:.2} m", self.sigma_at_end)),
            MotionKind::Turn => ("about", format!("{:.2}°", self.sigma_at_end.to_degrees())),
        };
        write!(
            f,
            "from {:.1} to {:.1} s, {} scans do not constrain the motion {word} ({x:.2}, {y:.2}, {z:.2}): the pose is then uncertain by {sigma} {word} it (one standard deviation)",
            self.from_s, self.to_s, self.scans
        )
    }
}
