//! Why images give too few map points.

/// Why images give too few map points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MapShortage {
    /// The images are blank.
    #[error("{images} images show {features} features")]
    FewFeatures {
        /// Images.
        images: usize,
        /// Features in all of them.
        features: usize,
    },
    /// Nothing is seen from two places.
    #[error("no two of the {images} images see the same thing from different positions")]
    NoBaseline {
        /// Images.
        images: usize,
    },
    /// What images share does not agree with their poses.
    #[error("too few matches between {images} images agree with their poses")]
    Disagreement {
        /// Images.
        images: usize,
    },
}

impl MapShortage {
    /// What to do.
    pub(super) fn remedy(self) -> &'static str {
        match self {
            Self::FewFeatures { .. } => "check focus, exposure and lens caps",
            Self::NoBaseline { .. } => "move between images, since rotation alone gives no depth",
            Self::Disagreement { .. } => {
                "check that they overlap, that these are camera poses (world from camera, z forward), and that the calibration belongs to them"
            }
        }
    }
}

/// Fewer points localize nobody.
pub(crate) const MIN_MAP_POINTS: usize = 100;
/// An image with fewer features on average sees too little.
pub(crate) const MIN_FEATURES_PER_IMAGE: usize = 50;
