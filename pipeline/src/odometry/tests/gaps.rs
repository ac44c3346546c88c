//! Scans and samples that are missing, and sensors that are not mounted as is said.

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
