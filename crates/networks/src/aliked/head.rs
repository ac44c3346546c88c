//! The head that makes descriptors: from the three by three pixels around a keypoint it says where to look, and what is seen at
//! these places together is the descriptor.

use rayon::prelude::*;

use super::features::Features;
use crate::convolution::{Convolution, Gate, Shape};
use crate::error::Damage;
use crate::keypoints::normalise;
use crate::tensor::{Tensor, cells_around};
use crate::weights::Weights;

/// Places that a descriptor looks at.
const PLACES: usize = 16;
/// Rows and columns of the patch that says where.
const SIDE: usize = 3;
const NAME: &str = "desc_head";

/// Names of the tensors it is made of.
pub(super) fn tensors() -> Vec<String> {
    let parts = [
        "offset_conv.0.weight",
        "offset_conv.0.bias",
        "offset_conv.2.weight",
        "offset_conv.2.bias",
        "sf_conv.weight",
        "agg_weights",
    ];
    parts.iter().map(|part| format!("{NAME}.{part}")).collect()
}

#[derive(Clone, Debug)]
pub(super) struct DescriptorHead {
    /// From a patch to `PLACES` offsets to the right, then as many down.
    offsets: [Convolution; 2],
    /// What is seen at each place.
    seen: Convolution,
    /// All places together.
    together: Convolution,
}

impl DescriptorHead {
    /// Of descriptors with this many values.
    pub fn read(weights: &Weights, values: usize) -> Result<Self, Damage> {
        let layer = |name: &str, outputs: usize, inputs: usize, side: usize| {
            let shape = Shape {
                outputs,
                inputs,
                side,
            };
            Convolution::read(weights, &format!("{NAME}.{name}.weight"), shape)
        };
        let bias = |name: &str| format!("{NAME}.{name}.bias");
        let first = layer("offset_conv.0", 2 * PLACES, values, SIDE)?;
        let second = layer("offset_conv.2", 2 * PLACES, 2 * PLACES, 1)?;
        let together = format!("{NAME}.agg_weights");
        Ok(Self {
            offsets: [
                first
                    .with_bias(weights, &bias("offset_conv.0"))?
                    .gated(Gate::Selu),
                second.with_bias(weights, &bias("offset_conv.2"))?,
            ],
            seen: layer("sf_conv", values, values, 1)?.gated(Gate::Selu),
            together: Convolution::product(weights, &together, &[PLACES, values, values])?,
        })
    }

    /// The descriptors at these pixels, one after the other.
    pub fn describe(&self, features: &Features, pixels: &[[f32; 2]]) -> Vec<f32> {
        let channels = features.channels();
        let patch_len = SIDE * SIDE * channels;
        let mut patches = vec![0.0; pixels.len() * patch_len];
        let targets = patches.par_chunks_exact_mut(patch_len).zip(pixels);
        targets.for_each(|(patch, pixel)| {
            let [left, top] = [0, 1].map(|axis| patch_begin(pixel[axis], features.size[axis]));
            for (place, target) in patch.chunks_exact_mut(channels).enumerate() {
                features.of_pixel(left + place % SIDE, top + place / SIDE, target);
            }
        });
        let [first, second] = &self.offsets;
        let offsets = second.apply(&first.apply_to_patches(&patches));
        let farthest = features.size[0].max(features.size[1]) as f32 / 4.0;
        let mut sampled = Tensor::zeros(pixels.len(), PLACES, channels);
        let targets = sampled.values.par_chunks_exact_mut(PLACES * channels);
        let all = targets.zip(pixels).enumerate();
        all.for_each(|(index, (target, pixel))| {
            let (right, down) = offsets.cell(index, 0).split_at(PLACES);
            let moves = right.iter().zip(down);
            let mut corner = vec![0.0; channels];
            for (target, (right, down)) in target.chunks_exact_mut(channels).zip(moves) {
                let at = [
                    pixel[0] + right.clamp(-farthest, farthest),
                    pixel[1] + down.clamp(-farthest, farthest),
                ];
                for around in cells_around(at, features.size) {
                    features.of_pixel(around.column, around.row, &mut corner);
                    for (sum, value) in target.iter_mut().zip(&corner) {
                        *sum += around.weight * value;
                    }
                }
            }
        });
        let seen = self.seen.apply(&sampled);
        let mut descriptors = self.together.apply_to_patches(&seen.values).values;
        descriptors.chunks_exact_mut(channels).for_each(normalise);
        descriptors
    }
}

/// Where the patch around a pixel begins along one axis of the image; the authors leave out the last patch that would fit.
fn patch_begin(pixel: f32, size: usize) -> usize {
    (pixel.max(0.0) as usize)
        .saturating_sub(1)
        .min(size.saturating_sub(SIDE + 1))
}
