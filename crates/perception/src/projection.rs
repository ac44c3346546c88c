//! How points move with the poses through which they are seen: what residuals of corners, returns and features share.

use lsfb_geometry::{Matrix3, Matrix3x6, Se3, Vector3, so3};
use nalgebra::SMatrix;

/// Derivative of `target_from_source · exp(δ) · point` by `δ`: `R [−[p]ₓ, I]`.
pub fn moved_by_pose(target_from_source: &Se3, point: &Vector3<f64>) -> Matrix3x6<f64> {
    let rotation = target_from_source.rotation_matrix();
    stacked(-(rotation * so3::hat(point)), rotation)
}

/// Derivative of `p = (source_from_target · exp(δ))⁻¹ · point` by `δ`, from where it is: `[[p]ₓ, −I]`.
pub fn moved_by_inverse(in_target: &Vector3<f64>) -> Matrix3x6<f64> {
    stacked(so3::hat(in_target), -Matrix3::identity())
}

/// Derivative of what changes by `by_point` with `p = (source_from_target · exp(δ))⁻¹ · point`: `by_point · [[p]ₓ, −I]`, whose rows are
/// `[r × p, −r]`.
#[inline]
pub fn by_pose_of_inverse<const N: usize>(
    by_point: &SMatrix<f64, N, 3>,
    in_target: &Vector3<f64>,
) -> SMatrix<f64, N, 6> {
    let (r, p) = (by_point, in_target);
    SMatrix::from_fn(|row, column| match column {
        0 => r[(row, 1)] * p.z - r[(row, 2)] * p.y,
        1 => r[(row, 2)] * p.x - r[(row, 0)] * p.z,
        2 => r[(row, 0)] * p.y - r[(row, 1)] * p.x,
        c => -r[(row, c - 3)],
    })
}

fn stacked(by_rotation: Matrix3<f64>, by_translation: Matrix3<f64>) -> Matrix3x6<f64> {
    let mut by = Matrix3x6::zeros();
    by.fixed_columns_mut::<3>(0).copy_from(&by_rotation);
    by.fixed_columns_mut::<3>(3).copy_from(&by_translation);
    by
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;

    use super::*;

    #[test]
    fn derivatives_match_differences() {
        let pose = Se3::exp(&Vector6::new(0.3, -0.2, 0.5, 1.0, 2.0, -0.5));
        let point = Vector3::new(0.7, -1.1, 2.0);
        let in_target = pose.inverse() * point;
        for k in 0..6 {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let (up, down) = (pose.retract(&step), pose.retract(&-step));
            let forward = (up * point - down * point) / 2e-6;
            let back = (up.inverse() * point - down.inverse() * point) / 2e-6;
            assert!((forward - moved_by_pose(&pose, &point).column(k)).norm() < 1e-8);
            assert!((back - moved_by_inverse(&in_target).column(k)).norm() < 1e-8);
        }
        let by_point = SMatrix::<f64, 2, 3>::new(0.3, -1.0, 2.0, 0.7, 0.1, -0.4);
        let whole = by_point * moved_by_inverse(&in_target);
        assert!((by_pose_of_inverse(&by_point, &in_target) - whole).norm() < 1e-15);
    }
}
