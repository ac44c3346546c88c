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

/// Centroids: as many as wanted, or as there are vectors.
pub(crate) fn train<const N: usize>(values: &[[f32; N]], training: &Training) -> Vec<[f32; N]> {
    let mut rng = ChaCha8Rng::seed_from_u64(training.seed);
    let count = training.samples.max(training.centroids);
    let samples: Vec<[f32; N]> = sample(values.len(), count, &mut rng)
        .into_iter()
        .map(|i| values[i])
        .collect();
    // The sample is in random order: its beginning is a random choice.
    let mut centroids = samples[..training.centroids.min(samples.len())].to_vec();
    for _ in 0..training.rounds {
        let nearest_of: Vec<u32> = samples
            .par_iter()
            .map(|v| nearest(v, &centroids) as u32)
            .collect();
        let mut sums = vec![[0.0f64; N]; centroids.len()];
        let mut counts = vec![0u32; centroids.len()];
        for (v, centroid) in samples.iter().zip(&nearest_of) {
            let centroid = *centroid as usize;
            counts[centroid] += 1;
            for (sum, v) in sums[centroid].iter_mut().zip(v) {
                *sum += f64::from(*v);
            }
        }
        let members = sums.iter().zip(&counts);
        for (centroid, (sum, count)) in centroids.iter_mut().zip(members) {
            if *count > 0 {
                *centroid = sum.map(|s| (s / f64::from(*count)) as f32);
            }
        }
    }
    centroids
}

/// Index of the nearest centroid; of equally near ones the first. 0 where there is none.
pub(crate) fn nearest<const N: usize>(value: &[f32; N], centroids: &[[f32; N]]) -> usize {
    let mut best = (f32::INFINITY, 0);
    for (index, centroid) in centroids.iter().enumerate() {
        let distance = distance_squared(value, centroid);
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

/// Squared distance of two vectors. Sums side by side: the order of additions is fixed, and the compiler can use lanes. `N` is a multiple of 8.
pub(crate) fn distance_squared<const N: usize>(a: &[f32; N], b: &[f32; N]) -> f32 {
    let mut sums = [[0.0f32; 8]; 4];
    let pairs = a.as_chunks::<8>().0.iter().zip(b.as_chunks::<8>().0);
    for (i, (a, b)) in pairs.enumerate() {
        for lane in 0..8 {
            let difference = a[lane] - b[lane];
            sums[i % 4][lane] += difference * difference;
        }
    }
    let [p, q, r, s] = sums;
    (0..8)
        .map(|lane| (p[lane] + q[lane]) + (r[lane] + s[lane]))
        .sum()
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
            values.push(std::array::from_fn::<f32, 8, _>(|k| {
                noise(k) + if k == corner { 10.0 } else { 0.0 }
            }));
        }
        let training = Training {
            centroids: 3,
            samples: 1000,
            rounds: 10,
            seed: 4,
        };
        let centroids = train(&values, &training);
        let owners: Vec<usize> = values.iter().map(|v| nearest(v, &centroids)).collect();
        assert!((3..300).all(|i| owners[i] == owners[i % 3]));
        assert!(owners[0] != owners[1] && owners[1] != owners[2] && owners[0] != owners[2]);
    }
}
