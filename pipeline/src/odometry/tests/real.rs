//! Recordings made by others, with poses that others found.

use std::path::Path;

use lsfb_tests::recordings;
use lsfb_types::LidarPoint;

use super::super::{ImuSamples, OdometryResult, OdometryRun, TimedScan};
use super::*;

/// Triples of floats.
fn points(bytes: &[u8], floats_per_point: usize) -> Vec<Vector3<f64>> {
    let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let each = bytes.chunks_exact(4 * floats_per_point);
    each.map(|p| Vector3::new(float(p), float(&p[4..]), float(&p[8..])))
        .collect()
}

/// Poses of a `graph.txt`: a name, a place, a quaternion with its real part last.
fn graph(path: &Path) -> Vec<Se3> {
    let text = std::fs::read_to_string(path).expect("poses");
    let pose = |line: &str| {
        let numbers = line.split_whitespace().skip(1);
        let n: Vec<f64> = numbers.map(|w| w.parse().expect("a number")).collect();
        let rotation = lsfb_geometry::Quaternion::new(n[6], n[3], n[4], n[5]);
        Se3::new(
            lsfb_geometry::UnitQuaternion::from_quaternion(rotation),
            Vector3::new(n[0], n[1], n[2]),
        )
    };
    text.lines().map(pose).collect()
}

/// Registers each scan to the one before it from guesses that are off, and gives how far it ends from the given poses at most: metres and
/// degrees.
fn worst_of_pairs(
    scans: &[Vec<Vector3<f64>>],
    poses: &[Se3],
    config: &OdometryConfig,
    offset_m: f64,
) -> [f64; 2] {
    let lidar = RigLidar {
        rig_from_lidar: Se3::identity(),
        range_noise_m: 0.02,
    };
    let sensor = Vector3::zeros();
    let mut worst = [0.0_f64; 2];
    for (pair, given) in scans.windows(2).zip(poses.windows(2)) {
        let odometry = Odometry::new(config, &lidar, None).expect("config");
        let mut map = odometry.map.clone();
        map.insert(&pair[0], &Se3::identity(), &sensor);
        let expected = given[0].inverse() * given[1];
        let keypoints = voxel_downsample(&pair[1], config.keypoint_voxel_m);
        for k in 0..6 {
            let mut offset = Vector6::zeros();
            offset[k] = if k < 3 { 0.03 } else { offset_m };
            let prior = PosePrior {
                world_from_rig: expected * Se3::exp(&offset),
                information: Matrix6::identity(),
            };
            let settings = odometry.registration(config.initial_gate_m);
            let found = register(&keypoints, &prior, &settings, |pose, gate_m| {
                map.find_all(&keypoints, &sensor, pose, gate_m)
            });
            let error = expected.inverse() * found.world_from_rig;
            worst[0] = worst[0].max(error.translation.norm());
            worst[1] = worst[1].max(error.rotation.angle().to_degrees());
        }
    }
    worst
}

#[test]
fn scans_of_kitti_07_lie_where_gtsam_points_has_them() {
    let test = "scans_of_kitti_07_lie_where_gtsam_points_has_them";
    let Some(folder) = recordings(test, "lidar/gtsam_points/kitti_07_dump") else {
        return;
    };
    let poses = graph(&folder.join("graph.txt"));
    let scan = |k: usize| {
        let path = folder.join(format!("{k:06}/points.bin"));
        points(&std::fs::read(path).expect("points"), 3)
    };
    let scans: Vec<_> = (0..poses.len()).map(scan).collect();
    let [off_m, off_deg] = worst_of_pairs(&scans, &poses, &OdometryConfig::outdoor(), 0.5);
    assert!(off_m < 0.05 && off_deg < 0.5, "{off_m} m, {off_deg}°");
}

/// Features of LOAM from every tenth scan, 3 to 12 m apart.
#[test]
fn features_of_newer_college_lie_where_gtsam_points_has_them() {
    let test = "features_of_newer_college_lie_where_gtsam_points_has_them";
    let Some(folder) = recordings(test, "lidar/gtsam_points/newer_01") else {
        return;
    };
    let poses = graph(&folder.join("graph.txt"));
    let scan = |k: usize| {
        let read = |kind: &str| {
            let path = folder.join(format!("{kind}_{:06}.bin", 10 * k));
            points(&std::fs::read(path).expect("points"), 3)
        };
        [read("planes"), read("edges")].concat()
    };
    let scans: Vec<_> = (0..poses.len()).map(scan).collect();
    let [off_m, off_deg] = worst_of_pairs(&scans, &poses, &OdometryConfig::outdoor(), 0.3);
    assert!(off_m < 0.05 && off_deg < 0.5, "{off_m} m, {off_deg}°");
}

/// The columns of a file of numbers separated by commas, but for its header.
fn csv(path: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(path).expect("a file");
    let lines = text.lines().skip(1);
    lines
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

/// A robot that walks indoors: a scan of a VLP-16 every five seconds, its points without times, and an ADIS 16448.
fn maplab(folder: &Path) -> OdometryResult {
    let number = |word: &String| word.parse::<f64>().expect("a number");
    let stamped_at = |word: &String| Timestamp::from_nanos(word.parse().expect("nanoseconds"));
    let samples = csv(&folder.join("decoded/imu.csv")).into_iter().map(|row| {
        let of = |k: usize| [number(&row[k]), number(&row[k + 1]), number(&row[k + 2])];
        let time = stamped_at(&row[0]);
        Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: ImuSample {
                specific_force_m_s2: of(1),
                angular_velocity_rad_s: of(4),
            },
        }
    });
    let imu = ImuSamples {
        noise: ImuNoiseModel {
            gyro_noise_density: 0.005,
            accel_noise_density: 0.01,
            gyro_bias_walk: 4e-6,
            accel_bias_walk: 2e-4,
        },
        samples: samples.collect(),
    };
    // As its `sensors.yaml` has it.
    let rotation = nalgebra::Matrix3::new(
        0.999_987_4,
        -0.004_957_9,
        -0.000_759_0,
        0.004_954_9,
        0.999_979_8,
        -0.003_990_6,
        0.000_778_8,
        0.003_986_8,
        0.999_991_7,
    );
    let lidar = RigLidar {
        rig_from_lidar: Se3::new(
            lsfb_geometry::UnitQuaternion::from_matrix(&rotation),
            Vector3::new(-0.027_15, 0.045_06, 0.048_61),
        ),
        range_noise_m: 0.02,
    };
    let mut run = OdometryRun::new(&OdometryConfig::default(), &lidar, Some(imu)).expect("config");
    for row in csv(&folder.join("decoded/lidar_scans.csv")) {
        let file = folder
            .join("resources/point_cloud_w_intensity")
            .join(&row[1]);
        let bytes = std::fs::read(file).expect("a cloud");
        let end = b"end_header\n";
        let at = bytes
            .windows(end.len())
            .position(|w| w == end)
            .expect("PLY");
        let cloud = points(&bytes[at + end.len()..], 4);
        let time = stamped_at(&row[0]);
        let scan = LidarScan {
            points: cloud
                .iter()
                .map(|p| LidarPoint {
                    position_m: [p.x as f32, p.y as f32, p.z as f32],
                    ..LidarPoint::default()
                })
                .collect(),
        };
        let taken = run.push(TimedScan {
            scan: Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: scan,
            },
            times: lsfb_recording::cloud::PointTimes::Absent,
        });
        taken.expect("taken");
    }
    run.finish().expect("a result")
}

/// Naively the ninth scan is lost, and all behind it: the IMU leads it farther astray than cells of 25 cm are looked for.
#[test]
fn scans_five_seconds_apart_are_bridged_by_the_imu() {
    let test = "scans_five_seconds_apart_are_bridged_by_the_imu";
    let Some(folder) = recordings(test, "lidar/maplab_dense_map") else {
        return;
    };
    let result = maplab(&folder);
    // Beside what LOAM found, relative to the first scan; its edges lead from vertex to vertex, and scans lie between.
    let mut at = Se3::identity();
    let mut loam = Vec::new();
    for row in csv(&folder.join("decoded/odometry_edges.csv")) {
        let n: Vec<f64> = row[2..9]
            .iter()
            .map(|w| w.parse().expect("a number"))
            .collect();
        let rotation = lsfb_geometry::Quaternion::new(n[6], n[3], n[4], n[5]);
        if loam.is_empty() {
            loam.push(StampedPose {
                time: Timestamp::from_nanos(row[0].parse().expect("nanoseconds")),
                world_from_rig: at,
            });
        }
        at = at
            * Se3::new(
                lsfb_geometry::UnitQuaternion::from_quaternion(rotation),
                Vector3::new(n[0], n[1], n[2]),
            );
        loam.push(StampedPose {
            time: Timestamp::from_nanos(row[1].parse().expect("nanoseconds")),
            world_from_rig: at,
        });
    }
    let loam = lsfb_geometry::Trajectory::new(loam);
    let first = result.scan_poses[0].pose;
    let loam_first = loam.at(first.time).expect("covered");
    let apart: Vec<String> = result
        .scan_poses
        .iter()
        .filter_map(|scan| {
            let theirs = loam_first.inverse() * loam.at(scan.pose.time)?;
            let ours = first.world_from_rig.inverse() * scan.pose.world_from_rig;
            let off = theirs.local(&ours);
            let sigma = scan.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt();
            Some(format!(
                "{:.2} m ({sigma:.2}) {:.1}°",
                off.fixed_rows::<3>(3).norm(),
                off.fixed_rows::<3>(0).norm().to_degrees()
            ))
        })
        .collect();
    println!(
        "{} {} {:?} {apart:#?}",
        result.report.registered, result.report.path_length_m, result.report.warnings
    );
    assert_eq!(result.report.registered, 24, "{:?}", result.report.warnings);
}
