use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use lsfb_geometry::{
    Camera, ImuNoiseModel, RigCamera, RigImu, RigLidar, Se3, UnitQuaternion, Vector2, Vector3,
    Vector6, so3,
};
use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{Image, ImuSample, LidarPoint, LidarScan, Stamped, Timestamp, no_progress};
use rayon::prelude::*;

use super::*;

/// Low and high corners of the boxes in the room, the room itself first, metres.
const BOXES: [[[f64; 3]; 2]; 8] = [
    [[-4.0, -3.5, -1.4], [4.0, 3.5, 1.6]],
    [[2.2, 0.6, -1.4], [2.6, 1.1, 0.9]],
    [[2.0, -1.3, -1.4], [2.5, -0.7, 0.2]],
    [[-2.6, -1.6, -1.4], [-2.1, -0.9, 0.7]],
    [[-2.4, 0.8, -1.4], [-2.0, 1.7, 0.1]],
    [[0.4, 2.2, -1.4], [1.3, 2.6, 0.4]],
    [[-0.9, -2.4, -1.4], [-0.2, -2.0, 1.0]],
    [[2.4, -0.25, 0.5], [2.8, 0.2, 1.1]],
];

/// Distance along a ray and what it hits.
fn hit(origin: &Vector3<f64>, ray: &Vector3<f64>) -> (f64, usize, usize) {
    let mut best = (f64::INFINITY, 0, 0);
    for (number, [low, high]) in BOXES.iter().enumerate() {
        let (mut enter, mut leave) = ((0.0, 0), (f64::INFINITY, 0));
        for (k, (low, high)) in low.iter().zip(high).enumerate() {
            let (a, b) = ((low - origin[k]) / ray[k], (high - origin[k]) / ray[k]);
            if a.min(b) > enter.0 {
                enter = (a.min(b), k);
            }
            if a.max(b) < leave.0 {
                leave = (a.max(b), k);
            }
        }
        let inside = number == 0;
        let (distance, axis) = if inside { leave } else { enter };
        if distance > 0.0 && (inside || enter.0 < leave.0) && distance < best.0 {
            best = (distance, number, axis);
        }
    }
    best
}

fn brightness(origin: &Vector3<f64>, ray: &Vector3<f64>) -> f64 {
    let (distance, number, axis) = hit(origin, ray);
    let p = origin + ray * distance;
    let base = [105.0, 190.0, 45.0, 205.0, 40.0, 185.0, 55.0, 215.0][number] + 9.0 * axis as f64;
    let mut texture = 0.0;
    for (k, scale) in [3.1, 5.3, 9.7, 17.0, 41.0].into_iter().enumerate() {
        let turn = k as f64 + 1.3 * number as f64;
        texture +=
            (scale * (p.x + 0.7 * p.y) + turn).sin() * (scale * (p.z - 0.4 * p.y) + turn).cos();
    }
    base + 9.0 * texture
}

fn world_from_rig(time_s: f64) -> Se3 {
    let t = time_s;
    let turn = UnitQuaternion::from_euler_angles(
        0.2 * (1.9 * t).sin(),
        0.22 * (2.7 * t + 1.0).sin(),
        0.4 * (1.3 * t + 2.0).sin(),
    );
    let place = Vector3::new(
        0.1 * (0.8 * t).sin(),
        0.1 * (1.1 * t).cos(),
        0.05 * (1.7 * t).sin(),
    );
    Se3::new(turn, place)
}

fn rig() -> Rig {
    let forward = UnitQuaternion::from_euler_angles(-FRAC_PI_2, 0.0, -FRAC_PI_2);
    let camera = Camera::pinhole(256, 160, [160.0, 160.0], [127.5, 79.5]);
    let mounted = |y: f64| RigCamera {
        camera,
        rig_from_camera: Se3::new(forward, Vector3::new(0.05, y, 0.1)),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    Rig {
        cameras: [
            ("cam0".to_owned(), mounted(0.08)),
            ("cam1".to_owned(), mounted(-0.08)),
        ]
        .into(),
        imus: RigImu::from(ImuNoiseModel {
            gyro_noise_density: 1e-3,
            accel_noise_density: 1e-2,
            gyro_bias_walk: 1e-5,
            accel_bias_walk: 1e-4,
        })
        .alone(),
        lidars: RigLidar {
            rig_from_lidar: Se3::exp(&Vector6::new(0.01, 0.02, -0.03, -0.02, 0.0, 0.25)),
            range_noise_m: 0.0,
        }
        .alone(),
        ..Rig::empty("test")
    }
}

fn image(rig: &Rig, name: &str, time_s: f64) -> Image {
    let mounted = &rig.cameras[name];
    let world_from_camera = world_from_rig(time_s) * mounted.rig_from_camera;
    let (width, height) = (mounted.camera.width, mounted.camera.height);
    let pixels: Vec<u8> = (0..width * height)
        .into_par_iter()
        .map(|k| {
            let pixel = Vector2::new(f64::from(k % width), f64::from(k / width));
            let ray = mounted.camera.unproject(&pixel).expect("a pinhole");
            brightness(
                &world_from_camera.translation,
                &(world_from_camera.rotation * ray),
            ) as u8
        })
        .collect();
    Image {
        width,
        height,
        pixels,
        exposure_ns: 0,
        frame_id: 0,
    }
}

fn scan(rig: &Rig, start_s: f64) -> LidarScan {
    let lidar = rig.lidar().expect("a LiDAR");
    let mut points = Vec::new();
    for step in 0..900 {
        let offset_s = 0.1 * f64::from(step) / 900.0;
        let pose = world_from_rig(start_s + offset_s) * lidar.rig_from_lidar;
        for ring in 0..32 {
            let elevation = (f64::from(ring) - 20.0).to_radians();
            let azimuth = (0.4 * f64::from(step)).to_radians();
            let ray = Vector3::new(
                elevation.cos() * azimuth.cos(),
                elevation.cos() * azimuth.sin(),
                elevation.sin(),
            );
            let turned = pose.rotation * ray;
            let (distance, ..) = hit(&pose.translation, &turned);
            points.push(LidarPoint {
                position_m: (ray * distance).map(|x| x as f32).into(),
                intensity: (0.4 * brightness(&pose.translation, &turned)) as u8,
                ring: ring as u16,
                time_offset_ns: (offset_s * 1e9) as u32,
                ..LidarPoint::default()
            });
        }
    }
    LidarScan { points }
}

/// Five seconds of turning in the room; images are stamped late by `late_s`.
fn record(path: &Path, rig: &Rig, late_s: f64) {
    record_drifting(path, rig, 5.0, &|_| late_s);
}

/// Some seconds of it; images are stamped late by what is said of their time.
fn record_drifting(path: &Path, rig: &Rig, lasts_s: f64, late_s: &dyn Fn(f64) -> f64) {
    let config = WriterConfig::default();
    let mut writer = Writer::create(path, &config).expect("a file");
    let start = Timestamp::from_nanos(1_772_359_200_000_000_000);
    fn stamped<T>(start: Timestamp, time_s: f64, sample: T) -> Stamped<T> {
        let time = start.plus_secs(time_s);
        Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample,
        }
    }
    for k in 0..(200.0 * lasts_s) as u32 {
        let t = 0.005 * f64::from(k);
        let h = 1e-4;
        let turn = world_from_rig(t - h).rotation.inverse() * world_from_rig(t + h).rotation;
        let sample = ImuSample {
            angular_velocity_rad_s: (so3::log(&turn) / (2.0 * h)).into(),
            specific_force_m_s2: [0.0, 0.0, 9.81],
        };
        writer
            .write_imu("imu0", &stamped(start, t, sample))
            .expect("written");
        if k % 10 == 5 {
            for name in rig.cameras.keys() {
                let picture = image(rig, name, t);
                writer
                    .write_image(name, &stamped(start, t + late_s(t), picture))
                    .expect("written");
            }
        }
        if k % 40 == 20 && rig.lidar().is_some() {
            writer
                .write_scan("lidar", &stamped(start, t, scan(rig, t)))
                .expect("written");
        }
    }
    writer.finish().expect("closed");
}

fn outcome<'a>(found: &'a Verification, name: &str) -> &'a Check {
    let check = found.checks.iter().find(|c| c.name == name);
    check.unwrap_or_else(|| panic!("{name} in {:?}", found.checks))
}

#[test]
fn a_rig_that_fits_passes_and_what_does_not_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("good.mcap");
    let rig = rig();
    record(&path, &rig, 0.0);
    let recording = Recording::open(&path).expect("a recording");
    let config = VerifyConfig {
        views: 12,
        ..VerifyConfig::default()
    };
    let run = |rig: &Rig| verify(&recording, rig, &config, &no_progress).expect("verified");

    let found = run(&rig);
    assert_eq!(found.checks.len(), 11, "{:?}", found.checks);
    assert!(
        found.judgement().verdict() < Verdict::Fail,
        "{:?}",
        found.checks
    );
    for name in ["cam0 time offset", "cam0 rotation to the LiDAR"] {
        assert_eq!(
            outcome(&found, name).outcome,
            Verdict::Pass,
            "{:?}",
            found.checks
        );
    }
    assert_eq!(found.overlays.len(), 2);
    assert!(found.overlays[0].points > 300 && found.overlays[0].png.len() > 10_000);

    // One camera turned by 2° about its y axis.
    let mut moved = rig.clone();
    let camera = moved.cameras.get_mut("cam0").expect("cam0");
    camera.rig_from_camera =
        camera.rig_from_camera * Se3::exp(&Vector6::new(0.0, 0.035, 0.0, 0.0, 0.0, 0.0));
    let bad = run(&moved);
    assert_eq!(bad.judgement().verdict(), Verdict::Fail);
    assert_eq!(
        outcome(&bad, "cam0 rotation to the LiDAR").outcome,
        Verdict::Fail
    );
    assert_eq!(
        outcome(&bad, "cam1 rotation to the LiDAR").outcome,
        Verdict::Pass
    );

    // Turned about the x axis, a little and a lot: curves move across.
    for turn_rad in [0.025, 0.09] {
        let mut rolled = rig.clone();
        let camera = rolled.cameras.get_mut("cam1").expect("cam1");
        camera.rig_from_camera =
            camera.rig_from_camera * Se3::exp(&Vector6::new(turn_rad, 0.0, 0.0, 0.0, 0.0, 0.0));
        let bad = run(&rolled);
        let check = outcome(&bad, "cam0–cam1 epipolar");
        assert_eq!(check.outcome, Verdict::Fail, "{check:?}");
    }

    let mut other = rig;
    other.cameras.get_mut("cam0").expect("cam0").camera.width = 640;
    let error = verify(&recording, &other, &config, &no_progress)
        .expect_err("size")
        .to_string();
    assert!(error.contains("images are 256 × 160"), "{error}");
}

#[test]
fn late_images_are_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("late.mcap");
    let mut rig = rig();
    rig.cameras.remove("cam1");
    let lidars = std::mem::take(&mut rig.lidars);
    let mut with_lidar = rig.clone();
    with_lidar.lidars = lidars;
    record(&path, &with_lidar, 0.012);
    let recording = Recording::open(&path).expect("a recording");
    let config = VerifyConfig::default();
    let found = verify(&recording, &rig, &config, &no_progress).expect("verified");
    let check = outcome(&found, "cam0 time offset");
    // What is added to the camera's times gives the rig's.
    assert!(
        (check.value.expect("an offset") + 12.0).abs() < 4.0,
        "{check:?}"
    );
    assert_eq!(check.outcome, Verdict::Fail);
    // Put into the rig with its deviation, what was measured makes it fit.
    let (corrected, clocks) = found.with_measured_clocks(&rig);
    let [clock] = clocks.as_slice() else {
        panic!("{:?}: {clocks:?}", found.checks);
    };
    let own = corrected.cameras["cam0"].timing.rig_from_camera_s;
    assert_eq!(
        (
            clock.camera.as_str(),
            clock.rig_from_camera_s,
            clock.stated_s
        ),
        ("cam0", own, 0.0)
    );
    let error_s = (own + 0.012).abs();
    assert!(error_s < (3.0 * clock.sigma_s).max(0.5e-3), "{clock:?}");
    let again = verify(&recording, &corrected, &config, &no_progress).expect("verified");
    assert_eq!(outcome(&again, "cam0 time offset").outcome, Verdict::Pass);
    // A camera that does not turn as the gyroscope does may be another's.
    let mut turned = found.clone();
    for check in &mut turned.checks {
        if check.name == "cam0 rotation to the IMU" {
            check.outcome = Verdict::Fail;
        }
    }
    assert_eq!(turned.with_measured_clocks(&rig), (rig.clone(), Vec::new()));
}

#[test]
fn a_clock_that_changes_on_the_way_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drifting.mcap");
    let mut rig = rig();
    rig.cameras.remove("cam1");
    rig.lidars.clear();
    // Right for the first half of the recording, late by 12 ms in the second.
    record_drifting(&path, &rig, 20.0, &|t| if t < 10.0 { 0.0 } else { 0.012 });
    let recording = Recording::open(&path).expect("a recording");
    let config = VerifyConfig::default();
    let found = verify(&recording, &rig, &config, &no_progress).expect("verified");
    let check = outcome(&found, "cam0 time offset over time");
    assert_eq!(check.outcome, Verdict::Fail, "{:?}", found.checks);
    let off_ms = check.value.expect("found") - 12.0;
    assert!(off_ms.abs() < 2.5, "{check:?}");
    let mount = outcome(&found, "cam0 rotation over time");
    assert_eq!(mount.outcome, Verdict::Pass, "{mount:?}");
    assert_eq!(found.with_measured_clocks(&rig), (rig.clone(), Vec::new()));

    // A camera that the recording lacks is missed.
    let other = rig.cameras["cam0"].clone();
    rig.cameras.insert("cam7".to_owned(), other);
    let found = verify(&recording, &rig, &config, &no_progress).expect("verified");
    let missing = outcome(&found, "cam7 in the recording");
    assert_eq!(missing.outcome, Verdict::Warn);
    assert!(missing.sentence.contains("cam7"), "{missing:?}");
}
