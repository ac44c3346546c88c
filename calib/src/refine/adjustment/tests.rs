use lsfb_geometry::{Matrix6, UnitQuaternion, Vector2, Vector3, Vector6, so3};
use lsfb_perception::image::Gray;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::refine::landmarks::{Keyframe, Landmark, Observation};

/// Spread of what is measured.
const NOISE: Noise = Noise {
    pixel_px: 0.1,
    plane_m: 3e-3,
    turn_rad: 5e-4,
    shift_m: 2e-3,
};

/// Between images.
const SPACING_S: f64 = 0.25;

struct World {
    lens: Camera,
    truth: Se3,
    /// By how much images are stamped early.
    late_s: f64,
    /// Whether blocks move as their ways do; else all alike, and a clock that is off is a pose that is off.
    moves_by_way: bool,
    rng: ChaCha8Rng,
}

impl World {
    fn new(seed: u64) -> Self {
        let turn = UnitQuaternion::from_euler_angles(0.02, -0.03, 0.01);
        Self {
            lens: Camera::pinhole(640, 400, [350.0, 350.0], [319.5, 199.5]),
            truth: Se3::new(turn, Vector3::new(0.1, -0.2, 0.05)),
            late_s: 0.0,
            moves_by_way: false,
            rng: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    fn normal(&mut self, sigma: f64) -> f64 {
        // The sum of twelve even numbers is as good as normal.
        (0..12)
            .map(|_| self.rng.random_range(-0.5..0.5))
            .sum::<f64>()
            * sigma
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.rng.random_range(-1.0..1.0) * size)
    }

    /// Images from a way that turns and moves, before a room's walls.
    fn block(&mut self) -> Block {
        let (start, way) = (self.vector(0.3), self.vector(0.8));
        let turning = self.vector(0.35);
        let image = Gray {
            camera: self.lens,
            values: vec![0.0; 640 * 400],
        };
        let mut poses = Vec::new();
        let lasts_s = 5.0 * SPACING_S;
        let frames = (0..6)
            .map(|k| {
                let share = f64::from(k) / 5.0 - 0.5;
                let true_pose = Se3::new(so3::exp(&(turning * share)), start + way * share);
                poses.push(true_pose);
                let off = Vector6::from_fn(|k, _| {
                    self.normal(if k < 3 { NOISE.turn_rad } else { NOISE.shift_m })
                });
                let mut twist = Vector6::new(0.1, 0.2, -0.3, 0.4, 0.5, -0.6);
                if self.moves_by_way {
                    let velocity = true_pose.rotation.inverse() * way / lasts_s;
                    twist.fixed_rows_mut::<3>(0).copy_from(&(turning / lasts_s));
                    twist.fixed_rows_mut::<3>(3).copy_from(&velocity);
                }
                let at_stamp = true_pose.retract(&(twist * -self.late_s));
                Keyframe {
                    time_s: f64::from(k) * SPACING_S,
                    levels: [image.clone(), image.clone()],
                    world_from_lidar: at_stamp * Se3::exp(&-off),
                    twist,
                    information: Matrix6::identity() * 1e12,
                }
            })
            .collect();
        let landmarks = (0..80)
            .filter_map(|k| {
                let mut place = self.vector(3.0);
                place.z += 4.0;
                let normal = [Vector3::x(), Vector3::y(), Vector3::z()][k % 3];
                let place = place + normal * (5.0 - place.dot(&normal)) * 0.5;
                let seen = poses.iter().enumerate().filter_map(|(frame, pose)| {
                    let pixel = self
                        .lens
                        .project(&(self.truth * (pose.inverse() * place)))?;
                    let noise =
                        Vector2::new(self.normal(NOISE.pixel_px), self.normal(NOISE.pixel_px));
                    let inside = self.lens.contains(&pixel, 5.0);
                    inside.then_some(Observation {
                        frame,
                        pixel: pixel + noise,
                    })
                });
                let observations: Vec<Observation> = seen.collect();
                let plane_place = place + normal * self.normal(NOISE.plane_m);
                (observations.len() > 2).then_some(Landmark {
                    observations,
                    plane_place,
                    plane_normal: normal,
                    place,
                })
            })
            .collect();
        let mut block = Block::new(frames);
        block.take(landmarks);
        block
    }
}

#[test]
fn a_pose_is_found_and_known_as_well_as_is_said() {
    let (mut squares, runs) = (0.0, 20);
    for seed in 0..runs {
        let mut world = World::new(seed);
        let mut blocks: Vec<Block> = (0..8).map(|_| world.block()).collect();
        let wrong = Vector6::new(0.02, -0.02, 0.015, 0.02, -0.03, 0.02);
        let first = Shared {
            lidar_from_camera: world.truth.inverse().retract(&wrong),
            delay_s: 0.0,
        };
        let start = first.lidar_from_camera;
        let found = adjusted(&world.lens, &mut blocks, &start, &first, &[]).expect("settled");
        let off = world.truth.inverse().local(&found.shared.lidar_from_camera);
        assert!(
            off.fixed_rows::<3>(0).norm() < 3e-3 && off.fixed_rows::<3>(3).norm() < 0.01,
            "{off}"
        );
        assert!(
            (found.noise.pixel_px / NOISE.pixel_px - 1.0).abs() < 0.15,
            "{:?}",
            found.noise
        );
        let all = total(&found.normals, &start, &found.shared, &[]);
        let covariance = all.information.try_inverse().expect("known");
        let own = covariance.fixed_view::<6, 6>(0, 0).into_owned();
        squares += off.dot(&own.cholesky().expect("known").solve(&off)) / 6.0;
    }
    let mean = squares / runs as f64;
    assert!((0.6..1.5).contains(&mean), "{mean}");
}

/// What was known beforehand is in no block: else a clock that is off pulls once for each of them.
#[test]
fn what_blocks_say_adds_up_to_nothing_at_the_minimum() {
    let mut world = World {
        late_s: 2e-3,
        moves_by_way: true,
        ..World::new(5)
    };
    let mut blocks: Vec<Block> = (0..8).map(|_| world.block()).collect();
    let start = world.truth.inverse();
    let first = Shared {
        lidar_from_camera: start,
        delay_s: 0.0,
    };
    let found = adjusted(&world.lens, &mut blocks, &start, &first, &[]).expect("settled");
    let delay_s = found.shared.delay_s;
    assert!((delay_s - world.late_s).abs() < 8e-4, "{delay_s}");
    let all = total(&found.normals, &start, &found.shared, &[]);
    let step = all.step().expect("known");
    let square = step.dot(&(all.information * step));
    assert!(square < 0.05, "{square} σ² from the minimum");
}
