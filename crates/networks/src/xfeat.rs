//! XFeat (Potje et al., "XFeat: Accelerated features for lightweight image matching", CVPR 2024): a score for every pixel, a
//! descriptor and its reliability for every eight by eight.

use crate::Grey;
use crate::convolution::{Affine, Convolution, Gate, Shape};
use crate::error::Damage;
use crate::keypoints::{CELL_PX, NetworkKeypoint, PeakSearch, Scores, normalise, sigmoid};
use crate::tensor::{Between, Pooling, Tensor};
use crate::weights::Weights;

/// Values of a descriptor.
pub(crate) const DESCRIPTOR_LEN: usize = 64;
/// Sides of images are multiples of this.
const GRAIN_PX: usize = 32;
/// Added to the variance of an image.
const EPSILON: f32 = 1e-5;
/// Of the authors' detector. The scores of a cell sum up to one, so peaks are sharp: their neighbours hardly move them.
const PEAKS: PeakSearch = PeakSearch {
    radius: 2,
    min_score: 0.05,
    temperature: 0.1,
};
/// Of the cubic interpolation of descriptors.
const CUBIC: f32 = -0.75;

/// Layers of each block: outputs, inputs, side, stride.
type Layers = &'static [(usize, usize, usize, usize)];
const BLOCK1: Layers = &[(4, 1, 3, 1), (8, 4, 3, 2), (8, 8, 3, 1), (24, 8, 3, 2)];
const BLOCK2: Layers = &[(24, 24, 3, 1), (24, 24, 3, 1)];
const BLOCK3: Layers = &[(64, 24, 3, 2), (64, 64, 3, 1), (64, 64, 1, 1)];
const BLOCK4: Layers = &[(64, 64, 3, 2), (64, 64, 3, 1), (64, 64, 3, 1)];
const BLOCK5: Layers = &[
    (128, 64, 3, 2),
    (128, 128, 3, 1),
    (128, 128, 3, 1),
    (64, 128, 1, 1),
];
const FUSION: Layers = &[(64, 64, 3, 1), (64, 64, 3, 1)];
const HEATMAP: Layers = &[(64, 64, 1, 1), (64, 64, 1, 1)];
const KEYPOINTS: Layers = &[(64, 64, 1, 1), (64, 64, 1, 1), (64, 64, 1, 1)];
const BLOCKS: [(&str, Layers); 8] = [
    ("block1", BLOCK1),
    ("block2", BLOCK2),
    ("block3", BLOCK3),
    ("block4", BLOCK4),
    ("block5", BLOCK5),
    ("block_fusion", FUSION),
    ("heatmap_head", HEATMAP),
    ("keypoint_head", KEYPOINTS),
];
/// Convolutions with a bias and nothing after them: name, outputs, inputs.
const PLAIN: [(&str, usize, usize); 4] = [
    ("skip1.1", 24, 1),
    ("block_fusion.2", DESCRIPTOR_LEN, 64),
    ("heatmap_head.2", 1, 64),
    ("keypoint_head.3", CELL_PX * CELL_PX + 1, 64),
];

/// Names of the tensors it is made of.
pub(crate) fn tensors() -> Vec<String> {
    let blocks = BLOCKS.iter().flat_map(|(block, layers)| {
        (0..layers.len()).flat_map(move |i| {
            ["0.weight", "1.running_mean", "1.running_var"]
                .map(|part| format!("{block}.{i}.layer.{part}"))
        })
    });
    let plain = PLAIN.iter();
    let plain =
        plain.flat_map(|(name, ..)| ["weight", "bias"].map(|part| format!("{name}.{part}")));
    blocks.chain(plain).collect()
}

/// The network.
#[derive(Clone, Debug)]
pub(crate) struct XFeat {
    blocks: [Vec<Convolution>; 8],
    plain: [Convolution; 4],
}

/// What it says of an image.
pub(crate) struct XFeatMaps {
    width: usize,
    height: usize,
    scores: Scores,
    reliability: Tensor,
    /// Of unit length.
    descriptors: Tensor,
}

impl XFeat {
    pub fn read(weights: &Weights) -> Result<Self, Damage> {
        let block = |(name, layers): (&str, Layers)| -> Result<Vec<Convolution>, Damage> {
            let layers = layers.iter().enumerate();
            layers
                .map(|(i, &(outputs, inputs, side, stride))| {
                    let shape = Shape {
                        outputs,
                        inputs,
                        side,
                    };
                    let name = format!("{name}.{i}.layer");
                    let read = Convolution::read(weights, &format!("{name}.0.weight"), shape)?;
                    let read = read.normalised(weights, &format!("{name}.1"), Affine::None)?;
                    Ok(read.strided(stride).gated(Gate::Relu))
                })
                .collect()
        };
        let plain = |(name, outputs, inputs): (&str, usize, usize)| {
            let shape = Shape {
                outputs,
                inputs,
                side: 1,
            };
            Convolution::read(weights, &format!("{name}.weight"), shape)?
                .with_bias(weights, &format!("{name}.bias"))
        };
        let [a, b, c, d, e, f, g, h] = BLOCKS.map(block);
        let [i, j, k, l] = PLAIN.map(plain);
        Ok(Self {
            blocks: [a?, b?, c?, d?, e?, f?, g?, h?],
            plain: [i?, j?, k?, l?],
        })
    }

    pub fn run(&self, image: &Grey) -> XFeatMaps {
        let [
            block1,
            block2,
            block3,
            block4,
            block5,
            fusion,
            heatmap,
            keypoints,
        ] = &self.blocks;
        let [skip, fused, reliable, corners] = &self.plain;
        let through = |layers: &[Convolution], map: &Tensor| {
            let mut map = map.clone();
            for layer in layers {
                map = layer.apply(&map);
            }
            map
        };
        let input = normalised(image);
        let mut fine = through(block1, &input);
        fine.add(&skip.apply(&input.pooled(4, Pooling::Mean)));
        let fine = through(block2, &fine);
        let mut sum = through(block3, &fine);
        let medium = through(block4, &sum);
        let coarse = through(block5, &medium);
        let (rows, columns) = (sum.height, sum.width);
        sum.add(&medium.enlarged(rows, columns));
        sum.add(&coarse.enlarged(rows, columns));
        let mut descriptors = fused.apply(&through(fusion, &sum));
        let mut reliability = reliable.apply(&through(heatmap, &descriptors));
        reliability.values.iter_mut().for_each(|v| *v = sigmoid(*v));
        for cell in descriptors.values.chunks_exact_mut(DESCRIPTOR_LEN) {
            normalise(cell);
        }
        let logits = corners.apply(&through(keypoints, &unfolded(&input)));
        XFeatMaps {
            width: image.width,
            height: image.height,
            scores: Scores::of_cells(&logits),
            reliability,
            descriptors,
        }
    }
}

/// The image with mean 0 and variance 1, and its last rows and columns repeated until its sides are multiples of the grain.
fn normalised(image: &Grey) -> Tensor {
    let count = image.values.len().max(1) as f64;
    let mean = image.values.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
    let squares = image.values.iter().map(|v| (f64::from(*v) - mean).powi(2));
    let scale = 1.0 / ((squares.sum::<f64>() / count) as f32 + EPSILON).sqrt();
    let mut padded = image.padded(GRAIN_PX);
    padded
        .values
        .iter_mut()
        .for_each(|v| *v = (*v - mean as f32) * scale);
    padded
}

/// The pixels of each cell, row by row, as its channels.
fn unfolded(input: &Tensor) -> Tensor {
    let (rows, columns) = (input.height / CELL_PX, input.width / CELL_PX);
    let mut cells = Tensor::zeros(rows, columns, CELL_PX * CELL_PX);
    let each = cells.values.chunks_exact_mut(CELL_PX * CELL_PX).enumerate();
    for (index, cell) in each {
        let (top, left) = (index / columns * CELL_PX, index % columns * CELL_PX);
        for (y, row) in cell.chunks_exact_mut(CELL_PX).enumerate() {
            let from = (top + y) * input.width + left;
            row.copy_from_slice(&input.values[from..from + CELL_PX]);
        }
    }
    cells
}

impl XFeatMaps {
    pub fn keypoints(&self) -> Vec<NetworkKeypoint> {
        let peaks = self.scores.peaks(self.width, self.height, &PEAKS);
        let peaks = peaks.into_iter();
        peaks
            .map(|peak| {
                let mut reliability = [0.0];
                let [row, column] = [
                    self.cell_of(peak.row as f32, self.reliability.height),
                    self.cell_of(peak.column as f32, self.reliability.width),
                ];
                let row = Between::new(row, self.reliability.height);
                let column = Between::new(column, self.reliability.width);
                self.reliability.between(&row, &column, &mut reliability);
                NetworkKeypoint {
                    pixel: peak.pixel,
                    score: peak.score * reliability[0],
                }
            })
            .collect()
    }

    /// Where a pixel lies among `cells`, which reach from the first to the last pixel.
    fn cell_of(&self, pixel: f32, cells: usize) -> f32 {
        let last_px = (cells * CELL_PX - 1) as f32;
        pixel / last_px * cells as f32 - 0.5
    }

    /// The descriptor at a pixel, cubic between the cells.
    pub fn descriptor(&self, pixel: [f32; 2]) -> [f32; DESCRIPTOR_LEN] {
        let map = &self.descriptors;
        let x = self.cell_of(pixel[0], map.width);
        let y = self.cell_of(pixel[1], map.height);
        let (left, top) = (x.floor(), y.floor());
        let (across, down) = (cubic_weights(x - left), cubic_weights(y - top));
        let index = |first: f32, step: usize, count: usize| {
            (first as i64 - 1 + step as i64).clamp(0, count as i64 - 1) as usize
        };
        let mut descriptor = [0.0; DESCRIPTOR_LEN];
        for (i, vertical) in down.iter().enumerate() {
            for (j, horizontal) in across.iter().enumerate() {
                let cell = map.cell(index(top, i, map.height), index(left, j, map.width));
                for (sum, value) in descriptor.iter_mut().zip(cell) {
                    *sum += vertical * horizontal * value;
                }
            }
        }
        normalise(&mut descriptor);
        descriptor
    }

    /// The highest score of a column, to be compared with that of other programs.
    pub fn highest_score(&self, column: usize) -> f32 {
        let cell = column / CELL_PX;
        let score = |row: usize| {
            self.scores.at(column, row) * self.reliability.cell(row / CELL_PX, cell)[0]
        };
        (0..self.height).map(score).fold(0.0, f32::max)
    }

    /// A channel of the descriptor of the cell around a pixel, to be compared with that of other programs.
    pub fn channel(&self, column: usize, row: usize, channel: usize) -> f32 {
        self.descriptors.cell(row / CELL_PX, column / CELL_PX)[channel]
    }
}

/// Weights of four cells for a place `share` after the second of them (Keys, IEEE ASSP 1981).
fn cubic_weights(share: f32) -> [f32; 4] {
    let near = |x: f32| ((CUBIC + 2.0) * x - (CUBIC + 3.0)) * x * x + 1.0;
    let far = |x: f32| ((CUBIC * x - 5.0 * CUBIC) * x + 8.0 * CUBIC) * x - 4.0 * CUBIC;
    [
        far(share + 1.0),
        near(share),
        near(1.0 - share),
        far(2.0 - share),
    ]
}
