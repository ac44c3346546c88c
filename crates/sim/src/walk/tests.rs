use super::*;
use crate::config::SimConfig;
use crate::world::World;
use lsfb_geometry::so3;
use lsfb_types::no_progress;

fn walks(seed: u64) -> (FloorPlan, [Walk; 2]) {
    let config = SimConfig::default();
    let plan = FloorPlan::new(seed);
    let scan = Walk::new(&plan, Walker::Backpack, &config.scan, seed);
    let glasses = Walk::new(&plan, Walker::Glasses, &config.glasses, seed);
    (plan, [scan, glasses])
}

#[test]
fn velocities_are_the_derivatives_of_the_pose() {
    let (_, walks) = walks(1);
    let h = 1e-5;
    for walk in &walks {
        for i in 1..200 {
            let t = walk.duration_s() * f64::from(i) / 200.0;
            let (a, m, b) = (walk.at(t - h), walk.at(t), walk.at(t + h));
            let turned = a.world_from_rig.rotation.inverse() * b.world_from_rig.rotation;
            let rate = so3::log(&turned) / (2.0 * h);
            assert!((rate - m.angular_velocity_rad_s).norm() < 1e-6, "{t}");
            let moved = b.world_from_rig.translation - a.world_from_rig.translation;
            assert!((moved / (2.0 * h) - m.velocity_m_s).norm() < 1e-6);
            let gained = b.velocity_m_s - a.velocity_m_s;
            assert!((gained / (2.0 * h) - m.acceleration_m_s2).norm() < 1e-4);
            let coasted = m.coasted(h);
            assert!((coasted.translation - b.world_from_rig.translation).norm() < 1e-8);
            assert!((coasted.inverse() * b.world_from_rig).log().norm() < 1e-8);
        }
    }
}

#[test]
fn rests_at_both_ends_and_walks_between() {
    let (_, walks) = walks(2);
    for (walk, least_m) in walks.iter().zip([18.0, 10.0]) {
        for t in [0.0, 0.6, 1.15, walk.duration_s() - 0.1, walk.duration_s()] {
            let motion = walk.at(t);
            let still = motion.velocity_m_s.norm() + motion.angular_velocity_rad_s.norm();
            assert!(still < 1e-9, "moves at {t}: {still}");
        }
        let mut path_m = 0.0;
        for i in 0..(walk.duration_s() * 100.0) as i32 {
            let motion = walk.at(f64::from(i) * 0.01);
            path_m += motion.velocity_m_s.norm() * 0.01;
            assert!(motion.velocity_m_s.norm() < 1.3);
            assert!(motion.acceleration_m_s2.norm() < 6.0);
            assert!(motion.angular_velocity_rad_s.norm() < 2.2);
        }
        assert!(path_m > least_m, "only {path_m} m");
    }
}

#[test]
fn keeps_clear_of_everything() {
    for seed in 1..=4 {
        let world = World::build(seed, 0.1, &no_progress).expect("built");
        let (_, walks) = walks(seed);
        for walk in &walks {
            let mut nearest = (f32::INFINITY, [0.0; 3]);
            for i in 0..(walk.duration_s() * 4.0) as i32 {
                let position = walk.at(f64::from(i) * 0.25).world_from_rig.translation;
                for k in 0..48 {
                    let (sin, cos) = (f32::from(k as u8) * 0.1309).sin_cos();
                    for height in [0.1, 0.45, 0.735, 1.0, 1.3, 1.6, 1.8] {
                        let origin = [position.x as f32, position.y as f32, height];
                        let hit = world
                            .cast(origin, [cos, sin, 0.0])
                            .expect("inside the building");
                        if hit.distance < nearest.0 {
                            let point = |i| origin[i] + hit.distance * [cos, sin, 0.0][i];
                            nearest = (hit.distance, std::array::from_fn(point));
                        }
                    }
                }
            }
            assert!(nearest.0 > 0.35, "seed {seed}: {nearest:?}");
        }
    }
}

#[test]
fn both_walks_see_room_and_corridor() {
    let (_, walks) = walks(3);
    for walk in &walks {
        let ys: Vec<f64> = (0..(walk.duration_s() * 10.0) as i32)
            .map(|i| walk.at(f64::from(i) * 0.1).world_from_rig.translation.y)
            .collect();
        let inside = ys.iter().filter(|y| **y > 0.3).count() as f64 / ys.len() as f64;
        assert!(
            (0.15..=0.85).contains(&inside),
            "{inside} of the time in the room"
        );
    }
}
