use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

use crate::error::Damage;
use crate::tensor::Tensor;
use crate::weights::Weights;

/// Values of patches that are multiplied at a time: as many as a core's cache holds.
const PATCH_VALUES: usize = 1 << 17;
/// Added to variances before their roots are taken, as the networks were trained.
const BATCH_EPSILON: f32 = 1e-5;

/// A convolution with what follows it folded in: normalisation and rectification. Beyond the rim there are zeros.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    side: usize,
    stride: usize,
    inputs: usize,
    outputs: usize,
    /// For each input value of a patch, row by row, its weight in each output.
    weights: Vec<f32>,
    bias: Vec<f32>,
    rectified: bool,
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
            rectified: false,
        })
    }

    /// With the bias of tensor `name`.
    pub fn with_bias(mut self, weights: &Weights, name: &str) -> Result<Self, Damage> {
        self.bias = weights.tensor(name, &[self.outputs])?.to_vec();
        Ok(self)
    }

    /// Followed by the batch normalisation of this name, which may have scales and shifts of its own.
    pub fn normalised(
        mut self,
        weights: &Weights,
        name: &str,
        affine: Affine,
    ) -> Result<Self, Damage> {
        let column = |part: &str| weights.tensor(&format!("{name}.{part}"), &[self.outputs]);
        let (mean, variance) = (column("running_mean")?, column("running_var")?);
        let (scales, shifts) = match affine {
            Affine::Learned => (column("weight")?.to_vec(), column("bias")?.to_vec()),
            Affine::None => (vec![1.0; self.outputs], vec![0.0; self.outputs]),
        };
        for output in 0..self.outputs {
            let scale = scales[output] / (variance[output] + BATCH_EPSILON).sqrt();
            let of_output = self.weights.iter_mut().skip(output).step_by(self.outputs);
            of_output.for_each(|w| *w *= scale);
            self.bias[output] = (self.bias[output] - mean[output]) * scale + shifts[output];
        }
        Ok(self)
    }

    /// Evaluated at every `stride`-th cell.
    pub fn strided(mut self, stride: usize) -> Self {
        self.stride = stride;
        self
    }

    /// Followed by a rectification.
    pub fn rectified(mut self) -> Self {
        self.rectified = true;
        self
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

    /// The map convolved, in strips of rows.
    pub fn apply(&self, input: &Tensor) -> Tensor {
        let rim = self.side / 2;
        let length = |cells: usize| (cells + 2 * rim - self.side) / self.stride + 1;
        let (height, width) = (length(input.height), length(input.width));
        let mut output = Tensor::zeros(height, width, self.outputs);
        let patch_len = self.side * self.side * self.inputs;
        let rows_at_once = (PATCH_VALUES / (patch_len * width).max(1)).max(1);
        let strip_len = rows_at_once * width * self.outputs;
        let strips = output.values.par_chunks_mut(strip_len).enumerate();
        strips.for_each_init(Vec::new, |patches, (strip, target)| {
            let first = strip * rows_at_once;
            let rows = target.len() / (width * self.outputs);
            let cells = rows * width;
            let values = if self.side == 1 && self.stride == 1 {
                &input.values[first * width * self.inputs..][..cells * self.inputs]
            } else {
                self.collect_patches(input, first..first + rows, width, patches);
                &patches[..]
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
                    if self.rectified {
                        *value = value.max(0.0);
                    }
                }
            }
        });
        output
    }

    /// What each output cell of these rows sees, one after the other.
    fn collect_patches(
        &self,
        input: &Tensor,
        rows: std::ops::Range<usize>,
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

/// Whether a batch normalisation has scales and shifts of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Affine {
    None,
    Learned,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the definition, one value at a time.
    fn plain(input: &Tensor, weights: &[f32], shape: Shape, stride: usize) -> Vec<f32> {
        let rim = shape.side / 2;
        let length = |cells: usize| (cells + 2 * rim - shape.side) / stride + 1;
        let mut values = Vec::new();
        for row in 0..length(input.height) {
            for column in 0..length(input.width) {
                for output in 0..shape.outputs {
                    let mut sum = 0.0;
                    for c in 0..shape.inputs {
                        for y in 0..shape.side {
                            for x in 0..shape.side {
                                let (v, u) = (row * stride + y, column * stride + x);
                                let inside = v >= rim
                                    && u >= rim
                                    && v - rim < input.height
                                    && u - rim < input.width;
                                if inside {
                                    let weight = ((output * shape.inputs + c) * shape.side + y)
                                        * shape.side
                                        + x;
                                    sum += weights[weight] * input.cell(v - rim, u - rim)[c];
                                }
                            }
                        }
                    }
                    values.push(sum);
                }
            }
        }
        values
    }

    #[test]
    fn agrees_with_the_definition() {
        let number = |i: usize| ((i * 7919 + 13) % 101) as f32 / 50.0 - 1.0;
        for (side, stride, height, width) in
            [(3, 1, 7, 5), (3, 2, 8, 9), (1, 1, 4, 6), (3, 2, 1, 1)]
        {
            let shape = Shape {
                outputs: 5,
                inputs: 3,
                side,
            };
            let input = Tensor {
                height,
                width,
                channels: 3,
                values: (0..height * width * 3).map(number).collect(),
            };
            let values: Vec<f32> = (0..5 * 3 * side * side).map(|i| number(i + 1000)).collect();
            let weights =
                Weights::from_tensors([("w".to_owned(), vec![5, 3, side, side], values.clone())]);
            let convolution = Convolution::read(&weights, "w", shape).expect("there");
            let found = convolution.strided(stride).apply(&input);
            let expected = plain(&input, &values, shape, stride);
            assert_eq!(found.values.len(), expected.len());
            for (a, b) in found.values.iter().zip(&expected) {
                assert!((a - b).abs() < 1e-4, "{side} {stride}: {a} {b}");
            }
        }
    }
}
