//! What carriers do and meet: quick turns, people who stand around, a start in the middle of a step.

use lsfb_geometry::so3;

use super::room::{self, Room};
use super::*;

/// Each scan's outcome, how far its pose is from the truth relative to the first that has one (metres, degrees), and what it says of that.
struct Found {
    outcome: StepOutcome,
    off_m: f64,
    off_deg: f64,
}

/// A walk through the furnished room from `start_s` on, with what `change` makes of its scans.
fn walk(
    motion: fn(f64) -> Se3,
    seconds: std::ops::Range<f64>,
    change: impl Fn(f64, &mut LidarScan),
) -> Vec<Found> {
    walk_with(Some(&room::imu()), motion, seconds, change)
}

/// The same with this IMU, or none.
fn walk_with(
    noise: Option<&ImuNoiseModel>,
    motion: fn(f64) -> Se3,
    seconds: std::ops::Range<f64>,
    change: impl Fn(f64, &mut LidarScan),
) -> Vec<Found> {
    let room = Room::furnished();
    let mut odometry =
        Odometry::new(&OdometryConfig::default(), &room::lidar(), noise).expect("config");
    let start = room::time(seconds.start);
    for sample in room::imu_samples_on(motion, seconds.end, 7) {
        if sample.time >= start {
            odometry.push_imu(&sample);
        }
    }
    let mut origin: Option<(Se3, Se3)> = None;
    let scans = (10.0 * seconds.start).ceil() as u64..(10.0 * seconds.end) as u64 - 1;
    scans
        .map(|i| {
            let t = i as f64 * 0.1;
            let mut scan = room::scan_on(motion, &room, t, i);
            change(t, &mut scan.sample);
            let step = odometry.push_scan(&scan).expect("scan");
            let truth = motion(step.time.secs_since(room::time(0.0)));
            if let Some(first) = step.anew.first() {
                let begun = motion(first.time.secs_since(room::time(0.0)));
                origin = Some((first.world_from_rig, begun));
            }
            let (found_start, true_start) = *origin.get_or_insert((step.world_from_rig, truth));
            let off = (true_start.inverse() * truth).inverse()
                * (found_start.inverse() * step.world_from_rig);
            Found {
                outcome: step.outcome,
                off_m: off.translation.norm(),
                off_deg: off.rotation.angle().to_degrees(),
            }
        })
        .collect()
}

/// None is lost, and none farther off than asked for.
fn assert_all_right(found: &[Found], most_m: f64, most_deg: f64) {
    for (i, f) in found.iter().enumerate() {
        assert!(
            f.outcome != StepOutcome::Lost && f.off_m < most_m && f.off_deg < most_deg,
            "{i}: {:?} {} m {}°",
            f.outcome,
            f.off_m,
            f.off_deg
        );
    }
}

/// To and fro about the vertical by 170°, with up to two radians a second, while wandering about.
fn turning_fast(t: f64) -> Se3 {
    let w = (t - 1.0).max(0.0);
    // Begins at rest, within a second.
    let s = w - 0.5 * (1.0 - (-2.0 * w).exp());
    let yaw = Vector3::new(0.0, 0.0, 1.5 * (2.0 * s / 1.5).sin());
    let sway = Vector3::new(0.05 * (1.9 * s).sin(), 0.08 * (1.3 * s).sin(), 0.0);
    let position = Vector3::new(0.8 * (1.0 - (0.5 * s).cos()), 0.4 * (0.4 * s).sin(), 1.5);
    Se3::new(so3::exp(&yaw) * so3::exp(&sway), position)
}

#[test]
fn turns_of_two_radians_a_second_cost_nothing() {
    let found = walk(turning_fast, 0.0..10.0, |_, _| ());
    assert_all_right(&found, 0.05, 0.5);
}

#[test]
fn a_start_in_the_middle_of_a_walk_finds_its_way() {
    // Turning and a metre a second fast when the recording begins.
    let found = walk(room::world_from_rig, 3.3..11.3, |_, _| ());
    assert_all_right(&found, 0.1, 1.0);
}

/// Like somebody who keeps their balance: fastest in the middle of the second in which they stand.
fn swaying(t: f64) -> Se3 {
    let wave = |hz: f64, from: f64| (std::f64::consts::TAU * hz * (t - from)).sin();
    let (pitch, roll) = (3.5e-3 * wave(0.2, 0.5), 2.0e-3 * wave(0.25, 0.6));
    let lean = Se3::new(
        so3::exp(&Vector3::new(roll, pitch, 1e-3 * wave(0.3, 0.4))),
        Vector3::new(1.5 * pitch, -1.5 * roll, 0.0),
    );
    room::world_from_rig(t) * lean
}

#[test]
fn who_stands_and_sways_does_not_turn_what_is_mapped() {
    let found = walk(swaying, 0.0..10.0, |_, _| ());
    // Who is not begun again with the bias that motion tells is 0.49° off here: this pitch is little seen, and its bias told to a third.
    assert_all_right(&found[90..], 0.018, 0.25);
}

/// Evenly, at a metre and 23° a second.
fn rolling(t: f64) -> Se3 {
    Se3::new(
        so3::exp(&(Vector3::z() * (0.4 * t))),
        Vector3::new(1.0 * t - 0.5, 0.3 * t, 1.4),
    )
}

#[test]
fn without_an_imu_a_start_in_motion_is_seen_as_one() {
    let found = walk_with(None, rolling, 0.0..0.5, |_, _| {});
    // Taken to have stood in its first scan: 7 cm and 2.2° off in the second, 11 cm and 4.1° in the third.
    assert_all_right(&found, 0.02, 0.6);
}

/// People stand around within arm's reach and go along with the carrier, about whom they circle; what is seen between them is a tenth.
fn surround(t: f64, scan: &mut LidarScan) {
    for point in &mut scan.points {
        let [x, y, z] = point.position_m.map(f64::from);
        let (azimuth, across) = (y.atan2(x), x.hypot(y));
        // Ten gaps, that turn about the carrier with half a radian a second.
        let between = (10.0 * (azimuth + 0.5 * t) / std::f64::consts::TAU).rem_euclid(1.0) < 0.1;
        let reach = 0.8 + 0.15 * (5.0 * (azimuth + 0.5 * t)).sin();
        if !between && across > reach {
            point.position_m = [x, y, z].map(|v| (v * reach / across) as f32);
        }
    }
}

#[test]
fn a_scan_of_which_nine_tenths_are_people_is_right_or_lost() {
    // One scan, and three seconds of them.
    for crowded in [5.0..5.1, 5.0..8.0] {
        let found = walk(room::world_from_rig, 0.0..10.0, |t, scan| {
            if crowded.contains(&t) {
                surround(t, scan);
            }
        });
        for (i, f) in found.iter().enumerate() {
            assert!(
                f.outcome == StepOutcome::Lost || (f.off_m < 0.1 && f.off_deg < 1.0),
                "{i}: {:?} {} m {}°",
                f.outcome,
                f.off_m,
                f.off_deg
            );
        }
        let last = found.last().expect("scans");
        assert!(last.outcome != StepOutcome::Lost, "not found again");
    }
}
