//! Lens parameters as one list: what an optimiser changes and a report names.

use serde::{Deserialize, Serialize};

use super::Lens;

/// Parameters of the lens with the most: focal lengths, principal point, five of distortion.
pub const MAX_PARAMETERS: usize = 9;

/// A lens model without its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LensModel {
    /// [`Lens::PinholeRadtan`].
    PinholeRadtan,
    /// [`Lens::KannalaBrandt`].
    KannalaBrandt,
    /// [`Lens::DoubleSphere`].
    DoubleSphere,
    /// [`Lens::ExtendedUnified`].
    ExtendedUnified,
    /// [`Lens::FieldOfView`].
    FieldOfView,
}

impl LensModel {
    /// Every model.
    pub const ALL: [LensModel; 5] = [
        Self::PinholeRadtan,
        Self::KannalaBrandt,
        Self::DoubleSphere,
        Self::ExtendedUnified,
        Self::FieldOfView,
    ];

    /// The name in a rig file.
    pub fn name(self) -> &'static str {
        match self {
            Self::PinholeRadtan => "pinhole-radtan",
            Self::KannalaBrandt => "kannala-brandt",
            Self::DoubleSphere => "double-sphere",
            Self::ExtendedUnified => "extended-unified",
            Self::FieldOfView => "field-of-view",
        }
    }

    /// Names of the parameters, in the order of [`Lens::parameters`].
    pub fn parameter_names(self) -> &'static [&'static str] {
        match self {
            Self::PinholeRadtan => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"],
            Self::KannalaBrandt => &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
            Self::DoubleSphere => &["fx", "fy", "cx", "cy", "xi", "alpha"],
            Self::ExtendedUnified => &["fx", "fy", "cx", "cy", "alpha", "beta"],
            Self::FieldOfView => &["fx", "fy", "cx", "cy", "omega"],
        }
    }

    /// Number of parameters.
    pub fn parameter_count(self) -> usize {
        self.parameter_names().len()
    }

    /// A lens of this model; numbers beyond [`LensModel::parameter_count`] are not read.
    pub fn lens(self, parameters: &[f64; MAX_PARAMETERS]) -> Lens {
        let [fx, fy, cx, cy, d0, d1, d2, d3, d4] = *parameters;
        let (focal_px, principal_px) = ([fx, fy], [cx, cy]);
        match self {
            Self::PinholeRadtan => Lens::PinholeRadtan {
                focal_px,
                principal_px,
                distortion: [d0, d1, d2, d3, d4],
            },
            Self::KannalaBrandt => Lens::KannalaBrandt {
                focal_px,
                principal_px,
                distortion: [d0, d1, d2, d3],
            },
            Self::DoubleSphere => Lens::DoubleSphere {
                focal_px,
                principal_px,
                distortion: [d0, d1],
            },
            Self::ExtendedUnified => Lens::ExtendedUnified {
                focal_px,
                principal_px,
                distortion: [d0, d1],
            },
            Self::FieldOfView => Lens::FieldOfView {
                focal_px,
                principal_px,
                distortion: [d0],
            },
        }
    }
}

/// The parameters of a lens in one list: `fx, fy, cx, cy`, then the distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensParameters {
    /// The numbers; zero beyond [`LensParameters::count`].
    pub values: [f64; MAX_PARAMETERS],
    /// How many belong to the model.
    pub count: usize,
}

impl Lens {
    /// The model.
    pub fn model(&self) -> LensModel {
        match self {
            Lens::PinholeRadtan { .. } => LensModel::PinholeRadtan,
            Lens::KannalaBrandt { .. } => LensModel::KannalaBrandt,
            Lens::DoubleSphere { .. } => LensModel::DoubleSphere,
            Lens::ExtendedUnified { .. } => LensModel::ExtendedUnified,
            Lens::FieldOfView { .. } => LensModel::FieldOfView,
        }
    }

    /// The distortion parameters alone.
    pub fn distortion(&self) -> &[f64] {
        match self {
            Lens::PinholeRadtan { distortion, .. } => distortion,
            Lens::KannalaBrandt { distortion, .. } => distortion,
            Lens::DoubleSphere { distortion, .. } => distortion,
            Lens::ExtendedUnified { distortion, .. } => distortion,
            Lens::FieldOfView { distortion, .. } => distortion,
        }
    }

    /// All parameters in one list.
    pub fn parameters(&self) -> LensParameters {
        let [fx, fy] = self.focal_px();
        let [cx, cy] = self.principal_px();
        let distortion = self.distortion();
        let mut values = [0.0; MAX_PARAMETERS];
        values[..4].copy_from_slice(&[fx, fy, cx, cy]);
        values[4..4 + distortion.len()].copy_from_slice(distortion);
        LensParameters {
            values,
            count: 4 + distortion.len(),
        }
    }

    /// What is wrong with the parameters, if anything: a number that is not finite, a focal length that is not
    /// positive, a distortion outside the model's domain.
    pub fn problem(&self) -> Option<String> {
        let parameters = self.parameters();
        for (name, value) in self.model().parameter_names().iter().zip(parameters.values) {
            if !value.is_finite() {
                return Some(format!("{name} is {value}"));
            }
        }
        for (name, value) in ["fx", "fy"].into_iter().zip(self.focal_px()) {
            if !(value > 0.0) {
                return Some(format!("{name} is {value} px: it must be positive"));
            }
        }
        let outside = |name: &str, value: f64, expected: &str| {
            Some(format!("{name} is {value}: it must be {expected}"))
        };
        match *self {
            Lens::DoubleSphere {
                distortion: [_, alpha],
                ..
            }
            | Lens::ExtendedUnified {
                distortion: [alpha, _],
                ..
            } if !(0.0..=1.0).contains(&alpha) => outside("alpha", alpha, "between 0 and 1"),
            Lens::ExtendedUnified {
                distortion: [_, beta],
                ..
            } if !(beta > 0.0) => outside("beta", beta, "positive"),
            Lens::DoubleSphere {
                distortion: [xi, _],
                ..
            } if !(xi > -1.0) => outside("xi", xi, "above -1"),
            Lens::FieldOfView {
                distortion: [omega],
                ..
            } if !(omega.abs() < std::f64::consts::PI) => {
                outside("omega", omega, "below pi, in radians")
            }
            _ => None,
        }
    }
}
