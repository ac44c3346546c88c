//! Lloyd's k-means, seeded, with the same result on any number of threads.

use std::collections::BTreeMap;

use lsfb_types::Stopped;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::kernels::CentroidBlocks;

/// Vectors that one thread takes at a time.
const GROUP: usize = 256;

/// Whether a round of the training is to go on.
pub(crate) type GoOn<'a> = dyn Fn(usize) -> Result<(), Stopped> + Sync + 'a;

/// As many centroids as wanted, or as there are vectors, one after the other. `samples`, of `dimensions` each, are in random
/// order: the first of them are where the search begins. `go_on` is asked before each group of samples, with the number of the round.
pub(crate) fn train(
    samples: &[f32],
    dimensions: usize,
    wanted: usize,
    rounds: usize,
    go_on: &GoOn,
) -> Result<Vec<f32>, Stopped> {
    let count = wanted.min(samples.len() / dimensions);
    let mut centroids = samples[..count * dimensions].to_vec();
    for round in 0..rounds {
        let nearest = nearest_of_all(
            &CentroidBlocks::new(&centroids, dimensions),
            samples,
            dimensions,
            &|| go_on(round),
        )?;
        let mut sums = vec![0.0f64; centroids.len()];
        let mut counts = vec![0u32; count];
        for (value, nearest) in samples.chunks_exact(dimensions).zip(nearest) {
            let nearest = nearest as usize;
            counts[nearest] += 1;
            for (sum, v) in sums[nearest * dimensions..].iter_mut().zip(value) {
                *sum += f64::from(*v);
            }
        }
        let members = sums.chunks_exact(dimensions).zip(&counts);
        for (centroid, (sum, count)) in centroids.chunks_exact_mut(dimensions).zip(members) {
            if *count > 0 {
                for (c, s) in centroid.iter_mut().zip(sum) {
                    *c = (s / f64::from(*count)) as f32;
                }
            }
        }
    }
    Ok(centroids)
}

/// The nearest centroid of each vector, by all threads.
pub(super) fn nearest_of_all(
    centroids: &CentroidBlocks,
    values: &[f32],
    dimensions: usize,
    go_on: &(dyn Fn() -> Result<(), Stopped> + Sync),
) -> Result<Vec<u32>, Stopped> {
    let groups = values.par_chunks(GROUP * dimensions);
    let found: Result<Vec<Vec<u32>>, Stopped> = groups
        .map(|group| {
            go_on()?;
            Ok(centroids.nearest(group))
        })
        .collect();
    Ok(found?.concat())
}

/// `count` different numbers below `total` in random order; all of them where `count` is larger. Memory for `count` numbers,
/// however many there are in all.
pub(crate) fn sample(total: usize, count: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    // Places of a shuffled list of all numbers that hold another number than their own.
    let mut moved: BTreeMap<usize, usize> = BTreeMap::new();
    (0..count.min(total))
        .map(|i| {
            let j = rng.random_range(i..total);
            let first = moved.get(&i).copied().unwrap_or(i);
            moved.insert(j, first).unwrap_or(j)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn finds_separate_clusters() {
        let mut values = Vec::new();
        for i in 0..300 {
            let corner = i % 3;
            let noise = |k: usize| ((i * 31 + k * 17) % 100) as f32 * 1e-3;
            values.extend((0..8).map(|k| noise(k) + if k == corner { 10.0 } else { 0.0 }));
        }
        let centroids = train(&values, 8, 3, 10, &|_| Ok(())).expect("trained");
        let centroids = CentroidBlocks::new(&centroids, 8);
        let owners = centroids.nearest(&values);
        assert!((3..300).all(|i| owners[i] == owners[i % 3]));
        assert!(owners[0] != owners[1] && owners[1] != owners[2] && owners[0] != owners[2]);
    }

    #[test]
    fn samples_are_different_and_all_where_all_are_wanted() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let some = sample(1_000_000, 500, &mut rng);
        let different: std::collections::BTreeSet<usize> = some.iter().copied().collect();
        assert_eq!(different.len(), 500);
        assert!(some.iter().all(|i| *i < 1_000_000) && some.iter().any(|i| *i > 900_000));
        let mut all = sample(40, 100, &mut rng);
        assert_ne!(all, (0..40).collect::<Vec<_>>());
        all.sort_unstable();
        assert_eq!(all, (0..40).collect::<Vec<_>>());
    }
}
