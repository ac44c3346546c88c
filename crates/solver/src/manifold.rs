use lsfb_geometry::{Se3, UnitQuaternion, Vector3, Vector6, so3};
use nalgebra::{Quaternion, SVector};

/// The kind of value a parameter block holds: numbers that are stored, and a tangent space that is searched.
///
/// Perturbation is on the right, `x * exp(delta)`; for vectors it is addition. The problem stores the numbers.
pub trait Manifold: Sized {
    /// Numbers stored.
    const STORED: usize;
    /// Dimension of the tangent space.
    const TANGENT: usize;
    /// From its stored numbers, [`Manifold::STORED`] of them.
    fn load(stored: &[f64]) -> Self;
    /// Writes the stored numbers.
    fn store(&self, stored: &mut [f64]);
    /// `self * exp(delta)`, with [`Manifold::TANGENT`] numbers in `delta`.
    fn plus(&self, delta: &[f64]) -> Self;
}

/// Numbers a block stores and searches: what a residual expects of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Numbers stored.
    pub stored: usize,
    /// Dimension of the tangent space.
    pub tangent: usize,
}

impl Shape {
    /// The shape of blocks of type `M`.
    pub const fn of<M: Manifold>() -> Self {
        Self {
            stored: M::STORED,
            tangent: M::TANGENT,
        }
    }
}

fn load_rotation(stored: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(stored[3], stored[0], stored[1], stored[2]))
}

fn store_rotation(rotation: &UnitQuaternion<f64>, stored: &mut [f64]) {
    stored[..4].copy_from_slice(rotation.quaternion().coords.as_slice());
}

/// A pose: tangent `[rotation, translation]`, both in the body frame (SE(3), right perturbation).
impl Manifold for Se3 {
    const STORED: usize = 7;
    const TANGENT: usize = 6;

    fn load(stored: &[f64]) -> Self {
        Self::new(
            load_rotation(stored),
            Vector3::new(stored[4], stored[5], stored[6]),
        )
    }

    fn store(&self, stored: &mut [f64]) {
        store_rotation(&self.rotation, stored);
        stored[4..7].copy_from_slice(self.translation.as_slice());
    }

    fn plus(&self, delta: &[f64]) -> Self {
        *self * Self::exp(&Vector6::from_column_slice(delta))
    }
}

/// A rotation: tangent is the rotation vector in the body frame.
impl Manifold for UnitQuaternion<f64> {
    const STORED: usize = 4;
    const TANGENT: usize = 3;

    fn load(stored: &[f64]) -> Self {
        load_rotation(stored)
    }

    fn store(&self, stored: &mut [f64]) {
        store_rotation(self, stored);
    }

    fn plus(&self, delta: &[f64]) -> Self {
        let mut rotation = self * so3::exp(&Vector3::from_column_slice(delta));
        rotation.renormalize_fast();
        rotation
    }
}

/// Points, velocities, biases, intrinsics: perturbed by addition.
impl<const N: usize> Manifold for SVector<f64, N> {
    const STORED: usize = N;
    const TANGENT: usize = N;

    fn load(stored: &[f64]) -> Self {
        Self::from_column_slice(stored)
    }

    fn store(&self, stored: &mut [f64]) {
        stored.copy_from_slice(self.as_slice());
    }

    fn plus(&self, delta: &[f64]) -> Self {
        self + Self::from_column_slice(delta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn laws<M: Manifold>(value: M, delta: &[f64]) {
        let mut before = vec![0.0; M::STORED];
        value.store(&mut before);
        let mut again = vec![0.0; M::STORED];
        M::load(&before).store(&mut again);
        assert_eq!(before, again);

        let mut moved_back = vec![0.0; M::STORED];
        let negative: Vec<f64> = delta.iter().map(|d| -d).collect();
        value.plus(delta).plus(&negative).store(&mut moved_back);
        value.plus(&vec![0.0; M::TANGENT]).store(&mut again);
        for k in 0..M::STORED {
            assert!((before[k] - again[k]).abs() < 1e-15);
            assert!((before[k] - moved_back[k]).abs() < 1e-14);
        }
    }

    #[test]
    fn every_manifold_stores_and_moves_back() {
        let delta = [0.3, -0.2, 0.5, 1.0, -2.0, 0.7];
        laws(
            Se3::exp(&Vector6::new(0.4, 0.1, -0.9, 3.0, 2.0, 1.0)),
            &delta,
        );
        laws(so3::exp(&Vector3::new(0.4, 0.1, -0.9)), &delta[..3]);
        laws(Vector3::new(4.0, 5.0, 6.0), &delta[..3]);
        laws(SVector::<f64, 1>::new(4.0), &delta[..1]);
    }

    #[test]
    fn poses_move_by_the_exponential_on_the_right() {
        let pose = Se3::exp(&Vector6::new(0.4, 0.1, -0.9, 3.0, 2.0, 1.0));
        let delta = Vector6::new(0.3, -0.2, 0.5, 1.0, -2.0, 0.7);
        let moved = pose.plus(delta.as_slice());
        assert!(((pose.inverse() * moved).log() - delta).norm() < 1e-14);
    }
}
