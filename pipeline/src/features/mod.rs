//! Points that can be found again: detection, description, matching, tracks and triangulation.
//!
//! Detection and description follow Lowe, "Distinctive image features from scale-invariant keypoints" (IJCV 2004);
//! descriptors are RootSIFT (Arandjelović and Zisserman, CVPR 2012), quantised to bytes. A [`FeatureDetector`] may be a network
//! instead (`lsfb-networks`), whose descriptors are quantised to as many bytes. Everything after detection
//! works on viewing rays and [`Camera`](lsfb_geometry::Camera)s, so that fisheye and pinhole lenses are treated alike.

mod descriptor;
mod detector;
mod extrema;
mod feature;
mod keypoint_grid;
mod learned;
pub mod matching;
mod orientation;
mod scale_space;
mod selection;
mod sift;
pub mod tracks;
pub mod triangulation;

pub use detector::FeatureDetector;
pub use feature::{Feature, LearnedFeature};
pub use keypoint_grid::KeypointGrid;
pub use learned::{LearnedConfig, LearnedDetector};
pub use sift::{FirstOctave, SiftConfig, SiftDetector};

/// Dimensions of a descriptor.
pub const DESCRIPTOR_LEN: usize = 128;

/// RootSIFT times 512, saturated at 255, or the values of a network at distances of the same scale. The squared distance of two
/// is an integer.
pub type Descriptor = [u8; DESCRIPTOR_LEN];

/// Where a feature was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Position, pixels; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f32; 2],
    /// Standard deviation of the Gaussian at which it was found, pixels of the image; a network finds all at one scale.
    pub scale_px: f32,
    /// Dominant gradient direction, radians from +x towards +y; zero of networks, which know none.
    pub angle_rad: f32,
    /// Contrast of the extremum, or score of a network, 0–1.
    pub response: f32,
}

impl Keypoint {
    /// The position in double precision.
    pub fn pixel_f64(&self) -> lsfb_geometry::Vector2<f64> {
        lsfb_geometry::Vector2::new(f64::from(self.pixel[0]), f64::from(self.pixel[1]))
    }
}

/// The features of one image; `keypoints` and `descriptors` run in parallel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Where.
    pub keypoints: Vec<Keypoint>,
    /// What it looks like.
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    /// Number of features.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether nothing was found.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }
}

/// Features of one camera's image.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameFeatures {
    /// Name of the camera on the rig.
    pub camera: String,
    /// What was found in its image.
    pub features: Features,
}
