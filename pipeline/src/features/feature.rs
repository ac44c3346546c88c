use std::fmt;

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
