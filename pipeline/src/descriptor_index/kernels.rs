//! The inner loops, compiled for the vector units of the processor they run on. None fuses a product with a sum, so that every
//! processor finds the same numbers.
//!
//! Each is a type of its own, not a closure or a function handed on: nothing could force those to be inlined where the vector
//! instructions are.

use std::hint::black_box;

use pulp::{Arch, Simd, WithSimd};

use crate::features::Descriptor;
use crate::features::matching::distance_squared;

/// Centroids that are looked at together: as many sums as the registers of a processor with AVX2 take.
const LANES: usize = 64;

/// Centroids as the search for the nearest wants them: [`LANES`] side by side, dimension by dimension.
#[derive(Clone, Debug)]
pub(crate) struct CentroidBlocks {
    dimensions: usize,
    count: usize,
    /// For each block its dimensions, one after the other.
    rows: Vec<[f32; LANES]>,
    /// `|c|²`; infinite where there is no centroid.
    squared_norms: Vec<[f32; LANES]>,
}

impl CentroidBlocks {
    /// From centroids one after the other.
    pub fn new(centroids: &[f32], dimensions: usize) -> Self {
        let count = centroids.len() / dimensions;
        let blocks = count.div_ceil(LANES);
        let mut rows = vec![[0.0; LANES]; blocks * dimensions];
        let mut squared_norms = vec![[f32::INFINITY; LANES]; blocks];
        for (index, centroid) in centroids.chunks_exact(dimensions).enumerate() {
            let (block, lane) = (index / LANES, index % LANES);
            squared_norms[block][lane] = centroid.iter().map(|v| v * v).sum();
            for (row, value) in rows[block * dimensions..].iter_mut().zip(centroid) {
                row[lane] = *value;
            }
        }
        Self {
            dimensions,
            count,
            rows,
            squared_norms,
        }
    }

    /// The nearest centroid of each of some vectors, of equally near ones the first; 0 where there is none.
    pub fn nearest(&self, values: &[f32]) -> Vec<u32> {
        let mut best = vec![(f32::INFINITY, 0); values.len() / self.dimensions];
        Arch::new().dispatch(UpdateNearest {
            centroids: self,
            values,
            best: &mut best,
        });
        best.into_iter().map(|(_, index)| index).collect()
    }

    /// `|c|² − 2 v·c` of each centroid: its squared distance less `|v|²`.
    pub fn scores(&self, value: &[f32], scores: &mut Vec<f32>) {
        scores.clear();
        Arch::new().dispatch(AppendScores {
            centroids: self,
            value,
            scores,
        });
        scores.truncate(self.count);
    }

    fn blocks(&self) -> impl Iterator<Item = (&[[f32; LANES]], &[f32; LANES])> {
        let rows = self.rows.chunks_exact(self.dimensions);
        rows.zip(&self.squared_norms)
    }
}

#[inline(always)]
fn block_scores(value: &[f32], rows: &[[f32; LANES]], norms: &[f32; LANES]) -> [f32; LANES] {
    let mut sums = [0.0; LANES];
    for (value, row) in value.iter().zip(rows) {
        for (sum, word) in sums.iter_mut().zip(row) {
            *sum += value * word;
        }
    }
    for (sum, norm) in sums.iter_mut().zip(norms) {
        *sum = norm - 2.0 * *sum;
    }
    sums
}

#[inline(always)]
fn smallest(scores: &[f32; LANES]) -> f32 {
    let mut least = [f32::INFINITY; 8];
    for eight in scores.as_chunks::<8>().0 {
        for (least, score) in least.iter_mut().zip(eight) {
            *least = if *score < *least { *score } else { *least };
        }
    }
    least.into_iter().fold(f32::INFINITY, f32::min)
}

/// The nearest so far of each vector, with its score.
struct UpdateNearest<'a> {
    centroids: &'a CentroidBlocks,
    values: &'a [f32],
    best: &'a mut [(f32, u32)],
}

impl WithSimd for UpdateNearest<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for (block, (rows, norms)) in self.centroids.blocks().enumerate() {
            let vectors = self.values.chunks_exact(self.centroids.dimensions);
            for (value, best) in vectors.zip(self.best.iter_mut()) {
                let scores = block_scores(value, rows, norms);
                let least = smallest(&scores);
                if least < best.0 {
                    let lane = scores.iter().position(|s| *s == least).unwrap_or(0);
                    *best = (least, (block * LANES + lane) as u32);
                }
            }
        }
    }
}

struct AppendScores<'a> {
    centroids: &'a CentroidBlocks,
    value: &'a [f32],
    scores: &'a mut Vec<f32>,
}

impl WithSimd for AppendScores<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for (rows, norms) in self.centroids.blocks() {
            let scores = block_scores(self.value, rows, norms);
            self.scores.extend_from_slice(&scores);
        }
    }
}

/// Values a byte of a code can take.
pub(super) const WORDS: usize = 256;

/// Products of each part of a query with each word of its part: `words` has for each dimension the values of all words.
pub(super) fn multiply(query: &[f32], words: &[f32], products: &mut [[f32; WORDS]]) {
    Arch::new().dispatch(MultiplyParts {
        query,
        words,
        products,
    });
}

struct MultiplyParts<'a> {
    query: &'a [f32],
    words: &'a [f32],
    products: &'a mut [[f32; WORDS]],
}

impl WithSimd for MultiplyParts<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let part_len = (self.query.len() / self.products.len().max(1)).max(1);
        let rows = self.words.as_chunks::<WORDS>().0.chunks_exact(part_len);
        let parts = self.query.chunks_exact(part_len).zip(rows);
        for ((query, rows), products) in parts.zip(self.products) {
            for (group, products) in products.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
                let mut sums = [0.0; LANES];
                for (value, row) in query.iter().zip(rows) {
                    for (sum, word) in sums.iter_mut().zip(&row.as_chunks::<LANES>().0[group]) {
                        *sum += value * word;
                    }
                }
                *products = sums;
            }
        }
    }
}

/// Estimated distances of codes of `N` bytes: `base` and the offset of each, less twice the products of its words.
pub(super) fn estimate<const N: usize>(
    codes: &[[u8; N]],
    offsets: &[f32],
    products: &[[f32; WORDS]; N],
    base: f32,
    distances: &mut Vec<f32>,
) {
    let entries = codes.iter().zip(offsets);
    distances.clear();
    distances.extend(entries.map(|(code, offset)| {
        let mut sums = [0.0; 4];
        for (part, (words, word)) in products.iter().zip(code).enumerate() {
            sums[part % 4] += words[usize::from(*word)];
        }
        base + offset - 2.0 * ((sums[0] + sums[1]) + (sums[2] + sums[3]))
    }));
}

/// Squared distances of a query to some of many descriptors, by their numbers.
pub(super) fn compare(
    query: &Descriptor,
    all: &[Descriptor],
    numbers: impl Iterator<Item = u32> + Clone,
    distances: &mut Vec<u32>,
) {
    /// Bytes of a line of the cache.
    const LINE: usize = 64;
    // They lie all over a large table: memory is asked for all of them before the first is waited for.
    let asked = numbers.clone().flat_map(|number| {
        let lines = all[number as usize].chunks(LINE);
        lines.map(|line| line[0])
    });
    black_box(asked.fold(0, |any, byte| any | byte));
    distances.clear();
    Arch::new().dispatch(AppendDistances {
        query,
        all,
        numbers,
        distances,
    });
}

struct AppendDistances<'a, N> {
    query: &'a Descriptor,
    all: &'a [Descriptor],
    numbers: N,
    distances: &'a mut Vec<u32>,
}

impl<N: Iterator<Item = u32>> WithSimd for AppendDistances<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for number in self.numbers {
            let other = &self.all[number as usize];
            self.distances.push(distance_squared(self.query, other));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::DESCRIPTOR_LEN;

    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        let hashed = |i: usize| (i + seed).wrapping_mul(2_654_435_761) >> 7;
        (0..count)
            .map(|i| (hashed(i) % 1000) as f32 * 0.25)
            .collect()
    }

    /// Against the definition, for sizes that fill their last block and sizes that do not.
    #[test]
    fn the_nearest_and_its_score_are_those_of_the_definition() {
        for (dimensions, count) in [(8, 256), (128, 100), (2, 1), (16, 64)] {
            let centroids = numbers(dimensions * count, 3);
            let values = numbers(dimensions * 50, 77);
            let blocks = CentroidBlocks::new(&centroids, dimensions);
            let nearest = blocks.nearest(&values);
            for (value, nearest) in values.chunks_exact(dimensions).zip(nearest) {
                let squared = |c: &[f32]| -> f64 {
                    let terms = c.iter().zip(value);
                    terms.map(|(c, v)| f64::from(c - v).powi(2)).sum()
                };
                // What sums of so many terms are rounded by, at most.
                let rounding = 2.0
                    * dimensions as f64
                    * f64::from(f32::EPSILON)
                    * 250.0f64.powi(2)
                    * dimensions as f64;
                let exact: Vec<f64> = centroids.chunks_exact(dimensions).map(squared).collect();
                let least = exact.iter().copied().fold(f64::INFINITY, f64::min);
                assert!(
                    exact[nearest as usize] <= least + rounding,
                    "{dimensions} {count}"
                );
                let mut scores = Vec::new();
                blocks.scores(value, &mut scores);
                assert_eq!(scores.len(), count);
                let own: f64 = value.iter().map(|v| f64::from(*v).powi(2)).sum();
                for (score, exact) in scores.iter().zip(&exact) {
                    assert!(
                        (f64::from(*score) + own - exact).abs() < rounding,
                        "{score} {exact}"
                    );
                }
            }
        }
        assert_eq!(CentroidBlocks::new(&[], 8).nearest(&[0.0; 16]), [0, 0]);
    }

    /// With the vectors of this processor and with those that every processor has.
    #[test]
    fn every_processor_finds_the_same_numbers() {
        let blocks = CentroidBlocks::new(&numbers(128 * 70, 5), 128);
        let query = numbers(128, 6);
        let (mut plain, mut wide) = (Vec::new(), Vec::new());
        let scores = |scores| AppendScores {
            centroids: &blocks,
            value: &query,
            scores,
        };
        Arch::Scalar.dispatch(scores(&mut plain));
        Arch::new().dispatch(scores(&mut wide));
        assert!(
            plain
                .iter()
                .zip(&wide)
                .all(|(a, b)| a.to_bits() == b.to_bits())
        );
        let words = numbers(128 * WORDS, 8);
        let mut products = [[[0.0; WORDS]; 16]; 2];
        let [plain, wide] = &mut products;
        let multiply = |products| MultiplyParts {
            query: &query,
            words: &words,
            products,
        };
        Arch::Scalar.dispatch(multiply(plain.as_mut_slice()));
        Arch::new().dispatch(multiply(wide.as_mut_slice()));
        assert!(plain == wide && plain[3][200] != 0.0);
    }

    #[test]
    fn distances_are_those_of_the_descriptors() {
        let bytes = numbers(DESCRIPTOR_LEN * 20, 4);
        let bytes: Vec<u8> = bytes.iter().map(|v| (*v * 1.03) as u8).collect();
        let all = bytes.as_chunks::<DESCRIPTOR_LEN>().0;
        let query = [[0; DESCRIPTOR_LEN], [255; DESCRIPTOR_LEN], all[3]];
        let numbers = [7, 3, 19, 0, 3];
        for query in &query {
            let mut distances = vec![1, 2];
            compare(query, all, numbers.into_iter(), &mut distances);
            let exact = numbers.map(|n| distance_squared(query, &all[n as usize]));
            assert_eq!(distances, exact);
        }
    }

    /// `|q − w|²` of codes of four bytes, one dimension each, with all of it in the offset and the products.
    #[test]
    fn estimates_are_distances_to_the_words() {
        let words = numbers(4 * WORDS, 9);
        let query = [3.0, 70.0, 128.5, 9.0];
        let mut products = [[0.0; WORDS]; 4];
        multiply(&query, &words, &mut products);
        let codes: Vec<[u8; 4]> = (0..=255u8).map(|i| [i, 255 - i, i / 2, 7]).collect();
        let word = |code: &[u8; 4], part: usize| words[part * WORDS + usize::from(code[part])];
        let offset = |code: &[u8; 4]| (0..4).map(|part| word(code, part).powi(2)).sum::<f32>();
        let offsets: Vec<f32> = codes.iter().map(offset).collect();
        let base = query.iter().map(|q| q * q).sum();
        let mut distances = Vec::new();
        estimate(&codes, &offsets, &products, base, &mut distances);
        for (code, distance) in codes.iter().zip(&distances) {
            let exact: f32 = (0..4)
                .map(|part| (query[part] - word(code, part)).powi(2))
                .sum();
            assert!((distance - exact).abs() < 0.1, "{distance} {exact}");
        }
    }
}
