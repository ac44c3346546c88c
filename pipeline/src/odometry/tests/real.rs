//! Recordings made by others, with poses that others found.

use std::path::Path;

use lsfb_tests::recordings;

use super::*;

/// Triples of floats.
fn points(bytes: &[u8], floats_per_point: usize) -> Vec<Vector3<f64>> {
    let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let each = bytes.chunks_exact(4 * floats_per_point);
    each.map(|p| Vector3::new(float(p), float(&p[4..]), float(&p[8..])))
        .collect()
}

/// Points of a binary PLY of three coordinates and another float.
pub(super) fn ply(path: &Path) -> Vec<Vector3<f64>> {
    let bytes = std::fs::read(path).expect("a cloud");
    let marker = b"end_header\n";
    let head = bytes.windows(marker.len()).position(|w| w == marker);
    points(&bytes[head.expect("a head") + marker.len()..], 4)
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
            let mut finder = ScanFinder::new(&map, &keypoints, &sensor);
            let found = register(&keypoints, &prior, &settings, |pose, gate_m| {
                finder.find_all(pose, gate_m)
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

#[test]
fn the_scans_of_small_gicp_lie_where_it_has_them() {
    let test = "the_scans_of_small_gicp_lie_where_it_has_them";
    let Some(folder) = recordings(test, "lidar/small_gicp") else {
        return;
    };
    let text = std::fs::read_to_string(folder.join("T_target_source.txt")).expect("a transform");
    let words = text.split_whitespace();
    let n: Vec<f64> = words.map(|w| w.parse().expect("a number")).collect();
    let turn = nalgebra::Matrix3::new(n[0], n[1], n[2], n[4], n[5], n[6], n[8], n[9], n[10]);
    let target_from_source = Se3::new(
        lsfb_geometry::UnitQuaternion::from_matrix(&turn),
        Vector3::new(n[3], n[7], n[11]),
    );
    let scans = ["target.ply", "source.ply"].map(|name| ply(&folder.join(name)));
    let poses = [Se3::identity(), target_from_source];
    let [off_m, off_deg] = worst_of_pairs(&scans, &poses, &OdometryConfig::outdoor(), 0.5);
    assert!(off_m < 0.05 && off_deg < 0.5, "{off_m} m, {off_deg}°");
}

/// Features of LOAM whose poses are disturbed by 0.3 m and 3°, all but the first: planes and edges of Eq. (4) bring them back.
#[test]
fn disturbed_scans_of_newer_college_go_back_to_where_they_were() {
    use crate::mapping::{PosedScan, ScanPoseConfig, refine_scan_poses};

    let test = "disturbed_scans_of_newer_college_go_back_to_where_they_were";
    let Some(folder) = recordings(test, "lidar/gtsam_points/newer_01") else {
        return;
    };
    let expected = graph(&folder.join("graph.txt"));
    let read = |kind: &str, k: usize| {
        let path = folder.join(format!("{kind}_{:06}.bin", 10 * k));
        points(&std::fs::read(path).expect("points"), 3)
    };
    let given = |(k, pose): (usize, &Se3)| PosedScan {
        time: Timestamp::from_secs_f64(k as f64),
        world_from_lidar: *pose,
        on_surfaces: read("planes", k),
        on_edges: read("edges", k),
    };
    let given: Vec<PosedScan> = expected.iter().enumerate().map(given).collect();
    let refine = |scans: &[PosedScan]| {
        let config = ScanPoseConfig::default();
        let refined = refine_scan_poses(scans, &config, &lsfb_types::no_progress);
        refined.expect("poses")
    };
    // Along three directions, and about three axes.
    for seed in 0..3 {
        let mut scans = given.clone();
        for (k, scan) in scans.iter_mut().enumerate().skip(1) {
            let sign = if (k + seed) % 2 == 0 { 1.0 } else { -1.0 };
            let mut off = Vector6::zeros();
            off[(k + seed) % 3] = sign * 3f64.to_radians();
            off[3 + (k + 2 * seed) % 3] = -sign * 0.3;
            scan.world_from_lidar = scan.world_from_lidar * Se3::exp(&off);
        }
        let found = refine(&scans);
        let (before, after) = (found.report.lidar_before, found.report.lidar_after);
        let (mut off_m, mut off_deg) = (0.0_f64, 0.0_f64);
        for (found, expected) in found.poses.iter().zip(&expected) {
            let off = expected.inverse() * found.world_from_rig;
            off_m = off_m.max(off.translation.norm());
            off_deg = off_deg.max(off.rotation.angle().to_degrees());
        }
        assert!(after.plane_rms_m < 0.5 * before.plane_rms_m, "{after:?}");
        assert!(after.edge_rms_m < 0.5 * before.edge_rms_m, "{after:?}");
        assert!(off_m < 0.05 && off_deg < 0.5, "{off_m} m, {off_deg}°");
        let failed = |f: &lsfb_types::Finding| f.verdict == lsfb_types::Verdict::Fail;
        assert!(!found.report.findings().iter().any(failed));
    }
    // A scan that is nowhere near is named.
    let mut scans = given;
    scans[4].world_from_lidar = Se3::exp(&Vector6::new(0.0, 0.0, 1.3, 30.0, 40.0, 2.0));
    let report = refine(&scans).report;
    let [apart, ..] = &report.findings()[..] else {
        panic!("{report:?}");
    };
    assert_eq!(apart.verdict, lsfb_types::Verdict::Fail, "{report:?}");
    assert_eq!(report.least_matched_scan, 4);
}
