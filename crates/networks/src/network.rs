use std::path::Path;

use lsfb_types::Image;

use crate::alike::{Alike, AlikeMaps};
use crate::error::{Damage, Error};
use crate::grey::Grey;
use crate::keypoints::{DESCRIPTOR_LEN, NetworkKeypoint};
use crate::model::Model;
use crate::weights::Weights;
use crate::xfeat::{XFeat, XFeatMaps};

/// A network with its weights. Shared by threads; runs on all of the pool it is called in, with the same result on any number.
#[derive(Clone, Debug)]
pub struct Network {
    model: Model,
    weights: Weights,
    weights_sha256: String,
    layers: Layers,
}

#[derive(Clone, Debug)]
enum Layers {
    XFeat(Box<XFeat>),
    Alike(Alike),
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
    /// The network in a file of weights; refuses weights that were not published, unless told to trust any.
    pub fn read(path: &Path, trust: Trust) -> Result<Self, Error> {
        let sets = Weights::read(path)?;
        let damaged = |reason| Error::File {
            path: path.to_owned(),
            reason,
        };
        let Some((model, weights)) = sets.iter().find_map(Model::of) else {
            let known: Vec<&str> = Model::ALL.iter().map(|m| m.name()).collect();
            return Err(Error::UnknownArchitecture {
                path: path.to_owned(),
                tensors: sets.iter().map(Weights::len).sum(),
                known: known.join(", "),
            });
        };
        let network = Self::new(model, weights).map_err(damaged)?;
        if trust == Trust::Published && network.weights_sha256 != model.weights_sha256() {
            return Err(Error::UnknownWeights {
                path: path.to_owned(),
                model: model.name(),
                found: network.weights_sha256,
                expected: model.weights_sha256().to_owned(),
            });
        }
        Ok(network)
    }

    fn new(model: Model, weights: Weights) -> Result<Self, Damage> {
        let layers = match model {
            Model::XFeat => Layers::XFeat(Box::new(XFeat::read(&weights)?)),
            Model::AlikeT => Layers::Alike(Alike::read(&weights)?),
        };
        Ok(Self {
            model,
            weights_sha256: weights.sha256(),
            weights,
            layers,
        })
    }

    /// Which one it is.
    pub fn model(&self) -> Model {
        self.model
    }

    /// SHA-256 of its weights, as hexadecimal digits: the same whatever file they come from.
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
        }))
    }
}

/// What a network says of an image.
pub struct NetworkMaps<'a>(Maps<'a>);

enum Maps<'a> {
    XFeat(XFeatMaps),
    Alike(AlikeMaps<'a>),
}

impl NetworkMaps<'_> {
    /// All keypoints, by row and column.
    pub fn keypoints(&self) -> Vec<NetworkKeypoint> {
        match &self.0 {
            Maps::XFeat(maps) => maps.keypoints(),
            Maps::Alike(maps) => maps.keypoints(),
        }
    }

    /// The descriptor at a pixel, of unit length.
    pub fn descriptor(&self, pixel: [f32; 2]) -> [f32; DESCRIPTOR_LEN] {
        match &self.0 {
            Maps::XFeat(maps) => maps.descriptor(pixel),
            Maps::Alike(maps) => maps.descriptor(pixel),
        }
    }

    /// The highest score of a column.
    pub(crate) fn highest_score(&self, column: usize) -> f32 {
        match &self.0 {
            Maps::XFeat(maps) => maps.highest_score(column),
            Maps::Alike(maps) => maps.highest_score(column),
        }
    }

    /// A channel of the descriptor around a pixel.
    pub(crate) fn channel(&self, column: usize, row: usize, channel: usize) -> f32 {
        match &self.0 {
            Maps::XFeat(maps) => maps.channel(column, row, channel),
            Maps::Alike(maps) => maps.channel(column, row, channel),
        }
    }
}
