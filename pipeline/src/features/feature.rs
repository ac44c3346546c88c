use std::fmt;

use lsfb_networks::Model;
use serde::{Deserialize, Serialize};

/// What descriptors are of: only those of one feature can be compared.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Feature {
    /// RootSIFT, built in.
    #[default]
    Sift,
    /// A network's.
    Learned(LearnedFeature),
}

/// A network with its weights.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedFeature {
    /// Name of the network.
    pub model: String,
    /// SHA-256 of its weights, as hexadecimal digits: the same network with other weights is another feature.
    pub weights_sha256: String,
}

impl LearnedFeature {
    /// By the hash under which its weights are known now: maps were made under that of folded ones.
    pub(crate) fn into_known(self) -> Self {
        let known = Model::named(&self.model).map(|model| model.known_by(&self.weights_sha256));
        let weights_sha256 = known.unwrap_or(&self.weights_sha256).to_owned();
        Self {
            weights_sha256,
            ..self
        }
    }
}

impl fmt::Display for Feature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sift => f.write_str("sift"),
            Self::Learned(LearnedFeature {
                model,
                weights_sha256,
            }) => {
                let digits: String = weights_sha256.chars().take(8).collect();
                write!(f, "{model} (weights {digits}…)")
            }
        }
    }
}
