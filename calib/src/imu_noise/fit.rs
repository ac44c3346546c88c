//! Three noises from an Allan variance: `σ²(τ) = N²/τ + (2 ln 2 / π) B² + K² τ / 3` with the density `N` of white noise, the bias
//! instability `B` and the random walk `K` (IEEE 952-1997, annex C).

use lsfb_geometry::Vector3;
use lsfb_solver::gauss_newton::{NormalEquations, minimise_damped};

use super::allan::Cluster;

/// `2 ln 2 / π`: the flat of an Allan variance over the square of the bias instability.
pub(super) const FLAT: f64 = 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI;
const MAX_TRIALS: u32 = 200;

/// The noises of one signal in units `u` of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Noise {
    /// Density of white noise, `u/√Hz`.
    pub density: f64,
    /// Bias instability, `u`.
    pub instability: f64,
    /// Random walk, `u·√Hz` (`u/s/√Hz`).
    pub walk: f64,
}

impl Noise {
    /// The Allan deviation that this noise has.
    pub fn deviation(&self, time_s: f64) -> f64 {
        let parts = [
            self.density * self.density / time_s,
            FLAT * self.instability * self.instability,
            self.walk * self.walk * time_s / 3.0,
        ];
        parts.iter().sum::<f64>().sqrt()
    }
}

/// The noise that explains the clusters best: least squares of `ln σ²`, each cluster with its freedom, none of the three
/// negative.
pub(super) fn fit(clusters: &[Cluster]) -> Noise {
    let good: Vec<&Cluster> = clusters.iter().filter(|c| c.variance > 0.0).collect();
    let (Some(first), Some(last)) = (good.first(), good.last()) else {
        return Noise::default();
    };
    let bases = |c: &Cluster| Vector3::new(1.0 / c.time_s, 1.0, c.time_s);
    let cost = |x: &Vector3<f64>| -> f64 {
        good.iter()
            .map(|c| {
                let off = (bases(c).dot(x) / c.variance).ln();
                c.freedom * off * off
            })
            .sum()
    };
    let lowest = good
        .iter()
        .map(|c| c.variance)
        .fold(f64::INFINITY, f64::min);
    // As squares, so that they stay positive: x = y².
    let start = Vector3::new(
        first.variance * first.time_s,
        0.5 * lowest,
        0.5 * last.variance / last.time_s,
    );
    let terms = |y: &Vector3<f64>| {
        let x = y.component_mul(y);
        let mut terms = NormalEquations::default();
        for c in &good {
            let model = bases(c).dot(&x);
            let by = bases(c).component_mul(y) * (2.0 / model);
            terms.add((model / c.variance).ln(), &by, c.freedom);
        }
        terms
    };
    let of_roots = |y: &Vector3<f64>| cost(&y.component_mul(y));
    let (y, _) = minimise_damped(start.map(f64::sqrt), MAX_TRIALS, terms, of_roots);
    let y = y.map(f64::abs);
    Noise {
        density: y[0],
        instability: y[1] / FLAT.sqrt(),
        walk: y[2] * 3f64.sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_curves_give_their_noise_back() {
        for noise in [
            Noise {
                density: 1e-3,
                instability: 2e-4,
                walk: 3e-5,
            },
            Noise {
                density: 2e-4,
                instability: 0.0,
                walk: 2e-5,
            },
            Noise {
                density: 3e-2,
                instability: 1e-3,
                walk: 0.0,
            },
        ] {
            let clusters: Vec<Cluster> = (0..50)
                .map(|k| {
                    let time_s = 0.005 * 1.3f64.powi(k);
                    let variance = noise.deviation(time_s).powi(2);
                    Cluster {
                        time_s,
                        variance,
                        freedom: 1e6 / time_s,
                    }
                })
                .collect();
            let found = fit(&clusters);
            let close = |a: f64, b: f64, unit: f64| (a - b).abs() < 1e-3 * b + 1e-2 * unit;
            assert!(
                (found.density / noise.density - 1.0).abs() < 1e-3,
                "{found:?}"
            );
            assert!(
                close(found.instability, noise.instability, noise.density),
                "{found:?}"
            );
            assert!(close(found.walk, noise.walk, noise.density), "{found:?}");
        }
    }
}
