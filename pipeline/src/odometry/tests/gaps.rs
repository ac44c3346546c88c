//! Scans and samples that are missing, and sensors that are not mounted as is said.

use lsfb_recording::cloud::{PointTimes, TimesBegin};

use super::room::{self, Room};
use super::*;

/// Seconds of the walk.
const WALK_S: f64 = 10.0;

/// What each scan of the walk gave, with how far its pose is from the truth since the start, metres.
fn walk(
    lidar: &RigLidar,
    with_imu: bool,
    has_scan: impl Fn(u64) -> bool,
    has_sample: impl Fn(usize) -> bool,
) -> Vec<(StepOutcome, f64)> {
    walk_for(WALK_S, lidar, with_imu, has_scan, has_sample)
}

fn walk_for(
    walk_s: f64,
    lidar: &RigLidar,
    with_imu: bool,
    has_scan: impl Fn(u64) -> bool,
    has_sample: impl Fn(usize) -> bool,
) -> Vec<(StepOutcome, f64)> {
    let room = Room::furnished();
    let noise = room::imu();
    let config = OdometryConfig::default();
    let mut odometry = Odometry::new(&config, lidar, with_imu.then_some(&noise)).expect("config");
    for (_, sample) in room::imu_samples(walk_s, 7)
        .iter()
        .enumerate()
        .filter(|(i, _)| has_sample(*i))
    {
        odometry.push_imu(sample);
    }
    let mut start: Option<(Se3, Se3)> = None;
    let scans = (0..(walk_s * 10.0) as u64 - 1).filter(|i| has_scan(*i));
    scans
        .map(|i| {
            let scan = room::scan(&room, i as f64 * 0.1, i);
            let step = odometry.push_scan(&scan).expect("scan");
            let truth = room::world_from_rig(step.time.secs_since(room::time(0.0)));
            let (found_start, true_start) = *start.get_or_insert((step.world_from_rig, truth));
            let found = found_start.inverse() * step.world_from_rig;
            let off = found.translation - (true_start.inverse() * truth).translation;
            (step.outcome, off.norm())
        })
        .collect()
}

#[test]
fn a_second_without_scans_is_bridged_or_named() {
    let has_scan = |i: u64| !(50..60).contains(&i);
    let with_imu = walk(&room::lidar(), true, has_scan, |_| true);
    for (i, (outcome, off_m)) in with_imu.iter().enumerate() {
        assert!(
            *outcome != StepOutcome::Lost && *off_m < 0.05,
            "{i}: {outcome:?} {off_m} m"
        );
    }
    // The motion of a second ago says little of where it is now: found again, or lost, never elsewhere.
    let alone = walk(&room::lidar(), false, has_scan, |_| true);
    for (i, (outcome, off_m)) in alone.iter().enumerate() {
        assert!(
            *outcome == StepOutcome::Lost || *off_m < 0.1,
            "{i}: {outcome:?} {off_m} m"
        );
    }
}

#[test]
fn gaps_of_45_ms_between_samples_cost_nothing() {
    // Nine samples of 200 Hz, four times a second.
    let found = walk(&room::lidar(), true, |_| true, |i| i % 50 >= 8);
    for (i, (outcome, off_m)) in found.iter().enumerate() {
        assert!(
            *outcome != StepOutcome::Lost && *off_m < 0.05,
            "{i}: {outcome:?} {off_m} m"
        );
    }
}

#[test]
fn the_next_room_is_not_taken_for_the_one_that_was_seen() {
    // Scans five seconds apart: the third is the first of the next room, and more than half of it fits the room before, 4 m from where it is.
    for first in 0..3 {
        let has_scan = |i: u64| i % 50 == first;
        let found = walk_for(20.0, &room::lidar(), true, has_scan, |_| true);
        assert_eq!(found.len(), 4);
        for (i, (outcome, off_m)) in found.iter().enumerate() {
            assert!(
                *outcome == StepOutcome::Lost || *off_m < 0.3,
                "{i}: {outcome:?} {off_m} m"
            );
        }
        // Back in the first room it is found again.
        assert_ne!(found[3].0, StepOutcome::Lost);
    }
}

/// A capture of packets ends within a turn of its rotor. Naively a twentieth of one that saw its carrier alone was a scan that is lost, and the sensor covered.
#[test]
fn a_piece_of_a_scan_at_the_end_is_none_that_is_lost() {
    let (config, room) = (OdometryConfig::default(), Room::furnished());
    let mut run = OdometryRun::new(&config, &room::lidar(), None).expect("settings");
    for i in 0..5 {
        let mut scan = room::scan(&room, 0.1 * i as f64, i);
        if i == 4 {
            let points = &mut scan.sample.points;
            points.retain(|p| p.time_offset_ns < 5_000_000);
            let near = |c: f32| 0.01 * c;
            points
                .iter_mut()
                .for_each(|p| p.position_m = p.position_m.map(near));
        }
        let times = PointTimes::Field {
            name: "t".to_owned(),
            begins: TimesBegin::AfterStamp { nanos: 0 },
        };
        run.push(TimedScan { scan, times }).expect("scan");
    }
    let report = run.finish().expect("a trajectory").report;
    assert_eq!((report.scans, report.registered), (4, 4));
    assert!(report.is_whole(), "{report:?}");
    let codes: Vec<_> = report.warnings.iter().map(|w| w.finding().code).collect();
    assert_eq!(codes, ["last-piece", "no-imu"]);
}

/// Naively a LiDAR that hung was a carrier that stood, and nothing was said.
#[test]
fn scans_that_are_the_one_before_once_more_are_said() {
    let (config, room) = (OdometryConfig::default(), Room::furnished());
    let mut run = OdometryRun::new(&config, &room::lidar(), None).expect("settings");
    for i in 0..6_u64 {
        let of = i.min(2);
        let mut scan = room::scan(&room, 0.1 * of as f64, of);
        scan.time = scan.time.plus_nanos(100_000_000 * (i - of) as i64);
        let times = PointTimes::Absent;
        run.push(TimedScan { scan, times }).expect("scan");
    }
    let report = run.finish().expect("a trajectory").report;
    assert_eq!((report.scans, report.repeated), (6, 3));
    let codes: Vec<_> = report.warnings.iter().map(|w| w.finding().code).collect();
    assert!(
        codes.iter().any(|code| code == "repeated-scans"),
        "{codes:?}"
    );
}
