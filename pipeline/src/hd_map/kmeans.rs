//! Lloyd's k-means, seeded, with the same result on any number of threads.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// How to train.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Training {
    /// Centroids wanted.
    pub centroids: usize,
    /// Most vectors to train on.
    pub samples: usize,
    /// Rounds.
    pub rounds: usize,
    pub seed: u64,
}

/// Centroids of vectors of `dimension` values, one after the other: as many as wanted, or as there are vectors.
pub(crate) fn train(values: &[f32], dimension: usize, training: &Training) -> Vec<f32> {
    let total = values.len() / dimension;
    let mut rng = ChaCha8Rng::seed_from_u64(training.seed);
    let chosen = sample(total, training.samples.max(training.centroids), &mut rng);
    let vector = |index: &usize| &values[index * dimension..][..dimension];
    let samples: Vec<f32> = chosen
        .iter()
        .flat_map(|i| vector(i).iter().copied())
        .collect();
    let count = training.centroids.min(chosen.len());
    // The sample is in random order: its beginning is a random choice.
    let mut centroids: Vec<f32> = samples[..count * dimension].to_vec();
    for _ in 0..training.rounds {
        let nearest_of: Vec<u32> = samples
            .par_chunks_exact(dimension)
            .map(|v| nearest(v, &centroids) as u32)
            .collect();
        let mut sums = vec![0.0f64; centroids.len()];
        let mut counts = vec![0u32; count];
        for (v, centroid) in samples.chunks_exact(dimension).zip(&nearest_of) {
            let centroid = *centroid as usize;
            counts[centroid] += 1;
            let sum = &mut sums[centroid * dimension..][..dimension];
            sum.iter_mut().zip(v).for_each(|(s, v)| *s += f64::from(*v));
        }
        for (centroid, members) in counts.iter().enumerate().filter(|(_, n)| **n > 0) {
            let at = centroid * dimension..(centroid + 1) * dimension;
            for (c, s) in centroids[at.clone()].iter_mut().zip(&sums[at]) {
                *c = (s / f64::from(*members)) as f32;
            }
        }
    }
    centroids
}

/// Index of the nearest centroid; of equally near ones the first. 0 where there is none.
pub(crate) fn nearest(value: &[f32], centroids: &[f32]) -> usize {
    let mut best = (f32::INFINITY, 0);
    for (index, centroid) in centroids.chunks_exact(value.len()).enumerate() {
        let distance = super::index::distance_squared(value, centroid);
        if distance < best.0 {
            best = (distance, index);
        }
    }
    best.1
}

/// `count` different numbers below `total` in random order; all of them where `count` is larger.
fn sample(total: usize, count: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut all: Vec<usize> = (0..total).collect();
    let count = count.min(total);
    for i in 0..count {
        let j = rng.random_range(i..total);
        all.swap(i, j);
    }
    all.truncate(count);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_separate_clusters() {
        let mut values = Vec::new();
        for i in 0..300 {
            let corner = i % 3;
            let noise = |k: usize| ((i * 31 + k * 17) % 100) as f32 * 1e-3;
            values.extend((0..8).map(|k| noise(k) + if k == corner { 10.0 } else { 0.0 }));
        }
        let training = Training {
            centroids: 3,
            samples: 1000,
            rounds: 10,
            seed: 4,
        };
        let centroids = train(&values, 8, &training);
        let owners: Vec<usize> = values
            .chunks_exact(8)
            .map(|v| nearest(v, &centroids))
            .collect();
        assert!((3..300).all(|i| owners[i] == owners[i % 3]));
        assert!(owners[0] != owners[1] && owners[1] != owners[2] && owners[0] != owners[2]);
    }
}
