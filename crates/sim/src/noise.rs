//! Random numbers: ChaCha streams for what is drawn in order, a counter hash for what is drawn per ray or pixel, where
//! the order of the threads must not matter.

use std::cell::RefCell;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A stream of random numbers that can be drawn from in the middle of an expression.
pub(crate) struct Dice(RefCell<ChaCha8Rng>);

impl Dice {
    /// 64 random bits.
    pub(crate) fn bits(&self) -> u64 {
        self.0.borrow_mut().next_u64()
    }
}

/// The stream named `purpose`, number `index`, of a seed. Streams of different names or numbers are independent.
pub(crate) fn stream(seed: u64, purpose: &str, index: u64) -> Dice {
    let mut key = [0_u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&index.to_le_bytes());
    for (slot, byte) in key[16..].iter_mut().zip(purpose.bytes()) {
        *slot = byte;
    }
    Dice(RefCell::new(ChaCha8Rng::from_seed(key)))
}

/// The finaliser of SplitMix64: a bijection whose output bits look independent.
pub(crate) const fn hash(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// The upper 53 bits as a number in [0, 1).
pub(crate) fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

/// Standard normal from two hashes (Box and Muller 1958).
pub(crate) fn gaussian(bits: u64) -> f64 {
    let radius = (-2.0 * (1.0 - unit(bits)).ln()).sqrt();
    radius * (std::f64::consts::TAU * unit(hash(bits ^ 0x5851_f42d_4c95_7f2d))).cos()
}

/// Standard normal from a stream.
pub(crate) fn next_gaussian(rng: &Dice) -> f64 {
    gaussian(rng.bits())
}

/// Uniform in `[low, high)`.
pub(crate) fn uniform(rng: &Dice, low: f32, high: f32) -> f32 {
    low + (high - low) * unit(rng.bits()) as f32
}

/// Uniform among `0..count`; 0 where `count` is 0.
pub(crate) fn below(rng: &Dice, count: usize) -> usize {
    (unit(rng.bits()) * count as f64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_has_unit_moments() {
        let n = 200_000;
        let draws: Vec<f64> = (0..n).map(|i| gaussian(hash(i))).collect();
        let mean = draws.iter().sum::<f64>() / n as f64;
        let variance = draws.iter().map(|d| d * d).sum::<f64>() / n as f64;
        let tail = draws.iter().filter(|d| d.abs() > 1.96).count() as f64 / n as f64;
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02 && (tail - 0.05).abs() < 0.003);
    }

    #[test]
    fn streams_differ_by_name_and_number() {
        let first = |purpose, index| stream(7, purpose, index).bits();
        assert_eq!(first("walk", 0), first("walk", 0));
        assert_ne!(first("walk", 0), first("walk", 1));
        assert_ne!(first("walk", 0), first("world", 0));
    }
}
