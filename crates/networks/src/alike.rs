//! ALIKE-t (Zhao et al., "ALIKE: Accurate and lightweight keypoint detection and descriptor extraction", IEEE TMM 2022): a score and
//! a descriptor for every pixel, both linear in four maps of different fineness.
//!
//! The authors enlarge all four maps to the size of the image and multiply them there. As enlarging and multiplying may change
//! places, the score is multiplied first, and descriptors are made where there are keypoints alone: the same numbers, less work.

use crate::Grey;
use crate::convolution::{Affine, Convolution, Gate, Shape};
use crate::error::Damage;
use crate::keypoints::{NetworkKeypoint, PeakSearch, Scores, normalise, sigmoid};
use crate::tensor::{Between, Pooling, Tensor};
use crate::weights::Weights;

/// Values of a descriptor.
pub(crate) const DESCRIPTOR_LEN: usize = 64;
/// Sides of images are multiples of this.
const GRAIN_PX: usize = 32;
/// Of the authors' detector, but for the least score: which of the weaker ones are kept is up to who asks.
const PEAKS: PeakSearch = PeakSearch {
    radius: 2,
    min_score: 0.05,
    temperature: 0.1,
};
/// Channels of the four blocks, and by how much each is coarser than the one before.
const CHANNELS: [usize; 4] = [8, 16, 32, 64];
const POOLED: [usize; 4] = [1, 2, 4, 4];
/// Channels that each of the four maps gives.
const SHARED: usize = 16;

/// Names of the tensors it is made of.
pub(crate) fn tensors() -> Vec<String> {
    let mut names = vec!["convhead2.weight".to_owned()];
    names.extend(backbone_tensors(|_| &["weight"]));
    names
}

/// Names of the tensors of the four blocks, in which ALIKE and ALIKED are alike but for `parts` of the convolutions of a block.
pub(crate) fn backbone_tensors(parts: impl Fn(usize) -> &'static [&'static str]) -> Vec<String> {
    let mut names = Vec::new();
    for block in 1..=4 {
        names.push(format!("conv{block}.weight"));
        for half in 1..=2 {
            let parts = parts(block).iter();
            names.extend(parts.map(|part| format!("block{block}.conv{half}.{part}")));
            let parts = ["weight", "bias", "running_mean", "running_var"];
            names.extend(parts.map(|part| format!("block{block}.bn{half}.{part}")));
        }
        if block > 1 {
            names.extend(["weight", "bias"].map(|p| format!("block{block}.downsample.{p}")));
        }
    }
    names
}

/// The network.
#[derive(Clone, Debug)]
pub(crate) struct Alike {
    blocks: Vec<Block>,
    /// For each channel of the descriptor and the score, its weights in the four maps.
    head: Vec<f32>,
}

#[derive(Clone, Debug)]
struct Block {
    first: Convolution,
    second: Convolution,
    /// What by-passes both, but in the first block.
    bypass: Option<Convolution>,
    /// What its map gives to the head.
    shared: Convolution,
}

/// What it says of an image.
pub(crate) struct AlikeMaps<'a> {
    width: usize,
    height: usize,
    head: &'a [f32],
    scores: Scores,
    /// From fine to coarse.
    maps: Vec<Tensor>,
}

impl Alike {
    pub fn read(weights: &Weights) -> Result<Self, Damage> {
        let head_shape = [DESCRIPTOR_LEN + 1, CHANNELS.len() * SHARED, 1, 1];
        let head = weights.tensor("convhead2.weight", &head_shape)?.to_vec();
        let mut blocks = Vec::new();
        for (index, &outputs) in CHANNELS.iter().enumerate() {
            let name = format!("block{}", index + 1);
            let inputs = if index == 0 { 3 } else { CHANNELS[index - 1] };
            let half =
                |half: usize, inputs: usize| {
                    let shape = Shape {
                        outputs,
                        inputs,
                        side: 3,
                    };
                    Convolution::read(weights, &format!("{name}.conv{half}.weight"), shape)?
                        .normalised(weights, &format!("{name}.bn{half}"), Affine::Learned)
                };
            let (mut first, mut second) = (half(1, inputs)?.gated(Gate::Relu), half(2, outputs)?);
            let mut bypass = None;
            if index == 0 {
                // Red, green and blue of a grey image are the same.
                first = first.of_equal_inputs();
                second = second.gated(Gate::Relu);
            } else {
                let shape = Shape {
                    outputs,
                    inputs,
                    side: 1,
                };
                let read = Convolution::read(weights, &format!("{name}.downsample.weight"), shape)?;
                bypass = Some(read.with_bias(weights, &format!("{name}.downsample.bias"))?);
            }
            let shape = Shape {
                outputs: SHARED,
                inputs: outputs,
                side: 1,
            };
            let shared = Convolution::read(weights, &format!("conv{}.weight", index + 1), shape)?;
            blocks.push(Block {
                first,
                second,
                bypass,
                shared: shared.gated(Gate::Relu),
            });
        }
        Ok(Self { blocks, head })
    }

    pub fn run(&self, image: &Grey) -> AlikeMaps<'_> {
        let mut map = image.padded(GRAIN_PX);
        let (height, width) = (map.height, map.width);
        let mut maps: Vec<Tensor> = Vec::new();
        for (block, pooled) in self.blocks.iter().zip(POOLED) {
            if pooled > 1 {
                map = map.pooled(pooled, Pooling::Largest);
            }
            let mut next = block.second.apply(&block.first.apply(&map));
            if let Some(bypass) = &block.bypass {
                next.add(&bypass.apply(&map));
                Gate::Relu.apply(&mut next.values);
            }
            maps.push(block.shared.apply(&next));
            map = next;
        }
        let mut logits = Tensor::zeros(height, width, 1);
        let score_weights = &self.head[DESCRIPTOR_LEN * CHANNELS.len() * SHARED..];
        for (map, weights) in maps.iter().zip(score_weights.chunks_exact(SHARED)) {
            let cells = map.values.chunks_exact(SHARED);
            logits.add_stretched(&Tensor {
                height: map.height,
                width: map.width,
                channels: 1,
                values: cells.map(|cell| dot(cell, weights)).collect(),
            });
        }
        let mut scores = logits.values;
        scores.iter_mut().for_each(|v| *v = sigmoid(*v));
        AlikeMaps {
            width: image.width,
            height: image.height,
            head: &self.head,
            scores: Scores {
                width,
                values: scores,
            },
            maps,
        }
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl AlikeMaps<'_> {
    pub fn keypoints(&self) -> Vec<NetworkKeypoint> {
        let peaks = self.scores.peaks(self.width, self.height, &PEAKS);
        peaks.iter().map(NetworkKeypoint::from).collect()
    }

    /// The descriptor of a whole pixel.
    fn of_pixel(&self, column: usize, row: usize) -> [f32; DESCRIPTOR_LEN] {
        let (height, width) = (
            self.scores.values.len() / self.scores.width,
            self.scores.width,
        );
        let mut shared = [0.0; CHANNELS.len() * SHARED];
        for (map, target) in self.maps.iter().zip(shared.chunks_exact_mut(SHARED)) {
            let place = |pixel: usize, pixels: usize, cells: usize| {
                let ratio = (cells - 1) as f32 / (pixels - 1) as f32;
                Between::new(pixel as f32 * ratio, cells)
            };
            let row = place(row, height, map.height);
            let column = place(column, width, map.width);
            map.between(&row, &column, target);
        }
        let mut descriptor = [0.0; DESCRIPTOR_LEN];
        let weights = self.head.chunks_exact(shared.len());
        for (value, weights) in descriptor.iter_mut().zip(weights) {
            *value = dot(weights, &shared);
        }
        normalise(&mut descriptor);
        descriptor
    }

    /// The descriptor at a pixel, linear between those of whole pixels.
    pub fn descriptor(&self, pixel: [f32; 2]) -> [f32; DESCRIPTOR_LEN] {
        let column = Between::new(pixel[0], self.width);
        let row = Between::new(pixel[1], self.height);
        let mut descriptor = [0.0; DESCRIPTOR_LEN];
        for (y, vertical) in [(row.first, 1.0 - row.share), (row.second, row.share)] {
            for (x, horizontal) in [
                (column.first, 1.0 - column.share),
                (column.second, column.share),
            ] {
                let here = self.of_pixel(x, y);
                for (sum, value) in descriptor.iter_mut().zip(here) {
                    *sum += vertical * horizontal * value;
                }
            }
        }
        normalise(&mut descriptor);
        descriptor
    }

    /// The highest score of a column, to be compared with that of other programs.
    pub fn highest_score(&self, column: usize) -> f32 {
        self.scores.highest(column, self.height)
    }

    /// A channel of the descriptor of a pixel, to be compared with that of other programs.
    pub fn channel(&self, column: usize, row: usize, channel: usize) -> f32 {
        self.of_pixel(column, row)[channel]
    }
}
