//! How badly a pose may be known.

use lsfb_geometry::{Matrix3, Matrix6};

/// Standard deviations of a pose's rotation and place in the direction in which each is known worst: radians and metres. Infinite where the covariance says nothing.
/// A mean over three axes would hide one: along a corridor 9 cm are 5 cm of it.
pub(crate) fn worst_sigmas(covariance: &Matrix6<f64>) -> [f64; 2] {
    [0, 3].map(|first| worst_sigma(&covariance.fixed_view::<3, 3>(first, first).into()))
}

/// The same of one place.
pub(crate) fn worst_sigma(covariance: &Matrix3<f64>) -> f64 {
    match covariance.iter().all(|v| v.is_finite()) {
        true => covariance.symmetric_eigenvalues().max().max(0.0).sqrt(),
        false => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;

    use super::*;

    #[test]
    fn the_worst_direction_counts() {
        let sigmas = Vector6::new(0.01, 0.02, 0.03, 0.005, 0.086, 0.005);
        let known = Matrix6::from_diagonal(&sigmas.map(|s| s * s));
        let [rotation, place] = worst_sigmas(&known);
        assert!((rotation - 0.03).abs() < 1e-12 && (place - 0.086).abs() < 1e-12);
        let mut unknown = known;
        unknown[(4, 4)] = f64::NAN;
        assert_eq!(worst_sigmas(&unknown)[1], f64::INFINITY);
    }
}
