//! Convolutions with what follows them, as products of matrices in strips of rows.

mod deformable;
mod gate;
mod normalisation;
#[cfg(test)]
mod tests;

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

use crate::error::Damage;
use crate::tensor::Tensor;
use crate::weights::Weights;
pub(crate) use deformable::DeformableConvolution;
pub(crate) use gate::Gate;
pub(crate) use normalisation::{Affine, Normalisation};

/// Values of patches that are multiplied at a time: as many as a core's cache holds.
const PATCH_VALUES: usize = 1 << 17;
/// Added to variances before their roots are taken, as the networks were trained.
const BATCH_EPSILON: f32 = 1e-5;

/// A convolution with what follows it folded in: normalisation and gate. Beyond the rim there are zeros.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    side: usize,
    stride: usize,
    inputs: usize,
    outputs: usize,
    /// For each input value of a patch, row by row, its weight in each output.
    weights: Vec<f32>,
    bias: Vec<f32>,
    gate: Gate,
}

/// The shape of a convolution.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub outputs: usize,
    pub inputs: usize,
    pub side: usize,
}

impl Convolution {
    /// From tensor `name` (outputs × inputs × rows × columns), without bias, not rectified.
    pub fn read(weights: &Weights, name: &str, shape: Shape) -> Result<Self, Damage> {
        let Shape {
            outputs,
            inputs,
            side,
        } = shape;
        let values = weights.tensor(name, &[outputs, inputs, side, side])?;
        let mut sorted = vec![0.0; values.len()];
        for (index, value) in values.iter().enumerate() {
            let (place, rest) = (index % (side * side), index / (side * side));
            let (input, output) = (rest % inputs, rest / inputs);
            sorted[(place * inputs + input) * outputs + output] = *value;
        }
        Ok(Self {
            side,
            stride: 1,
            inputs,
            outputs,
            weights: sorted,
            bias: vec![0.0; outputs],
            gate: Gate::None,
        })
    }

    /// With the bias of tensor `name`.
    pub fn with_bias(mut self, weights: &Weights, name: &str) -> Result<Self, Damage> {
        self.bias = weights.tensor(name, &[self.outputs])?.to_vec();
        Ok(self)
    }

    /// Followed by the batch normalisation of this name, which may have scales and shifts of its own. Where it has no statistics, it
    /// has been folded into the weights, and there is a bias.
    pub fn normalised(
        mut self,
        weights: &Weights,
        name: &str,
        affine: Affine,
    ) -> Result<Self, Damage> {
        if !weights.has(&format!("{name}.running_mean")) {
            return self.with_bias(weights, &format!("{name}.bias"));
        }
        let folded = Normalisation::read(weights, name, self.outputs, affine, BATCH_EPSILON)?;
        for cell in self.weights.chunks_exact_mut(self.outputs) {
            for (weight, scale) in cell.iter_mut().zip(&folded.scales) {
                *weight *= scale;
            }
        }
        folded.apply_to(&mut self.bias);
        Ok(self)
    }

    /// Evaluated at every `stride`-th cell.
    pub fn strided(mut self, stride: usize) -> Self {
        self.stride = stride;
        self
    }

    /// Followed by a gate.
    pub fn gated(mut self, gate: Gate) -> Self {
        self.gate = gate;
        self
    }

    /// Of an input of one cell per output: the part that these of its channels have in it.
    pub fn of_channels(&self, channels: Range<usize>) -> Self {
        let weights = self.outputs * channels.start..self.outputs * channels.end;
        Self {
            inputs: channels.len(),
            weights: self.weights.get(weights).unwrap_or_default().to_vec(),
            ..self.clone()
        }
    }

    /// A product with the matrix in tensor `name`: `shape.inputs` rows of `shape.outputs` values.
    pub fn product(weights: &Weights, name: &str, dimensions: &[usize]) -> Result<Self, Damage> {
        let values = weights.tensor(name, dimensions)?;
        let outputs = dimensions.last().copied().unwrap_or(1).max(1);
        Ok(Self {
            side: 1,
            stride: 1,
            inputs: values.len() / outputs,
            outputs,
            weights: values.to_vec(),
            bias: vec![0.0; outputs],
            gate: Gate::None,
        })
    }

    /// For inputs that are all the same: one of them, with the sum of their weights.
    pub fn of_equal_inputs(mut self) -> Self {
        let (inputs, outputs) = (self.inputs, self.outputs);
        let places = self.weights.chunks_exact(inputs * outputs);
        self.weights = places
            .flat_map(|place| {
                (0..outputs).map(|output| place.iter().skip(output).step_by(outputs).sum())
            })
            .collect();
        self.inputs = 1;
        self
    }

    /// The map convolved.
    pub fn apply(&self, input: &Tensor) -> Tensor {
        let rim = self.side / 2;
        let length = |cells: usize| (cells + 2 * rim - self.side) / self.stride + 1;
        let (height, width) = (length(input.height), length(input.width));
        if self.side == 1 && self.stride == 1 {
            return self.multiply(height, width, &Patches::Ready(&input.values));
        }
        let collect = |rows: Range<usize>, patches: &mut Vec<f32>| {
            self.collect_patches(input, rows, width, patches);
        };
        self.multiply(height, width, &Patches::Collected(&collect))
    }

    /// Of patches that were collected elsewhere, one cell each.
    pub fn apply_to_patches(&self, patches: &[f32]) -> Tensor {
        let count = patches.len() / self.patch_len().max(1);
        self.multiply(count, 1, &Patches::Ready(patches))
    }

    fn patch_len(&self) -> usize {
        self.side * self.side * self.inputs
    }

    /// The weights times each patch, in strips of rows.
    fn multiply(&self, height: usize, width: usize, patches: &Patches) -> Tensor {
        let mut output = Tensor::zeros(height, width, self.outputs);
        let patch_len = self.patch_len();
        let rows_at_once = (PATCH_VALUES / (patch_len * width).max(1)).max(1);
        let strip_len = (rows_at_once * width * self.outputs).max(1);
        let strips = output.values.par_chunks_mut(strip_len).enumerate();
        strips.for_each_init(Vec::new, |collected, (strip, target)| {
            let first = strip * rows_at_once;
            let cells = target.len() / self.outputs;
            let values = match patches {
                Patches::Ready(values) => &values[first * width * patch_len..][..cells * patch_len],
                Patches::Collected(collect) => {
                    collect(first..first + cells / width, collected);
                    &collected[..]
                }
            };
            matmul(
                MatMut::from_column_major_slice_mut(target, self.outputs, cells),
                Accum::Replace,
                MatRef::from_column_major_slice(&self.weights, self.outputs, patch_len),
                MatRef::from_column_major_slice(values, patch_len, cells),
                1.0,
                Par::Seq,
            );
            for cell in target.chunks_exact_mut(self.outputs) {
                for (value, bias) in cell.iter_mut().zip(&self.bias) {
                    *value += bias;
                }
            }
            self.gate.apply(target);
        });
        output
    }

    /// What each output cell of these rows sees, one after the other.
    fn collect_patches(
        &self,
        input: &Tensor,
        rows: Range<usize>,
        width: usize,
        patches: &mut Vec<f32>,
    ) {
        let rim = self.side / 2;
        let row_len = self.side * self.inputs;
        patches.clear();
        patches.resize(rows.len() * width * self.side * row_len, 0.0);
        let mut next = patches.chunks_exact_mut(row_len);
        for row in rows {
            for column in 0..width {
                let left = column * self.stride;
                for step in 0..self.side {
                    let Some(target) = next.next() else { return };
                    let Some(above) = (row * self.stride + step).checked_sub(rim) else {
                        continue;
                    };
                    if above >= input.height {
                        continue;
                    }
                    // Columns left - rim … left - rim + side, as far as they are there.
                    let skipped = rim.saturating_sub(left);
                    let from = left + skipped - rim;
                    let count = (self.side - skipped).min(input.width - from);
                    let source = &input.values[(above * input.width + from) * self.inputs..];
                    let target = &mut target[skipped * self.inputs..][..count * self.inputs];
                    target.copy_from_slice(&source[..target.len()]);
                }
            }
        }
    }
}

/// What each output cell sees, one after the other.
enum Patches<'a> {
    Ready(&'a [f32]),
    /// Put together for some rows at a time.
    Collected(&'a (dyn Fn(Range<usize>, &mut Vec<f32>) + Sync)),
}
