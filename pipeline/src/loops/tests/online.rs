//! Loops that are told while one walks.

use super::*;
use crate::odometry::{OdometryStep, StepOutcome};

/// A room around a core, of which no two sides are alike.
fn room() -> Room {
    Room::of(&[
        [[-2.0, -2.0, 0.0], [8.0, 6.0, 2.6]],
        [[1.0, 1.0, 0.0], [5.0, 3.0, 2.6]],
        [[2.0, -2.0, 0.0], [2.9, -1.6, 1.9]],
        [[7.5, 0.5, 0.0], [8.0, 1.9, 1.2]],
        [[5.5, 5.3, 0.0], [6.1, 6.0, 0.8]],
        [[-2.0, 3.0, 0.0], [-1.6, 3.8, 2.1]],
        [[-0.6, -2.0, 0.0], [0.1, -1.4, 0.7]],
    ])
}

fn step(result: &OdometryResult, k: usize) -> OdometryStep {
    let (scan, cloud) = (&result.scan_poses[k], &result.clouds[k]);
    let points = cloud.points_in_rig.iter();
    OdometryStep {
        time: cloud.time,
        world_from_rig: scan.pose.world_from_rig,
        by_scan_alone: scan.pose.world_from_rig,
        covariance: scan.covariance,
        unseen: None,
        poses: vec![scan.pose],
        keypoints_in_rig: points.map(|p| Vector3::from(p.map(f64::from))).collect(),
        inlier_ratio: 1.0,
        plane_rms_m: 0.0,
        iterations: 1,
        outcome: match k {
            0 => StepOutcome::First,
            _ => StepOutcome::Registered,
        },
        anew: Vec::new(),
    }
}

/// Nothing said so while one walked: a place that is recognised was found at home.
#[test]
fn loops_are_told_as_they_are_walked() {
    let around = [
        [0.0, 0.0],
        [6.5, 0.0],
        [6.5, 4.5],
        [-0.5, 4.5],
        [-0.5, 0.0],
        [5.5, 0.0],
    ];
    let stops = stops(&around, 0.5, 0.0);
    let clouds = seen(&room(), &stops);
    let drift = |_| Vector6::new(0.0, 0.0, 1e-4, 0.000_5, 0.001, 0.002);
    let sigma = Vector6::new(1e-4, 1e-4, 3e-4, 0.01, 0.01, 0.01);
    let result = walk(&clouds, &stops, drift, &sigma);
    let expected = found(&result);
    let mut online = OnlineLoops::new(&OdometryConfig::default(), &result.lidar).expect("settings");
    let mut told = Vec::new();
    for k in 0..stops.len() {
        let of_step = online.push(&step(&result, k)).expect("looked");
        // None before the walk is back.
        assert!(of_step.is_empty() || k > stops.len() / 2, "{k}");
        told.extend(of_step);
    }
    assert!(told.len() >= 2, "{}: {}", told.len(), decisions(&expected));
    let accepted: Vec<&Loop> = expected.accepted().collect();
    assert_eq!(told.iter().map(|l| &l.found).collect::<Vec<_>>(), accepted);
    for l in &told {
        let at = |pose: Se3| {
            stops
                .iter()
                .any(|s| (s.world_from_rig.translation - pose.translation).norm() < 0.3)
        };
        assert!(at(l.world_from_earlier) && at(l.world_from_later));
        // What it has drifted on some 24 m.
        assert!((0.03..0.3).contains(&l.off_m), "{} m", l.off_m);
    }
    // The same walk once more, from its beginning.
    let again = online.push(&step(&result, 0)).expect("looked");
    assert!(again.is_empty() && online.kept() == 1);
}
