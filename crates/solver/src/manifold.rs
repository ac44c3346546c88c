use lsfb_geometry::{Se3, UnitQuaternion, Vector2, Vector3, Vector6, so3};
use nalgebra::{Matrix3x2, Quaternion, SVector, UnitVector3};

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
    /// Angle in radians by which [`Manifold::plus`] turns the frame in which `delta` is given: 0 where it is addition.
    fn turn(_delta: &[f64]) -> f64 {
        0.0
    }
    /// Turns the parts of tangent vectors that are given in the body frame, and are not angles, into the world's axes, or back
    /// from them; `rows` are vectors one after the other. Where everything moves together such parts are alike for all then,
    /// however each is turned. Nothing is turned for most manifolds.
    fn align(&self, _rows: &mut [f64], _to_world: bool) {}
    /// What a component of the tangent is called in reports; empty where it has no name of its own.
    fn tangent_name(_component: usize) -> &'static str {
        ""
    }
}

const ROTATION_NAMES: [&str; 3] = ["rotation x", "rotation y", "rotation z"];
const TRANSLATION_NAMES: [&str; 3] = ["translation x", "translation y", "translation z"];

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

fn norm(delta: &[f64]) -> f64 {
    delta.iter().map(|x| x * x).sum::<f64>().sqrt()
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
        self.retract(&Vector6::from_column_slice(delta))
    }

    fn turn(delta: &[f64]) -> f64 {
        norm(&delta[..3])
    }

    fn align(&self, rows: &mut [f64], to_world: bool) {
        let rotation = self.rotation_matrix();
        let rotation = if to_world {
            rotation
        } else {
            rotation.transpose()
        };
        for row in rows.chunks_exact_mut(Self::TANGENT) {
            let turned = rotation * Vector3::from_column_slice(&row[3..]);
            row[3..].copy_from_slice(turned.as_slice());
        }
    }

    fn tangent_name(component: usize) -> &'static str {
        let names = ROTATION_NAMES.iter().chain(&TRANSLATION_NAMES);
        names.copied().nth(component).unwrap_or("")
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
        let mut rotation = so3::retract(self, &Vector3::from_column_slice(delta));
        rotation.renormalize_fast();
        rotation
    }

    fn turn(delta: &[f64]) -> f64 {
        norm(delta)
    }

    fn tangent_name(component: usize) -> &'static str {
        ROTATION_NAMES.get(component).copied().unwrap_or("")
    }
}

/// Two unit vectors across a direction, which change smoothly but where the direction passes through `−z`.
pub fn directions_across(direction: &Vector3<f64>) -> Matrix3x2<f64> {
    let sign = 1.0f64.copysign(direction.z);
    let a = -1.0 / (sign + direction.z);
    let b = direction.x * direction.y * a;
    Matrix3x2::new(
        1.0 + sign * direction.x * direction.x * a,
        b,
        sign * b,
        sign + direction.y * direction.y * a,
        -sign * direction.x,
        -direction.y,
    )
}

/// A direction: tangent are the angles along two directions across it.
impl Manifold for UnitVector3<f64> {
    const STORED: usize = 3;
    const TANGENT: usize = 2;

    fn load(stored: &[f64]) -> Self {
        Self::new_unchecked(Vector3::from_column_slice(stored))
    }

    fn store(&self, stored: &mut [f64]) {
        stored.copy_from_slice(self.as_slice());
    }

    fn plus(&self, delta: &[f64]) -> Self {
        let across = directions_across(self) * Vector2::new(delta[0], delta[1]);
        let angle = across.norm();
        // sin(x)/x, exact where x vanishes.
        let ratio = if angle < 1e-8 {
            1.0
        } else {
            angle.sin() / angle
        };
        Self::new_normalize(self.into_inner() * angle.cos() + across * ratio)
    }

    fn turn(delta: &[f64]) -> f64 {
        norm(delta)
    }

    fn tangent_name(component: usize) -> &'static str {
        ["first angle", "second angle"]
            .get(component)
            .copied()
            .unwrap_or("")
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

/// Two unknowns side by side: the numbers of the first, then those of the second.
impl<A: Manifold, B: Manifold> Manifold for (A, B) {
    const STORED: usize = A::STORED + B::STORED;
    const TANGENT: usize = A::TANGENT + B::TANGENT;

    fn load(stored: &[f64]) -> Self {
        let (first, second) = stored.split_at(A::STORED);
        (A::load(first), B::load(second))
    }

    fn store(&self, stored: &mut [f64]) {
        let (first, second) = stored.split_at_mut(A::STORED);
        self.0.store(first);
        self.1.store(second);
    }

    fn plus(&self, delta: &[f64]) -> Self {
        let (first, second) = delta.split_at(A::TANGENT);
        (self.0.plus(first), self.1.plus(second))
    }

    fn turn(delta: &[f64]) -> f64 {
        let (first, second) = delta.split_at(A::TANGENT);
        A::turn(first).max(B::turn(second))
    }

    fn align(&self, rows: &mut [f64], to_world: bool) {
        for row in rows.chunks_exact_mut(Self::TANGENT.max(1)) {
            let (first, second) = row.split_at_mut(A::TANGENT);
            self.0.align(first, to_world);
            self.1.align(second, to_world);
        }
    }

    fn tangent_name(component: usize) -> &'static str {
        match component.checked_sub(A::TANGENT) {
            Some(second) => B::tangent_name(second),
            None => A::tangent_name(component),
        }
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
        laws(
            (so3::exp(&Vector3::new(0.4, 0.1, -0.9)), Vector3::x()),
            &delta,
        );
        assert_eq!(<(Vector3<f64>, Se3)>::tangent_name(3), "rotation x");
    }

    #[test]
    fn poses_tell_their_turn_and_turn_translations_alone() {
        let pose = Se3::exp(&Vector6::new(0.4, 0.1, -0.9, 3.0, 2.0, 1.0));
        let delta = [0.3, 0.4, 0.0, 1.0, -2.0, 0.7];
        assert!((Se3::turn(&delta) - 0.5).abs() < 1e-15);
        assert_eq!(Vector3::turn(&delta[..3]), 0.0);
        let mut rows = [delta, delta].concat();
        pose.align(&mut rows, true);
        let turned = pose.rotation * Vector3::new(1.0, -2.0, 0.7);
        for row in rows.chunks(6) {
            assert_eq!(row[..3], delta[..3]);
            assert!((Vector3::from_column_slice(&row[3..]) - turned).norm() < 1e-14);
        }
        pose.align(&mut rows, false);
        assert!((0..12).all(|k| (rows[k] - delta[k % 6]).abs() < 1e-14));
    }

    #[test]
    fn poses_move_by_the_exponential_on_the_right() {
        let pose = Se3::exp(&Vector6::new(0.4, 0.1, -0.9, 3.0, 2.0, 1.0));
        let delta = Vector6::new(0.3, -0.2, 0.5, 1.0, -2.0, 0.7);
        let moved = pose.plus(delta.as_slice());
        assert!(((pose.inverse() * moved).log() - delta).norm() < 1e-14);
    }
}
