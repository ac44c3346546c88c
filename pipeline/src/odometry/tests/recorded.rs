//! The stage on files: with all sensors, without IMU, without LiDAR, on any number of threads.

use std::path::Path;

use lsfb_geometry::Rig;
use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_types::no_progress;

use super::super::*;
use super::room::{self, Room};

/// A walk of `duration_s` in the furnished room.
fn record(path: &Path, duration_s: f64, rig: &Rig, with_imu_samples: usize) {
    record_from(path, duration_s, rig, with_imu_samples, 0);
}

/// The same, begun so long after its first turn has: nanoseconds.
fn record_from(path: &Path, duration_s: f64, rig: &Rig, with_imu_samples: usize, begun_ns: u32) {
    let mut writer = Writer::create(path, &WriterConfig::default()).expect("create");
    writer.attach_rig(rig).expect("rig");
    for sample in room::imu_samples(duration_s, 7)
        .iter()
        .take(with_imu_samples)
    {
        writer.write_imu("imu0", sample).expect("imu");
    }
    let room = Room::furnished();
    for i in 0..(duration_s * 10.0) as u64 - 1 {
        let mut scan = room::scan(&room, i as f64 * 0.1, i);
        if i == 0 {
            let points = &mut scan.sample.points;
            points.retain(|p| p.time_offset_ns >= begun_ns);
            points.iter_mut().for_each(|p| p.time_offset_ns -= begun_ns);
            scan.time = scan.time.plus_nanos(begun_ns.into());
        }
        writer.write_scan("lidar", &scan).expect("scan");
    }
    writer.finish().expect("finish");
}

fn rig() -> Rig {
    Rig {
        imus: lsfb_geometry::RigImu::from(room::imu()).alone(),
        lidars: room::lidar().alone(),
        ..Rig::empty("backpack")
    }
}

fn worst_error_m(trajectory: &lsfb_geometry::Trajectory) -> f64 {
    let start = trajectory.poses()[0];
    let t = |time: Timestamp| time.secs_since(room::time(0.0));
    let true_start = room::world_from_rig(t(start.time));
    let errors = trajectory.poses().iter().map(|p| {
        let found = start.world_from_rig.inverse() * p.world_from_rig;
        let truth = true_start.inverse() * room::world_from_rig(t(p.time));
        (found.translation - truth.translation).norm()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_recording_gives_a_level_trajectory_the_same_on_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 4.0, &rig(), usize::MAX);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().expect("pool").install(|| {
            let recording = Recording::open(&path).expect("recording");
            run_odometry(&recording, &OdometryConfig::default(), &no_progress).expect("odometry")
        })
    };
    let one = run(1);
    assert_eq!(one, run(3));
    assert_eq!((one.report.scans, one.report.registered), (39, 39));
    assert!(one.report.warnings.is_empty(), "{:?}", one.report.warnings);
    assert!(one.trajectory.len() > 39 * 19);
    assert!(worst_error_m(&one.trajectory) < 0.03);
    // z up: the true attitude of the first pose is level too
    let tilt = |pose: &Se3| (pose.rotation.inverse() * Vector3::z()).normalize();
    let first = one.trajectory.poses()[0];
    let truth = room::world_from_rig(first.time.secs_since(room::time(0.0)));
    assert!(
        tilt(&first.world_from_rig)
            .angle(&tilt(&truth))
            .to_degrees()
            < 0.5
    );
}

#[test]
fn without_inertial_samples_it_warns_and_goes_on() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 2.5, &rig(), 0);
    let recording = Recording::open(&path).expect("recording");
    let result =
        run_odometry(&recording, &OdometryConfig::default(), &no_progress).expect("odometry");
    assert_eq!(
        result.report.warnings,
        [OdometryWarning::NoImu { deskewed: true }]
    );
    assert_eq!(result.report.registered, 24);
    assert!(worst_error_m(&result.trajectory) < 0.05);
}

#[test]
fn a_recording_that_begins_in_the_middle_of_a_turn_loses_that_part_alone() {
    let folder = tempfile::tempdir().expect("folder");
    for with_imu_samples in [0, usize::MAX] {
        let path = folder.path().join(format!("scan{with_imu_samples}.mcap"));
        record_from(&path, 2.5, &rig(), with_imu_samples, 95_000_000);
        let recording = Recording::open(&path).expect("recording");
        let result =
            run_odometry(&recording, &OdometryConfig::default(), &no_progress).expect("odometry");
        let report = &result.report;
        assert_eq!((report.registered, report.lost), (23, 1), "{report:?}");
        assert_eq!(report.lost_at_end, 0, "{report:?}");
        assert!(worst_error_m(&result.trajectory) < 0.05);
    }
}

#[test]
fn an_imu_that_dies_costs_accuracy_and_nothing_else() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 4.0, &rig(), 500);
    let recording = Recording::open(&path).expect("recording");
    let result =
        run_odometry(&recording, &OdometryConfig::default(), &no_progress).expect("odometry");
    assert_eq!(result.report.registered, 39);
    assert!(worst_error_m(&result.trajectory) < 0.05);
}

#[test]
fn without_lidar_it_says_so() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    let blind = Rig {
        lidars: Default::default(),
        ..rig()
    };
    record(&path, 0.5, &blind, usize::MAX);
    let recording = Recording::open(&path).expect("recording");
    let error = run_odometry(&recording, &OdometryConfig::default(), &no_progress)
        .expect_err("no LiDAR on the rig");
    assert!(
        error.to_string().contains("backpack has no LiDAR"),
        "{error}"
    );
}
