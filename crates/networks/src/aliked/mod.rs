//! ALIKED (Zhao et al., "ALIKED: A lighter keypoint and descriptor extraction network via deformable transformation", IEEE TIM
//! 2023): a score for every pixel, and descriptors of keypoints, looked up around them where the network says.
//!
//! The authors enlarge all four maps to the size of the image and multiply them there. As enlarging and multiplying may change
//! places, the first layer of the scores is applied before, and features are put together where descriptors look alone: the same
//! numbers, less work.

mod features;
mod head;
#[cfg(test)]
mod tests;

use crate::Grey;
use crate::alike::backbone_tensors;
use crate::convolution::{Affine, Convolution, DeformableConvolution, Gate, Shape};
use crate::error::Damage;
use crate::keypoints::{NetworkKeypoint, PeakSearch, Scores, sigmoid};
use crate::tensor::{Pooling, Tensor};
use crate::weights::Weights;
use features::Features;
use head::DescriptorHead;

/// Sides of images are multiples of this.
const GRAIN_PX: usize = 32;
/// Of the authors' detector, but for the least score: which of the weaker ones are kept is up to who asks.
const PEAKS: PeakSearch = PeakSearch {
    radius: 2,
    min_score: 0.05,
    temperature: 0.1,
};
/// By how much each of the four blocks is coarser than the one before.
const POOLED: [usize; 4] = [1, 2, 4, 4];
/// Layers of the score: name, outputs, side.
const SCORE: [(&str, usize, usize); 4] = [
    ("score_head.0", 8, 1),
    ("score_head.2", 4, 3),
    ("score_head.4", 4, 3),
    ("score_head.6", 1, 3),
];

/// Which of the family.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Size {
    /// The smallest.
    Tiny,
    /// The normal one.
    Normal,
}

impl Size {
    /// Channels of the four blocks; descriptors have as many values as the last.
    fn channels(self) -> [usize; 4] {
        match self {
            Self::Tiny => [8, 16, 32, 64],
            Self::Normal => [16, 32, 64, 128],
        }
    }

    /// Values of a descriptor.
    pub fn descriptor_len(self) -> usize {
        self.channels()[3]
    }
}

/// Names of the tensors it is made of: the same of all sizes.
pub(crate) fn tensors() -> Vec<String> {
    let mut names = head::tensors();
    names.extend(SCORE.map(|(name, ..)| format!("{name}.weight")));
    names.extend(backbone_tensors(|block| match block {
        1 | 2 => &["weight"],
        _ => &[
            "offset_conv.weight",
            "offset_conv.bias",
            "regular_conv.weight",
        ],
    }));
    names
}

/// The network.
#[derive(Clone, Debug)]
pub(crate) struct Aliked {
    blocks: Vec<Block>,
    /// The first layer of the score, as far as each of the four maps goes.
    score_parts: Vec<Convolution>,
    score: Vec<Convolution>,
    head: DescriptorHead,
}

#[derive(Clone, Debug)]
struct Block {
    first: Layer,
    second: Layer,
    /// What by-passes both, but in the first block.
    bypass: Option<Convolution>,
    /// What its map gives to scores and descriptors.
    shared: Convolution,
}

#[derive(Clone, Debug)]
enum Layer {
    Plain(Convolution),
    Deformable(DeformableConvolution),
}

impl Layer {
    fn apply(&self, map: &Tensor) -> Tensor {
        match self {
            Self::Plain(convolution) => convolution.apply(map),
            Self::Deformable(convolution) => convolution.apply(map),
        }
    }
}

impl Block {
    /// Block `index` of four, from 0.
    fn read(weights: &Weights, index: usize, size: Size) -> Result<Self, Damage> {
        let channels = size.channels();
        let (name, outputs) = (format!("block{}", index + 1), channels[index]);
        let inputs = if index == 0 { 3 } else { channels[index - 1] };
        let layer = |half: usize, inputs: usize, gate: Gate| -> Result<Layer, Damage> {
            let layer = format!("{name}.conv{half}");
            let normalisation = format!("{name}.bn{half}");
            if index >= 2 {
                let ends = [inputs, outputs];
                return DeformableConvolution::read(weights, &layer, ends, &normalisation, gate)
                    .map(Layer::Deformable);
            }
            let shape = Shape {
                outputs,
                inputs,
                side: 3,
            };
            let read = Convolution::read(weights, &format!("{layer}.weight"), shape)?
                .normalised(weights, &normalisation, Affine::Learned)?
                .gated(gate);
            // Red, green and blue of a grey image are the same.
            Ok(Layer::Plain(match (index, half) {
                (0, 1) => read.of_equal_inputs(),
                _ => read,
            }))
        };
        let shape = |outputs, inputs| Shape {
            outputs,
            inputs,
            side: 1,
        };
        let shared = format!("conv{}.weight", index + 1);
        let shared = Convolution::read(weights, &shared, shape(channels[3] / 4, outputs))?;
        let (mut second_gate, mut bypass) = (Gate::Selu, None);
        if index > 0 {
            second_gate = Gate::None;
            let weight = format!("{name}.downsample.weight");
            let read = Convolution::read(weights, &weight, shape(outputs, inputs))?;
            bypass = Some(read.with_bias(weights, &format!("{name}.downsample.bias"))?);
        }
        Ok(Self {
            first: layer(1, inputs, Gate::Selu)?,
            second: layer(2, outputs, second_gate)?,
            bypass,
            shared: shared.gated(Gate::Selu),
        })
    }

    fn apply(&self, map: &Tensor) -> Tensor {
        let mut next = self.second.apply(&self.first.apply(map));
        if let Some(bypass) = &self.bypass {
            next.add(&bypass.apply(map));
            Gate::Selu.apply(&mut next.values);
        }
        next
    }
}

/// What it says of an image.
pub(crate) struct AlikedMaps<'a> {
    scores: Scores,
    features: Features,
    head: &'a DescriptorHead,
}

impl Aliked {
    pub fn read(weights: &Weights, size: Size) -> Result<Self, Damage> {
        let values = size.descriptor_len();
        let mut inputs = values;
        let mut score = Vec::new();
        for (index, (name, outputs, side)) in SCORE.into_iter().enumerate() {
            let shape = Shape {
                outputs,
                inputs,
                side,
            };
            let read = Convolution::read(weights, &format!("{name}.weight"), shape)?;
            let is_last = index + 1 == SCORE.len();
            score.push(read.gated(if is_last { Gate::None } else { Gate::Selu }));
            inputs = outputs;
        }
        let first = score.remove(0).gated(Gate::None);
        let share = values / 4;
        let parts = (0..4).map(|i| first.of_channels(i * share..(i + 1) * share));
        let blocks = (0..4).map(|index| Block::read(weights, index, size));
        Ok(Self {
            blocks: blocks.collect::<Result<_, _>>()?,
            score_parts: parts.collect(),
            score,
            head: DescriptorHead::read(weights, values)?,
        })
    }

    pub fn run(&self, image: &Grey) -> AlikedMaps<'_> {
        let (mut map, begin) = image.padded_around(GRAIN_PX);
        let size = [map.width, map.height];
        let mut logits = Tensor::zeros(map.height, map.width, SCORE[0].1);
        let mut maps = Vec::new();
        for ((block, pooled), part) in self.blocks.iter().zip(POOLED).zip(&self.score_parts) {
            if pooled > 1 {
                map = map.pooled(pooled, Pooling::Mean);
            }
            map = block.apply(&map);
            let shared = block.shared.apply(&map);
            logits.add_stretched(&part.apply(&shared));
            maps.push(shared);
        }
        Gate::Selu.apply(&mut logits.values);
        for layer in &self.score {
            logits = layer.apply(&logits);
        }
        let rows = logits.values.chunks_exact(size[0]);
        let inside = rows.skip(begin[1]).take(image.height);
        let scores = inside.flat_map(|row| &row[begin[0]..begin[0] + image.width]);
        AlikedMaps {
            scores: Scores {
                width: image.width,
                values: scores.map(|v| sigmoid(*v)).collect(),
            },
            features: Features::new(maps, size, begin, [image.width, image.height]),
            head: &self.head,
        }
    }
}

impl AlikedMaps<'_> {
    pub fn keypoints(&self) -> Vec<NetworkKeypoint> {
        let [width, height] = self.features.size;
        let peaks = self.scores.peaks(width, height, &PEAKS);
        peaks.iter().map(NetworkKeypoint::from).collect()
    }

    /// The descriptors at these pixels, one after the other.
    pub fn descriptors(&self, pixels: &[[f32; 2]]) -> Vec<f32> {
        self.head.describe(&self.features, pixels)
    }

    /// The highest score of a column, to be compared with that of other programs.
    pub fn highest_score(&self, column: usize) -> f32 {
        self.scores.highest(column, self.features.size[1])
    }
}
