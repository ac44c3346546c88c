use std::path::Path;

use lsfb_tests::recordings;
use lsfb_types::LidarPoint;

use super::*;
use room::Room;

mod degenerate;
mod gaps;
mod hard;
mod mounting;
mod online;
mod rare;
mod real;
mod recorded;
mod registration;
pub(crate) mod room;

/// Points of a binary PCD file of four floats per point.
fn read_pcd(path: &Path) -> LidarScan {
    let bytes = std::fs::read(path).expect("pcd file");
    let marker = b"DATA binary\n";
    let start = bytes
        .windows(marker.len())
        .position(|w| w == marker)
        .expect("binary pcd")
        + marker.len();
    let float = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    LidarScan {
        points: bytes[start..]
            .chunks_exact(16)
            .map(|p| LidarPoint {
                position_m: [float(p), float(&p[4..]), float(&p[8..])],
                ..Default::default()
            })
            .collect(),
    }
}

/// Poses as twelve numbers per line, row by row.
fn read_kitti_poses(path: &Path) -> Vec<Se3> {
    let text = std::fs::read_to_string(path).expect("poses");
    text.lines()
        .map(|line| {
            let n: Vec<f64> = line
                .split_whitespace()
                .map(|w| w.parse().expect("number"))
                .collect();
            let rotation =
                nalgebra::Matrix3::new(n[0], n[1], n[2], n[4], n[5], n[6], n[8], n[9], n[10]);
            Se3::new(
                lsfb_geometry::UnitQuaternion::from_matrix(&rotation),
                Vector3::new(n[3], n[7], n[11]),
            )
        })
        .collect()
}

#[test]
fn kitti_end_point_agrees_with_kiss_icp() {
    let Some(folder) = recordings(
        "kitti_end_point_agrees_with_kiss_icp",
        "lidar/udacity_kitti_raw",
    ) else {
        return;
    };
    let reference = read_kitti_poses(&folder.join("data_1_kissicp_poses.txt"));
    let config = OdometryConfig::outdoor();
    let lidar = RigLidar {
        rig_from_lidar: Se3::identity(),
        range_noise_m: 0.02,
    };
    let mut odometry = Odometry::new(&config, &lidar, None).expect("config");
    let mut path_length_m = 0.0;
    for (i, expected) in reference.iter().enumerate() {
        let scan = Stamped {
            time: Timestamp::from_nanos(i as i64 * 100_000_000),
            arrival: Timestamp::from_nanos(i as i64 * 100_000_000),
            device_ticks: 0,
            sample: read_pcd(&folder.join(format!("data_1/{i:010}.pcd"))),
        };
        let step = odometry.push_scan(&scan).expect("scan");
        if i > 0 {
            path_length_m += (expected.translation - reference[i - 1].translation).norm();
        }
        let error = step.world_from_rig.translation - expected.translation;
        if i + 1 == reference.len() {
            assert!(
                error.norm() < 0.01 * path_length_m,
                "{} m off after {path_length_m} m",
                error.norm()
            );
        }
    }
}

/// Root mean square position error after rigid alignment, of a walk through the synthetic room.
fn walk(duration_s: f64, with_imu: Option<&ImuNoiseModel>) -> (f64, Odometry) {
    let room = Room::furnished();
    let config = OdometryConfig::default();
    let mut odometry = Odometry::new(&config, &room::lidar(), with_imu).expect("config");
    let samples = room::imu_samples(duration_s, 7);
    let mut next_sample = 0;
    let (mut found, mut truth) = (Vec::new(), Vec::new());
    for i in 0..(duration_s * 10.0) as u64 - 1 {
        let scan = room::scan(&room, i as f64 * 0.1, i);
        let covered = scan.time.plus_secs(0.11);
        while let Some(sample) = samples.get(next_sample).filter(|s| s.time <= covered) {
            odometry.push_imu(sample);
            next_sample += 1;
        }
        let step = odometry.push_scan(&scan).expect("scan");
        assert_ne!(step.outcome, StepOutcome::Lost, "scan {i}");
        let times = step
            .poses
            .iter()
            .map(|p| p.time.secs_since(room::time(0.0)));
        truth.extend(times.map(|t| room::world_from_rig(t).translation));
        found.extend(step.poses.iter().map(|p| p.world_from_rig.translation));
    }
    let alignment =
        lsfb_geometry::align::umeyama(&found, &truth, lsfb_geometry::align::Scale::Fixed)
            .expect("enough poses");
    let squares: f64 = found
        .iter()
        .zip(&truth)
        .map(|(f, t)| (alignment.apply(f) - t).norm_squared())
        .sum();
    ((squares / found.len() as f64).sqrt(), odometry)
}

#[test]
fn room_with_imu_within_a_centimetre() {
    let imu = room::imu();
    let (rms_m, odometry) = walk(12.0, Some(&imu));
    let state = odometry.inertial_state().expect("with IMU");
    assert!(rms_m < 0.01, "{rms_m} m");
    let gyro_error = state.gyro_bias_rad_s - Vector3::new(0.004, -0.003, 0.006);
    assert!(gyro_error.norm() < 1e-3, "{gyro_error}");
    let accel_error = state.accel_bias_m_s2 - Vector3::new(0.04, -0.03, 0.05);
    assert!(accel_error.norm() < 0.02, "{accel_error}");
}

#[test]
fn room_without_imu_within_three_centimetres() {
    let (rms_m, _) = walk(12.0, None);
    assert!(rms_m < 0.03, "{rms_m} m");
}
