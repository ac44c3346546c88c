//! The odometry over scans that are seconds apart: the walk indoors of maplab's dense mapping test (24 scans, one in five seconds, an IMU).
//!
//! `cargo run --release -p lsfb-pipeline --example rare_scans -- DATA/lidar/maplab_dense_map [--from K] [--to K] [--every N] [--out walk.tum]`
//!
//! Prints where each scan found its place, and how the scans lie on one another. There are no true poses beside the recording.

#![allow(clippy::print_stdout)] // a program, not a library

use std::error::Error;
use std::path::{Path, PathBuf};

use lsfb_geometry::{ImuNoiseModel, RigLidar, Se3, UnitQuaternion, Vector3};
use lsfb_pipeline::odometry::{ImuSamples, OdometryConfig, OdometryRun, TimedScan};
use lsfb_recording::cloud::PointTimes;
use lsfb_recording::write_tum;
use lsfb_types::{ImuSample, LidarPoint, LidarScan, Stamped, Timestamp};

type Failure = Box<dyn Error>;

/// As `vi_map/sensors.yaml` has them.
const NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 0.005,
    accel_noise_density: 0.01,
    gyro_bias_walk: 4e-6,
    accel_bias_walk: 2e-4,
};

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| {
        let at = arguments.iter().position(|a| a == name);
        at.and_then(|k| arguments.get(k + 1))
    };
    let number = |name: &str, otherwise: usize| -> Result<usize, Failure> {
        Ok(option(name).map_or(Ok(otherwise), |n| n.parse())?)
    };
    let folder = PathBuf::from(arguments.first().ok_or("give the folder")?);
    let (from, to) = (number("--from", 0)?, number("--to", usize::MAX)?);
    let every = number("--every", 1)?.max(1);
    let mut noise = NOISE;
    if arguments.iter().any(|a| a == "--cheap") {
        noise = ImuNoiseModel {
            gyro_noise_density: 1e-3,
            accel_noise_density: 1e-2,
            gyro_bias_walk: 1e-4,
            accel_bias_walk: 1e-3,
        };
    }
    let shift_ms = number("--shift-ms", 0)? as i64;
    let scans: Vec<_> = scans(&folder)?
        .into_iter()
        .enumerate()
        .filter(|(k, _)| (from..to).contains(k) && (k - from.min(*k)).is_multiple_of(every))
        .map(|(_, mut scan)| {
            scan.time = scan.time.plus_nanos(-shift_ms * 1_000_000);
            scan
        })
        .collect();
    let first = scans.first().ok_or("no scans")?.time;
    let mut samples = imu(&folder)?;
    samples.retain(|s| s.time >= first.plus_nanos(-1_300_000_000));
    let imu = ImuSamples { noise, samples };
    let config = OdometryConfig::default();
    let mut run = OdometryRun::new(&config, &lidar(), Some(imu))?;
    if arguments.iter().any(|a| a == "--azimuth") {
        run = run.with_times_by_azimuth();
    }
    for scan in scans {
        let times = PointTimes::Absent;
        run.push(TimedScan { scan, times })?;
    }
    let result = run.finish()?;
    for scan in &result.scan_poses {
        let place = scan.pose.world_from_rig.translation;
        let (roll, pitch, yaw) = scan.pose.world_from_rig.rotation.euler_angles();
        let c = &scan.covariance;
        println!(
            "{:7.2} s  ({:7.3}, {:7.3}, {:7.3}) m  rpy {:6.2} {:6.2} {:7.2}  σ {:.3} {:.3} {:.3} m",
            scan.pose.time.secs_since(first),
            place.x,
            place.y,
            place.z,
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees(),
            c[(3, 3)].sqrt(),
            c[(4, 4)].sqrt(),
            c[(5, 5)].sqrt(),
        );
    }
    println!("{:#?}", result.report);
    if let Some(out) = option("--out") {
        let poses = result.scan_poses.iter().map(|s| s.pose).collect();
        write_tum(Path::new(out), &lsfb_geometry::Trajectory::new(poses))?;
    }
    Ok(())
}

/// The LiDAR on the IMU, as `vi_map/sensors.yaml` has it.
fn lidar() -> RigLidar {
    let rotation = lsfb_geometry::Matrix3::new(
        0.9999874213511631,
        -0.004957927403632594,
        -0.0007590094278570014,
        0.00495486045362637,
        0.9999797618555115,
        -0.003990643717431052,
        0.0007787793887593181,
        0.00398683273472708,
        0.9999917492996675,
    );
    let place = Vector3::new(
        -0.02715030606424891,
        0.04506446949568683,
        0.04861247181001468,
    );
    RigLidar {
        rig_from_lidar: Se3::new(UnitQuaternion::from_matrix(&rotation), place),
        range_noise_m: 0.02,
    }
}

fn stamped<T>(nanos: &str, sample: T) -> Result<Stamped<T>, Failure> {
    let time = Timestamp::from_nanos(nanos.parse()?);
    Ok(Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample,
    })
}

fn imu(folder: &Path) -> Result<Vec<Stamped<ImuSample>>, Failure> {
    let text = std::fs::read_to_string(folder.join("decoded/imu.csv"))?;
    let sample = |line: &str| {
        let mut words = line.split(',');
        let nanos = words.next().unwrap_or_default();
        let numbers: Vec<f64> = words.map(str::parse).collect::<Result<_, _>>()?;
        let [ax, ay, az, gx, gy, gz] = numbers[..] else {
            return Err(Failure::from("six numbers a line"));
        };
        stamped(
            nanos,
            ImuSample {
                angular_velocity_rad_s: [gx, gy, gz],
                specific_force_m_s2: [ax, ay, az],
            },
        )
    };
    text.lines().skip(1).map(sample).collect()
}

fn scans(folder: &Path) -> Result<Vec<Stamped<LidarScan>>, Failure> {
    let text = std::fs::read_to_string(folder.join("decoded/lidar_scans.csv"))?;
    let scan = |line: &str| {
        let mut words = line.split(',');
        let (Some(nanos), Some(name)) = (words.next(), words.next()) else {
            return Err(Failure::from("a time and a file a line"));
        };
        let bytes = std::fs::read(folder.join("resources/point_cloud_w_intensity").join(name))?;
        let marker = b"end_header\n";
        let head = bytes.windows(marker.len()).position(|w| w == marker);
        let points = &bytes[head.ok_or("no head")? + marker.len()..];
        let float = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        let points = points.chunks_exact(16).map(|p| LidarPoint {
            position_m: [float(p), float(&p[4..]), float(&p[8..])],
            ..Default::default()
        });
        stamped(
            nanos,
            LidarScan {
                points: points.collect(),
            },
        )
    };
    text.lines().skip(1).map(scan).collect()
}
