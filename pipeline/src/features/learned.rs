//! Features of a network.

use std::path::PathBuf;
use std::sync::Arc;

use lsfb_networks::{Network, Trust};
use lsfb_types::Image;
use serde::{Deserialize, Serialize};

use super::matching::DESCRIPTOR_NORM;
use super::selection::{Candidate, select};
use super::{DESCRIPTOR_LEN, Descriptor, Features, Keypoint, LearnedFeature};
use crate::Error;

/// Which network finds features, and how many.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedConfig {
    /// File of its weights.
    pub weights: PathBuf,
    /// The network and weights that must be in it.
    pub feature: LearnedFeature,
    /// Most features per image.
    pub max_features: usize,
}

/// Features per image, as many as of SIFT.
const MAX_FEATURES: usize = 900;

impl LearnedConfig {
    /// With the recommended number of features.
    pub fn new(weights: PathBuf, feature: LearnedFeature) -> Self {
        Self {
            weights,
            feature,
            max_features: MAX_FEATURES,
        }
    }
}

/// A network that finds and describes features. Cloning shares it.
#[derive(Clone, Debug)]
pub struct LearnedDetector {
    network: Arc<Network>,
    feature: LearnedFeature,
    max_features: usize,
}

impl LearnedDetector {
    /// Reads the weights; refuses others than the configuration says.
    pub fn new(config: &LearnedConfig) -> Result<Self, Error> {
        let network = Network::read(&config.weights, Trust::Any)?;
        let feature = LearnedFeature {
            model: network.model().name().to_owned(),
            weights_sha256: network.weights_sha256().to_owned(),
        };
        if feature != config.feature {
            return Err(Error::OtherWeights {
                path: config.weights.clone(),
                expected: super::Feature::Learned(config.feature.clone()).to_string(),
                found: super::Feature::Learned(feature).to_string(),
            });
        }
        Ok(Self {
            network: Arc::new(network),
            feature,
            max_features: config.max_features,
        })
    }

    /// What its descriptors are of.
    pub fn feature(&self) -> &LearnedFeature {
        &self.feature
    }

    /// The features of `image`, by row and column. An image whose pixels do not fill its size, or too small, has none.
    pub fn detect(&self, image: &Image) -> Features {
        let Some(maps) = self.network.run(image) else {
            return Features::default();
        };
        let found = maps.keypoints();
        let candidates: Vec<Candidate> = found
            .iter()
            .map(|k| Candidate {
                x: k.pixel[0],
                y: k.pixel[1],
                response: k.score,
            })
            .collect();
        let mut chosen = select(&candidates, image.width, image.height, self.max_features);
        chosen.sort_unstable();
        let keypoints: Vec<Keypoint> = chosen
            .into_iter()
            .map(|index| Keypoint {
                pixel: found[index].pixel,
                scale_px: SCALE_PX,
                angle_rad: 0.0,
                response: found[index].score,
            })
            .collect();
        let pixels: Vec<[f32; 2]> = keypoints.iter().map(|k| k.pixel).collect();
        let descriptors = maps.descriptors(&pixels);
        Features {
            keypoints,
            descriptors: descriptors
                .chunks_exact(self.network.model().descriptor_len())
                .map(quantised)
                .collect(),
        }
    }
}

/// The size of what these networks call a keypoint, pixels: that of the neighbourhood in which it is the highest.
const SCALE_PX: f32 = 2.0;

/// Values of unit length as bytes: distances are those of SIFT's descriptors (512 times the unit). Of 64 values two bytes each: half a
/// step apart, they hold it twice as finely as one would, and each part of the index's codes gets its share. Of 128 values one each. Of
/// 256 the sums of one of the first half and one of the second: squared distances stay the same in the mean, to about a tenth.
fn quantised(values: &[f32]) -> Descriptor {
    const ZERO: f32 = 128.0;
    if values.len() > DESCRIPTOR_LEN {
        let (first, second) = values.split_at(DESCRIPTOR_LEN);
        let sums = first.iter().zip(second).enumerate();
        let sums: Vec<f32> = sums
            .map(|(i, (a, b))| if i % 2 == 0 { a + b } else { a - b })
            .collect();
        return quantised(&sums);
    }
    let bytes_per_value = (DESCRIPTOR_LEN / values.len().max(1)).max(1);
    // The squares of both bytes of a value add up.
    let steps_per_unit = DESCRIPTOR_NORM / (bytes_per_value as f32).sqrt();
    std::array::from_fn(|i| {
        let between = (i % bytes_per_value) as f32 + 0.5;
        let part = between / bytes_per_value as f32 - 0.5;
        let value = values.get(i / bytes_per_value).copied().unwrap_or(0.0);
        // Beyond ±0.35 a value of 64 saturates, beyond ±0.25 one of 128; casting does so by itself.
        (ZERO + steps_per_unit * value + part).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::matching::distance_squared;

    #[test]
    fn distances_of_bytes_are_those_of_the_values() {
        let unit = |seed: usize, count: usize| {
            let value = |i: usize| ((i * 31 + seed * 97 + i * i * seed) % 23) as f32 - 11.0;
            let mut values: Vec<f32> = (0..count).map(value).collect();
            let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
            values.iter_mut().for_each(|v| *v /= norm);
            values
        };
        let pairs = [(1, 2), (3, 3), (5, 8), (2, 9)];
        for (a, b) in pairs.map(|(a, b)| (unit(a, 256), unit(b, 256))) {
            let exact: f32 = a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum();
            let bytes = distance_squared(&quantised(&a), &quantised(&b)) as f32 / 512f32.powi(2);
            assert!((bytes - exact).abs() <= 0.2 * exact, "{bytes} {exact}");
        }
        for ((a, b), count) in pairs.into_iter().flat_map(|p| [(p, 64), (p, 128)]) {
            let (a, b) = (unit(a, count), unit(b, count));
            let exact: f32 = a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum();
            let bytes = distance_squared(&quantised(&a), &quantised(&b)) as f32 / 512f32.powi(2);
            assert!(
                (bytes.sqrt() - exact.sqrt()).abs() < 0.01,
                "{bytes} {exact}"
            );
        }
    }
}
