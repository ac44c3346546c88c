//! A codebook from descriptors of many images.

use lsfb_types::{Progress, ProgressFn};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::Codebook;
use crate::descriptor_index::kmeans::{sample, train};
use crate::features::{DESCRIPTOR_LEN, Descriptor};
use crate::{Error, Refusal};

/// Rounds of k-means.
const ROUNDS: usize = 40;
/// Descriptors for each word, at most: more change nothing.
const PER_WORD: usize = 4000;

impl Codebook {
    /// As many words as wanted; the same descriptors and seed give the same on any number of threads. [`Refusal::FewDescriptors`] where
    /// there are fewer than ten for each word.
    pub fn train(
        descriptors: &[Descriptor],
        words: usize,
        seed: u64,
        progress: ProgressFn<'_>,
    ) -> Result<Self, Error> {
        let needed = 10 * words.max(1);
        if descriptors.len() < needed {
            return Err(Refusal::FewDescriptors {
                count: descriptors.len(),
                needed,
            }
            .into());
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let chosen = sample(descriptors.len(), PER_WORD * words.max(1), &mut rng);
        let of = |k: &usize| descriptors[*k].iter().map(|v| f32::from(*v));
        let values: Vec<f32> = chosen.iter().flat_map(of).collect();
        let centroids = train(&values, DESCRIPTOR_LEN, words.max(1), ROUNDS, &|round| {
            progress(Progress {
                stage: "training the codebook",
                done: round as u64,
                total: ROUNDS as u64,
            })
        })?;
        let rounded = centroids.iter().map(|v| v.round() as u8);
        Ok(Self::of_words(rounded.collect()))
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng;

    use super::*;

    #[test]
    fn words_are_where_descriptors_are() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let places = [[20u8; DESCRIPTOR_LEN], [120; DESCRIPTOR_LEN]];
        let near = |place: &Descriptor, rng: &mut ChaCha8Rng| {
            place.map(|v| v + (rng.next_u32() % 21) as u8)
        };
        let descriptors: Vec<Descriptor> =
            (0..400).map(|k| near(&places[k % 2], &mut rng)).collect();
        let trained = Codebook::train(&descriptors, 2, 1, &lsfb_types::no_progress).expect("words");
        let mut means: Vec<u8> = trained.words.chunks(DESCRIPTOR_LEN).map(|w| w[7]).collect();
        means.sort_unstable();
        assert!(
            (28..=32).contains(&means[0]) && (128..=132).contains(&means[1]),
            "{means:?}"
        );
        let few = Codebook::train(&descriptors[..15], 2, 1, &lsfb_types::no_progress);
        assert!(matches!(
            few,
            Err(Error::Refused(Refusal::FewDescriptors { .. }))
        ));
    }
}
