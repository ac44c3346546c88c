//! What an image shows as one vector, by which images of one place are found among many.
//!
//! Vectors of locally aggregated descriptors: for each word of a codebook, the sum of what the descriptors next to it differ from it by
//! (Jégou, Douze, Schmid, Pérez, "Aggregating local descriptors into a compact image representation", CVPR 2010), each word's sum scaled to
//! length one, so that a wall of equal tiles counts no more than one tile (Arandjelović and Zisserman, "All about VLAD", CVPR 2013). Likeness
//! only proposes: whether two images are of one place says the geometry of what they show.
//!
//! The codebook built in is of SIFT, trained on images of simulated places by `lsfb models codebook`; its format is in `FORMAT.md` beside
//! this file.

mod file;
mod training;

use crate::descriptor_index::CentroidBlocks;
use crate::features::{DESCRIPTOR_LEN, Descriptor};

/// The one built in: the bytes of `default.codebook`.
const DEFAULT: &[u8] = include_bytes!("default.codebook");

/// Words that descriptors are next to.
#[derive(Clone, Debug)]
pub struct Codebook {
    /// One after the other.
    words: Vec<u8>,
    blocks: CentroidBlocks,
}

/// An image as a codebook describes it: of length one, or of zeros where it shows nothing. Only vectors of one codebook can be compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Vlad(Vec<f32>);

impl Codebook {
    /// The one built in.
    pub fn built_in() -> Self {
        // A test reads it: it is never empty.
        Self::from_bytes(DEFAULT).unwrap_or_else(|_| Self::of_words(Vec::new()))
    }

    fn of_words(words: Vec<u8>) -> Self {
        let centroids: Vec<f32> = words.iter().map(|v| f32::from(*v)).collect();
        Self {
            words,
            blocks: CentroidBlocks::new(&centroids, DESCRIPTOR_LEN),
        }
    }

    /// Number of words.
    pub fn len(&self) -> usize {
        self.words.len() / DESCRIPTOR_LEN
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// What descriptors of an image come to.
    pub fn describe(&self, descriptors: &[Descriptor]) -> Vlad {
        let mut sums = vec![0.0f32; self.words.len()];
        let values: Vec<f32> = descriptors
            .iter()
            .flatten()
            .map(|v| f32::from(*v))
            .collect();
        if !self.is_empty() {
            for (descriptor, word) in descriptors.iter().zip(self.blocks.nearest(&values)) {
                let from = word as usize * DESCRIPTOR_LEN;
                let word = &self.words[from..from + DESCRIPTOR_LEN];
                for ((sum, v), w) in sums[from..].iter_mut().zip(descriptor).zip(word) {
                    *sum += f32::from(*v) - f32::from(*w);
                }
            }
        }
        sums.chunks_exact_mut(DESCRIPTOR_LEN).for_each(scale_to_one);
        scale_to_one(&mut sums);
        Vlad(sums)
    }
}

impl Vlad {
    /// How alike two images are, from −1 to 1: the cosine of the angle between them.
    pub fn likeness(&self, other: &Self) -> f32 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }
}

fn scale_to_one(values: &mut [f32]) {
    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    if norm > 0.0 {
        values.iter_mut().for_each(|v| *v /= norm);
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn random(rng: &mut ChaCha8Rng) -> Descriptor {
        std::array::from_fn(|_| (rng.next_u32() % 90) as u8)
    }

    #[test]
    fn the_one_built_in_has_words() {
        let codebook = Codebook::from_bytes(DEFAULT).expect("a codebook");
        assert_eq!(codebook.len(), 32);
        assert_eq!(Codebook::built_in().words, codebook.words);
    }

    #[test]
    fn images_that_share_features_are_more_alike() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let codebook = Codebook::built_in();
        let place: Vec<Descriptor> = (0..200).map(|_| random(&mut rng)).collect();
        let elsewhere: Vec<Descriptor> = (0..200).map(|_| random(&mut rng)).collect();
        // Half of what is seen from there, in another order, with noise.
        let again: Vec<Descriptor> = place[..100]
            .iter()
            .rev()
            .map(|d| d.map(|v| v + (rng.next_u32() % 9) as u8))
            .chain(elsewhere[..60].iter().copied())
            .collect();
        let [place, elsewhere, again] = [place, elsewhere, again].map(|d| codebook.describe(&d));
        assert!((place.likeness(&place) - 1.0).abs() < 1e-5);
        assert!(place.likeness(&again) > place.likeness(&elsewhere) + 0.1);
        let nothing = codebook.describe(&[]);
        assert_eq!(nothing.likeness(&place), 0.0);
    }
}
