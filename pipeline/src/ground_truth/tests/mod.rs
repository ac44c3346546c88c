//! A walk made up in memory: true motion, IMU, points with descriptors, and all the mistakes a real one has.

mod bad_input;
mod cameras;
mod consensus;
mod cross_check;
mod dense;
mod imu;
mod in_view;
mod learned;
mod long_walk;
mod other_place;
mod recorded;
mod settling;
mod standing;
mod together;
mod trusted;
mod without_imu;

use std::sync::Arc;

use lsfb_geometry::{
    Camera, CameraSigmas, ImuNoiseModel, Matrix3, Matrix6, RigCamera, Se3, UnitQuaternion, Vector2,
    Vector3, camera::Lens, so3,
};
use lsfb_types::{ImuSample, Stamped, Timestamp, no_progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::in_view::InView;
use super::report::Span;
use super::run::not_used;
use super::start::{Start, start_states};
use super::trusted::{Solution, trusted};
use super::uncertainty::{Uncertainty, uncertainty};
use super::walk::{FixedObservation, Frame, FrameState, LocalizedPose, Walk};
use super::*;
use crate::Refusal;
use crate::features::{DESCRIPTOR_LEN, Keypoint};
use crate::residuals::{CameraCorrection, FrameMotion, MovingCamera};
use lsfb_perception::imu::standard_gravity_m_s2;

const FRAMES: usize = 100;
const FRAME_SECS: f64 = 0.1;
const NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1.5e-3,
    accel_noise_density: 2e-3,
    gyro_bias_walk: 6e-5,
    accel_bias_walk: 6e-4,
};

/// Stands for a second, then walks a loop in a room, looking about.
fn truth(t: f64) -> Se3 {
    let moving = (t - 1.0).max(0.0);
    // Starts softly: no jump in acceleration.
    let s = moving * moving / (moving + 1.0);
    let (sin, cos) = (0.7 * s).sin_cos();
    let position = Vector3::new(1.2 * cos, 1.2 * sin, 1.6 + 0.03 * (6.0 * s).sin());
    let attitude = Vector3::new(0.05 * (2.0 * s).sin(), 0.1 * (1.3 * s).sin(), 0.0);
    Se3::new(
        so3::exp(&Vector3::new(0.0, 0.0, 0.7 * s + 0.3 * s.sin())) * so3::exp(&attitude),
        position,
    )
}

fn imu(rng: &mut Gauss) -> Vec<Stamped<ImuSample>> {
    imu_of(FRAMES, rng)
}

/// Samples for as long as so many frames take.
fn imu_of(frames: usize, rng: &mut Gauss) -> Vec<Stamped<ImuSample>> {
    let rate = 200.0f64;
    let h = 1e-3;
    (0..=(frames as f64 * FRAME_SECS * rate) as i64)
        .map(|k| {
            let t = k as f64 / rate;
            let (before, here, after) = (truth(t - h), truth(t), truth(t + h));
            let acceleration =
                (before.translation + after.translation - here.translation * 2.0) / (h * h);
            let gyro = so3::log(&(before.rotation.inverse() * after.rotation)) / (2.0 * h)
                + Vector3::new(0.004, -0.006, 0.003)
                + rng.vector(NOISE.gyro_noise_density * rate.sqrt());
            let accel = here.rotation.inverse() * (acceleration - standard_gravity_m_s2())
                + Vector3::new(0.05, -0.04, 0.08)
                + rng.vector(NOISE.accel_noise_density * rate.sqrt());
            let time = Timestamp::from_nanos(k * 5_000_000);
            Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: gyro.into(),
                    specific_force_m_s2: accel.into(),
                },
            }
        })
        .collect()
}

/// Nearly normal numbers: twelve uniform ones added up.
struct Gauss(ChaCha8Rng);

impl Gauss {
    fn number(&mut self, sigma: f64) -> f64 {
        ((0..12).map(|_| self.0.random::<f64>()).sum::<f64>() - 6.0) * sigma
    }
    fn vector(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.number(sigma))
    }
}

/// One camera of [`glasses`], this far to the left.
fn camera_of_glasses(y_m: f64, sigmas: CameraSigmas) -> Arc<MovingCamera> {
    let forward =
        UnitQuaternion::from_matrix(&Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0));
    MovingCamera::new(&RigCamera {
        camera: Camera {
            width: 640,
            height: 400,
            lens: Lens::KannalaBrandt {
                focal_px: [290.0, 290.0],
                principal_px: [318.0, 201.0],
                distortion: [-0.012, 0.004, -0.002, 0.0003],
            },
        },
        rig_from_camera: Se3::new(forward, Vector3::new(0.01, y_m, 0.0)),
        timing: Default::default(),
        sigmas,
    })
}

fn glasses() -> Vec<Arc<MovingCamera>> {
    [0.055, -0.055]
        .map(|y_m| camera_of_glasses(y_m, CameraSigmas::default()))
        .to_vec()
}

/// On the walls of a room of 6 × 6 × 3 m.
fn wall_points(count: usize, rng: &mut Gauss) -> Vec<Vector3<f64>> {
    (0..count)
        .map(|k| {
            let along = rng.0.random_range(-3.0..3.0);
            let height = rng.0.random_range(0.0..3.0);
            match k % 4 {
                0 => Vector3::new(3.0, along, height),
                1 => Vector3::new(-3.0, along, height),
                2 => Vector3::new(along, 3.0, height),
                _ => Vector3::new(along, -3.0, height),
            }
        })
        .collect()
}

struct MadeUp {
    walk: Walk,
    features: Vec<Features>,
}

/// The first `map` of the points are in the map, the others are local.
fn make_walk(map: usize, local: usize, seen_in_map: impl Fn(usize) -> bool) -> MadeUp {
    make_walk_with(map, local, seen_in_map, &CameraCorrection::zeros())
}

/// Seed of the points, and of what is wrong of everything in the first walk among them.
const SEED: u64 = 11;

/// How the rig truly moves around an instant.
fn true_motion(t: f64) -> FrameMotion {
    let h = 1e-3;
    let (before, here, after) = (truth(t - h), truth(t), truth(t + h));
    let turned = |a: &Se3, b: &Se3| so3::log(&(a.rotation.inverse() * b.rotation)) / h;
    FrameMotion {
        turn_rate_rad_s: turned(&before, &after) / 2.0,
        turn_acceleration_rad_s2: (turned(&here, &after) - turned(&before, &here)) / h,
        velocity_m_s: (after.translation - before.translation) / (2.0 * h),
        acceleration_m_s2: (before.translation + after.translation - here.translation * 2.0)
            / (h * h),
    }
}

/// With cameras that are off from what the rig file says.
fn make_walk_with(
    map: usize,
    local: usize,
    seen_in_map: impl Fn(usize) -> bool,
    off: &CameraCorrection,
) -> MadeUp {
    make_walk_of(SEED, (map, local), seen_in_map, off)
}

/// One of several walks among the same points.
fn make_walk_of(
    seed: u64,
    (map, local): (usize, usize),
    seen_in_map: impl Fn(usize) -> bool,
    off: &CameraCorrection,
) -> MadeUp {
    let mut rng = Gauss(ChaCha8Rng::seed_from_u64(SEED));
    let points = wall_points(map + local, &mut rng);
    let looks: Vec<[u8; DESCRIPTOR_LEN]> = points
        .iter()
        .map(|_| std::array::from_fn(|_| rng.0.random_range(0..140u8)))
        .collect();
    if seed != SEED {
        rng = Gauss(ChaCha8Rng::seed_from_u64(seed));
    }
    let cameras = glasses();
    let real: Vec<_> = cameras.iter().map(|camera| camera.corrected(off)).collect();
    let mut features = Vec::new();
    let mut frames = Vec::new();
    for k in 0..FRAMES {
        let t = k as f64 * FRAME_SECS;
        let pose = truth(t);
        let mut fixed = Vec::new();
        for (c, camera) in real.iter().enumerate() {
            let mut image = Features::default();
            for (p, point) in points.iter().enumerate() {
                let Some(pixel) = camera.project(&pose, &true_motion(t), point) else {
                    continue;
                };
                if !camera.camera().contains(&pixel, 5.0) {
                    continue;
                }
                let pixel = pixel + Vector2::new(rng.number(0.4), rng.number(0.4));
                image.keypoints.push(Keypoint {
                    pixel: [pixel.x as f32, pixel.y as f32],
                    scale_px: 2.0,
                    angle_rad: 0.0,
                    response: 0.1,
                });
                image
                    .descriptors
                    .push(looks[p].map(|v| v + rng.0.random_range(0..9u8)));
                // Localization finds half of the map's points; one in fifty is a wrong one.
                if p < map && seen_in_map(k) && rng.0.random::<f64>() < 0.5 {
                    let wrong = rng.0.random::<f64>() < 0.02;
                    let matched = if wrong { (p + 7) % map } else { p };
                    fixed.push(FixedObservation {
                        camera: c,
                        keypoint: image.keypoints.len() as u32 - 1,
                        pixel,
                        point: matched as u32,
                        point_in_world: points[matched],
                    });
                }
            }
            features.push(image);
        }
        let off = Se3::new(so3::exp(&rng.vector(0.004)), rng.vector(0.012));
        frames.push(Frame {
            time: Timestamp::from_nanos((t * 1e9).round() as i64),
            localized: seen_in_map(k).then(|| LocalizedPose {
                world_from_rig: pose * off,
                covariance: Matrix6::zeros(),
            }),
            fixed: Vec::new(),
            recognised: fixed,
        });
    }
    MadeUp {
        walk: Walk {
            cameras,
            frames,
            imu: imu(&mut rng),
            noise: NOISE,
            noise_factors: Default::default(),
            point_covariances_m2: Default::default(),
        },
        features,
    }
}

fn started(walk: &Walk, config: &GroundTruthConfig) -> Start {
    let start = start_states(walk, config, &no_progress).expect("solves");
    start.expect("localized poses agree")
}

struct Errors {
    rms_m: f64,
    worst_m: f64,
    worst_rad: f64,
}

fn errors(walk: &Walk, states: &[FrameState]) -> Errors {
    let mut result = Errors {
        rms_m: 0.0,
        worst_m: 0.0,
        worst_rad: 0.0,
    };
    for (frame, state) in walk.frames.iter().zip(states) {
        let t = frame.time.nanos() as f64 * 1e-9;
        let error = truth(t).inverse() * state.nav.world_from_rig;
        let distance = error.translation.norm();
        result.rms_m += distance * distance / states.len() as f64;
        result.worst_m = result.worst_m.max(distance);
        result.worst_rad = result.worst_rad.max(so3::log(&error.rotation).norm());
    }
    result.rms_m = result.rms_m.sqrt();
    result
}

#[test]
fn a_walk_with_wrong_matches_false_places_and_a_blind_stretch() {
    // Two seconds without the map, in the middle of the loop.
    let seen = |k: usize| !(45..65).contains(&k);
    let MadeUp { mut walk, features } = make_walk(220, 220, seen);
    // Two false localizations, consistent in themselves.
    for k in [20, 80] {
        let elsewhere = Se3::new(Default::default(), Vector3::new(1.0, -0.5, 0.2));
        let localized = walk.frames[k].localized.as_mut().expect("localized");
        localized.world_from_rig = elsewhere * truth(k as f64 * FRAME_SECS);
        for seen in &mut walk.frames[k].recognised {
            seen.point_in_world = elsewhere * seen.point_in_world;
        }
    }
    let before: usize = walk.frames.iter().map(|f| f.recognised.len()).sum();
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");

    let found = errors(&walk, &solved.last.estimate.states);
    assert!(found.rms_m < 0.002, "rms {} m", found.rms_m);
    assert!(found.worst_m < 0.006, "worst {} m", found.worst_m);
    assert!(found.worst_rad < 0.003, "worst {} rad", found.worst_rad);
    // All but the false ones and those of the blind stretch.
    assert_eq!(
        (start.accepted_count, start.rival_count),
        (FRAMES - 20 - 2, 0)
    );
    let outliers = not_used(&walk, &solved.last.points);
    assert!(outliers > 50, "{outliers} outliers");
    assert!(
        solved.last.points.len() > 50,
        "{} local points",
        solved.last.points.len()
    );
    let after: usize = walk.frames.iter().map(|f| f.fixed.len()).sum();
    // Half of the sights were hidden: most of them come back, also in the blind stretch and the false places.
    assert!(
        after as f64 > 1.5 * before as f64,
        "{before} → {after} map observations"
    );
    assert!(walk.frames[20].fixed.len() > 20 && walk.frames[50].fixed.len() > 20);
    for (k, frame) in walk.frames.iter().enumerate() {
        for seen in &frame.fixed {
            assert!(solved.last.estimate.fixed_error_px(k, seen) <= config.max_error_px);
        }
    }
    let middle = solved.last.estimate.states[FRAMES / 2].bias;
    assert!((middle.gyro_rad_s - Vector3::new(0.004, -0.006, 0.003)).norm() < 1e-3);
}

/// What is left out of a walk of which all poses are known to a millimetre and halves of the map agree.
fn spans_left_out(walk: &Walk, accepted: &[bool], in_view: &[InView]) -> Vec<Span> {
    let config = GroundTruthConfig::default();
    let found = Solution {
        states: &started(walk, &config).states,
        accepted,
        covariances: &[Some(Matrix6::identity() * 1e-6); FRAMES],
        disagreements_m: &[0.0; FRAMES],
        in_view,
    };
    trusted(walk, &found, &config).left_out
}

#[test]
fn local_points_and_imu_carry_a_stretch_the_map_does_not_know() {
    // The map ends half-way: its points are never found again after frame 60.
    let seen = |k: usize| k < 60;
    let MadeUp {
        mut walk,
        mut features,
    } = make_walk(220, 220, seen);
    for (image, features) in features.iter_mut().enumerate() {
        // What the map knows looks different there, so that guided matching finds nothing.
        if image / 2 >= 60 {
            let flip = |d: &mut [u8; DESCRIPTOR_LEN]| d.rotate_left(17);
            features.descriptors.iter_mut().for_each(flip);
        }
    }
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");
    let found = errors(&walk, &solved.last.estimate.states);
    assert!(found.worst_m < 0.1, "worst {} m after 4 s", found.worst_m);

    let estimate = &solved.last.estimate;
    let Uncertainty { poses, .. } =
        uncertainty(&walk, estimate, &solved.last.points, &config, &no_progress)
            .expect("covariances");
    let found = Solution {
        states: &estimate.states,
        accepted: &start.accepted,
        covariances: &poses,
        disagreements_m: &[0.0; FRAMES],
        in_view: &[],
    };
    let trusted = trusted(&walk, &found, &config);
    assert_eq!(trusted.covariances.len(), trusted.poses.len());
    assert_eq!(trusted.left_out.len(), 1, "{:?}", trusted.left_out);
    assert_eq!(trusted.left_out[0].to_ns, 9_900_000_000);
    assert!(
        (60..=64).contains(&trusted.poses.len()),
        "{}",
        trusted.poses.len()
    );
}

#[test]
fn same_bits_on_any_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("pool").install(|| {
            let MadeUp { mut walk, features } = make_walk(80, 80, |k| k < 70);
            walk.frames.truncate(30);
            let config = GroundTruthConfig::default();
            let features = &features[..60];
            let start = started(&walk, &config);
            solve_walk(&mut walk, &start, features, &config, &no_progress)
                .expect("solves")
                .last
                .estimate
                .states
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}
