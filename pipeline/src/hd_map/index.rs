//! Approximate nearest descriptors: inverted lists with product-quantised residuals.
//!
//! Jégou, Douze, Schmid, "Product quantization for nearest neighbor search" (PAMI 2011), section IV. With $c$ the
//! centroid of a list and $\hat r$ the quantised residual of an entry,
//! $$|q - c - \hat r|^2 = |q - c|^2 + (|\hat r|^2 + 2 c \cdot \hat r) - 2 q \cdot \hat r,$$
//! where the bracket is stored with the entry, so that one table of products serves all lists of a query.

use arrow_buffer::{Buffer, ScalarBuffer};
use lsfb_types::{Bounds, Progress, ProgressFn, Stopped};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::kmeans::{Training, distance_squared, nearest, train};
use crate::features::{DESCRIPTOR_LEN, Descriptor};

/// Bytes of a code: one per part of the descriptor.
pub(crate) const PARTS: usize = 16;
/// Dimensions of a part.
const PART_LEN: usize = DESCRIPTOR_LEN / PARTS;
/// Values a byte of a code can take.
pub(crate) const CODEWORDS: usize = 256;

/// Configuration of the descriptor index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IndexConfig {
    /// Descriptors per inverted list, on average.
    pub list_length: usize,
    /// Most inverted lists.
    pub max_lists: usize,
    /// Training descriptors per centroid, at most.
    pub training_per_centroid: usize,
    /// Rounds of k-means.
    pub training_rounds: usize,
    /// Seed of the training.
    pub seed: u64,
}

impl Default for IndexConfig {
    fn default() -> Self {
        Self {
            list_length: 400,
            max_lists: 1024,
            training_per_centroid: 40,
            training_rounds: 6,
            seed: 1,
        }
    }
}

lsfb_types::bounds! {
    IndexConfig {
        list_length: number(Bounds::AT_LEAST_ONE),
        max_lists: number(Bounds::AT_LEAST_ONE),
        training_per_centroid: any,
        training_rounds: any,
        seed: any,
    }
}

/// The index: columns as they are in the files.
#[derive(Clone, Debug)]
pub(crate) struct DescriptorIndex {
    /// Centroid of each list, one after the other.
    pub centroids: ScalarBuffer<f32>,
    /// First entry of each list.
    pub first_entry: ScalarBuffer<u32>,
    /// Which descriptor each entry is.
    pub entries: ScalarBuffer<u32>,
    /// Code of each entry, `PARTS` bytes.
    pub codes: Buffer,
    /// `|r̂|² + 2 c·r̂` of each entry.
    pub offsets: ScalarBuffer<f32>,
    /// For each dimension of the descriptor, its value in the `CODEWORDS` words of its part.
    pub codebook: ScalarBuffer<f32>,
}

/// An entry that may be near a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Neighbour {
    pub descriptor: u32,
    /// Estimated, in squared units of the descriptor.
    pub distance_squared: f32,
}

/// Memory of one search, to be used again.
#[derive(Clone, Debug, Default)]
pub(crate) struct SearchScratch {
    lists: Vec<(f32, u32)>,
    products: Vec<f32>,
    found: Vec<Neighbour>,
}

fn widened(descriptor: &Descriptor) -> [f32; DESCRIPTOR_LEN] {
    descriptor.map(f32::from)
}

impl DescriptorIndex {
    /// Trains and fills an index over `descriptors`. Same input and seed give the same bytes.
    pub fn build(
        descriptors: &[Descriptor],
        config: &IndexConfig,
        progress: ProgressFn,
    ) -> Result<Self, Stopped> {
        let step = |done| {
            progress(Progress {
                stage: "descriptor index",
                done,
                total: 4,
            })
        };
        let values: Vec<[f32; DESCRIPTOR_LEN]> = descriptors.iter().map(widened).collect();
        let lists =
            (descriptors.len() / config.list_length.max(1)).clamp(1, config.max_lists.max(1));
        let training = |centroids, seed| Training {
            centroids,
            samples: config.training_per_centroid.max(1) * centroids,
            rounds: config.training_rounds,
            seed,
        };
        step(0)?;
        let centroids = train(&values, &training(lists, config.seed));
        step(1)?;
        let list_of: Vec<u32> = values
            .par_iter()
            .map(|v| nearest(v, &centroids) as u32)
            .collect();
        let residuals: Vec<[f32; DESCRIPTOR_LEN]> = values
            .iter()
            .zip(&list_of)
            .map(|(v, list)| {
                let centroid = &centroids[*list as usize];
                std::array::from_fn(|d| v[d] - centroid[d])
            })
            .collect();
        step(2)?;
        let parts: Vec<Vec<[f32; PART_LEN]>> = (0..PARTS)
            .into_par_iter()
            .map(|part| {
                let column: Vec<_> = residuals.iter().map(|r| split(r)[part]).collect();
                let seed = config.seed.wrapping_add(1 + part as u64);
                train(&column, &training(CODEWORDS, seed))
            })
            .collect();
        step(3)?;
        let codebook = transposed(&parts);
        let codes: Vec<[u8; PARTS]> = residuals
            .par_iter()
            .map(|residual| encode(residual, &parts))
            .collect();

        let mut order: Vec<u32> = (0..descriptors.len() as u32).collect();
        order.sort_by_key(|d| (list_of[*d as usize], *d));
        let mut first_entry = Vec::with_capacity(centroids.len());
        let mut next = 0;
        for list in 0..centroids.len() as u32 {
            first_entry.push(next as u32);
            while next < order.len() && list_of[order[next] as usize] == list {
                next += 1;
            }
        }
        let offset = |descriptor: &u32| {
            let d = *descriptor as usize;
            let centroid = &centroids[list_of[d] as usize];
            let word = decode(&codes[d], &codebook);
            let terms = word.iter().zip(centroid);
            terms.map(|(r, c)| r * (r + 2.0 * c)).sum::<f32>()
        };
        let offsets: Vec<f32> = order.iter().map(offset).collect();
        let sorted_codes: Vec<u8> = order.iter().flat_map(|d| codes[*d as usize]).collect();
        step(4)?;
        Ok(Self {
            centroids: centroids.into_flattened().into(),
            first_entry: first_entry.into(),
            entries: order.into(),
            codes: sorted_codes.into(),
            offsets: offsets.into(),
            codebook: codebook.into(),
        })
    }

    /// The `count` entries with the smallest estimated distances among those of the `probes` nearest lists, nearest
    /// first.
    pub fn search<'a>(
        &self,
        query: &Descriptor,
        count: usize,
        probes: usize,
        scratch: &'a mut SearchScratch,
    ) -> &'a [Neighbour] {
        let query = widened(query);
        scratch.lists.clear();
        let centroids = self.centroids.as_chunks::<DESCRIPTOR_LEN>().0.iter();
        scratch.lists.extend(
            centroids
                .enumerate()
                .map(|(list, c)| (distance_squared(&query, c), list as u32)),
        );
        let probes = probes.min(scratch.lists.len());
        if probes < scratch.lists.len() && probes > 0 {
            let by_distance =
                |a: &(f32, u32), b: &(f32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            scratch
                .lists
                .select_nth_unstable_by(probes - 1, by_distance);
        }
        self.multiply(&query, &mut scratch.products);
        let products: &[f32] = &scratch.products;
        let found = &mut scratch.found;
        found.clear();
        let mut limit = f32::INFINITY;
        for (to_centroid, list) in &scratch.lists[..probes] {
            let list = *list as usize;
            let from = self.first_entry[list] as usize;
            let to = self
                .first_entry
                .get(list + 1)
                .map_or(self.entries.len(), |e| *e as usize);
            let codes = self.codes[from * PARTS..to * PARTS].chunks_exact(PARTS);
            for (i, code) in codes.enumerate() {
                let mut sum = 0.0;
                for (part, word) in products.chunks_exact(CODEWORDS).zip(code) {
                    sum += part[usize::from(*word)];
                }
                let distance = to_centroid + self.offsets[from + i] - 2.0 * sum;
                if distance < limit {
                    found.push(Neighbour {
                        descriptor: self.entries[from + i],
                        distance_squared: distance,
                    });
                    if found.len() >= 8 * count.max(4) {
                        keep_nearest(found, count);
                        limit = found.iter().map(|n| n.distance_squared).fold(0.0, f32::max);
                    }
                }
            }
        }
        keep_nearest(found, count);
        found.sort_unstable_by(by_distance);
        found
    }

    /// Products of each part of the query with each of its words.
    fn multiply(&self, query: &[f32; DESCRIPTOR_LEN], products: &mut Vec<f32>) {
        products.clear();
        products.resize(PARTS * CODEWORDS, 0.0);
        for (dimension, words) in self.codebook.chunks_exact(CODEWORDS).enumerate() {
            let value = query[dimension];
            let part = dimension / PART_LEN;
            let row = &mut products[part * CODEWORDS..][..CODEWORDS];
            for (product, word) in row.iter_mut().zip(words) {
                *product += value * word;
            }
        }
    }
}

fn by_distance(a: &Neighbour, b: &Neighbour) -> std::cmp::Ordering {
    let by_distance = a.distance_squared.total_cmp(&b.distance_squared);
    by_distance.then(a.descriptor.cmp(&b.descriptor))
}

fn keep_nearest(found: &mut Vec<Neighbour>, count: usize) {
    if found.len() > count && count > 0 {
        found.select_nth_unstable_by(count - 1, by_distance);
    }
    found.truncate(count);
}

/// The parts of a vector.
fn split(vector: &[f32; DESCRIPTOR_LEN]) -> &[[f32; PART_LEN]] {
    vector.as_chunks::<PART_LEN>().0
}

fn encode(residual: &[f32; DESCRIPTOR_LEN], parts: &[Vec<[f32; PART_LEN]>]) -> [u8; PARTS] {
    std::array::from_fn(|part| nearest(&split(residual)[part], &parts[part]) as u8)
}

/// Words of each part to values of each dimension, `CODEWORDS` each. No code uses the zeros at the end of parts that
/// had fewer different descriptors than words.
fn transposed(parts: &[Vec<[f32; PART_LEN]>]) -> Vec<f32> {
    let mut codebook = vec![0.0; DESCRIPTOR_LEN * CODEWORDS];
    for (part, words) in parts.iter().enumerate() {
        for (index, word) in words.iter().enumerate() {
            for (i, value) in word.iter().enumerate() {
                codebook[(part * PART_LEN + i) * CODEWORDS + index] = *value;
            }
        }
    }
    codebook
}

fn decode(code: &[u8; PARTS], codebook: &[f32]) -> [f32; DESCRIPTOR_LEN] {
    std::array::from_fn(|d| codebook[d * CODEWORDS + usize::from(code[d / PART_LEN])])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::matching;
    use lsfb_types::no_progress;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Descriptors like real ones: few large bins, similar ones in families.
    fn descriptors(count: usize, seed: u64) -> Vec<Descriptor> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut family: Descriptor = [0; DESCRIPTOR_LEN];
        (0..count)
            .map(|i| {
                if i % 7 == 0 {
                    family = std::array::from_fn(|_| {
                        let v: f32 = rng.random_range(0.0..1.0);
                        (v * v * v * 150.0) as u8
                    });
                }
                family.map(|v| v.saturating_add(rng.random_range(0..40)))
            })
            .collect()
    }

    fn assert_finds_the_nearest(
        index: &DescriptorIndex,
        stored: &[Descriptor],
        queries: &[Descriptor],
    ) {
        let mut scratch = SearchScratch::default();
        let mut found = 0;
        for query in queries {
            let truth = (0..stored.len())
                .min_by_key(|i| matching::distance_squared(query, &stored[*i]))
                .expect("not empty");
            let neighbours = index.search(query, 25, 8, &mut scratch);
            assert!(
                neighbours
                    .windows(2)
                    .all(|w| w[0].distance_squared <= w[1].distance_squared)
            );
            found += usize::from(neighbours.iter().any(|n| n.descriptor as usize == truth));
        }
        let recall = found as f64 / queries.len() as f64;
        assert!(recall >= 0.95, "{recall}");
    }

    #[test]
    fn the_nearest_is_among_the_first_25() {
        let stored = descriptors(20_000, 1);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let queries: Vec<Descriptor> = (0..500)
            .map(|i| stored[i * 37].map(|v| v.saturating_add(rng.random_range(0..25))))
            .collect();
        let index =
            DescriptorIndex::build(&stored, &IndexConfig::default(), &no_progress).expect("built");
        assert_finds_the_nearest(&index, &stored, &queries);
        let again =
            DescriptorIndex::build(&stored, &IndexConfig::default(), &no_progress).expect("built");
        assert_eq!(index.codes.as_slice(), again.codes.as_slice());
        assert_eq!(index.codebook, again.codebook);
    }

    #[test]
    fn few_descriptors_and_none() {
        let stored = descriptors(40, 3);
        let index =
            DescriptorIndex::build(&stored, &IndexConfig::default(), &no_progress).expect("built");
        assert_finds_the_nearest(&index, &stored, &stored);
        let empty =
            DescriptorIndex::build(&[], &IndexConfig::default(), &no_progress).expect("built");
        assert!(
            empty
                .search(&stored[0], 25, 8, &mut SearchScratch::default())
                .is_empty()
        );
    }
}
