//! Walks through places in closed form whose odometry drifts as is said, or otherwise.

mod circuit;
mod corridor;
mod floors;
mod list;
mod online;

use lsfb_geometry::{Matrix6, RigLidar, Se3, StampedPose, Trajectory, Vector3, Vector6};
use lsfb_perception::lidar::voxel_downsample;
use lsfb_types::Timestamp;

use super::*;
use crate::odometry::tests::room::Room;
use crate::odometry::{DeskewedCloud, OdometryConfig, OdometryReport, OdometryResult, ScanPose};

const RANGE_NOISE_M: f64 = 0.02;
const RANGE_M: f64 = 60.0;

/// A scan: where it was truly taken, and where the scanned surroundings are taken to stand (another floor is the same place lifted).
#[derive(Clone, Copy, Debug)]
struct Stop {
    world_from_rig: Se3,
    lift_m: f64,
}

/// Stops every `spacing_m` along a way through corners, looking ahead, on one floor.
fn stops(corners: &[[f64; 2]], spacing_m: f64, lift_m: f64) -> Vec<Stop> {
    let mut stops = Vec::new();
    for leg in corners.windows(2) {
        let (a, b) = (
            Vector3::from([leg[0][0], leg[0][1], 1.4 + lift_m]),
            Vector3::from([leg[1][0], leg[1][1], 1.4 + lift_m]),
        );
        let along = b - a;
        let heading = along.y.atan2(along.x);
        let count = (along.norm() / spacing_m).round() as usize;
        for k in 0..count {
            let translation = a + along * (k as f64 / count as f64);
            let turn = Vector3::new(0.0, 0.0, heading + 0.05 * (k as f64 * 0.3).sin());
            stops.push(Stop {
                world_from_rig: Se3::new(lsfb_geometry::so3::exp(&turn), translation),
                lift_m,
            });
        }
    }
    stops
}

/// What is seen from each stop in a room.
fn seen(room: &Room, stops: &[Stop]) -> Vec<DeskewedCloud> {
    let rig_from_lidar = lidar().rig_from_lidar;
    let cloud = |(k, stop): (usize, &Stop)| {
        let lift = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, stop.lift_m));
        let room_from_rig = lift.inverse() * stop.world_from_rig;
        let seen = room.seen_from(&(room_from_rig * rig_from_lidar), RANGE_NOISE_M, k as u64);
        let in_range = seen.into_iter().filter(|p| p.norm() < RANGE_M);
        let in_rig: Vec<_> = in_range.map(|p| rig_from_lidar * p).collect();
        DeskewedCloud {
            time: time(k),
            points_in_rig: voxel_downsample(&in_rig, 0.2)
                .iter()
                .map(|p| [p.x as f32, p.y as f32, p.z as f32])
                .collect(),
        }
    };
    stops.iter().enumerate().map(cloud).collect()
}

fn lidar() -> RigLidar {
    RigLidar {
        rig_from_lidar: Se3::exp(&Vector6::new(0.01, -0.02, 0.4, 0.05, 0.0, 0.3)),
        range_noise_m: RANGE_NOISE_M,
    }
}

/// Of the stop with that number.
fn time(number: usize) -> Timestamp {
    Timestamp::from_nanos(number as i64 * 500_000_000)
}

/// What an odometry makes of it that drifts by `drift` on each step, and says that it drifts by `sigma`.
fn walk(
    clouds: &[DeskewedCloud],
    stops: &[Stop],
    drift: impl Fn(usize) -> Vector6<f64>,
    sigma: &Vector6<f64>,
) -> OdometryResult {
    let mut pose = stops[0].world_from_rig;
    let mut covariance = Matrix6::zeros();
    let mut scan_poses = Vec::new();
    for (k, stop) in stops.iter().enumerate() {
        if k > 0 {
            let step = stops[k - 1].world_from_rig.inverse() * stop.world_from_rig;
            let adjoint = step.inverse().adjoint();
            covariance = adjoint * covariance * adjoint.transpose()
                + Matrix6::from_diagonal(&sigma.map(|s| s * s));
            pose = pose * step * Se3::exp(&drift(k));
        }
        scan_poses.push(ScanPose {
            pose: StampedPose {
                time: time(k),
                world_from_rig: pose,
            },
            covariance,
        });
    }
    OdometryResult {
        trajectory: Trajectory::new(scan_poses.iter().map(|s| s.pose).collect()),
        scan_poses,
        clouds: clouds.to_vec(),
        lidar: lidar(),
        report: OdometryReport::default(),
    }
}

fn found(result: &OdometryResult) -> Loops {
    find_loops(result, &OdometryConfig::default(), &lsfb_types::no_progress).expect("loops")
}

/// How far each accepted loop is from the truth, metres.
fn errors_m(loops: &Loops, result: &OdometryResult, stops: &[Stop]) -> Vec<f64> {
    let at = |time: Timestamp| {
        let k = result.scan_poses.iter().position(|s| s.pose.time == time);
        stops[k.expect("a scan")].world_from_rig
    };
    let error = |l: &Loop| {
        let truth = at(l.earlier).inverse() * at(l.later);
        let measured = l.measured.expect("measured").earlier_from_later;
        (truth.inverse() * measured).translation.norm()
    };
    loops.accepted().map(error).collect()
}

/// Largest distance of a pose from the truth, metres: all begin at the same.
fn worst_m(result: &OdometryResult, stops: &[Stop]) -> f64 {
    let off = result.scan_poses.iter().zip(stops).map(|(found, truth)| {
        (found.pose.world_from_rig.translation - truth.world_from_rig.translation).norm()
    });
    off.fold(0.0, f64::max)
}

/// How many loops came to each end.
fn decisions(loops: &Loops) -> String {
    let mut counts = std::collections::BTreeMap::new();
    for l in &loops.all {
        *counts.entry(format!("{:?}", l.decision)).or_insert(0) += 1;
    }
    format!("{counts:?}")
}

/// An office around a core: corridors with cupboards and pillars of which no two are alike.
fn office() -> Room {
    let mut boxes = vec![
        [[-2.0, -2.0, 0.0], [28.0, 18.0, 2.6]],
        [[1.0, 1.0, 0.0], [25.0, 15.0, 2.6]],
    ];
    let mut at = 1.7;
    for k in 0..9 {
        let (deep, long) = (0.3 + 0.05 * f64::from(k % 4), 0.6 + 0.17 * f64::from(k % 5));
        let height = 0.8 + 0.2 * f64::from((k * 5) % 7);
        boxes.push([[at, -2.0, 0.0], [at + long, -2.0 + deep, height]]);
        boxes.push([[27.9 - deep, at * 0.55, 0.0], [28.0, at * 0.55 + long, 2.0]]);
        boxes.push([
            [25.0 - at * 0.9, 18.0 - deep, 0.0],
            [25.0 - at * 0.9 + long * 0.7, 18.0, height],
        ]);
        boxes.push([
            [-2.0, at * 0.5, 0.0],
            [-2.0 + deep, at * 0.5 + 0.8 * long, 2.2 - 0.1 * f64::from(k)],
        ]);
        at += 2.1 + 0.33 * f64::from((k * 3) % 4);
    }
    Room::of(&boxes)
}

/// Once around the office's core, from a corner and some metres on.
const AROUND: [[f64; 2]; 7] = [
    [0.0, -0.5],
    [26.5, -0.5],
    [26.5, 16.5],
    [-0.5, 16.5],
    [-0.5, -0.5],
    [14.0, -0.5],
    [15.0, -0.5],
];
