//! Whether images and IMU agree, by what is left of their difference once both have had their say.
//!
//! White noise and biases that wander explain the IMU's part of a solve as far as its data sheet goes. Where they do not, something is wrong that
//! no unknown stands for (axes that are bent, stamps that jitter, a map that is too large), and standard deviations by that noise are too small.

use super::optimization::Optimized;
use super::walk::Walk;
use crate::Error;
use crate::residuals::ImuPreintegration;

/// Root mean square of what is left, in standard deviations of the noise that the solve took: what is known of the states draws it below 1 where that
/// noise is right. Zero without samples.
pub(super) fn left_sigmas(walk: &Walk, solved: &Optimized) -> Result<f64, Error> {
    let states = &solved.estimate.states;
    let intervals = walk.preintegrate(0..states.len(), |k| states[k].bias);
    let (mut squares, mut count) = (0.0, 0);
    for (pair, interval) in states.windows(2).zip(intervals) {
        let Some(samples) = interval.and_then(ImuPreintegration::new) else {
            continue;
        };
        let ends = [&pair[0].nav, &pair[1].nav];
        let (errors, gravity) = (&solved.imu_errors, &solved.gravity_m_s2);
        let left = samples.whitened(ends, &pair[0].bias, errors, gravity);
        squares += left.norm_squared();
        count += left.len();
    }
    Ok((squares / count.max(1) as f64).sqrt())
}
