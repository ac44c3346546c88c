//! A smooth random function of place: what shadows a transmitter here and not there.

use nalgebra::Vector3;

use crate::noise::{gaussian, hash, unit};

/// Waves that a field is made of.
const WAVES: u64 = 96;

/// Normally distributed at each point with mean 0 and deviation 1, alike at points closer than `length_m`: the correlation of
/// two points at distance d is exp(−d / `length_m`) (Gudmundson 1991).
#[derive(Clone, Debug)]
pub(super) struct SmoothField {
    /// Wave vectors, and where they begin.
    waves: Vec<(Vector3<f64>, f64)>,
}

impl SmoothField {
    pub(super) fn new(length_m: f64, seed: u64) -> Self {
        let waves = (0..WAVES).map(|k| {
            let draw = |n: u64| gaussian(hash(seed ^ hash(8 * k + n)));
            // The spectrum of an exponential correlation is Cauchy's: a normal vector over a normal number.
            let spread = draw(3).abs().max(1e-3) * length_m;
            let wave = Vector3::new(draw(0), draw(1), draw(2)) / spread;
            let phase = std::f64::consts::TAU * unit(hash(seed ^ hash(8 * k + 4)));
            (wave, phase)
        });
        Self {
            waves: waves.collect(),
        }
    }

    pub(super) fn at(&self, point: Vector3<f64>) -> f64 {
        let sum: f64 = self
            .waves
            .iter()
            .map(|(wave, phase)| (wave.dot(&point) + phase).cos())
            .sum();
        sum * (2.0 / WAVES as f64).sqrt()
    }
}
