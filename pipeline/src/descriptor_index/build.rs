use arrow_buffer::Buffer;
use lsfb_types::{Progress, ProgressFn, Stopped};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::kernels::{CentroidBlocks, WORDS};
use super::kmeans::{GoOn, nearest_of_all, sample, train};
use super::source::DescriptorSource;
use super::{Columns, DESCRIPTOR_LEN, DescriptorIndex, IndexConfig};
use crate::Error;
use crate::features::Descriptor;

/// Descriptors that are read and looked at together.
const PIECE: usize = 1 << 15;
/// Of these, descriptors that one thread encodes at a time.
const GROUP: usize = 1 << 10;

/// What has been trained: how a descriptor becomes a list and a code.
struct Quantizer {
    centroids: Vec<f32>,
    lists: CentroidBlocks,
    /// Words of each part, one after the other.
    words: Vec<Vec<f32>>,
    parts: Vec<CentroidBlocks>,
}

impl DescriptorIndex {
    /// Trains and fills an index over descriptors. Reads them twice, a piece at a time. Refuses settings without meaning, and more
    /// descriptors than have numbers.
    pub fn build(
        source: DescriptorSource,
        config: &IndexConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        config.check_bounds("index")?;
        let count = source.len();
        if u32::try_from(count).is_err() {
            return Err(Error::TooManyDescriptors { count });
        }
        let step = |done: usize| -> Result<(), Stopped> {
            progress(Progress {
                stage: "descriptor index",
                done: done as u64,
                total: 3 * count as u64,
            })
        };
        step(0)?;
        // Twice as many rounds as each search has: of the lists, and of the words.
        let rounds = 2 * config.training_rounds.max(1);
        let quantizer = Quantizer::train(source, config, &|round| step(count * round / rounds))?;

        let mut list_of: Vec<u32> = Vec::with_capacity(count);
        for from in (0..count).step_by(PIECE) {
            step(count + from)?;
            let values = widened(&source.read(from..count.min(from + PIECE))?);
            let nearest = nearest_of_all(&quantizer.lists, &values, DESCRIPTOR_LEN, &|| Ok(()))?;
            list_of.extend(nearest);
        }
        let mut first_entry = vec![0u32; quantizer.centroids.len() / DESCRIPTOR_LEN];
        let mut lengths = first_entry.clone();
        for list in &list_of {
            lengths[*list as usize] += 1;
        }
        let mut next = 0;
        for (first, length) in first_entry.iter_mut().zip(&lengths) {
            *first = next;
            next += length;
        }

        let code_bytes = config.code_bytes;
        let mut place = first_entry.clone();
        let mut entries = vec![0u32; count];
        let mut offsets = vec![0.0f32; count];
        let mut codes = vec![0u8; count * code_bytes];
        for from in (0..count).step_by(PIECE) {
            step(2 * count + from)?;
            let to = count.min(from + PIECE);
            let piece = source.read(from..to)?;
            let groups = piece
                .par_chunks(GROUP)
                .zip(list_of[from..to].par_chunks(GROUP));
            let encoded: Vec<Encoded> = groups
                .map(|(descriptors, lists)| quantizer.encode(descriptors, lists))
                .collect();
            // In the order of the descriptors, and thus in each list.
            let encoded = encoded.iter().flat_map(Encoded::entries);
            for ((descriptor, list), (code, offset)) in
                (from..to).zip(&list_of[from..to]).zip(encoded)
            {
                let entry = place[*list as usize] as usize;
                place[*list as usize] += 1;
                entries[entry] = descriptor as u32;
                offsets[entry] = offset;
                codes[entry * code_bytes..][..code_bytes].copy_from_slice(code);
            }
        }
        step(3 * count)?;
        let words = quantizer.words_by_dimension();
        Ok(Self::from_columns(Columns {
            centroids: quantizer.centroids.into(),
            first_entry: first_entry.into(),
            entries: entries.into(),
            code_bytes,
            codes: Buffer::from(codes),
            offsets: offsets.into(),
            words: words.into(),
        }))
    }
}

/// Codes and offsets of some descriptors.
struct Encoded {
    code_bytes: usize,
    codes: Vec<u8>,
    offsets: Vec<f32>,
}

impl Encoded {
    fn entries(&self) -> impl Iterator<Item = (&[u8], f32)> {
        let codes = self.codes.chunks_exact(self.code_bytes);
        codes.zip(self.offsets.iter().copied())
    }
}

impl Quantizer {
    /// `go_on` is told the rounds that are done, of all.
    fn train(source: DescriptorSource, config: &IndexConfig, go_on: &GoOn) -> Result<Self, Error> {
        let count = source.len();
        let lists = (count / config.list_length).clamp(1, config.max_lists);
        let drawn = |centroids: usize, seed: u64| {
            let wanted = config
                .training_per_centroid
                .max(1)
                .saturating_mul(centroids);
            values_at(source, wanted, seed)
        };
        let samples = drawn(lists, config.seed)?;
        let rounds = config.training_rounds;
        let centroids = train(&samples, DESCRIPTOR_LEN, lists, rounds, go_on)?;
        let lists = CentroidBlocks::new(&centroids, DESCRIPTOR_LEN);
        drop(samples);

        let words = 1 << config.code_bits;
        let mut residuals = drawn(words, config.seed.wrapping_add(1))?;
        let nearest = nearest_of_all(&lists, &residuals, DESCRIPTOR_LEN, &|| go_on(rounds))?;
        subtract_centroids(&mut residuals, &nearest, &centroids);
        let part_len = DESCRIPTOR_LEN / config.code_bytes;
        let words: Result<Vec<Vec<f32>>, Stopped> = (0..config.code_bytes)
            .into_par_iter()
            .map(|part| {
                let column = part_of(&residuals, part, part_len);
                // All parts are trained at once: none tells how far all of them are.
                train(&column, part_len, words, rounds, &|_| go_on(rounds))
            })
            .collect();
        let words = words?;
        let parts = words.iter().map(|w| CentroidBlocks::new(w, part_len));
        Ok(Self {
            centroids,
            lists,
            parts: parts.collect(),
            words,
        })
    }

    /// Codes and offsets of descriptors whose lists are known.
    fn encode(&self, descriptors: &[Descriptor], lists: &[u32]) -> Encoded {
        let code_bytes = self.parts.len();
        let part_len = DESCRIPTOR_LEN / code_bytes;
        let mut residuals = widened(descriptors);
        subtract_centroids(&mut residuals, lists, &self.centroids);
        let mut codes = vec![0; descriptors.len() * code_bytes];
        let mut offsets = vec![0.0; descriptors.len()];
        for (part, words) in self.parts.iter().enumerate() {
            let nearest = words.nearest(&part_of(&residuals, part, part_len));
            let entries = nearest.iter().zip(lists).zip(&mut offsets).enumerate();
            for (entry, ((word, list), offset)) in entries {
                // A byte takes any of at most 256 words.
                codes[entry * code_bytes + part] = *word as u8;
                let centroid =
                    &self.centroids[*list as usize * DESCRIPTOR_LEN..][part * part_len..];
                let word = &self.words[part][*word as usize * part_len..][..part_len];
                let terms = word.iter().zip(centroid);
                *offset += terms.map(|(r, c)| r * (r + 2.0 * c)).sum::<f32>();
            }
        }
        Encoded {
            code_bytes,
            codes,
            offsets,
        }
    }

    /// For each dimension its value in the [`WORDS`] words of its part. No code uses the zeros at the end of parts that have
    /// fewer.
    fn words_by_dimension(&self) -> Vec<f32> {
        let part_len = DESCRIPTOR_LEN / self.words.len();
        let mut by_dimension = vec![0.0; DESCRIPTOR_LEN * WORDS];
        for (part, words) in self.words.iter().enumerate() {
            for (index, word) in words.chunks_exact(part_len).enumerate() {
                for (i, value) in word.iter().enumerate() {
                    by_dimension[(part * part_len + i) * WORDS + index] = *value;
                }
            }
        }
        by_dimension
    }
}

fn widened(descriptors: &[Descriptor]) -> Vec<f32> {
    descriptors
        .as_flattened()
        .iter()
        .map(|v| f32::from(*v))
        .collect()
}

/// As many as wanted of the descriptors in random order, or all.
fn values_at(source: DescriptorSource, wanted: usize, seed: u64) -> Result<Vec<f32>, Error> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let places = sample(source.len(), wanted, &mut rng);
    let mut values = Vec::with_capacity(places.len() * DESCRIPTOR_LEN);
    for place in places {
        values.extend(widened(&source.read(place..place + 1)?));
    }
    Ok(values)
}

fn subtract_centroids(values: &mut [f32], lists: &[u32], centroids: &[f32]) {
    for (value, list) in values.chunks_exact_mut(DESCRIPTOR_LEN).zip(lists) {
        let centroid = &centroids[*list as usize * DESCRIPTOR_LEN..];
        for (v, c) in value.iter_mut().zip(centroid) {
            *v -= c;
        }
    }
}

/// One part of each of some vectors.
fn part_of(values: &[f32], part: usize, part_len: usize) -> Vec<f32> {
    let vectors = values.chunks_exact(DESCRIPTOR_LEN);
    let parts = vectors.flat_map(|v| &v[part * part_len..][..part_len]);
    parts.copied().collect()
}
