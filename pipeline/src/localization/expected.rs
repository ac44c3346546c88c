//! What a walk's IMU and its other poses say of an instant that was not localized.

use lsfb_geometry::{Matrix6, Se3};
use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2, Stamped, Timestamp, median};

use super::prior::{ExpectedPose, PoseKnowledge, Up};
use super::sequence::localized_shares;
use lsfb_perception::imu::{ImuBias, NO_WEIGHT, PreintegratedImu};

/// The accelerometer is averaged over this much time, half before and half after: who walks neither speeds up nor slows down for long.
const UP_SECS: f64 = 2.0;
/// Standard deviation of up at least: biases, and speed that changes all the same. More where the two halves disagree.
const UP_SIGMA_RAD: f64 = 0.02;
/// Forces whose mean is farther from gravity say nothing of it.
const LARGEST_OFF_M_S2: f64 = 1.0;
/// Poses as far away in time say where the device is, seconds.
const LONGEST_SECS: f64 = 1.0;
/// How people move, 1 σ: metres and, without an IMU, radians a second; and what a localized pose may be off by besides its own σ.
const PACE_M_S: f64 = 0.7;
const PACE_RAD_S: f64 = 0.7;
const BESIDE_M: f64 = 0.05;
const BESIDE_RAD: f64 = 0.01;
/// What a gyroscope is off by, its bias most of all, rad/s.
const GYRO_SIGMA_RAD_S: f64 = 0.02;

/// The inertial samples of a walk.
pub(super) struct WalkMotion<'a> {
    samples: &'a [Stamped<ImuSample>],
}

impl<'a> WalkMotion<'a> {
    /// Of samples in order of time; there may be none.
    pub fn new(samples: &'a [Stamped<ImuSample>]) -> Self {
        Self { samples }
    }

    fn between(&self, start: Timestamp, end: Timestamp) -> Option<PreintegratedImu> {
        PreintegratedImu::integrate(self.samples, start, end, ImuBias::default(), &NO_WEIGHT).ok()
    }

    /// Which way is up; `None` where the IMU does not cover the time around, or the device was thrown about.
    pub fn up(&self, time: Timestamp) -> Option<Up> {
        let half = (0.5e9 * UP_SECS) as i64;
        let before = self.between(time + -half, time)?;
        let after = self.between(time, time + half)?;
        // Both in the axes of the instant.
        let before = before.rotation.inverse() * before.velocity_m_s / before.duration_secs;
        let after = after.velocity_m_s / after.duration_secs;
        let mean = (before + after) / 2.0;
        if (mean.norm() - STANDARD_GRAVITY_M_S2).abs() > LARGEST_OFF_M_S2 {
            return None;
        }
        Some(Up {
            in_rig: mean.normalize(),
            sigma_rad: UP_SIGMA_RAD.max(before.angle(&after) / 2.0),
        })
    }

    /// Where the rig should be after, or before, it was at a localized pose; `None` where that is too long ago.
    pub fn moved(
        &self,
        from: (Timestamp, &Se3, &Matrix6<f64>),
        time: Timestamp,
    ) -> Option<ExpectedPose> {
        let (then, world_from_rig, covariance) = from;
        let secs = time.secs_since(then).abs();
        if secs > LONGEST_SECS {
            return None;
        }
        let turned = match time >= then {
            true => self.between(then, time).map(|m| m.rotation),
            false => self.between(time, then).map(|m| m.rotation.inverse()),
        };
        let rate_sigma = turned.map_or(PACE_RAD_S, |_| GYRO_SIGMA_RAD_S);
        let turn = turned.unwrap_or_default();
        let mut grown = *covariance;
        let more = [
            BESIDE_RAD.hypot(rate_sigma * secs),
            BESIDE_M.hypot(PACE_M_S * secs),
        ];
        for i in 0..6 {
            grown[(i, i)] += more[i / 3].powi(2);
        }
        Some(ExpectedPose {
            world_from_rig: Se3::new(world_from_rig.rotation * turn, world_from_rig.translation),
            covariance: grown,
        })
    }
}

/// Of the instants within ten seconds this share must be localized: what is looked for next to poses that are wrong together is found there.
const LEAST_LOCALIZED: f64 = 1.0 / 3.0;

/// Poses lean less against the IMU, in the median, where the map's z axis points upwards and the IMU's axes are right, radians.
const LEAST_LEAN_RAD: f64 = 0.05;
/// So many poses, evenly over the walk, tell whether it does.
const TELLING: usize = 100;

/// What is known of the instants that were not localized, by those that were; of these, and where nothing is known, nothing.
pub(super) fn knowledge(
    motion: &WalkMotion,
    times: &[Timestamp],
    found: &[Option<(&Se3, &Matrix6<f64>)>],
) -> Vec<PoseKnowledge> {
    let localized: Vec<(Timestamp, &Se3, &Matrix6<f64>)> = times
        .iter()
        .zip(found)
        .filter_map(|(time, found)| found.map(|(pose, covariance)| (*time, pose, covariance)))
        .collect();
    if localized.len() == times.len() {
        return vec![PoseKnowledge::NOTHING; times.len()];
    }
    let every = localized.len().div_ceil(TELLING).max(1);
    let leans = localized.iter().step_by(every);
    let leans = leans.filter_map(|(time, pose, _)| {
        let up = motion.up(*time)?;
        Some(up.lean_rad(pose))
    });
    let is_upright = median(leans.collect()).is_some_and(|lean| lean < LEAST_LEAN_RAD);
    let shares = localized_shares(times, found.iter().map(Option::is_some));
    let lost = times.iter().zip(found).zip(shares);
    lost.map(|((time, found), share)| {
        if found.is_some() || share < LEAST_LOCALIZED {
            return PoseKnowledge::NOTHING;
        }
        let after = localized.partition_point(|(then, ..)| then < time);
        let around = [after.checked_sub(1), Some(after)].into_iter().flatten();
        let around = around.filter_map(|k| localized.get(k));
        let nearest = around.min_by_key(|(then, ..)| (*then - *time).abs());
        PoseKnowledge {
            up: motion.up(*time).filter(|_| is_upright),
            pose: nearest.and_then(|nearest| motion.moved(*nearest, *time)),
        }
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Vector3, Vector6, so3};

    use super::*;

    const RATE_RAD_S: Vector3<f64> = Vector3::new(0.1, -0.2, 0.4);

    fn at(secs: f64) -> Timestamp {
        Timestamp::from_nanos((secs * 1e9).round() as i64)
    }

    /// A device that turns evenly, where it is.
    fn world_from_rig(secs: f64) -> Se3 {
        Se3::new(so3::exp(&(RATE_RAD_S * secs)), Vector3::zeros())
    }

    /// Its samples over ten seconds, with forces of so much more along x in the world in each second half of a second.
    fn samples(shaken_m_s2: f64) -> Vec<Stamped<ImuSample>> {
        let sample = |k: i32| {
            let secs = 0.005 * f64::from(k);
            let sign = if secs.fract() < 0.5 { 1.0 } else { -1.0 };
            let force = Vector3::new(sign * shaken_m_s2, 0.0, STANDARD_GRAVITY_M_S2);
            let force = world_from_rig(secs).rotation.inverse() * force;
            Stamped {
                time: at(secs),
                arrival: at(secs),
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: RATE_RAD_S.into(),
                    specific_force_m_s2: force.into(),
                },
            }
        };
        (0..=2000).map(sample).collect()
    }

    #[test]
    fn up_is_found_while_the_device_turns_and_is_shaken() {
        let samples = samples(1.0);
        let motion = WalkMotion::new(&samples);
        for secs in [1.0, 4.2, 8.9] {
            let up = motion.up(at(secs)).expect("covered");
            assert!(up.lean_rad(&world_from_rig(secs)) < 0.01, "{secs}: {up:?}");
            assert!(up.sigma_rad < 0.05, "{up:?}");
        }
        // Too near to the ends, and in free fall.
        assert_eq!(motion.up(at(0.5)), None);
        assert_eq!(motion.up(at(9.5)), None);
        let mut falling = samples.clone();
        for sample in &mut falling {
            sample.sample.specific_force_m_s2 = [0.0; 3];
        }
        assert_eq!(WalkMotion::new(&falling).up(at(4.0)), None);
    }

    #[test]
    fn a_lost_instant_is_expected_where_its_neighbour_turned_to() {
        let samples = samples(0.0);
        let motion = WalkMotion::new(&samples);
        let sigmas = Vector6::new(0.01, 0.01, 0.01, 0.02, 0.02, 0.02);
        let covariance = Matrix6::from_diagonal(&sigmas.map(|s| s * s));
        let times = [1.0, 4.0, 4.4, 5.0, 6.5].map(at);
        let poses = [1.0, 4.0, 5.0].map(world_from_rig);
        let found = [Some(0), Some(1), None, Some(2), None];
        let found = found.map(|k| k.map(|k: usize| (&poses[k], &covariance)));
        let known = knowledge(&motion, &times, &found);
        assert_eq!(known[1], PoseKnowledge::default());
        let expected = known[2].pose.expect("a neighbour");
        let off = expected.world_from_rig.inverse() * world_from_rig(4.4);
        assert!(off.rotation.angle() < 1e-3, "{off:?}");
        // 0.4 s at a walking pace.
        let sigma_m = expected.covariance[(3, 3)].sqrt();
        assert!((sigma_m - 0.285).abs() < 0.01, "{sigma_m}");
        assert!(known[2].up.is_some() && !known[2].contradicts(&world_from_rig(4.4)));
        // Alone, up is known all the same.
        assert!(known[4].pose.is_none() && known[4].up.is_some());
        // Where most instants were not recognised, those that were say nothing.
        let times = [1.0, 4.0, 4.1, 4.2, 4.3].map(at);
        let found = [None, Some((&poses[1], &covariance)), None, None, None];
        let known = knowledge(&motion, &times, &found);
        assert!(known.iter().all(|k| *k == PoseKnowledge::default()));
        // In a map that does not stand upright the IMU says nothing of up.
        let times = [1.0, 4.0, 4.4, 5.0, 6.5].map(at);
        let lying = so3::exp(&Vector3::new(1.0, 0.0, 0.0));
        let poses = poses.map(|pose| Se3::new(lying * pose.rotation, Vector3::zeros()));
        let found = [Some(0), Some(1), None, Some(2), None];
        let found = found.map(|k| k.map(|k: usize| (&poses[k], &covariance)));
        let known = knowledge(&motion, &times, &found);
        assert!(known[2].pose.is_some() && known[2].up.is_none());
        assert_eq!(known[4], PoseKnowledge::default());
    }

    #[test]
    fn without_an_imu_neighbours_say_less() {
        let motion = WalkMotion::new(&[]);
        let covariance = Matrix6::identity() * 1e-4;
        let pose = world_from_rig(2.0);
        let times = [2.0, 2.5, 4.0].map(at);
        let found = [Some((&pose, &covariance)), None, None];
        let known = knowledge(&motion, &times, &found);
        let expected = known[1].pose.expect("a neighbour");
        assert!(expected.covariance[(0, 0)].sqrt() > 0.3);
        assert_eq!(known[2], PoseKnowledge::default());
    }
}
