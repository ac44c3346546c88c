use std::ops::Range;

use super::{Affine, Convolution, Gate, Patches, Shape};
use crate::error::Damage;
use crate::tensor::Tensor;
use crate::weights::Weights;

/// Values of a patch of three by three cells.
const SIDE: usize = 3;

/// A convolution of three by three cells, each of which is looked up where another convolution says (Dai et al., "Deformable
/// convolutional networks", ICCV 2017). Beyond the rim there are zeros.
#[derive(Clone, Debug)]
pub(crate) struct DeformableConvolution {
    /// For each cell of a patch how far down and to the right of its place it is looked up, in cells.
    offsets: Convolution,
    regular: Convolution,
}

impl DeformableConvolution {
    /// From the tensors of this name, followed by a batch normalisation and a gate.
    pub fn read(
        weights: &Weights,
        name: &str,
        [inputs, outputs]: [usize; 2],
        normalisation: &str,
        gate: Gate,
    ) -> Result<Self, Damage> {
        let shape = |outputs| Shape {
            outputs,
            inputs,
            side: SIDE,
        };
        let offsets = format!("{name}.offset_conv");
        let regular = format!("{name}.regular_conv.weight");
        let two_per_cell = shape(2 * SIDE * SIDE);
        Ok(Self {
            offsets: Convolution::read(weights, &format!("{offsets}.weight"), two_per_cell)?
                .with_bias(weights, &format!("{offsets}.bias"))?,
            regular: Convolution::read(weights, &regular, shape(outputs))?
                .normalised(weights, normalisation, Affine::Learned)?
                .gated(gate),
        })
    }

    /// The map convolved.
    pub fn apply(&self, input: &Tensor) -> Tensor {
        let mut offsets = self.offsets.apply(input);
        let farthest = input.height.max(input.width) as f32 / 4.0;
        let all = offsets.values.iter_mut();
        all.for_each(|offset| *offset = offset.clamp(-farthest, farthest));
        let collect = |rows: Range<usize>, patches: &mut Vec<f32>| {
            patches.clear();
            let cells = rows.len() * input.width;
            patches.resize(cells * SIDE * SIDE * input.channels, 0.0);
            let mut targets = patches.chunks_exact_mut(input.channels);
            for row in rows {
                for column in 0..input.width {
                    let (moves, _) = offsets.cell(row, column).as_chunks::<2>();
                    for (place, [down, right]) in moves.iter().enumerate() {
                        let Some(target) = targets.next() else { return };
                        let y = (row + place / SIDE) as f32 - 1.0 + down;
                        let x = (column + place % SIDE) as f32 - 1.0 + right;
                        input.add_sample([x, y], target);
                    }
                }
            }
        };
        let patches = Patches::Collected(&collect);
        self.regular.multiply(input.height, input.width, &patches)
    }
}
