//! SuperPoint (DeTone et al., "SuperPoint: Self-supervised interest point detection and description", CVPR workshops 2018): a score for
//! every pixel, a descriptor for every eight by eight. Two files are known: Magic Leap's, and SuperPoint-Open, trained again by
//! others, which normalises behind each gate.

#[cfg(test)]
mod tests;

use crate::Grey;
use crate::convolution::{Affine, Convolution, Gate, Normalisation, Shape};
use crate::error::Damage;
use crate::keypoints::{CELL_PX, NetworkKeypoint, PeakSearch, Scores, normalise};
use crate::tensor::{Between, Pooling, Tensor};
use crate::weights::Weights;

/// Values of a descriptor.
pub(crate) const DESCRIPTOR_LEN: usize = 256;
/// Of the authors' detector; so low a temperature leaves keypoints on whole pixels, as theirs are.
const PEAKS: PeakSearch = PeakSearch {
    radius: 4,
    min_score: 0.005,
    temperature: 1e-4,
};
/// Added to variances in SuperPoint-Open.
const OPEN_EPSILON: f32 = 1e-3;

/// Layers of the backbone: outputs, and whether the map is made half as large before.
const BACKBONE: [(usize, bool); 8] = [
    (64, false),
    (64, false),
    (64, true),
    (64, false),
    (128, true),
    (128, false),
    (128, true),
    (128, false),
];
/// Layers of each head: outputs, side. The first has a gate.
const DETECTOR: [(usize, usize); 2] = [(256, 3), (CELL_PX * CELL_PX + 1, 1)];
const DESCRIPTOR: [(usize, usize); 2] = [(256, 3), (DESCRIPTOR_LEN, 1)];

/// Whose file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Author {
    MagicLeap,
    Open,
}

impl Author {
    /// Names of the layers: the backbone, then detector, then descriptor.
    fn layers(self) -> [&'static str; 12] {
        match self {
            Self::MagicLeap => [
                "conv1a", "conv1b", "conv2a", "conv2b", "conv3a", "conv3b", "conv4a", "conv4b",
                "convPa", "convPb", "convDa", "convDb",
            ],
            Self::Open => [
                "backbone.0.0",
                "backbone.0.1",
                "backbone.1.0",
                "backbone.1.1",
                "backbone.2.0",
                "backbone.2.1",
                "backbone.3.0",
                "backbone.3.1",
                "detector.0",
                "detector.1",
                "descriptor.0",
                "descriptor.1",
            ],
        }
    }

    /// Names of the tensors it is made of.
    pub fn tensors(self) -> Vec<String> {
        let parts: &[&str] = match self {
            Self::MagicLeap => &["weight", "bias"],
            Self::Open => &[
                "conv.weight",
                "conv.bias",
                "bn.weight",
                "bn.bias",
                "bn.running_mean",
                "bn.running_var",
            ],
        };
        let layers = self.layers().into_iter();
        layers
            .flat_map(|layer| parts.iter().map(move |part| format!("{layer}.{part}")))
            .collect()
    }
}

/// The network.
#[derive(Clone, Debug)]
pub(crate) struct SuperPoint {
    backbone: Vec<Layer>,
    detector: Vec<Layer>,
    descriptor: Vec<Layer>,
}

/// A convolution with its gate, and what may follow the gate.
#[derive(Clone, Debug)]
struct Layer {
    convolution: Convolution,
    normalisation: Option<Normalisation>,
}

impl Layer {
    fn read(
        weights: &Weights,
        author: Author,
        name: &str,
        shape: Shape,
        gate: Gate,
    ) -> Result<Self, Damage> {
        let (convolution, normalisation) = match author {
            Author::MagicLeap => (name.to_owned(), None),
            Author::Open => {
                let name_of = format!("{name}.bn");
                let read = Normalisation::read(
                    weights,
                    &name_of,
                    shape.outputs,
                    Affine::Learned,
                    OPEN_EPSILON,
                );
                (format!("{name}.conv"), Some(read?))
            }
        };
        let read = Convolution::read(weights, &format!("{convolution}.weight"), shape)?;
        let read = read.with_bias(weights, &format!("{convolution}.bias"))?;
        Ok(Self {
            convolution: read.gated(gate),
            normalisation,
        })
    }

    fn apply(&self, map: &Tensor) -> Tensor {
        let mut next = self.convolution.apply(map);
        if let Some(normalisation) = &self.normalisation {
            normalisation.apply(&mut next);
        }
        next
    }
}

impl SuperPoint {
    pub fn read(weights: &Weights, author: Author) -> Result<Self, Damage> {
        let names = author.layers();
        let (backbone_names, head_names) = names.split_at(BACKBONE.len());
        let mut inputs = 1;
        let mut backbone = Vec::new();
        for (name, (outputs, _)) in backbone_names.iter().zip(BACKBONE) {
            let shape = Shape {
                outputs,
                inputs,
                side: 3,
            };
            backbone.push(Layer::read(weights, author, name, shape, Gate::Relu)?);
            inputs = outputs;
        }
        let head = |names: &[&str], layers: [(usize, usize); 2]| {
            let gates = [Gate::Relu, Gate::None];
            let mut inputs = inputs;
            let mut read = Vec::new();
            for ((name, (outputs, side)), gate) in names.iter().zip(layers).zip(gates) {
                let shape = Shape {
                    outputs,
                    inputs,
                    side,
                };
                read.push(Layer::read(weights, author, name, shape, gate)?);
                inputs = outputs;
            }
            Ok(read)
        };
        let (detector_names, descriptor_names) = head_names.split_at(DETECTOR.len());
        Ok(Self {
            detector: head(detector_names, DETECTOR)?,
            descriptor: head(descriptor_names, DESCRIPTOR)?,
            backbone,
        })
    }

    pub fn run(&self, image: &Grey) -> SuperPointMaps {
        let mut map = image.padded(CELL_PX);
        for (layer, (_, is_halved)) in self.backbone.iter().zip(BACKBONE) {
            if is_halved {
                map = map.pooled(2, Pooling::Largest);
            }
            map = layer.apply(&map);
        }
        let through = |layers: &[Layer]| {
            let first = layers.iter().take(1).map(|layer| layer.apply(&map)).next();
            let rest = layers.iter().skip(1);
            rest.fold(first.unwrap_or_else(|| map.clone()), |map, layer| {
                layer.apply(&map)
            })
        };
        let mut descriptors = through(&self.descriptor);
        let cells = descriptors.values.chunks_exact_mut(DESCRIPTOR_LEN);
        cells.for_each(normalise);
        SuperPointMaps {
            width: image.width,
            height: image.height,
            scores: Scores::of_cells(&through(&self.detector)),
            descriptors,
        }
    }
}

/// What it says of an image.
pub(crate) struct SuperPointMaps {
    width: usize,
    height: usize,
    scores: Scores,
    /// Of unit length.
    descriptors: Tensor,
}

impl SuperPointMaps {
    pub fn keypoints(&self) -> Vec<NetworkKeypoint> {
        let peaks = self.scores.peaks(self.width, self.height, &PEAKS);
        peaks.iter().map(NetworkKeypoint::from).collect()
    }

    /// The descriptor at a pixel, linear between the centres of the cells.
    pub fn descriptor(&self, pixel: [f32; 2]) -> [f32; DESCRIPTOR_LEN] {
        let place =
            |pixel: f32, cells: usize| Between::new((pixel + 0.5) / CELL_PX as f32 - 0.5, cells);
        let row = place(pixel[1], self.descriptors.height);
        let column = place(pixel[0], self.descriptors.width);
        let mut descriptor = [0.0; DESCRIPTOR_LEN];
        self.descriptors.between(&row, &column, &mut descriptor);
        normalise(&mut descriptor);
        descriptor
    }

    /// The highest score of a column, to be compared with that of other programs.
    pub fn highest_score(&self, column: usize) -> f32 {
        self.scores.highest(column, self.height)
    }

    /// A channel of the descriptor of the cell around a pixel, to be compared with that of other programs.
    pub fn channel(&self, column: usize, row: usize, channel: usize) -> f32 {
        self.descriptors.cell(row / CELL_PX, column / CELL_PX)[channel]
    }
}
