//! How far disjoint parts of the data scatter, against what their weights explain.
//!
//! A part moves the result by `d = −C Jᵀ r`. Were its errors independent and as large as their weights say, that would have the
//! covariance `E = M − M C⁻¹ M` with `M = C Jᵀ J C`: its own noise, less what it has in common with the result. The squares of `d`
//! over those of `E` are 1 in the mean, whatever the number of parts and parameters. A model that lacks something (a board that
//! is not quite as said, a lens that is not quite its model, neighbours that err alike) makes parts pull in different directions, and
//! the ratio grows: standard deviations then come from the scatter. What all parts have in common is not seen.

use lsfb_solver::Influence;
use nalgebra::{DMatrix, DVector};

/// Parts needed.
const MIN_PARTS: usize = 5;
/// Neighbouring parts are joined so often by two: what errs alike for long is seen in long parts only.
const LEVELS: u32 = 3;
/// What errs alike for longer than that (views from one side of a board that is not quite flat) is seen in these many parts, by all
/// parameters together.
const LONG_PARTS: [usize; 3] = [4, 3, 2];
/// Standard deviations of a normal number by which the squares of all parameters must exceed what is expected to count.
const SIGNIFICANT: f64 = 3.0;
/// Degrees of freedom that the ratio of all parameters counts for beside a parameter's own.
const COMMON_FREEDOM: f64 = 4.0;

/// The scatter of the parts that scatter most for their length.
pub(crate) struct Scatter {
    parts: Vec<Part>,
    /// Squares over what is expected, over all parameters; `None` where it could be so by accident.
    ratio: Option<f64>,
    /// How many times as large that is of longer parts, too few to tell it of each parameter.
    growth: f64,
}

struct Part {
    shift: DVector<f64>,
    /// What its weights explain.
    expected: DMatrix<f64>,
}

impl Scatter {
    /// Of the parts of a result with this covariance, neighbours of which may err alike. Rows and columns of zeros are of what was
    /// not searched.
    pub fn of_neighbours(covariance: &DMatrix<f64>, parts: &[Influence]) -> Self {
        let information = information(covariance);
        let mut best = Self {
            parts: Vec::new(),
            ratio: None,
            growth: 1.0,
        };
        for level in 0..LEVELS {
            let joined = joined(parts, 1 << level);
            if joined.len() < MIN_PARTS {
                break;
            }
            let of_level = Self::of(joined, &information);
            if of_level.ratio > best.ratio {
                best = of_level;
            }
        }
        if let Some(ratio) = best.ratio {
            for count in LONG_PARTS {
                let long = Sums::of(&joined(parts, parts.len() / count), &information);
                // A few parts are off by more or less by chance.
                if is_clear(long.squares / ratio, long.expected, long.variance) {
                    best.growth = best.growth.max(long.squares / long.expected / ratio);
                }
            }
        }
        best
    }

    /// The same where each part is as far from the next as from all others.
    pub fn of_strangers(covariance: &DMatrix<f64>, parts: Vec<Influence>) -> Self {
        match parts.len() < MIN_PARTS {
            true => Self {
                parts: Vec::new(),
                ratio: None,
                growth: 1.0,
            },
            false => Self::of(parts, &information(covariance)),
        }
    }

    fn of(influences: Vec<Influence>, information: &DMatrix<f64>) -> Self {
        let sums = Sums::of(&influences, information);
        let parts = influences.into_iter();
        let parts = parts.map(|Influence { shift, noise }| Part {
            expected: own(&noise, information),
            shift,
        });
        Self {
            parts: parts.collect(),
            ratio: is_clear(sums.squares, sums.expected, sums.variance)
                .then(|| sums.squares / sums.expected),
            growth: 1.0,
        }
    }

    /// What the standard deviation of `along · parameters` is to be multiplied by; 1 where weights explain the scatter.
    pub fn factor_along(&self, along: &DVector<f64>) -> f64 {
        let Some(ratio) = self.ratio else {
            return 1.0;
        };
        let (mut squares, mut expected, mut spread) = (0.0, 0.0, 0.0);
        for part in &self.parts {
            let own = along.dot(&(&part.expected * along)).max(0.0);
            squares += along.dot(&part.shift).powi(2);
            expected += own;
            spread += own * own;
        }
        if !(expected > 0.0) {
            return 1.0;
        }
        let own = expected * expected / spread;
        let freedom = COMMON_FREEDOM + own;
        let both = (COMMON_FREEDOM * ratio + own * squares / expected) / freedom;
        (both * self.growth * of_few(freedom)).max(1.0).sqrt()
    }

    /// The same for each parameter.
    pub fn factors(&self, count: usize) -> Vec<f64> {
        let unit = |k: usize| DVector::from_fn(count, |i, _| f64::from(u8::from(i == k)));
        (0..count).map(|k| self.factor_along(&unit(k))).collect()
    }
}

/// What a part is expected to be off by: its own noise, less what the result took of it.
fn own(noise: &DMatrix<f64>, information: &DMatrix<f64>) -> DMatrix<f64> {
    noise - noise * information * noise
}

/// How far parts are off, all parameters together: the sum of squares, and what chance makes of it.
struct Sums {
    squares: f64,
    expected: f64,
    variance: f64,
}

impl Sums {
    fn of(influences: &[Influence], information: &DMatrix<f64>) -> Self {
        let mut sums = Self {
            squares: 0.0,
            expected: 0.0,
            variance: 0.0,
        };
        for Influence { shift, noise } in influences {
            let share = information * own(noise, information);
            sums.squares += shift.dot(&(information * shift));
            sums.expected += share.trace();
            // Of a normal vector's square.
            sums.variance += 2.0 * share.component_mul(&share.transpose()).sum();
        }
        sums
    }
}

/// By how much a variance that was found with so many degrees of freedom is to be raised: that of Student's t. So few tell little of their
/// own spread.
pub(crate) fn of_few(freedom: f64) -> f64 {
    freedom / (freedom - 2.0)
}

/// Whether a sum of squares of normal numbers, of this mean and variance, exceeds what chance makes of it. Such a sum is skewed: by
/// the cube root that makes it normal (E. B. Wilson, M. M. Hilferty, "The distribution of chi-square", PNAS 17, 1931), for the
/// degrees of freedom that have its mean and variance (Satterthwaite).
fn is_clear(squares: f64, expected: f64, variance: f64) -> bool {
    if !(expected > 0.0 && variance > 0.0) {
        return false;
    }
    let spread = variance / (9.0 * expected * expected);
    let deviations = ((squares / expected).cbrt() - (1.0 - spread)) / spread.sqrt();
    deviations > SIGNIFICANT
}

/// Influences of parts at a result that is `step` away: each then pulls back by its share.
pub(crate) fn moved(
    covariance: &DMatrix<f64>,
    mut parts: Vec<Influence>,
    step: &DVector<f64>,
) -> Vec<Influence> {
    let pull = information(covariance) * step;
    for part in &mut parts {
        part.shift -= &part.noise * &pull;
    }
    parts
}

/// Neighbours together, `count` at a time; what is left over goes to the last.
fn joined(parts: &[Influence], count: usize) -> Vec<Influence> {
    let mut joined: Vec<Influence> = Vec::with_capacity(parts.len() / count + 1);
    for (k, part) in parts.iter().enumerate() {
        match joined.last_mut() {
            Some(last) if k % count != 0 || parts.len() - k < count => {
                last.shift += &part.shift;
                last.noise += &part.noise;
            }
            _ => joined.push(part.clone()),
        }
    }
    joined
}

/// Inverse of a covariance on what was searched.
fn information(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let scale = covariance.map_diagonal(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
    let scaled = DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        covariance[(i, j)] * scale[i] * scale[j]
    });
    let eigen = scaled.symmetric_eigen();
    let floor = eigen.eigenvalues.max() * f64::EPSILON * covariance.nrows() as f64;
    let values = eigen
        .eigenvalues
        .map(|v| if v > floor { 1.0 / v } else { 0.0 });
    let inverse =
        &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose();
    DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        inverse[(i, j)] * scale[i] * scale[j]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A line fitted to measurements in parts, each with an error of its own beside the measurements'.
    fn line(
        seed: u64,
        parts: usize,
        in_common: f64,
    ) -> (DMatrix<f64>, Vec<Influence>, DVector<f64>) {
        const EACH: usize = 20;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Of variance 1.
        let mut noise = move || rng.random_range(-1.0..1.0) * 3f64.sqrt();
        let mut rows = Vec::new();
        for part in 0..parts {
            let common = in_common * noise();
            for k in 0..EACH {
                let at = (part * EACH + k) as f64 / (parts * EACH) as f64 - 0.3;
                rows.push((DVector::from_vec(vec![1.0, at]), -(noise() + common)));
            }
        }
        let normal: DMatrix<f64> = rows.iter().map(|(j, _)| j * j.transpose()).sum();
        let covariance = normal.try_inverse().expect("a line");
        let gradient: DVector<f64> = rows.iter().map(|(j, r)| j * *r).sum();
        let found = -(&covariance * gradient);
        let influences = rows
            .chunks(EACH)
            .map(|part| {
                let gradient: DVector<f64> =
                    part.iter().map(|(j, r)| j * (r + j.dot(&found))).sum();
                let normal: DMatrix<f64> = part.iter().map(|(j, _)| j * j.transpose()).sum();
                Influence {
                    shift: -(&covariance * gradient),
                    noise: &covariance * normal * &covariance,
                }
            })
            .collect();
        (covariance, influences, found)
    }

    #[test]
    fn noise_is_left_alone_and_what_parts_have_in_common_is_seen() {
        let mut alarms = 0;
        let (mut mean_square, mut naive) = (0.0, 0.0);
        const SEEDS: u64 = 200;
        for seed in 0..SEEDS {
            let (covariance, parts, _) = line(seed, 12, 0.0);
            alarms +=
                usize::from(Scatter::of_neighbours(&covariance, &parts).factors(2) != [1.0, 1.0]);
            // Errors of parts are as large as those of measurements: σ is 4.6 times too small by the weights alone.
            let (covariance, parts, found) = line(seed, 12, 1.0);
            let factors = Scatter::of_neighbours(&covariance, &parts).factors(2);
            for k in 0..2 {
                let in_sigmas = found[k] / covariance[(k, k)].sqrt();
                naive += in_sigmas * in_sigmas;
                mean_square += (in_sigmas / factors[k]).powi(2);
            }
        }
        let count = 2.0 * SEEDS as f64;
        assert!(alarms <= 4, "{alarms} false alarms");
        assert!(naive / count > 12.0, "{}", naive / count);
        assert!(
            (0.7..1.3).contains(&(mean_square / count)),
            "{}",
            mean_square / count
        );
    }

    /// Neighbours that err alike for as long as a half: parts of a few neighbours show a fraction of that.
    #[test]
    fn what_lasts_long_is_seen() {
        let (mut with, mut without) = (0.0, 0.0);
        for seed in 0..50 {
            let (covariance, mut parts, _) = line(seed, 36, 0.3);
            let of_few = Scatter::of_neighbours(&covariance, &parts).factors(2);
            let drift = &covariance * DVector::from_vec(vec![120.0, 0.0]);
            for (k, part) in parts.iter_mut().enumerate() {
                let sign = if k < 18 { 1.0 } else { -1.0 };
                part.shift += &drift * (sign / 36.0);
            }
            let of_all = Scatter::of_neighbours(&covariance, &parts).factors(2);
            without += of_few[0];
            with += of_all[0];
        }
        assert!(with > 1.3 * without, "{with} {without}");
    }

    #[test]
    fn few_parts_say_nothing() {
        let (covariance, parts, _) = line(1, 4, 10.0);
        assert_eq!(
            Scatter::of_neighbours(&covariance, &parts).factors(2),
            [1.0, 1.0]
        );
    }
}
