use lsfb_types::{Image, ProgressFn, SharedProgress};
use rayon::prelude::*;

use super::{Feature, Features, LearnedConfig, LearnedDetector, SiftConfig, SiftDetector};
use crate::Error;

/// Whatever finds and describes features. Keeps memory between images: clone it for each thread.
#[derive(Clone, Debug)]
pub enum FeatureDetector {
    /// SIFT.
    Sift(Box<SiftDetector>),
    /// A network.
    Learned(LearnedDetector),
}

/// Memory that a network takes for each pixel, bytes: its finest maps.
const LEARNED_BYTES_PER_PIXEL: usize = 320;
/// Most memory that images take at a time, bytes: large ones wait for one another.
const MAX_BYTES: usize = 2 << 30;

impl FeatureDetector {
    /// The network that is named, else SIFT.
    pub fn new(sift: &SiftConfig, learned: Option<&LearnedConfig>) -> Result<Self, Error> {
        match learned {
            Some(config) => Ok(Self::Learned(LearnedDetector::new(config)?)),
            None => Self::sift(sift),
        }
    }

    /// SIFT; refuses a configuration without meaning.
    pub fn sift(config: &SiftConfig) -> Result<Self, Error> {
        Ok(Self::Sift(Box::new(SiftDetector::new(config)?)))
    }

    /// What its descriptors are of.
    pub fn feature(&self) -> Feature {
        match self {
            Self::Sift(_) => Feature::Sift,
            Self::Learned(learned) => Feature::Learned(learned.feature().clone()),
        }
    }

    /// The features of `image`; none of one whose pixels do not fill its size, or too small.
    pub fn detect(&mut self, image: &Image) -> Features {
        match self {
            Self::Sift(sift) => sift.detect(image),
            Self::Learned(learned) => learned.detect(image),
        }
    }

    /// Memory that an image takes, bytes.
    fn bytes(&self, image: &Image) -> usize {
        match self {
            Self::Sift(sift) => sift.scale_space_bytes(image),
            Self::Learned(_) => image.pixels.len() * LEARNED_BYTES_PER_PIXEL,
        }
    }

    /// Features of many images, in their order, on as many threads as their memory allows.
    pub fn detect_all(
        &self,
        images: &[&Image],
        progress: ProgressFn,
    ) -> Result<Vec<Features>, Error> {
        let done = SharedProgress::new("image features", images.len(), progress);
        let largest = images.iter().map(|i| self.bytes(i)).max();
        let at_once = (MAX_BYTES / largest.unwrap_or(0).max(1)).max(1);
        let group_len = match at_once < rayon::current_num_threads() {
            true => at_once,
            false => images.len().max(1),
        };
        let mut features = Vec::with_capacity(images.len());
        for group in images.chunks(group_len) {
            let found: Result<Vec<Features>, Error> = group
                .par_iter()
                .map_init(
                    || self.clone(),
                    |detector, image| {
                        let features = detector.detect(image);
                        done.one_more()?;
                        Ok(features)
                    },
                )
                .collect();
            features.extend(found?);
        }
        Ok(features)
    }
}
