use std::sync::Arc;

use lsfb_geometry::{Matrix3, Matrix6, Se3, Vector2, Vector3, so3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

use super::ObservingCamera;

/// A point of the world seen by a camera of the rig between two keyframes, at the pose that the trajectory has there: that of the motion from the
/// one before and that of the motion to the one behind, interpolated. Blocks: poses `world_from_rig` of both keyframes, point.
///
/// With `T₁ = T_a A`, `T₂ = T_b B`, `φ = log(R₁ᵀ R₂)`: `R = R₁ exp(f φ)`, `t = (1 − f) t₁ + f t₂`, and the reprojection of [`Reprojection`](super::Reprojection) from there.
/// Small motions `[θ₁, ρ₁]`, `[θ₂, ρ₂]` of `T₁` and `T₂` turn it by `exp(f φ)ᵀ θ₁ + f Jᵣ(f φ) (Jᵣ⁻¹(φ) θ₂ − Jₗ⁻¹(φ) θ₁)`; those of `T_a` move `T₁` by
/// `θ₁ = R_Aᵀ θ`, and its place by `R_a (ρ − [t_A]ₓ θ)`. Undefined behind the lens.
#[derive(Clone, Debug)]
pub struct BetweenReprojection {
    /// The camera.
    pub camera: Arc<ObservingCamera>,
    /// Poses of the rig at the image in the frames of the keyframe before and of that behind, as the trajectory to start from has its motion.
    pub image_in_keyframes: [Se3; 2],
    /// How far on the way from one to the other, 0 to 1.
    pub fraction: f64,
    /// Where the point was seen.
    pub pixel: Vector2<f64>,
    /// Standard deviation of the pixel in each direction.
    pub sigma_px: f64,
}

impl BetweenReprojection {
    /// The pose of the image, with poses of the keyframes before and behind.
    fn pose(&self, keyframes: &[Se3; 2]) -> ([Se3; 2], Se3) {
        let ends = [0, 1].map(|k| keyframes[k] * self.image_in_keyframes[k]);
        (ends, ends[0].interpolate(&ends[1], self.fraction))
    }

    /// How the image moves in its own frame with both keyframes in theirs.
    fn moved_by(&self, keyframes: &[Se3; 2], ends: &[Se3; 2], pose: &Se3) -> [Matrix6<f64>; 2] {
        let f = self.fraction;
        let phi = so3::log(&(ends[0].rotation.inverse() * ends[1].rotation));
        let by_phi = so3::right_jacobian(&(phi * f)) * f;
        let back = so3::exp(&(phi * f)).inverse().to_rotation_matrix();
        let turns = [
            back.matrix() - by_phi * so3::left_jacobian_inverse(&phi),
            by_phi * so3::right_jacobian_inverse(&phi),
        ];
        let to_image: Matrix3<f64> = pose.rotation_matrix().transpose();
        let shares = [1.0 - f, f];
        [0, 1].map(|k| {
            let motion = &self.image_in_keyframes[k];
            let turn_of_end = motion.rotation_matrix().transpose();
            let shift = to_image * keyframes[k].rotation_matrix() * shares[k];
            let mut moved = Matrix6::zeros();
            moved
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&(turns[k] * turn_of_end));
            moved
                .fixed_view_mut::<3, 3>(3, 0)
                .copy_from(&(-shift * so3::hat(&motion.translation)));
            moved.fixed_view_mut::<3, 3>(3, 3).copy_from(&shift);
            moved
        })
    }
}

impl Residual for BetweenReprojection {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const {
            &[
                Shape::of::<Se3>(),
                Shape::of::<Se3>(),
                Shape::of::<Vector3<f64>>(),
            ]
        }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let keyframes: [Se3; 2] = [parameters.get(0), parameters.get(1)];
        let point: Vector3<f64> = parameters.get(2);
        let (ends, pose) = self.pose(&keyframes);
        let weight = 1.0 / self.sigma_px;
        let seen = self.camera.see(&pose, &point)?;
        out.set_residual(&((seen.pixel - self.pixel) * weight));
        let moved = self.moved_by(&keyframes, &ends, &pose);
        for (block, moved) in moved.iter().enumerate() {
            out.set_jacobian(block, &(seen.by_pose * moved * weight));
        }
        out.set_jacobian(2, &(seen.by_point * weight));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    use super::super::reprojection::tests::stereo;
    use super::*;

    /// Keyframes that have moved a good deal from where the trajectory had them, so that both ends disagree.
    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let a = problem.add_block(Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, 0.5)));
        let b = problem.add_block(Se3::exp(&Vector6::new(0.0, -0.1, 0.6, 1.4, 2.1, 0.6)));
        for camera in stereo() {
            for (seen_at, fraction) in [
                ([100.0, 80.0], 0.3),
                ([320.0, 200.0], 0.8),
                ([600.0, 350.0], 0.5),
            ] {
                let residual = BetweenReprojection {
                    camera: camera.clone(),
                    image_in_keyframes: [
                        Se3::exp(&Vector6::new(0.05, 0.1, 0.2, 0.1, 0.0, 0.02)),
                        Se3::exp(&Vector6::new(-0.1, 0.02, -0.2, -0.2, 0.05, 0.0)),
                    ],
                    fraction,
                    pixel: Vector2::from(seen_at) + Vector2::new(1.0, -2.0),
                    sigma_px: 0.7,
                };
                let (_, pose) = residual.pose(&[problem.value(a), problem.value(b)]);
                let ray = camera
                    .camera()
                    .unproject(&Vector2::from(seen_at))
                    .expect("inside the lens");
                let in_rig = camera.camera_from_rig().inverse() * (ray * 3.0);
                let point = problem.add_block(pose * in_rig);
                problem
                    .add_residual(residual, &[a.id(), b.id(), point.id()], Kernel::Squared)
                    .expect("blocks fit");
            }
        }
        check_residual_jacobian!(all of problem);
    }
}
