//! An IMU that hangs upside down, or measures in another unit: the walk is the same.

use lsfb_geometry::UnitQuaternion;
use lsfb_recording::cloud::{PointTimes, TimesBegin};
use lsfb_types::STANDARD_GRAVITY_M_S2;

use super::room::{self, Room};
use super::*;

/// Seconds of the walk.
const WALK_S: f64 = 6.0;

/// Runs the walk in the furnished room with an IMU whose axes are turned against those of the rig of the others, and whose specific forces are
/// in a unit of so many m/s². Gives what was said, and how far poses are off at most since the start, metres.
fn walk(rig_from_usual: &UnitQuaternion<f64>, unit_m_s2: f64) -> (OdometryReport, f64) {
    walk_with_lidar_off_by(&Vector3::zeros(), rig_from_usual, [unit_m_s2; 3])
}

/// The same with a rig in which the LiDAR is turned by so much against where it is, radians.
fn walk_with_lidar_off_by(
    off: &Vector3<f64>,
    rig_from_usual: &UnitQuaternion<f64>,
    units_m_s2: [f64; 3],
) -> (OdometryReport, f64) {
    walk_in(&Room::furnished(), off, rig_from_usual, units_m_s2)
}

fn walk_in(
    room: &Room,
    off: &Vector3<f64>,
    rig_from_usual: &UnitQuaternion<f64>,
    units_m_s2: [f64; 3],
) -> (OdometryReport, f64) {
    let turned = |v: [f64; 3], units: [f64; 3]| {
        let turned = rig_from_usual * Vector3::from(v);
        turned.component_div(&Vector3::from(units)).into()
    };
    let mut samples = room::imu_samples(WALK_S, 7);
    for Stamped { sample, .. } in &mut samples {
        sample.angular_velocity_rad_s = turned(sample.angular_velocity_rad_s, [1.0; 3]);
        sample.specific_force_m_s2 = turned(sample.specific_force_m_s2, units_m_s2);
    }
    let rig_from_usual = Se3::new(*rig_from_usual, Vector3::zeros());
    let mut lidar = RigLidar {
        rig_from_lidar: rig_from_usual * room::lidar().rig_from_lidar,
        ..room::lidar()
    };
    let of_lidar = &mut lidar.rig_from_lidar.rotation;
    *of_lidar = lsfb_geometry::so3::exp(off) * *of_lidar;
    let imu = ImuSamples {
        noise: room::imu(),
        samples,
    };
    let result = run(&lidar, imu, WALK_S, |t, i| room::scan(room, t, i));
    let truth = |pose: &StampedPose| {
        room::world_from_rig(pose.time.secs_since(room::time(0.0))) * rig_from_usual.inverse()
    };
    let start = result.scan_poses[0].pose;
    let off_m = result.scan_poses.iter().map(|scan| {
        let found = start.world_from_rig.inverse() * scan.pose.world_from_rig;
        let expected = truth(&start).inverse() * truth(&scan.pose);
        (found.translation - expected.translation).norm()
    });
    let worst_m = off_m.fold(0.0, f64::max);
    (result.report, worst_m)
}

/// Runs on so many seconds of scans.
fn run(
    lidar: &RigLidar,
    imu: ImuSamples,
    seconds: f64,
    scan: impl Fn(f64, u64) -> Stamped<LidarScan>,
) -> OdometryResult {
    let config = OdometryConfig::default();
    let mut run = OdometryRun::new(&config, lidar, Some(imu)).expect("settings");
    for i in 0..(seconds * 10.0) as u64 - 1 {
        let times = PointTimes::Field {
            name: "t".to_owned(),
            begins: TimesBegin::AfterStamp { nanos: 0 },
        };
        let scan = scan(i as f64 * 0.1, i);
        run.push(TimedScan { scan, times }).expect("scan");
    }
    run.finish().expect("a trajectory")
}

/// Naively a path that was a tenth too long was nowhere off its scans, and nothing was said.
#[test]
fn ranges_that_are_too_long_are_told_by_the_accelerometer() {
    const SECONDS: f64 = 16.0;
    let room = Room::furnished();
    let told = |factor: f32| {
        let imu = ImuSamples {
            noise: room::imu(),
            samples: room::imu_samples(SECONDS, 7),
        };
        let result = run(&room::lidar(), imu, SECONDS, |t, i| {
            let mut scan = room::scan(&room, t, i);
            for point in &mut scan.sample.points {
                point.position_m = point.position_m.map(|v| factor * v);
            }
            scan
        });
        result.report.warnings
    };
    assert_eq!(told(1.0), []);
    let said = told(1.08);
    let [OdometryWarning::Scale { scale, .. }] = said[..] else {
        panic!("{said:?}");
    };
    // At least so much: the accelerometer is in the poses.
    assert!((1.04..1.1).contains(&scale), "{scale}");
    let finding = said[0].finding();
    assert!(finding.what.contains("too long"), "{}", finding.what);
}

#[test]
fn upside_down_the_walk_is_the_same() {
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let (report, worst_m) = walk(&half_turn, 1.0);
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
    assert!(worst_m < 0.05, "{worst_m} m");
}

#[test]
fn in_gravities_the_walk_is_the_same_and_that_is_said() {
    let upright = UnitQuaternion::identity();
    let (report, worst_m) = walk(&upright, STANDARD_GRAVITY_M_S2);
    assert_eq!(report.warnings, [OdometryWarning::AccelerometerInGravities]);
    assert!(worst_m < 0.05, "{worst_m} m");
}

/// Five degrees cost 25 cm in five seconds, and were not said.
#[test]
fn a_lidar_that_is_turned_against_the_rig_is_named() {
    for off_deg in [[0.0, 5.0, 0.0], [-5.0, 0.0, 0.0]] {
        let off = Vector3::from(off_deg.map(f64::to_radians));
        let (report, _) = walk_with_lidar_off_by(&off, &UnitQuaternion::identity(), [1.0; 3]);
        let found = report.warnings.iter().find_map(|w| match w {
            OdometryWarning::ExtrinsicRotation { off_deg, .. } => Some(*off_deg),
            _ => None,
        });
        // At least so much: the poses lean on the gyroscope.
        assert!(
            found.is_some_and(|deg| (2.0..6.0).contains(&deg)),
            "{:?}",
            report.warnings
        );
    }
    // Half a degree is left to calibration.
    let little = Vector3::new(0.0, 0.5f64.to_radians(), 0.0);
    let (report, _) = walk_with_lidar_off_by(&little, &UnitQuaternion::identity(), [1.0; 3]);
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
}

/// Naively an axis that is turned round bent a walk by metres, every scan lay on the map, and nothing was said.
#[test]
fn an_accelerometer_of_a_wrong_sign_bends_no_walk_without_a_word() {
    let none = Vector3::zeros();
    for units in [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [-1.0; 3]] {
        let (report, worst_m) = walk_with_lidar_off_by(&none, &UnitQuaternion::identity(), units);
        let fails = |w: &OdometryWarning| w.finding().verdict == lsfb_types::Verdict::Fail;
        let is_said = !report.is_whole() || report.warnings.iter().any(fails);
        assert!(
            is_said || worst_m < 0.1,
            "{units:?}: {worst_m} m, {:?}",
            report.warnings
        );
    }
}

/// Along a corridor without ends nothing tells of it. Naively the pose was said to be sure to centimetres.
#[test]
fn in_a_corridor_without_ends_an_accelerometer_of_a_wrong_sign_is_not_believed() {
    let (none, upright) = (Vector3::zeros(), UnitQuaternion::identity());
    let corridor = Room::endless_corridor();
    let (report, worst_m) = walk_in(&corridor, &none, &upright, [-1.0, 1.0, 1.0]);
    let is_said = report.warnings.iter().any(|w| {
        matches!(w, OdometryWarning::AccelerometerUntold { .. })
            || w.finding().verdict == lsfb_types::Verdict::Fail
    });
    assert!(
        is_said || worst_m < 0.1,
        "{worst_m} m, {:?}",
        report.warnings
    );
}
