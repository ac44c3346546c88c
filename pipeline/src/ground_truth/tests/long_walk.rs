//! A walk of minutes in which the map is recognised now and then.

use super::super::dead_reckoning::DeadReckoning;
use super::*;
use lsfb_perception::imu::{ImuBias, NavState};

/// Recognised for so many frames, then not for so many: longer than localized poses vote for one another.
const SEEN: usize = 15;
const UNSEEN: usize = 35;
/// So often: in a walk of 160 s.
const STRETCHES: usize = 32;

fn long_walk() -> Walk {
    let frames = STRETCHES * (SEEN + UNSEEN) - UNSEEN;
    let mut rng = Gauss(ChaCha8Rng::seed_from_u64(SEED));
    let frame = |k: usize| {
        let t = k as f64 * FRAME_SECS;
        let off = Se3::new(so3::exp(&rng.vector(0.004)), rng.vector(0.012));
        Frame {
            time: Timestamp::from_nanos((t * 1e9).round() as i64),
            localized: (k % (SEEN + UNSEEN) < SEEN).then(|| LocalizedPose {
                world_from_rig: truth(t) * off,
                covariance: Matrix6::zeros(),
            }),
            fixed: Vec::new(),
            recognised: Vec::new(),
        }
    };
    Walk {
        cameras: glasses(),
        frames: (0..frames).map(frame).collect(),
        imu: imu_of(frames, &mut Gauss(ChaCha8Rng::seed_from_u64(SEED))),
        noise: NOISE,
        noise_factors: Default::default(),
        point_covariances_m2: Default::default(),
    }
}

/// Before, an explanation took in what was next to it in a dozen rounds at most, each of them with minutes of the IMU alone on both sides.
#[test]
fn all_stretches_of_a_long_walk_are_joined_but_the_one_that_is_elsewhere() {
    let mut walk = long_walk();
    let elsewhere = 7 * (SEEN + UNSEEN);
    let moved = Se3::new(Default::default(), Vector3::new(0.0, 4.0, 0.0));
    for frame in &mut walk.frames[elsewhere..elsewhere + SEEN] {
        let localized = frame.localized.as_mut().expect("localized");
        localized.world_from_rig = moved * localized.world_from_rig;
    }
    let start = started(&walk, &GroundTruthConfig::default());
    let right = SEEN * (STRETCHES - 1);
    assert_eq!((start.accepted_count, start.rival_count), (right, SEEN));
    assert!(!start.accepted[elsewhere..elsewhere + SEEN].contains(&true));
    let found = errors(&walk, &start.states);
    assert!(found.worst_m < 0.1, "worst {} m", found.worst_m);
}

/// The true state and biases, in which the IMU leads forwards and backwards to all others.
#[test]
fn the_imu_leads_both_ways_and_from_pose_to_pose() {
    let mut walk = long_walk();
    walk.frames.truncate(31);
    let imu = DeadReckoning::of(&walk).expect("sums");
    let gravity = standard_gravity_m_s2();
    let state = |k: usize| {
        let t = k as f64 * FRAME_SECS;
        FrameState {
            nav: NavState {
                world_from_rig: truth(t),
                velocity_m_s: true_motion(t).velocity_m_s,
            },
            bias: ImuBias {
                gyro_rad_s: Vector3::new(0.004, -0.006, 0.003),
                accel_m_s2: Vector3::new(0.05, -0.04, 0.08),
            },
        }
    };
    let known = state(15);
    let mut states = vec![known; 31];
    imu.carry_on(&mut states, 15..16, &gravity);
    let found = errors(&walk, &states);
    assert!(found.worst_m < 0.02, "{} m", found.worst_m);
    assert!(found.worst_rad < 0.01, "{} rad", found.worst_rad);
    // Back again by the same samples, to the digit.
    let first = states[0];
    imu.carry_on(&mut states, 0..1, &gravity);
    assert_eq!(states[0], first);
    let error = known.nav.world_from_rig.inverse() * states[15].nav.world_from_rig;
    assert!(error.translation.norm() < 1e-9 && error.rotation.angle() < 1e-9);

    let ends = [0, 30].map(|k| (k, truth(k as f64 * FRAME_SECS)));
    // Of an IMU of which no bias is known.
    let between = imu.between(ends, ImuBias::default(), &gravity);
    assert_eq!(between.len(), 31);
    for (end, (k, pose)) in [&between[0], &between[30]].iter().zip(ends) {
        let error = pose.inverse() * end.nav.world_from_rig;
        assert!(error.translation.norm() < 1e-9, "frame {k}");
        assert!(error.rotation.angle() < 1e-9, "frame {k}");
    }
    let found = errors(&walk, &between);
    assert!(found.worst_m < 0.15, "{} m", found.worst_m);
}
