//! Pose of a rig from two points and their viewing rays, where up is known.
//!
//! In axes that are upright only the heading `θ` and the place `t` are unknown. With the rays `oᵢ + λᵢ rᵢ` of the points `Xᵢ`,
//! `R_z(θ) (X₁ − X₂) = o₁ − o₂ + λ₁ r₁ − λ₂ r₂`: heights are the same in all headings, which leaves one unknown of the two distances,
//! and the horizontal lengths on both sides a quadratic equation for it. The rays may come from different cameras of the rig.

use lsfb_geometry::{Se3, UnitQuaternion, Vector2, Vector3};

/// A ray in the rig frame and the point that is seen along it.
pub(super) struct SeenPoint {
    pub origin_in_rig: Vector3<f64>,
    pub ray_in_rig: Vector3<f64>,
    pub point_in_world: Vector3<f64>,
}

/// Heights and horizontal lengths below this, in units of the points' distance, say nothing.
const LEAST: f64 = 1e-6;

/// Poses `rig_from_world` that see both points along their rays, two at most; none for points above one another and for level rays.
pub(super) fn solve_upright(up_in_rig: &Vector3<f64>, seen: [&SeenPoint; 2]) -> Vec<Se3> {
    let Some(level_from_rig) = UnitQuaternion::rotation_between(up_in_rig, &Vector3::z()) else {
        return Vec::new();
    };
    let [a, b] = seen;
    let [ray_a, ray_b] = [a, b].map(|s| level_from_rig * s.ray_in_rig);
    let [origin_a, origin_b] = [a, b].map(|s| level_from_rig * s.origin_in_rig);
    let apart = a.point_in_world - b.point_in_world;
    let offset = origin_a - origin_b;
    let length = apart.norm();
    let along = Vector2::new(ray_a.z, -ray_b.z);
    if !(apart.xy().norm() > LEAST * length) || !(along.norm() > LEAST) {
        return Vec::new();
    }
    // λ = nearest + s across, and the horizontal difference start + s change.
    let nearest = along * ((apart.z - offset.z) / along.norm_squared());
    let across = Vector2::new(-along.y, along.x).normalize();
    let start = offset.xy() + ray_a.xy() * nearest.x - ray_b.xy() * nearest.y;
    let change = ray_a.xy() * across.x - ray_b.xy() * across.y;
    let (square, half) = (change.norm_squared(), start.dot(&change));
    let rest = start.norm_squared() - apart.xy().norm_squared();
    let root = half * half - square * rest;
    if !(square > LEAST * LEAST) || !(root >= 0.0) {
        return Vec::new();
    }
    let poses = [root.sqrt(), -root.sqrt()].map(|root| {
        let s = (root - half) / square;
        let lambda = nearest + across * s;
        if !(lambda.x > 0.0 && lambda.y > 0.0) {
            return None;
        }
        let seen = start + change * s;
        let heading = apart.xy().perp(&seen).atan2(apart.xy().dot(&seen));
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
        let place = origin_a + ray_a * lambda.x - turn * a.point_in_world;
        let rig_from_level = Se3::new(level_from_rig.inverse(), Vector3::zeros());
        Some(rig_from_level * Se3::new(turn, place))
    });
    poses.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn the_pose_is_among_the_solutions() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut found = 0;
        for _ in 0..1000 {
            let mut number = |most: f64| rng.random_range(-most..most);
            let world_from_rig = Se3::exp(&Vector6::new(
                number(2.0),
                number(2.0),
                number(2.0),
                number(5.0),
                number(5.0),
                number(2.0),
            ));
            let mut seen = || {
                let origin_in_rig = Vector3::new(number(0.1), number(0.1), number(0.1));
                let ray_in_rig = Vector3::new(number(1.0), number(1.0), number(1.0)).normalize();
                let distance = 5.0 + number(4.0);
                SeenPoint {
                    origin_in_rig,
                    ray_in_rig,
                    point_in_world: world_from_rig * (origin_in_rig + ray_in_rig * distance),
                }
            };
            let (a, b) = (seen(), seen());
            let up_in_rig = world_from_rig.rotation.inverse() * Vector3::z();
            let poses = solve_upright(&up_in_rig, [&a, &b]);
            let off = poses.iter().map(|rig_from_world| {
                let off = *rig_from_world * world_from_rig;
                off.translation.norm() + off.rotation.angle()
            });
            found += usize::from(off.fold(f64::INFINITY, f64::min) < 1e-6);
        }
        // Where both roots meet, half of the digits are lost.
        assert!(found > 990, "{found}");
    }

    #[test]
    fn what_determines_no_pose_gives_none() {
        let seen = |ray: [f64; 3], point: [f64; 3]| SeenPoint {
            origin_in_rig: Vector3::zeros(),
            ray_in_rig: Vector3::from(ray).normalize(),
            point_in_world: point.into(),
        };
        let up = Vector3::z();
        let a = seen([1.0, 0.0, 0.2], [3.0, 0.0, 1.0]);
        let above = seen([1.0, 0.0, 0.5], [3.0, 0.0, 2.0]);
        assert!(solve_upright(&up, [&a, &above]).is_empty());
        let level = [
            seen([1.0, 0.0, 0.0], [3.0, 0.0, 1.0]),
            seen([0.0, 1.0, 0.0], [0.0, 3.0, 1.0]),
        ];
        assert!(solve_upright(&up, [&level[0], &level[1]]).is_empty());
        let nowhere = seen([f64::NAN, 0.0, 0.0], [0.0, 3.0, 1.0]);
        assert!(solve_upright(&up, [&a, &nowhere]).is_empty());
    }
}
