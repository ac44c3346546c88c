//! The motion that the LiDAR does not see at the moment, for the operator.

use std::time::{Duration, Instant};

use lsfb_operator::{UnseenKind, UnseenMotion};
use lsfb_pipeline::odometry::{MotionKind, OdometryStep};

/// Shown for so long after the last scan that did not see it: a line that flickers is not read.
const SHOWN_FOR: Duration = Duration::from_secs(1);

/// What scans did not see last.
#[derive(Debug, Default)]
pub struct Unseen {
    last: Option<(Instant, UnseenMotion)>,
}

impl Unseen {
    /// Takes what a scan gave.
    pub fn take(&mut self, step: &OdometryStep, now: Instant) {
        if let Some(unseen) = step.unseen {
            let motion = UnseenMotion {
                kind: match unseen.kind {
                    MotionKind::Shift => UnseenKind::Shift,
                    MotionKind::Turn => UnseenKind::Turn,
                },
                direction_in_map: unseen.direction_in_world.into(),
            };
            self.last = Some((now, motion));
        }
    }

    /// What is shown now.
    pub fn shown(&self, now: Instant) -> Option<UnseenMotion> {
        let (since, motion) = self.last?;
        (now.duration_since(since) <= SHOWN_FOR).then_some(motion)
    }
}

/// What the operator reads.
pub fn sentence_of(motion: &UnseenMotion) -> String {
    let what = match motion.kind {
        UnseenKind::Shift => "how far you walk along the dashed line",
        UnseenKind::Turn => "how you turn",
    };
    format!(
        "The LiDAR cannot see {what}: everything here looks the same. Walk steadily on to where there is more to see."
    )
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector3;
    use lsfb_pipeline::odometry::{StepOutcome, Unseen as UnseenByScan};

    use super::super::odometry::tests::step;
    use super::*;

    #[test]
    fn what_is_not_seen_is_shown_until_it_is_seen_again() {
        let (mut unseen, began) = (Unseen::default(), Instant::now());
        assert_eq!(unseen.shown(began), None);
        let seeing = |end_ms| step(end_ms, StepOutcome::Registered);
        let mut blind = seeing(99);
        blind.unseen = Some(UnseenByScan {
            direction_in_world: Vector3::y(),
            kind: MotionKind::Shift,
        });
        unseen.take(&blind, began);
        unseen.take(&seeing(199), began + SHOWN_FOR / 2);
        let shown = unseen.shown(began + SHOWN_FOR / 2).expect("a motion");
        assert_eq!(shown.direction_in_map, [0.0, 1.0, 0.0]);
        assert!(sentence_of(&shown).contains("dashed line"));
        assert_eq!(unseen.shown(began + SHOWN_FOR * 2), None);
    }
}
