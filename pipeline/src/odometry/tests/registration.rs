//! Registration to the local map, in the synthetic room.

use super::room::{self, Room};
use lsfb_perception::lidar::{LocalMapConfig, RangeWindow, Weighting};

use super::*;

/// A scan taken while the carrier stands.
fn standing_scan(room: &Room, seed: u64) -> Vec<Vector3<f64>> {
    let scan = room::scan(room, 0.0, seed);
    let window = RangeWindow {
        min_m: 0.5,
        max_m: 50.0,
    };
    deskew(&scan.sample, &room::lidar().rig_from_lidar, &[], window)
}

fn config() -> RegistrationConfig {
    RegistrationConfig {
        max_iterations: 30,
        gate_m: 2.0,
        min_kernel_m: 0.09,
        range_noise_m: 0.03,
        point_noise_m: 0.1,
        points_per_independent: 4.0,
        weighting: Weighting::Tightening,
    }
}

#[test]
fn finds_the_pose_from_wrong_guesses_in_all_directions() {
    let room = Room::furnished();
    let sensor_in_rig = room::lidar().rig_from_lidar.translation;
    let mut map = LocalMap::new(LocalMapConfig {
        cell_size_m: 1.0,
        levels: 3,
        range_noise_m: 0.03,
    });
    let truth = room::world_from_rig(0.0);
    for seed in 0..5 {
        map.insert(&standing_scan(&room, seed), &truth, &sensor_in_rig);
    }
    let keypoints = voxel_downsample(&standing_scan(&room, 9), 0.2);
    for direction in 0..6 {
        for sign in [-1.0, 1.0] {
            let mut offset = Vector6::zeros();
            offset[direction] = sign * if direction < 3 { 0.06 } else { 0.3 };
            let prior = PosePrior {
                world_from_rig: truth * Se3::exp(&offset),
                information: Matrix6::identity(),
            };
            let mut finder = ScanFinder::new(&map, &keypoints, &sensor_in_rig);
            let found = register(&keypoints, &prior, &config(), |pose, gate_m| {
                finder.find_all(pose, gate_m)
            });
            let error = (truth.inverse() * found.world_from_rig).log();
            assert!(error.fixed_rows::<3>(0).norm() < 0.004, "{offset} {error}");
            assert!(error.fixed_rows::<3>(3).norm() < 0.015, "{offset} {error}");
            assert!(found.inlier_ratio > 0.8 && found.iterations < 30);
        }
    }
}

#[test]
fn without_a_map_the_prior_stands() {
    let map = LocalMap::new(LocalMapConfig {
        cell_size_m: 1.0,
        levels: 3,
        range_noise_m: 0.03,
    });
    let prior = PosePrior {
        world_from_rig: Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 1.0, 2.0, 3.0)),
        information: Matrix6::identity(),
    };
    let keypoints = vec![Vector3::new(1.0, 2.0, 3.0); 10];
    let mut finder = ScanFinder::new(&map, &keypoints, &Vector3::zeros());
    let found = register(&keypoints, &prior, &config(), |pose, gate_m| {
        finder.find_all(pose, gate_m)
    });
    assert_eq!(found.world_from_rig, prior.world_from_rig);
    assert_eq!(found.inlier_ratio, 0.0);
}
