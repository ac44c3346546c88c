//! How far a pair of rays is from meeting, in pixels (Sampson's approximation).
//!
//! With `E = [t]ₓ R` and unit rays `a`, `b` that move with their pixels by `A = ∂a/∂p`, `B = ∂b/∂q`:
//! `r = c / √s`, `c = bᵀ E a`, `s = |Aᵀ Eᵀ b|² + |Bᵀ E a|²`, the least by which both pixels must move so that the rays meet, to first
//! order. With `E_k` the derivative of `E` by an unknown, `∂r/∂k = c_k / √s − c s_k / (2 s^{3/2})`, where `c_k = bᵀ E_k a` and
//! `s_k = 2 (Aᵀ Eᵀ b)·(Aᵀ E_kᵀ b) + 2 (Bᵀ E a)·(Bᵀ E_k a)`.

use lsfb_geometry::{Camera, Matrix3, UnitQuaternion, Vector2, Vector3, so3};
use lsfb_solver::directions_across;
use nalgebra::{Matrix3x2, SVector, UnitVector3};

/// Rotation and direction of the translation of `second_from_first`: what a pair of images determines.
pub(super) type Motion = (UnitQuaternion<f64>, UnitVector3<f64>);

/// What two images show of one point.
#[derive(Clone, Copy, Debug)]
pub struct RayPair {
    /// Unit rays in the frames of the cameras.
    rays: [Vector3<f64>; 2],
    /// Their derivatives by the pixels.
    by_pixel: [Matrix3x2<f64>; 2],
}

impl RayPair {
    /// Of a pixel in each of two cameras; `None` where a lens does not say where a pixel looks.
    pub fn new(cameras: [&Camera; 2], pixels: [Vector2<f64>; 2]) -> Option<Self> {
        let side = |k: usize| {
            let ray = cameras[k].unproject(&pixels[k])?;
            let pixel_by_ray = cameras[k].project_with_jacobian(&ray)?.pixel_by_point;
            // Moving along the ray moves no pixel, so that the pseudo-inverse leads across it.
            let square = (pixel_by_ray * pixel_by_ray.transpose()).try_inverse()?;
            Some((ray, pixel_by_ray.transpose() * square))
        };
        let [(a, by_p), (b, by_q)] = [side(0)?, side(1)?];
        Some(Self {
            rays: [a, b],
            by_pixel: [by_p, by_q],
        })
    }

    /// The rays.
    pub(super) fn rays(&self) -> [&Vector3<f64>; 2] {
        [&self.rays[0], &self.rays[1]]
    }

    /// Squared error, pixels².
    pub(super) fn squared_px2(&self, essential: &Matrix3<f64>) -> f64 {
        let [a, b] = &self.rays;
        let ea = essential * a;
        let across = self.by_pixel[0].tr_mul(&essential.tr_mul(b)).norm_squared()
            + self.by_pixel[1].tr_mul(&ea).norm_squared();
        b.dot(&ea).powi(2) / across.max(f64::MIN_POSITIVE)
    }

    /// Error, pixels, and its derivative by the tangent of the motion.
    pub(super) fn error_px(&self, model: &Linearised) -> (f64, SVector<f64, 5>) {
        let [a, b] = &self.rays;
        let ea = model.essential * a;
        let (left, right) = (
            self.by_pixel[0].tr_mul(&model.essential.tr_mul(b)),
            self.by_pixel[1].tr_mul(&ea),
        );
        let c = b.dot(&ea);
        let s = (left.norm_squared() + right.norm_squared()).max(f64::MIN_POSITIVE);
        let derivative = SVector::from_fn(|k, _| {
            let by = &model.by_motion[k];
            let by_a = by * a;
            let c_k = b.dot(&by_a);
            let s_k = 2.0
                * (left.dot(&self.by_pixel[0].tr_mul(&by.tr_mul(b)))
                    + right.dot(&self.by_pixel[1].tr_mul(&by_a)));
            (c_k - c * s_k / (2.0 * s)) / s.sqrt()
        });
        (c / s.sqrt(), derivative)
    }

    /// Whether the rays meet in front of both cameras, or are too parallel to say.
    pub(super) fn in_front(&self, motion: &Motion) -> bool {
        /// Sine of the angle below which two rays do not say where they meet.
        const PARALLEL: f64 = 2e-3;
        let turned = motion.0 * self.rays[0];
        let across = self.rays[1].cross(&turned);
        if across.norm() <= PARALLEL {
            return turned.dot(&self.rays[1]) > 0.0;
        }
        across.dot(&motion.1.cross(&turned)) > 0.0
            && across.dot(&motion.1.cross(&self.rays[1])) > 0.0
    }
}

/// The essential matrix of a motion with its derivatives.
pub(super) struct Linearised {
    essential: Matrix3<f64>,
    by_motion: [Matrix3<f64>; 5],
}

impl Linearised {
    /// At a motion.
    pub fn at(motion: &Motion) -> Self {
        let rotation = motion.0.to_rotation_matrix().into_inner();
        let direction = so3::hat(&motion.1);
        let across = directions_across(&motion.1);
        let by_motion = std::array::from_fn(|k| match k {
            0..3 => direction * rotation * so3::hat(&Vector3::ith(k, 1.0)),
            _ => so3::hat(&across.column(k - 3).into_owned()) * rotation,
        });
        Self {
            essential: direction * rotation,
            by_motion,
        }
    }
}

/// The essential matrix of a motion.
pub(super) fn essential_of(motion: &Motion) -> Matrix3<f64> {
    so3::hat(&motion.1) * motion.0.to_rotation_matrix().into_inner()
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::camera::Lens;
    use lsfb_solver::Manifold;

    use super::*;

    fn cameras() -> [Camera; 2] {
        let fisheye = Camera {
            width: 640,
            height: 400,
            lens: Lens::KannalaBrandt {
                focal_px: [290.0; 2],
                principal_px: [319.5, 199.5],
                distortion: [0.01, -0.005, 0.001, 0.0],
            },
        };
        [
            Camera::pinhole(640, 480, [500.0, 520.0], [319.5, 239.5]),
            fisheye,
        ]
    }

    fn motion() -> Motion {
        let direction = Vector3::new(0.6, -0.3, 0.2);
        (
            so3::exp(&Vector3::new(0.1, -0.2, 0.05)),
            UnitVector3::new_normalize(direction),
        )
    }

    #[test]
    fn jacobian_matches_differences() {
        let [first, second] = cameras();
        for (p, q) in [
            ([100.0, 80.0], [300.0, 120.0]),
            ([500.0, 300.0], [420.0, 310.0]),
        ] {
            let pair = RayPair::new([&first, &second], [p.into(), q.into()]).expect("rays");
            let (error, derivative) = pair.error_px(&Linearised::at(&motion()));
            assert!(
                (error.powi(2) / pair.squared_px2(&essential_of(&motion())) - 1.0).abs() < 1e-9
            );
            for k in 0..5 {
                let at = |h: f64| {
                    let mut delta = [0.0; 5];
                    delta[k] = h;
                    pair.error_px(&Linearised::at(&motion().plus(&delta))).0
                };
                let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
                let scale = derivative.norm();
                assert!(
                    (numeric - derivative[k]).abs() < 1e-6 * scale,
                    "{k}: {numeric} {derivative}"
                );
            }
        }
    }

    #[test]
    fn the_error_is_how_far_pixels_are_off() {
        let [first, second] = cameras();
        let (rotation, direction) = motion();
        let point = Vector3::new(0.4, -0.3, 3.0);
        let seen = second
            .project(&(rotation * point + direction.into_inner()))
            .expect("seen");
        let p = first.project(&point).expect("seen");
        let at = |off: Vector2<f64>| {
            let pair = RayPair::new([&first, &second], [p, seen + off]).expect("rays");
            (
                pair.squared_px2(&essential_of(&motion())).sqrt(),
                pair.in_front(&motion()),
            )
        };
        assert!(at(Vector2::zeros()).0 < 1e-9);
        assert!(at(Vector2::zeros()).1);
        // Of an offset in one image alone at most the share across the curve shows, and both images bear it.
        let errors = [[1.0, 0.0], [0.0, 1.0]].map(|o| at(o.into()).0);
        let across = errors[0].hypot(errors[1]);
        assert!((0.4..=1.0).contains(&across), "{errors:?}");
        let opposite = (rotation, -direction);
        let pair = RayPair::new([&first, &second], [p, seen]).expect("rays");
        assert!(!pair.in_front(&opposite));
    }
}
