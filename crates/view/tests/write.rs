//! A small recording becomes a file that the viewer's own library reads again.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::atomic::{AtomicU64, Ordering};

use lsfb_geometry::{Camera, Rig, RigCamera, RigLidar, Se3, StampedPose, Trajectory, Vector6};
use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_types::{
    Image, ImuSample, LidarPoint, LidarScan, Progress, Stamped, Stopped, Timestamp, no_progress,
};
use lsfb_view::{
    CameraPyramids, Error, MapPoints, NamedTrajectory, ViewConfig, ViewInputs, ViewReport, Walk,
    write_rrd,
};

const START: Timestamp = Timestamp::from_nanos(1_772_359_200_000_000_000);

fn rig() -> Rig {
    // Camera z forward is rig x; camera x right is rig −y.
    let looking_forward = Se3::new(
        lsfb_geometry::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
            0.5, -0.5, 0.5, -0.5,
        )),
        lsfb_geometry::Vector3::new(0.1, 0.0, 0.0),
    );
    Rig {
        cameras: [(
            "cam0".to_owned(),
            RigCamera {
                camera: Camera::pinhole(160, 100, [90.0; 2], [79.5, 49.5]),
                rig_from_camera: looking_forward,
                timing: Default::default(),
                sigmas: Default::default(),
            },
        )]
        .into(),
        lidars: RigLidar {
            rig_from_lidar: Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.3)),
            range_noise_m: 0.02,
        }
        .alone(),
        ..Rig::empty("backpack")
    }
}

fn pose(secs: f64) -> Se3 {
    Se3::exp(&Vector6::new(0.0, 0.0, 0.3 * secs, 0.8 * secs, 0.0, 0.0))
}

fn at<T>(secs: f64, sample: T) -> Stamped<T> {
    let time = START.plus_secs(secs);
    Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample,
    }
}

/// A ring of walls five metres around the world's origin, seen from the rig.
fn scan(secs: f64) -> LidarScan {
    let lidar_from_world = (pose(secs) * rig().lidar().unwrap().rig_from_lidar).inverse();
    let points = (0..2000u16).map(|i| {
        let (angle, z) = (f64::from(i) * 0.05, f64::from(i % 20) * 0.1);
        let world = lsfb_geometry::Vector3::new(5.0 * angle.cos(), 5.0 * angle.sin(), z);
        LidarPoint {
            position_m: (lidar_from_world * world).cast::<f32>().into(),
            intensity: (i % 20 * 5) as u8,
            ring: i % 20,
            time_offset_ns: 0,
            ..LidarPoint::default()
        }
    });
    LidarScan {
        points: points.collect(),
    }
}

#[test]
fn a_small_walk_is_written_with_everything_in_it() {
    let scratch = tempfile::tempdir().unwrap();
    let kept = std::env::var_os("LSFB_KEEP_VIEW").map(std::path::PathBuf::from);
    let dir = kept.unwrap_or_else(|| scratch.path().to_owned());
    let path = dir.join("walk.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    writer.attach_rig(&rig()).unwrap();
    for n in 0..40u32 {
        let secs = f64::from(n) * 0.1;
        let pixels = (0..16_000u32)
            .map(|i| ((i % 160) + (i / 160) + 4 * n) as u8)
            .collect();
        let image = Image {
            width: 160,
            height: 100,
            pixels,
            exposure_ns: 0,
            frame_id: n,
        };
        writer.write_image("cam0", &at(secs, image)).unwrap();
        writer.write_scan("lidar", &at(secs, scan(secs))).unwrap();
        for k in 0..20 {
            let secs = secs + f64::from(k) * 0.005;
            let sample = ImuSample {
                angular_velocity_rad_s: [0.0, 0.1 * secs.sin(), 0.3],
                specific_force_m_s2: [0.2, 0.0, 9.81],
            };
            writer.write_imu("imu0", &at(secs, sample)).unwrap();
        }
    }
    writer.finish().unwrap();

    let poses = (0..=40).map(|n| StampedPose {
        time: START.plus_secs(f64::from(n) * 0.1),
        world_from_rig: pose(f64::from(n) * 0.1),
    });
    let trajectory = Trajectory::new(poses.collect());
    let positions_m: Vec<[f32; 3]> = (0..500)
        .map(|i| [4.9, i as f32 * 0.01 - 2.5, (i % 20) as f32 * 0.1])
        .collect();
    let recording = Recording::open(&path).unwrap();
    let inputs = ViewInputs {
        map: MapPoints {
            colors_rgb: vec![[250, 120, 40]; positions_m.len()],
            positions_m,
        },
        surface: MapPoints {
            positions_m: vec![[4.9, 0.0, 1.0]],
            colors_rgb: Vec::new(),
        },
        cameras: vec![CameraPyramids {
            name: "cam0".into(),
            strips_m: vec![vec![[0.0; 3], [0.2, 0.1, 0.1], [0.2, -0.1, 0.1]]],
            color_rgb: [230, 159, 0],
        }],
        trajectories: vec![NamedTrajectory {
            name: "scanner".into(),
            trajectory: trajectory.clone(),
            color_rgb: [80, 220, 80],
        }],
        walks: vec![Walk {
            name: "scan".into(),
            recording: &recording,
            rig: rig(),
            world_from_rig: trajectory,
        }],
    };
    let out = dir.join("walk.rrd");
    let config = ViewConfig::default();
    let steps = AtomicU64::new(0);
    let count = |_: Progress| {
        steps.fetch_add(1, Ordering::Relaxed);
        Ok(())
    };
    write_rrd(&out, &inputs, &config, &count).unwrap();
    std::fs::remove_file(&out).unwrap();
    let steps = steps.into_inner();
    assert!(steps >= 4, "{steps}");
    for last in 0..steps {
        let step = AtomicU64::new(0);
        let stop = |_: Progress| match step.fetch_add(1, Ordering::Relaxed) == last {
            true => Err(Stopped),
            false => Ok(()),
        };
        let stopped = write_rrd(&out, &inputs, &config, &stop);
        assert!(matches!(stopped, Err(Error::Stopped(_))), "{stopped:?}");
        assert!(!out.exists(), "{last}");
    }
    let report = write_rrd(&out, &inputs, &config, &no_progress).unwrap();
    // Four seconds: images and scans every half second, inertial samples every 20 ms.
    let expected = ViewReport {
        images: 8,
        scans: 8,
        imu_samples: 200,
        unreadable: 0,
    };
    assert_eq!(report, expected);
    let bytes = std::fs::read(&out).unwrap();
    assert!(
        bytes.starts_with(b"RRF2") && bytes.len() > 100_000,
        "{} bytes",
        bytes.len()
    );
    for entity in ["world/map", "world/surface", "world/cameras/cam0"] {
        let is_named = bytes.windows(entity.len()).any(|w| w == entity.as_bytes());
        assert!(is_named, "{entity}");
    }
}

#[test]
fn what_cannot_be_written_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let inputs = ViewInputs {
        map: MapPoints {
            positions_m: vec![[0.0; 3]; 2],
            colors_rgb: vec![[0; 3]],
        },
        ..ViewInputs::default()
    };
    let config = ViewConfig::default();
    let error = write_rrd(&dir.path().join("a.rrd"), &inputs, &config, &no_progress).unwrap_err();
    assert!(matches!(
        error,
        Error::MapColors {
            positions: 2,
            colors: 1
        }
    ));
    let out = dir.path().join("no/such/folder/a.rrd");
    let error = write_rrd(&out, &ViewInputs::default(), &config, &no_progress)
        .unwrap_err()
        .to_string();
    assert!(error.contains("no/such/folder/a.rrd"), "{error}");
}
