//! The rotation group: exponential, logarithm and their Jacobians, accurate near 0 and near π.
//!
//! Formulas: Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", appendix B. Where a closed
//! form cancels, its Taylor series stands in, to machine precision.

use nalgebra::{Const, Matrix3, Quaternion, Rotation3, SVD, UnitQuaternion, Vector3};

/// Below this squared angle (1 rad²) the series are used.
const SERIES_BELOW: f64 = 1.0;

/// The skew-symmetric matrix with `hat(a) * b == a × b`.
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Rotation by the rotation vector `phi`, radians.
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    let angle = phi.norm();
    // sin(a/2)/a does not cancel: only where the angle itself has underflown is there nothing to divide by.
    let factor = if angle < 1e-150 {
        0.5
    } else {
        (angle * 0.5).sin() / angle
    };
    let real = (angle * 0.5).cos();
    UnitQuaternion::new_normalize(Quaternion::from_parts(real, phi * factor))
}

/// The rotation vector of `rotation`, angle in [0, π].
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = rotation.quaternion();
    // q and −q are one rotation: take the half with the shorter angle.
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let (w, v) = (q.w * sign, q.imag() * sign);
    let sine = v.norm();
    if sine < 1e-150 {
        v * (2.0 / w)
    } else {
        v * (2.0 * sine.atan2(w) / sine)
    }
}

/// A rotation moved by a rotation vector, on the right: `rotation * exp(phi)`, with `phi` in the source frame.
pub fn retract(rotation: &UnitQuaternion<f64>, phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    rotation * exp(phi)
}

/// The rotation vector that moves one rotation to another: `retract(a, local(a, b)) == b`.
pub fn local(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>) -> Vector3<f64> {
    log(&(from.inverse() * to))
}

/// The rotation nearest to a matrix; of a sum of `a bᵀ` that which turns the `b` onto the `a` best (Kabsch), where the `b` span a
/// plane or more. `None` where the matrix has no singular values.
pub fn nearest(matrix: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    Some(nearest_of(&matrix.svd(true, true))?.rotation)
}

/// The rotation whose matrix stands in a file, rounded: `None` where `R Rᵀ` is farther from 1 than `rounding` (Frobenius norm), and of
/// mirrors.
pub fn from_rounded(matrix: &Matrix3<f64>, rounding: f64) -> Option<UnitQuaternion<f64>> {
    let off = (matrix * matrix.transpose() - Matrix3::identity()).norm();
    let is_rotation = off < rounding && matrix.determinant() > 0.0;
    is_rotation.then(|| nearest(matrix)).flatten()
}

/// The rotation nearest to a matrix, and the signs that its singular values have in it.
pub(crate) struct Nearest {
    pub rotation: UnitQuaternion<f64>,
    pub sign: Vector3<f64>,
}

pub(crate) fn nearest_of(svd: &SVD<f64, Const<3>, Const<3>>) -> Option<Nearest> {
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sign = Vector3::repeat(1.0);
    // A mirror fits as well: the direction that says least is turned round.
    sign[svd.singular_values.imin()] = (u * v_t).determinant().signum();
    let matrix = u * Matrix3::from_diagonal(&sign) * v_t;
    let rotation = Rotation3::from_matrix_unchecked(matrix);
    Some(Nearest {
        rotation: UnitQuaternion::from_rotation_matrix(&rotation),
        sign,
    })
}

/// Coefficients `(1 − cos a)/a²` and `(a − sin a)/a³` of the left Jacobian.
fn left_coefficients(squared: f64) -> (f64, f64) {
    if squared < SERIES_BELOW {
        (series(squared, &COSINE_REST), series(squared, &SINE_REST))
    } else {
        let angle = squared.sqrt();
        let half_sine = (0.5 * angle).sin();
        (
            2.0 * half_sine * half_sine / squared,
            (angle - angle.sin()) / (squared * angle),
        )
    }
}

/// `1/2! − a²/4! + …`, signs left out.
const COSINE_REST: [f64; 9] = inverse_factorials(2);
/// `1/3! − a²/5! + …`, signs left out.
const SINE_REST: [f64; 9] = inverse_factorials(3);

/// `1/first!, 1/(first + 2)!, …`
pub(crate) const fn inverse_factorials<const N: usize>(first: usize) -> [f64; N] {
    let mut out = [0.0; N];
    let (mut factorial, mut n, mut k) = (1.0, 1, 0);
    while k < N {
        while n <= first + 2 * k {
            factorial *= n as f64;
            n += 1;
        }
        out[k] = 1.0 / factorial;
        k += 1;
    }
    out
}

/// `c₀ − c₁ x + c₂ x² − …`
pub(crate) fn series(x: f64, coefficients: &[f64]) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| c - x * sum)
}

/// `J_l`: `exp(phi + d) ≈ exp(J_l d) exp(phi)`.
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let (b, c) = left_coefficients(phi.norm_squared());
    let k = hat(phi);
    Matrix3::identity() + k * b + k * k * c
}

/// `J_r`: `exp(phi + d) ≈ exp(phi) exp(J_r d)`.
pub fn right_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(&-phi)
}

/// `|B₂ₖ| / (2k)!` with the Bernoulli numbers: the series of `(1 − (a/2) cot(a/2))/a²`.
const COTANGENT_REST: [f64; 11] = [
    1.0 / 12.0,
    1.0 / 720.0,
    1.0 / 30_240.0,
    1.0 / 1_209_600.0,
    1.0 / 47_900_160.0,
    691.0 / 1_307_674_368_000.0,
    1.0 / 74_724_249_600.0,
    3_617.0 / 10_670_622_842_880_000.0,
    43_867.0 / 5_109_094_217_170_944_000.0,
    174_611.0 / 802_857_662_698_291_200_000.0,
    77_683.0 / 14_101_100_039_391_805_440_000.0,
];

/// Inverse of [`left_jacobian`], for angles below 2π.
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let squared = phi.norm_squared();
    let d = if squared < SERIES_BELOW {
        COTANGENT_REST
            .iter()
            .rev()
            .fold(0.0, |sum, c| c + squared * sum)
    } else {
        let half = squared.sqrt() * 0.5;
        (1.0 - half / half.tan()) / squared
    };
    let k = hat(phi);
    Matrix3::identity() - k * 0.5 + k * k * d
}

/// Inverse of [`right_jacobian`], for angles below 2π.
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian_inverse(&-phi)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use proptest::prelude::*;

    fn rotation_vector() -> impl Strategy<Value = Vector3<f64>> {
        let axis = prop::array::uniform3(-1.0..1.0f64)
            .prop_map(Vector3::from)
            .prop_filter("an axis", |v| v.norm() > 0.1);
        let angle = prop_oneof![
            (-18.0..0.0f64).prop_map(|e| 10f64.powf(e)),
            0.0..PI,
            (-15.0..-1.0f64).prop_map(|e| PI - 10f64.powf(e)),
        ];
        (axis, angle).prop_map(|(axis, angle)| axis.normalize() * angle)
    }

    proptest! {
        #[test]
        fn log_inverts_exp(phi in rotation_vector()) {
            let again = log(&exp(&phi));
            // At π itself a rotation has two vectors.
            let error = (again - phi).norm().min((again + phi).norm() + (phi.norm() - PI).abs());
            prop_assert!(error <= 4e-16 + 1e-15 * phi.norm(), "{error}");
        }

        #[test]
        fn the_nearest_rotation_is_the_one_that_was_stretched(
            phi in rotation_vector(), axes in rotation_vector(), stretch in prop::array::uniform3(0.2..5.0f64),
        ) {
            // A rotation behind a symmetric stretch: its polar decomposition, which is unique.
            let (rotation, axes) = (exp(&phi), exp(&axes).to_rotation_matrix().into_inner());
            let stretch = axes * Matrix3::from_diagonal(&Vector3::from(stretch)) * axes.transpose();
            let found = nearest(&(rotation.to_rotation_matrix().matrix() * stretch)).expect("a rotation");
            prop_assert!(local(&rotation, &found).norm() < 1e-12);
        }

        #[test]
        fn a_rounded_matrix_is_a_rotation_and_a_mirror_is_none(phi in rotation_vector()) {
            let matrix = exp(&phi).to_rotation_matrix().into_inner();
            let rounded = matrix.map(|v| (v * 1e4).round() / 1e4);
            let found = from_rounded(&rounded, 1e-3).expect("a rotation");
            prop_assert!(local(&exp(&phi), &found).norm() < 2e-4);
            for none in [-matrix, matrix * 1.01, matrix * f64::NAN, Matrix3::zeros()] {
                prop_assert!(from_rounded(&none, 1e-3).is_none());
            }
        }

        #[test]
        fn vectors_of_one_plane_are_turned_onto_each_other(phi in rotation_vector()) {
            let rotation = exp(&phi);
            let pairs = [Vector3::x(), Vector3::y() * 2.0].map(|b| (rotation * b) * b.transpose());
            let found = nearest(&(pairs[0] + pairs[1])).expect("a rotation");
            prop_assert!(local(&rotation, &found).norm() < 1e-12);
        }

        #[test]
        fn local_undoes_retract(phi in rotation_vector(), d in prop::array::uniform3(-1.0..1.0f64)) {
            let (rotation, d) = (exp(&phi), Vector3::from(d));
            prop_assert!((local(&rotation, &retract(&rotation, &d)) - d).norm() < 1e-13);
        }

        #[test]
        fn jacobians_match_numeric_differences(phi in rotation_vector(), d in prop::array::uniform3(-1.0..1.0f64)) {
            let d = Vector3::from(d);
            let h = 1e-6;
            let left = log(&(exp(&(phi + d * h)) * exp(&(phi - d * h)).inverse())) / (2.0 * h);
            prop_assert!((left - left_jacobian(&phi) * d).norm() < 1e-8);
            let right = log(&(exp(&(phi - d * h)).inverse() * exp(&(phi + d * h)))) / (2.0 * h);
            prop_assert!((right - right_jacobian(&phi) * d).norm() < 1e-8);
            prop_assert!((left_jacobian_inverse(&phi) * left_jacobian(&phi) - Matrix3::identity()).norm() < 3e-15);
            prop_assert!((right_jacobian_inverse(&phi) * right_jacobian(&phi) - Matrix3::identity()).norm() < 3e-15);
        }
    }

    /// mpmath with 50 digits: `(1 − cos a)/a²`, `(a − sin a)/a³`, `(1 − (a/2) cot(a/2))/a²`.
    #[test]
    fn coefficients_agree_with_many_digits() {
        let expected = [
            [1e-9, 0.5, 0.16666666666666666, 0.08333333333333333],
            [
                0.0001,
                0.49999999958333335,
                0.16666666658333334,
                0.08333333334722222,
            ],
            [
                0.0099,
                0.4999959162633416,
                0.1666658499185726,
                0.08333346945865099,
            ],
            [
                0.01,
                0.4999958333472222,
                0.16666583333531745,
                0.08333347222255291,
            ],
            [
                0.1,
                0.4995834721974234,
                0.1665833531718477,
                0.08334722552992746,
            ],
            [
                0.5,
                0.48966975243850913,
                0.16459569116637598,
                0.0836826353540599,
            ],
            [
                0.99,
                0.46047356332865264,
                0.1586871896183336,
                0.08472714716844885,
            ],
            [
                1.0,
                0.4596976941318603,
                0.1585290151921035,
                0.08475613914377404,
            ],
            [
                1.01,
                0.4589150854089251,
                0.15836940406928152,
                0.08478545118236505,
            ],
            [
                1.5,
                0.4130056881476876,
                0.14889037433953942,
                0.08663572826131866,
            ],
            [
                2.0,
                0.3540367091367856,
                0.1363378216467898,
                0.08947684601641732,
            ],
            [
                3.0,
                0.2211102774000495,
                0.10588444414593084,
                0.09929197039400237,
            ],
            [
                3.1405,
                0.20278333935177154,
                0.10135642339569886,
                0.10130471906780301,
            ],
            [
                4.5,
                0.059792385157075544,
                0.060110069878354974,
                0.139087732840328,
            ],
        ];
        for [angle, b, c, d] in expected {
            let (got_b, got_c) = left_coefficients(angle * angle);
            assert!((got_b / b - 1.0).abs() < 4e-16, "{angle}: {got_b} {b}");
            assert!((got_c / c - 1.0).abs() < 1e-15, "{angle}: {got_c} {c}");
            let phi = Vector3::new(0.0, 0.0, angle);
            let got_d = (1.0 - left_jacobian_inverse(&phi).m11) / (angle * angle);
            let resolution = 2e-16 / (angle * angle);
            assert!(
                (got_d - d).abs() < 1e-15 + resolution,
                "{angle}: {got_d} {d}"
            );
        }
    }

    #[test]
    fn log_is_accurate_up_to_pi() {
        for angle in [1e-12, 1e-8, 1e-4, PI - 1e-8, PI] {
            let axis = Vector3::new(0.36, -0.48, 0.8);
            assert!(
                (log(&exp(&(axis * angle))).norm() - angle).abs() < 1e-14 + 1e-15 * angle,
                "{angle}"
            );
        }
    }
}
