//! Standard deviations of the noises that were fitted to an Allan variance.
//!
//! Allan variances of one recording hang together: clusters overlap, and long ones are made of short ones. For Gaussian noise
//! the covariance of two of them is `2 Σ c² / n` over the lags between their clusters, where `c` is the covariance of the two
//! differences. Those are second differences of the integral of the signal, so `c` follows from its generalised covariance
//! `−N²|h|/2 + B² h² ln|h| / 2π + K² |h|³/12`. The fit is least squares with other weights, so its covariance is the sandwich
//! `H⁻¹ Jᵀ W C W J H⁻¹`.

use lsfb_geometry::{Matrix3, Vector3};

use super::allan::Cluster;
use super::fit::{FLAT, Noise};

/// Lags looked at within the shorter cluster.
const LAGS_PER_CLUSTER: usize = 8;
/// Clusters whose lengths differ by more than this do not hang together.
const FAR_APART: usize = 64;

/// What was recorded.
pub(super) struct Recorded {
    /// Samples of each axis.
    pub samples: usize,
    /// Time between them, seconds.
    pub interval_s: f64,
    /// Axes whose Allan variances were averaged.
    pub axes: usize,
}

/// Standard deviations of the three noises of a [`fit`](super::fit::fit) to `clusters`. Of one that is not seen it is how large
/// it could be.
pub(super) fn sigma(noise: &Noise, clusters: &[Cluster], recorded: &Recorded) -> Noise {
    let good: Vec<&Cluster> = clusters.iter().filter(|c| c.variance > 0.0).collect();
    let covariance = covariances(noise, &good, recorded);
    // In units of the whole variance at either end: the three columns differ by many powers of ten.
    let (Some(first), Some(last)) = (good.first(), good.last()) else {
        return Noise::default();
    };
    let unit = Vector3::new(
        first.variance * first.time_s,
        good.iter()
            .map(|c| c.variance)
            .fold(f64::INFINITY, f64::min),
        last.variance / last.time_s,
    );
    let rows: Vec<Vector3<f64>> = good
        .iter()
        .map(|c| {
            let by = Vector3::new(1.0 / c.time_s, 1.0, c.time_s).component_mul(&unit);
            by / noise.deviation(c.time_s).powi(2)
        })
        .collect();
    let mut normal = Matrix3::zeros();
    let mut scatter = Matrix3::zeros();
    for (i, row) in rows.iter().enumerate() {
        normal += row * row.transpose() * good[i].freedom;
        for (j, other) in rows.iter().enumerate() {
            let weight = good[i].freedom * good[j].freedom * covariance[i][j];
            scatter += row * other.transpose() * weight;
        }
    }
    let Some(inverse) = normal.try_inverse() else {
        return Noise {
            density: f64::INFINITY,
            instability: f64::INFINITY,
            walk: f64::INFINITY,
        };
    };
    let covariance = inverse * scatter * inverse;
    let squares = Vector3::new(
        noise.density * noise.density,
        FLAT * noise.instability * noise.instability,
        noise.walk * noise.walk / 3.0,
    );
    // Of the square root, on the side where it is larger: a square that is as large as its error may as well be zero.
    let of_root = |k: usize| {
        let sigma = covariance[(k, k)].max(0.0).sqrt() * unit[k];
        let root = squares[k].sqrt();
        let below = root - (squares[k] - sigma).max(0.0).sqrt();
        below.max((squares[k] + sigma).sqrt() - root)
    };
    Noise {
        density: of_root(0),
        instability: of_root(1) / FLAT.sqrt(),
        walk: of_root(2) * 3f64.sqrt(),
    }
}

/// Covariances of the logarithms of the Allan variances.
fn covariances(noise: &Noise, clusters: &[&Cluster], recorded: &Recorded) -> Vec<Vec<f64>> {
    let count = clusters.len();
    let lengths: Vec<usize> = clusters
        .iter()
        .map(|c| (c.time_s / recorded.interval_s).round() as usize)
        .collect();
    let mut covariances = vec![vec![0.0; count]; count];
    for (i, &short) in lengths.iter().enumerate() {
        let near = |(_, long): &(usize, &usize)| **long <= FAR_APART * short;
        for (j, &long) in lengths.iter().enumerate().skip(i).take_while(near) {
            let step = (short / LAGS_PER_CLUSTER).max(1);
            // Beyond these lags only flicker is left, and little of it.
            let (from, to) = (-3 * long as i64, (2 * short + long) as i64);
            let squares: f64 = (from..=to)
                .step_by(step)
                .map(|lag| together(noise, short, long, lag, recorded.interval_s).powi(2))
                .sum();
            // Positions of the shorter cluster: there are more of them.
            let positions = recorded.samples.saturating_sub(2 * short).max(1) as f64;
            let mean = 2.0 * squares * step as f64 / positions;
            let variance = |k: usize| {
                let time_s = clusters[k].time_s;
                2.0 * (time_s * noise.deviation(time_s)).powi(2)
            };
            let relative = mean / (variance(i) * variance(j)) / recorded.axes as f64;
            covariances[i][j] = relative;
            covariances[j][i] = relative;
        }
    }
    covariances
}

/// Covariance of the second differences over `a` and over `b` samples, the latter `lag` samples later.
fn together(noise: &Noise, a: usize, b: usize, lag: i64, interval_s: f64) -> f64 {
    const WEIGHTS: [f64; 3] = [1.0, -2.0, 1.0];
    let mut sum = 0.0;
    for (p, weight_a) in WEIGHTS.into_iter().enumerate() {
        for (q, weight_b) in WEIGHTS.into_iter().enumerate() {
            let samples = lag + (q * b) as i64 - (p * a) as i64;
            let h = samples.unsigned_abs() as f64 * interval_s;
            sum += weight_a * weight_b * generalised(noise, h);
        }
    }
    sum
}

/// Generalised covariance of the integral of the signal at two times `h` seconds apart.
fn generalised(noise: &Noise, h: f64) -> f64 {
    let flicker = noise.instability * noise.instability / std::f64::consts::TAU;
    let logarithm = if h > 0.0 && flicker > 0.0 {
        h.ln()
    } else {
        0.0
    };
    h * (h * (flicker * logarithm + noise.walk * noise.walk * h / 12.0)
        - noise.density * noise.density / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At the same place and length the covariance is the variance that the Allan variance is made of.
    #[test]
    fn differences_have_the_variance_of_the_model() {
        for (density, instability, walk) in [
            (1e-3, 0.0, 0.0),
            (0.0, 2e-4, 0.0),
            (0.0, 0.0, 3e-5),
            (1e-3, 2e-4, 3e-5),
        ] {
            let noise = Noise {
                density,
                instability,
                walk,
            };
            for length in [1, 7, 1000] {
                let time_s = length as f64 * 0.05;
                let expected = 2.0 * (time_s * noise.deviation(time_s)).powi(2);
                let found = together(&noise, length, length, 0, 0.05);
                assert!((found / expected - 1.0).abs() < 1e-9, "{noise:?} {length}");
            }
        }
    }

    /// White noise alone, one cluster length: what IEEE 952 and Howe, Allan, Barnes (1981) give for overlapping clusters.
    #[test]
    fn white_noise_scatters_as_is_known() {
        let noise = Noise {
            density: 1e-3,
            ..Noise::default()
        };
        let recorded = Recorded {
            samples: 100_000,
            interval_s: 0.01,
            axes: 1,
        };
        for length in [1, 10, 100, 1000] {
            let (n, m) = (recorded.samples as f64, f64::from(length));
            let freedom =
                (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0);
            let cluster = Cluster {
                time_s: m * 0.01,
                variance: 1.0,
                freedom,
            };
            let found = covariances(&noise, &[&cluster], &recorded)[0][0];
            // χ² with ν degrees of freedom has a relative variance of 2/ν.
            assert!(
                (found * freedom / 2.0 - 1.0).abs() < 0.1,
                "{length}: {}",
                found * freedom / 2.0
            );
        }
    }
}
