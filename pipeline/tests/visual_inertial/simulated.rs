//! Walks whose truth is exact: a camera and an IMU are carried through a room of points, and each corner is followed with an error that
//! grows from image to image and stays.

use lsfb_geometry::{
    Camera, CameraTiming, ImuNoiseModel, Matrix3, RigCamera, Se3, UnitQuaternion, Vector2, Vector3,
};
use lsfb_pipeline::features::{Descriptor, Features, Keypoint};
use lsfb_pipeline::ground_truth::{
    Beginning, Motion, MotionConfig, Sight, TrackedFrame, TrackedWalk, WalkView, motion_without_map,
};
use lsfb_types::{ImuSample, Stamped, Timestamp, no_progress};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::vimap::sample;

const SECS: f64 = 7.0;
/// Long enough to come back to what was seen before.
const LONG_SECS: f64 = 24.0;
const FRAME_SECS: f64 = 0.1;
const SAMPLE_SECS: f64 = 0.005;
const POINTS: usize = 260;
/// Error of a feature of a kept image, pixels, and how many frames these are apart.
const VIEW_PX: f64 = 0.3;
const VIEW_FRAMES: usize = 5;
/// The last seconds of a walk: less than two visits are apart.
const LAST_SECS: f64 = 4.0;
/// Added to a track's error at each frame, and its error at the first, pixels.
const STEP_PX: f64 = 0.08;
const FIRST_PX: f64 = 0.1;
const NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1e-3,
    accel_noise_density: 1e-2,
    gyro_bias_walk: 1e-4,
    accel_bias_walk: 1e-3,
};

/// How a walk begins, seconds of rest; it starts softly.
#[derive(Clone, Copy)]
struct Rest(f64);

const NO_REST: Rest = Rest(0.0);

impl Rest {
    /// Seconds of the same walk without it.
    fn walked(self, secs: f64) -> f64 {
        let moving = (secs - self.0).max(0.0);
        match self.0 > 0.0 {
            true => moving * moving / (moving + 0.5),
            false => secs,
        }
    }
}

/// Where the device is.
fn truth(secs: f64, phase: f64) -> Se3 {
    let wave = |rate: f64, shift: f64| (rate * secs + shift + phase).sin();
    let position = Vector3::new(
        1.5 * wave(0.7, 0.0),
        1.2 * wave(0.9, 1.0),
        0.3 * wave(1.1, 2.0),
    );
    let rotation = UnitQuaternion::from_euler_angles(
        0.1 * wave(1.6, 0.5),
        0.2 * wave(1.2, 1.5),
        0.8 * wave(0.6, 2.5),
    );
    Se3::new(rotation, position)
}

/// One number about zero with a standard deviation of one.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random_range(1e-12..1.0), random.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn three(random: &mut ChaCha8Rng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| sigma * normal(random))
}

fn samples(secs: f64, rest: Rest, phase: f64, random: &mut ChaCha8Rng) -> Vec<Stamped<ImuSample>> {
    let (gyro_bias, accel_bias) = (three(random, 5e-3), three(random, 0.05));
    let count = ((secs + 0.2) / SAMPLE_SECS) as i64;
    let step = 1e-3;
    let measured = |k: i64, random: &mut ChaCha8Rng| {
        let secs = k as f64 * SAMPLE_SECS - 0.1;
        let [before, now, after] = [-step, 0.0, step].map(|d| truth(rest.walked(secs + d), phase));
        let turn = (before.rotation.inverse() * after.rotation).scaled_axis() / (2.0 * step);
        let acceleration =
            (after.translation - 2.0 * now.translation + before.translation) / (step * step);
        let force = now.rotation.inverse() * (acceleration + Vector3::new(0.0, 0.0, 9.80665));
        let per_sample = SAMPLE_SECS.sqrt().recip();
        let turn = turn + gyro_bias + three(random, NOISE.gyro_noise_density * per_sample);
        let force = force + accel_bias + three(random, NOISE.accel_noise_density * per_sample);
        let time = Timestamp::from_secs_f64(10.0 + secs);
        sample(time.nanos(), turn.into(), force.into())
    };
    (0..count).map(|k| measured(k, random)).collect()
}

fn camera() -> RigCamera {
    let forward = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    RigCamera {
        camera: Camera::pinhole(640, 480, [320.0; 2], [319.5, 239.5]),
        rig_from_camera: Se3::new(
            UnitQuaternion::from_matrix(&forward),
            Vector3::new(0.02, 0.0, 0.01),
        ),
        timing: CameraTiming::default(),
        sigmas: Default::default(),
    }
}

/// What a detector finds in an image that is taken from a pose, each with an error of its own.
fn seen_from<'a>(
    world_from_rig: &Se3,
    camera: &RigCamera,
    points: impl Iterator<Item = (&'a Vector3<f64>, &'a Descriptor)>,
    random: &mut ChaCha8Rng,
) -> Features {
    let camera_from_world = (*world_from_rig * camera.rig_from_camera).inverse();
    let mut features = Features::default();
    for (point, look) in points {
        let seen = camera.camera.project(&(camera_from_world * *point));
        let Some(pixel) = seen.filter(|pixel| camera.camera.contains(pixel, 0.0)) else {
            continue;
        };
        let found = pixel + Vector2::from_fn(|_, _| VIEW_PX * normal(random));
        features.keypoints.push(Keypoint {
            pixel: [found.x as f32, found.y as f32],
            scale_px: 2.0,
            angle_rad: 0.0,
            response: 0.1,
        });
        let noisy = look.map(|v| v + (random.next_u32() % 9) as u8);
        features.descriptors.push(noisy);
    }
    features
}

/// A walk of a seed, with the truth of each frame. The kept images of its last seconds are taken so far aside of where the device is, as if what
/// they show stood there once more.
fn walk(seed: u64, all_secs: f64, aside_m: f64) -> (TrackedWalk, Vec<Se3>) {
    walk_after(NO_REST, seed, all_secs, aside_m)
}

fn walk_after(rest: Rest, seed: u64, all_secs: f64, aside_m: f64) -> (TrackedWalk, Vec<Se3>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let phase = random.random_range(0.0..std::f64::consts::TAU);
    let imu = samples(all_secs, rest, phase, &mut random);
    let camera = camera();
    // Walls of a room around.
    let points: Vec<Vector3<f64>> = (0..POINTS)
        .map(|_| {
            let around = random.random_range(0.0..std::f64::consts::TAU);
            let away = random.random_range(3.5..6.0);
            let height = random.random_range(-2.0..2.0);
            Vector3::new(away * around.cos(), away * around.sin(), height)
        })
        .collect();
    let looks: Vec<Descriptor> = (0..POINTS)
        .map(|_| std::array::from_fn(|_| (random.next_u32() % 90) as u8))
        .collect();
    let mut views = Vec::new();
    let mut followed: Vec<Option<(u32, Vector2<f64>)>> = vec![None; points.len()];
    let (mut next, mut frames, mut poses) = (0, Vec::new(), Vec::new());
    for k in 0..(all_secs / FRAME_SECS) as usize {
        let secs = k as f64 * FRAME_SECS;
        let pose = truth(rest.walked(secs), phase);
        let camera_from_world = (pose * camera.rig_from_camera).inverse();
        let mut sights = Vec::new();
        for (point, track) in points.iter().zip(&mut followed) {
            let seen = camera.camera.project(&(camera_from_world * *point));
            let Some(pixel) = seen.filter(|pixel| camera.camera.contains(pixel, 0.0)) else {
                *track = None;
                continue;
            };
            let mut error = |px: f64| Vector2::from_fn(|_, _| px * normal(&mut random));
            let (number, off) = match *track {
                Some((number, off)) => (number, off + error(STEP_PX)),
                None => {
                    next += 1;
                    (next, error(FIRST_PX))
                }
            };
            *track = Some((number, off));
            sights.push(Sight {
                track: number,
                camera: 0,
                pixel: pixel + off,
            });
        }
        if k % VIEW_FRAMES == 0 {
            let is_last = all_secs - secs <= LAST_SECS;
            let aside = Vector3::x() * if is_last { aside_m } else { 0.0 };
            let from = Se3::new(pose.rotation, pose.translation + aside);
            views.push(WalkView {
                frame: k,
                camera: 0,
                features: seen_from(&from, &camera, points.iter().zip(&looks), &mut random),
            });
        }
        frames.push(TrackedFrame {
            time: Timestamp::from_secs_f64(10.0 + secs),
            sights,
        });
        poses.push(pose);
    }
    let walk = TrackedWalk {
        cameras: vec![camera],
        frames,
        imu,
        noise: NOISE,
        views,
    };
    (walk, poses)
}

fn motion(walk: TrackedWalk) -> Motion {
    motion_without_map(&walk, None, &MotionConfig::default(), &no_progress).expect("moves")
}

/// Root mean square distance from the truth relative to the first frame, metres, and how many of the poses are within 95 %.
fn errors(found: &Motion, poses: &[Se3]) -> (f64, f64) {
    let all = found.trajectory.poses();
    let truth_from_world = poses[found.first] * all[found.first].world_from_rig.inverse();
    let (mut square_m2, mut within, mut count) = (0.0, 0u32, 0u32);
    for (k, pose) in all.iter().enumerate().filter(|(k, _)| *k != found.first) {
        let moved = truth_from_world * pose.world_from_rig;
        square_m2 += (moved.translation - poses[k].translation).norm_squared();
        let error = moved.local(&poses[k]);
        let whole = found.covariances[k].cholesky().expect("positive definite");
        within += u32::from(error.dot(&whole.solve(&error)) <= CHI_SQUARED_95[0]);
        count += 1;
    }
    let count = f64::from(count);
    ((square_m2 / count).sqrt(), f64::from(within) / count)
}

/// A walk that begins at rest is initialised there: the samples say which way is up, and the gyroscope's bias. One that moves all along is not; nor is
/// one whose images stand still and whose accelerometer does not feel gravity, which naively stands as well as the first.
#[test]
fn a_walk_that_begins_at_rest_is_initialised_there() {
    const REST_SECS: f64 = 0.8;
    for (rest, beginning) in [
        (Rest(REST_SECS), Beginning::Standing),
        (NO_REST, Beginning::Moving),
    ] {
        let (walk, poses) = walk_after(rest, 1, 4.0, 0.0);
        let found = motion(TrackedWalk {
            views: Vec::new(),
            ..walk.clone()
        });
        assert_eq!(found.beginning, beginning);
        let (rms_m, _) = errors(&found, &poses);
        let up = |pose: &Se3| pose.rotation.inverse() * Vector3::z();
        let all = found.trajectory.poses();
        let lean = up(&all[found.first].world_from_rig).angle(&up(&poses[found.first]));
        println!(
            "{beginning:?}: {:.1} mm, {:.2}° from upright",
            1e3 * rms_m,
            lean.to_degrees()
        );
        assert!(rms_m < 0.03, "{beginning:?}: {rms_m} m");
        assert!(lean < 0.02, "{beginning:?}: {lean} rad");
    }
    let (mut walk, _) = walk_after(Rest(REST_SECS), 1, 2.0, 0.0);
    for sample in &mut walk.imu {
        let force = &mut sample.sample.specific_force_m_s2;
        *force = force.map(|f| f / 9.80665);
    }
    let found = motion_without_map(&walk, None, &MotionConfig::default(), &no_progress);
    let begun = found.ok().map(|motion| motion.beginning);
    assert_ne!(begun, Some(Beginning::Standing));
}

/// Of a walk that comes back to what it saw, less drift is left where that is recognised; the covariances know it.
#[test]
fn what_is_seen_again_takes_drift_out() {
    let (mut ratios, mut shares) = (Vec::new(), Vec::new());
    for seed in 0..3 {
        let (walk, poses) = walk(seed, LONG_SECS, 0.0);
        let alone = motion(TrackedWalk {
            views: Vec::new(),
            ..walk.clone()
        });
        let found = motion(walk);
        let (before_m, _) = errors(&alone, &poses);
        let (after_m, within) = errors(&found, &poses);
        println!(
            "seed {seed}: {:.1} and {:.1} mm, {within:.2} within 95 %, {:?}",
            before_m * 1e3,
            after_m * 1e3,
            found.revisits
        );
        assert!(
            found.revisits.closed >= 3 && found.revisits.opened == 0,
            "{seed}"
        );
        ratios.push(after_m / before_m);
        shares.push(within);
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!(mean(&ratios) < 0.7, "{ratios:?}");
    assert!(mean(&shares) > 0.9, "{shares:?}");
}

/// Images of the last four seconds show what stands there once more, so far aside as the next room is, or the next of a row. What is as near as the
/// walk may have drifted is closed, does not fit the walk that is solved with it, and is opened again.
#[test]
fn a_place_that_looks_like_another_moves_nothing() {
    for (seed, aside_m) in [(0, 2.0), (1, 0.6), (2, 0.3), (3, 0.15)] {
        let (mut walk, poses) = walk(seed, LONG_SECS, aside_m);
        let end = walk.frames.len();
        let deceived = motion(walk.clone());
        let is_last = |v: &WalkView| (end - v.frame) as f64 * FRAME_SECS <= LAST_SECS;
        walk.views.retain(|view| !is_last(view));
        let honest = motion(walk);
        let (off_m, _) = errors(&deceived, &poses);
        let (least_m, _) = errors(&honest, &poses);
        let (deceived, honest) = (deceived.revisits, honest.revisits);
        println!(
            "{aside_m} m: {:.1} mm, {honest:?}, with them {:.1} mm, {deceived:?}",
            least_m * 1e3,
            off_m * 1e3
        );
        assert!(honest.closed >= 3 && honest.opened == 0, "{aside_m} m");
        assert!(off_m <= 1.2 * least_m, "{aside_m} m");
        assert_eq!(deceived.closed, honest.closed, "{aside_m} m");
        assert!(deceived.recognised == honest.recognised || aside_m < 1.0);
        assert!(deceived.places >= honest.places + 7, "{aside_m} m");
    }
}

/// Where the walk may have drifted too far for any likeness, what was recognised on the way shortens it: by the drift alone 11 places are within reach.
#[test]
fn loops_on_the_way_lead_to_later_ones() {
    let (walk, _) = walk(0, 2.0 * LONG_SECS, 0.0);
    let mut config = MotionConfig::default();
    config.revisits.max_open_m = 0.316;
    let found = motion_without_map(&walk, None, &config, &no_progress).expect("moves");
    println!("{:?}", found.revisits);
    assert!(found.revisits.recognised >= 40 && found.revisits.opened == 0);
}

/// 95 % of squared norms of six and of three standard normal numbers are below these.
const CHI_SQUARED_95: [f64; 2] = [12.591_587, 7.814_728];

/// With the errors of a track taken for independent, 84 % of the poses were within their region, and NEES was 8.9.
#[test]
fn covariances_are_honest_though_corners_drift() {
    let (mut within, mut within_of_position, mut count, mut mean) = (0, 0, 0, 0.0);
    for seed in 0..6 {
        let (walk, poses) = walk(seed, SECS, 0.0);
        let found = motion(TrackedWalk {
            views: Vec::new(),
            ..walk
        });
        let all = found.trajectory.poses();
        assert!(found.covariances[found.first].iter().all(|v| *v == 0.0));
        let truth_from_world = poses[found.first] * all[found.first].world_from_rig.inverse();
        for (k, pose) in all.iter().enumerate().filter(|(k, _)| *k != found.first) {
            let error = (truth_from_world * pose.world_from_rig).local(&poses[k]);
            let whole = found.covariances[k].cholesky().expect("positive definite");
            let squared = error.dot(&whole.solve(&error));
            let position = found.covariances[k].fixed_view::<3, 3>(3, 3).into_owned();
            let moved = error.fixed_rows::<3>(3).into_owned();
            let shift = position
                .cholesky()
                .expect("positive definite")
                .solve(&moved);
            within += usize::from(squared <= CHI_SQUARED_95[0]);
            within_of_position += usize::from(moved.dot(&shift) <= CHI_SQUARED_95[1]);
            mean += squared;
            count += 1;
        }
        println!(
            "seed {seed}: reprojection {:.2} px, so far {:.2} and {:.2} of {count} within 95 %, NEES {:.1}",
            found.errors.rms_px,
            within as f64 / count as f64,
            within_of_position as f64 / count as f64,
            mean / count as f64,
        );
    }
    let share = |within: usize| within as f64 / count as f64;
    assert!(share(within) > 0.93, "{:.3} of poses", share(within));
    assert!(
        share(within_of_position) > 0.93,
        "{:.3} of positions",
        share(within_of_position)
    );
    // Nor are they so wide that they say nothing.
    let mean = mean / count as f64;
    assert!((1.0..6.0).contains(&mean), "NEES {mean:.1} of 6");
}
