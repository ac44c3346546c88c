//! How far apart control points of the motion may lie: as far as the samples of the IMU let them.
//!
//! Control points that the motion does not need leave it free to be partly noise between two samples, and its rate where a view is
//! taken counts as if it were known: clocks are off by more than they say. Too few of them make all else wrong. Which of both it is
//! shows where splines are laid through the samples alone.

use lsfb_geometry::Vector3;
use lsfb_geometry::spline::UniformKnots;
use nalgebra::{Const, DMatrix, Dyn, OMatrix};

use super::state::Sample;

/// Pieces through which splines are laid: as long as so many of the least spacing.
const PIECE: usize = 120;
/// Spacings, by how many of them a piece has: the least, and the coarser ones that are tried, the farthest first.
const LEAST: usize = PIECE;
const COARSER: [usize; 2] = [PIECE / 2, PIECE * 2 / 3];
/// Growth of the variance about splines that is none of the motion: of all samples of half a minute, which know it to a hundredth or
/// two, and of a piece of two seconds, so that a moment of fast motion is not lost among minutes of rest.
const MOST_GROWTH: f64 = 1.05;
const MOST_GROWTH_OF_PIECE: f64 = 1.25;

/// The spacing, seconds: `least_s`, or up to twice that.
pub(super) fn knot_spacing_s(samples: &[Sample], least_s: f64) -> f64 {
    let piece_s = PIECE as f64 * least_s;
    let least = spreads(samples, piece_s, LEAST);
    let is_enough = |segments: &usize| is_alike(&least, &spreads(samples, piece_s, *segments));
    let segments = COARSER.into_iter().find(is_enough).unwrap_or(LEAST);
    piece_s / segments as f64
}

/// Squares about splines, and how many of them are free.
#[derive(Clone, Copy, Default)]
struct Spread {
    squares: f64,
    freedom: f64,
}

impl Spread {
    fn plus(self, other: Self) -> Self {
        Self {
            squares: self.squares + other.squares,
            freedom: self.freedom + other.freedom,
        }
    }

    /// Whether the variance has not grown by more than that; not where there is none to tell by.
    fn is_within(&self, most_growth: f64, least: &Self) -> bool {
        let [own, least] = [self, least].map(|s| s.squares / s.freedom);
        least > 0.0 && own <= most_growth * least
    }
}

/// Whether samples lie no farther from coarser splines, all together and in every piece.
fn is_alike(least: &[[Spread; 2]], coarser: &[[Spread; 2]]) -> bool {
    (0..2).all(|triad| {
        let of = |pieces: &[[Spread; 2]]| {
            let own = pieces.iter().map(|piece| piece[triad]);
            own.fold(Spread::default(), Spread::plus)
        };
        let mut pairs = least.iter().zip(coarser).map(|(l, c)| (l[triad], c[triad]));
        of(coarser).is_within(MOST_GROWTH, &of(least))
            && pairs.all(|(l, c)| l.freedom == 0.0 || c.is_within(MOST_GROWTH_OF_PIECE, &l))
    })
}

/// How far samples of gyroscope and accelerometer lie from splines of so many segments a piece: cubic ones, as angular velocities of the
/// motion are, and parabolas, as its accelerations are. Nothing of pieces that samples do not determine, or that are cut off.
fn spreads(samples: &[Sample], piece_s: f64, segments: usize) -> Vec<[Spread; 2]> {
    let first_s = samples.first().map_or(0.0, |s| s.time_s);
    let number = |s: &Sample| ((s.time_s - first_s) / piece_s).floor();
    let is_cut_off =
        |s: &Sample| s.gyro_saturated.contains(&true) || s.accel_saturated.contains(&true);
    let of_piece = |piece: &[Sample]| {
        if piece.iter().any(is_cut_off) {
            return [Spread::default(); 2];
        }
        let knots = UniformKnots {
            start_s: first_s + piece.first().map_or(0.0, number) * piece_s,
            spacing_s: piece_s / segments as f64,
        };
        let gyro = about_spline::<4>(piece, &knots, segments, |s| s.gyro);
        let accel = about_spline::<3>(piece, &knots, segments, |s| s.accel);
        [gyro, accel].map(Option::unwrap_or_default)
    };
    let pieces = samples.chunk_by(|a, b| number(a) == number(b));
    pieces.map(of_piece).collect()
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
    fn a_moment_of_fast_motion_is_not_lost_among_slow_ones() {
        let mut mostly_slow = samples(1.0, 0.5);
        let mut fast = samples(12.0, 0.5);
        mostly_slow.splice(1950..2350, fast.drain(1950..2350));
        assert_eq!(knot_spacing_s(&samples(1.0, 0.5), 0.02), 0.04);
        assert!(knot_spacing_s(&mostly_slow, 0.02) < 0.04);
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
