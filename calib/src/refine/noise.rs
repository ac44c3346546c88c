//! How much everything errs, measured from the errors that an adjustment leaves.

use lsfb_geometry::{Matrix6, Vector6};
use lsfb_perception::statistics::median;
use nalgebra::DVector;

/// Normalized error at which an observation's weight is halved.
pub(super) const ROBUST_SCALE: f64 = 3.0;
/// Median of the size of a normal number.
const MEDIAN_SIZE: f64 = 0.6745;

/// Standard deviations, as measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    pub pixel_px: f64,
    pub plane_m: f64,
    /// Of the odometry in each image, beside what the scan's returns say.
    pub turn_rad: f64,
    pub shift_m: f64,
}

/// Where they start, and the least that is believed.
pub(super) const START: Noise = Noise {
    pixel_px: 1.0,
    plane_m: 0.02,
    turn_rad: 5e-4,
    shift_m: 3e-3,
};
const LEAST: Noise = Noise {
    pixel_px: 0.03,
    plane_m: 1e-3,
    turn_rad: 5e-5,
    shift_m: 3e-4,
};

/// What an adjustment leaves of a block of images.
pub(super) struct Left {
    /// Errors over the square root of the share that is not fitted away: pixels, metres.
    pub pixel_errors: Vec<f64>,
    pub plane_errors: Vec<f64>,
    /// Each image's own error, perturbed on the right.
    pub shifts: Vec<Vector6<f64>>,
    /// Variances of these, after the fact.
    pub variances: DVector<f64>,
}

/// Weight by the square of a normalized error.
pub(super) fn robust(square: f64) -> f64 {
    1.0 / (1.0 + square / (ROBUST_SCALE * ROBUST_SCALE))
}

impl Noise {
    /// Information of an image's own error.
    pub fn odometry(&self, by_returns: &Matrix6<f64>) -> Option<Matrix6<f64>> {
        let own = self.own_variance();
        // 1/(a + b) where the returns say little: (A⁻¹ + B)⁻¹ = A (1 + B A)⁻¹
        let by_returns = by_returns + Matrix6::identity();
        let inner = Matrix6::identity() + Matrix6::from_diagonal(&own) * by_returns;
        let out = by_returns * inner.try_inverse()?;
        Some(0.5 * (out + out.transpose()))
    }

    fn own_variance(&self) -> Vector6<f64> {
        Vector6::from_fn(|k, _| {
            let sigma = if k < 3 { self.turn_rad } else { self.shift_m };
            sigma * sigma
        })
    }

    /// As the errors left in all blocks say.
    pub fn measured(&self, by_block: &[Left]) -> Self {
        let spread_of = |errors: fn(&Left) -> &[f64], least: f64| {
            let sizes = by_block.iter().flat_map(errors).map(|e| e.abs());
            let middle = median(sizes.collect()).unwrap_or(0.0);
            (middle / MEDIAN_SIZE).max(least)
        };
        // What is left of an image's error over what of it can be left.
        let mut squares = [0.0; 2];
        let mut free = [0.0; 2];
        let own = self.own_variance();
        for left in by_block {
            for (frame, shift) in left.shifts.iter().enumerate() {
                for k in 0..6 {
                    squares[k / 3] += shift[k] * shift[k];
                    free[k / 3] += 1.0 - (left.variances[6 * frame + k] / own[k]).min(0.98);
                }
            }
        }
        let spread = |k: usize, before: f64, least: f64| {
            let now = (squares[k] / free[k].max(1e-9)).sqrt();
            // Slowly: both sides depend on it.
            (before * now)
                .sqrt()
                .clamp(0.5 * before, 2.0 * before)
                .max(least)
        };
        Self {
            pixel_px: spread_of(|l| &l.pixel_errors, LEAST.pixel_px),
            plane_m: spread_of(|l| &l.plane_errors, LEAST.plane_m),
            turn_rad: spread(0, self.turn_rad, LEAST.turn_rad),
            shift_m: spread(1, self.shift_m, LEAST.shift_m),
        }
    }
}
