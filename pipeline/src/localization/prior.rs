//! What is known of a pose before its images are asked: which way is up, and where the rig should be.
//!
//! Poses that contradict it are not looked at, and of matches with few that agree those two suffice for a pose that three determine without it
//! (`upright`). As the images knew nothing of it, a pose that agrees with it is the less likely one of chance: by the share of all poses
//! that would agree.

use std::f64::consts::PI;

use lsfb_geometry::{Matrix6, Se3, Vector3};

use crate::worst_sigma::worst_sigmas;

/// What is known of a pose beforehand; nothing by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseKnowledge {
    /// Which way is up, in a map whose z axis points there.
    pub up: Option<Up>,
    /// Where the rig should be.
    pub pose: Option<ExpectedPose>,
}

/// Which way is up, as an accelerometer has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up {
    /// Unit vector in the rig frame.
    pub in_rig: Vector3<f64>,
    /// Standard deviation of its direction, radians.
    pub sigma_rad: f64,
}

/// Where a rig should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedPose {
    /// There.
    pub world_from_rig: Se3,
    /// Tangent `[rotation, translation]` on the right, rad² and m².
    pub covariance: Matrix6<f64>,
}

/// Standard deviations beyond which a pose contradicts what is known.
const MOST_SIGMAS: f64 = 3.5;
/// The pose is one of those in a room of this size, metres.
const ROOM_M: f64 = 10.0;
/// Decades that up and the pose count for at most: wrong poses are not spread evenly, people hold their devices upright, and where they were before.
pub(super) const DECADES_OF_UP: f64 = 2.0;
const DECADES_OF_POSE: f64 = 4.0;

impl Up {
    fn most_rad(&self) -> f64 {
        MOST_SIGMAS * self.sigma_rad
    }

    /// How far a pose leans against it, radians.
    pub fn lean_rad(&self, world_from_rig: &Se3) -> f64 {
        (world_from_rig.rotation * self.in_rig).angle(&Vector3::z())
    }
}

impl ExpectedPose {
    /// The largest angle and distance of a pose that agrees.
    fn most(&self) -> [f64; 2] {
        worst_sigmas(&self.covariance).map(|sigma| MOST_SIGMAS * sigma)
    }

    fn contradicts(&self, world_from_rig: &Se3) -> bool {
        let off = self.world_from_rig.inverse() * *world_from_rig;
        let [most_rad, most_m] = self.most();
        off.rotation.angle() > most_rad || off.translation.norm() > most_m
    }

    fn decades(&self) -> f64 {
        let [most_rad, most_m] = self.most();
        // Rotations by less than an angle a are (a − sin a) / π of all.
        let turned = most_rad.min(PI);
        let turns = ((turned - turned.sin()) / PI).max(f64::MIN_POSITIVE);
        let places = (most_m / ROOM_M).min(1.0).powi(3);
        (turns.log10() + places.max(f64::MIN_POSITIVE).log10()).clamp(-DECADES_OF_POSE, 0.0)
    }
}

impl PoseKnowledge {
    /// Nothing is known.
    pub const NOTHING: Self = Self {
        up: None,
        pose: None,
    };

    /// Whether a pose contradicts it.
    pub(super) fn contradicts(&self, world_from_rig: &Se3) -> bool {
        let leans = self
            .up
            .is_some_and(|up| up.lean_rad(world_from_rig) > up.most_rad());
        leans
            || self
                .pose
                .is_some_and(|expected| expected.contradicts(world_from_rig))
    }

    /// Decimal logarithm of the share of all poses that agree with it, but for what it counts for at most; 0 where nothing is known.
    pub(super) fn decades(&self) -> f64 {
        // An expected pose has its own up.
        if let Some(expected) = &self.pose {
            return expected.decades();
        }
        self.up.map_or(0.0, |up| {
            let share = (1.0 - up.most_rad().min(PI).cos()) / 2.0;
            share
                .max(f64::MIN_POSITIVE)
                .log10()
                .clamp(-DECADES_OF_UP, 0.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;

    use super::*;

    fn turned(about_x_rad: f64, x_m: f64) -> Se3 {
        Se3::exp(&Vector6::new(about_x_rad, 0.0, 0.0, x_m, 0.0, 0.0))
    }

    #[test]
    fn a_pose_that_leans_or_is_elsewhere_contradicts() {
        let nothing = PoseKnowledge::default();
        assert!(!nothing.contradicts(&turned(2.0, 50.0)));
        assert_eq!(nothing.decades(), 0.0);
        let up = PoseKnowledge {
            up: Some(Up {
                in_rig: Vector3::z(),
                sigma_rad: 0.02,
            }),
            pose: None,
        };
        assert!(!up.contradicts(&turned(0.06, 50.0)));
        assert!(up.contradicts(&turned(0.08, 0.0)));
        // About the vertical it may be turned.
        let heading = Se3::exp(&Vector6::new(0.0, 0.0, 2.0, 0.0, 0.0, 0.0));
        assert!(!up.contradicts(&heading));
        assert_eq!(up.decades(), -2.0);
        let sigmas = Vector6::new(0.02, 0.02, 0.02, 0.1, 0.1, 0.1);
        let expected = PoseKnowledge {
            up: None,
            pose: Some(ExpectedPose {
                world_from_rig: turned(0.0, 3.0),
                covariance: Matrix6::from_diagonal(&sigmas.map(|s| s * s)),
            }),
        };
        assert!(!expected.contradicts(&turned(0.06, 3.0)));
        assert!(expected.contradicts(&turned(0.08, 3.0)));
        assert!(expected.contradicts(&turned(0.0, 3.4)));
        assert_eq!(expected.decades(), -4.0);
        // Wide enough to say nothing.
        let anywhere = PoseKnowledge {
            up: None,
            pose: Some(ExpectedPose {
                world_from_rig: Se3::identity(),
                covariance: Matrix6::from_diagonal_element(100.0),
            }),
        };
        assert!(anywhere.decades().abs() < 1e-12);
    }
}
