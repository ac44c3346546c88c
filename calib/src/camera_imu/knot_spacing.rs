//! How far apart control points of the motion may lie: as far as the samples of the IMU let them.
//!
//! Control points that the motion does not need leave it free to be partly noise between two samples, and its rate where a view is
//! taken counts as if it were known: clocks are off by more than they say. Too few of them make all else wrong. Which of both it is
//! shows where splines are laid through the samples alone.

use lsfb_geometry::Vector3;
use lsfb_geometry::spline::UniformKnots;
use nalgebra::{Const, DMatrix, Dyn, OMatrix};

use super::state::Sample;

/// Spacings that are tried, as multiples of the least, the farthest first.
const MULTIPLES: [f64; 2] = [2.0, 1.5];
/// Length of the pieces through which splines are laid, seconds.
const PIECE_S: f64 = 2.0;
/// Growth of the variance about a spline that is none of the motion: in half a minute of samples it is known to a hundredth or two.
const MOST_GROWTH: f64 = 1.05;

/// The spacing, seconds: `least_s`, or up to twice that.
pub(super) fn knot_spacing_s(samples: &[Sample], least_s: f64) -> f64 {
    let Some(least) = variances(samples, least_s) else {
        return least_s;
    };
    let is_enough = |spacing_s: &f64| {
        variances(samples, *spacing_s).is_some_and(|found| {
            let pairs = found.iter().zip(&least);
            pairs
                .map(|(found, least)| found / least)
                .all(|growth| growth <= MOST_GROWTH)
        })
    };
    let coarser = MULTIPLES.map(|multiple| multiple * least_s);
    coarser.into_iter().find(is_enough).unwrap_or(least_s)
}

/// Squares about splines, and how many of them are free.
#[derive(Clone, Copy, Default)]
struct Spread {
    squares: f64,
    freedom: f64,
}

/// Variance of a sample of gyroscope and accelerometer about splines: cubic ones, as angular velocities of the motion are, and
/// parabolas, as its accelerations are. `None` where samples are too few to tell.
fn variances(samples: &[Sample], spacing_s: f64) -> Option<[f64; 2]> {
    let first_s = samples.first()?.time_s;
    let segments = (PIECE_S / spacing_s).floor();
    if !(1.0..=1e3).contains(&segments) {
        return None;
    }
    let piece_s = segments * spacing_s;
    let number = |s: &Sample| ((s.time_s - first_s) / piece_s).floor();
    let mut spreads = [Spread::default(); 2];
    for piece in samples.chunk_by(|a, b| number(a) == number(b)) {
        let is_cut_off =
            |s: &Sample| s.gyro_saturated.contains(&true) || s.accel_saturated.contains(&true);
        if piece.iter().any(is_cut_off) {
            continue;
        }
        let knots = UniformKnots {
            start_s: first_s + number(piece.first()?) * piece_s,
            spacing_s,
        };
        let gyro = about_spline::<4>(piece, &knots, segments as usize, |s| s.gyro);
        let accel = about_spline::<3>(piece, &knots, segments as usize, |s| s.accel);
        for (all, own) in spreads.iter_mut().zip([gyro, accel]) {
            let own = own.unwrap_or_default();
            all.squares += own.squares;
            all.freedom += own.freedom;
        }
    }
    let [gyro, accel] = spreads.map(|s| s.squares / s.freedom);
    (gyro > 0.0 && accel > 0.0).then_some([gyro, accel])
}

/// About the spline of order `N` nearest to the samples; `None` where they do not determine it.
fn about_spline<const N: usize>(
    samples: &[Sample],
    knots: &UniformKnots,
    segments: usize,
    value: impl Fn(&Sample) -> Vector3<f64>,
) -> Option<Spread> {
    let controls = segments + N - 1;
    if samples.len() <= controls {
        return None;
    }
    let mut normal = DMatrix::<f64>::zeros(controls, controls);
    let mut right = OMatrix::<f64, Dyn, Const<3>>::zeros(controls);
    let mut squares = 0.0;
    let mut mean = Vector3::zeros();
    for sample in samples {
        mean += value(sample) / samples.len() as f64;
    }
    for sample in samples {
        let at = knots.segment::<N>(sample.time_s, controls)?;
        // About the mean, so that gravity costs no digits.
        let off = value(sample) - mean;
        squares += off.norm_squared();
        for (i, weight) in at.weights.value.iter().enumerate() {
            let mut row = right.row_mut(at.first + i);
            row += off.transpose() * *weight;
            for (j, other) in at.weights.value.iter().enumerate() {
                normal[(at.first + i, at.first + j)] += weight * other;
            }
        }
    }
    let found = normal.cholesky()?.solve(&right);
    Some(Spread {
        squares: squares - found.dot(&right),
        freedom: 3.0 * (samples.len() - controls) as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Half a minute at 200 Hz of a motion that swings `hz` times a second, with noise.
    fn samples(hz: f64, noise: f64) -> Vec<Sample> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut draw = |sigma: f64| {
            Vector3::from_fn(|_, _| {
                let uniform: f64 = (0..12).map(|_| rng.random_range(-0.5..0.5)).sum();
                sigma * uniform
            })
        };
        (0..6000)
            .map(|k| {
                let time_s = 3.0 + f64::from(k) * 0.005;
                let phase = std::f64::consts::TAU * hz * time_s;
                Sample {
                    time_s,
                    gyro: Vector3::new(phase.sin(), phase.cos(), 0.3) + draw(noise),
                    accel: Vector3::new(phase.cos(), 9.8, phase.sin()) + draw(3.0 * noise),
                    gyro_saturated: [false; 3],
                    accel_saturated: [false; 3],
                }
            })
            .collect()
    }

    #[test]
    fn control_points_are_as_far_apart_as_the_motion_lets_them() {
        let least_s = 0.02;
        assert_eq!(knot_spacing_s(&samples(1.0, 0.02), least_s), 2.0 * least_s);
        assert_eq!(knot_spacing_s(&samples(12.0, 0.02), least_s), least_s);
        // Of a good IMU on the same motion less is noise.
        assert_eq!(knot_spacing_s(&samples(6.0, 1e-4), least_s), least_s);
    }

    #[test]
    fn where_samples_tell_nothing_nothing_is_changed() {
        let mut few = samples(1.0, 0.02);
        few.truncate(50);
        assert_eq!(knot_spacing_s(&few, 0.02), 0.02);
        assert_eq!(knot_spacing_s(&[], 0.02), 0.02);
        let mut rare = samples(1.0, 0.02);
        rare.retain(|s| (s.time_s / 0.005).round() as i64 % 4 == 0);
        assert_eq!(knot_spacing_s(&rare, 0.02), 0.02);
        let mut cut_off = samples(1.0, 0.02);
        cut_off.iter_mut().for_each(|s| s.gyro_saturated[1] = true);
        assert_eq!(knot_spacing_s(&cut_off, 0.02), 0.02);
        let mut still = samples(0.0, 0.0);
        still.iter_mut().for_each(|s| s.gyro = Vector3::zeros());
        assert_eq!(knot_spacing_s(&still, 0.02), 0.02);
    }
}
