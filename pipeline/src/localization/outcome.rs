//! What a query gets: a pose in the map, or the reason why there is none.

use std::fmt;

use lsfb_geometry::{Matrix6, Se3};

use super::acceptance::Evidence;
use super::joint_focal_length::JointFocalLength;

/// A feature that shows a map point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureMatch {
    /// Index of the map point.
    pub point: u32,
    /// Index of the frame among the query's.
    pub frame: usize,
    /// Index of its keypoint.
    pub keypoint: u32,
    /// Where that is, x right and y down.
    pub pixel: [f32; 2],
}

/// A pose in the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Localization {
    /// Pose of the rig.
    pub world_from_rig: Se3,
    /// Covariance of the pose, tangent `[rotation, translation]` on the right, rad² and m²: of the errors that its matches show, alone
    /// and in neighbourhoods, those of the map's points among them; of focal lengths that are a little off, of rows that were exposed
    /// one after the other, and of how far the map's own images are from where its points place them. Where the map's poses were given,
    /// the pose is adjusted together with those of the images next to it, and the covariance is that of the adjustment.
    pub covariance: Matrix6<f64>,
    /// Its inliers, by frame and keypoint.
    pub matches: Vec<FeatureMatch>,
    /// Root mean square of their reprojection errors, pixels.
    pub reprojection_rms_px: f64,
    /// Votes of the place where it was found.
    pub votes: u32,
    /// What speaks for the pose.
    pub evidence: Evidence,
    /// Probability that the pose is right: [`Evidence::probability`].
    pub probability: f64,
}

/// Why there is no pose.
#[derive(Clone, Debug, PartialEq)]
pub enum NotLocalizedReason {
    /// A frame's camera is not on the rig.
    UnknownCamera {
        /// The camera.
        camera: String,
    },
    /// The principal point lies where no lens of an image of this size has it.
    PrincipalPointOffCentre {
        /// The camera.
        camera: String,
        /// Size of its images, pixels.
        size_px: [u32; 2],
        /// Its principal point, pixels.
        principal_px: [f64; 2],
    },
    /// The image is not as large as its camera's images are.
    ImageSize {
        /// The camera.
        camera: String,
        /// Size of the camera's images, pixels.
        expected_px: [u32; 2],
        /// Size of this one, pixels.
        found_px: [u32; 2],
    },
    /// The image cannot be decoded.
    Unreadable {
        /// Which, and why.
        message: String,
    },
    /// No place got enough votes.
    NoPlace {
        /// Votes of the best one.
        votes: u32,
    },
    /// No place gave a pose that more than a handful of features agree with.
    NoPose,
    /// The matches fit another focal length than the cameras are said to have: the pose is wrong by as much.
    FocalLength {
        /// The pose, with what speaks for it: to be shown, not to be used.
        best: Box<Localization>,
        /// What the images of the camera say together, where they do and the focal length is another one by that.
        joint: Option<JointFocalLength>,
    },
    /// The best pose may be one of chance.
    Improbable {
        /// The pose, with what speaks for it: to be shown, not to be used.
        best: Box<Localization>,
        /// How probable it must be.
        needed: f64,
    },
    /// Other poses of the walk contradict it: nobody moves that fast.
    Sequence {
        /// The pose, with what speaks for it: to be shown, not to be used.
        best: Box<Localization>,
        /// Poses of the seconds around it on the longest way through it.
        agreeing: usize,
        /// Those on the longest way through one that contradicts it.
        contradicting: usize,
    },
    /// Hardly anything of the walk around it is recognised.
    HardlyRecognised {
        /// The pose, with what speaks for it: to be shown, not to be used.
        best: Box<Localization>,
        /// The share of the instants within ten seconds that is.
        share: f64,
    },
}

/// A query that could not be localized.
#[derive(Clone, Debug, PartialEq)]
pub struct NotLocalized {
    /// Why.
    pub reason: NotLocalizedReason,
}

impl fmt::Display for NotLocalized {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.reason {
            NotLocalizedReason::UnknownCamera { camera } => {
                write!(
                    f,
                    "the rig has no camera {camera}: give the rig of these images"
                )
            }
            NotLocalizedReason::PrincipalPointOffCentre {
                camera,
                size_px: [width, height],
                principal_px: [x, y],
            } => write!(
                f,
                "the principal point of camera {camera}, ({x:.1}, {y:.1}) px, is far from the centre of its \
                 {width} × {height} images: give the intrinsics for images of this size"
            ),
            NotLocalizedReason::ImageSize {
                camera,
                expected_px: [width, height],
                found_px: [found_width, found_height],
            } => write!(
                f,
                "the image has {found_width} × {found_height} px, but camera {camera} has {width} × \
                 {height}: give the intrinsics for images of this size, or the original images"
            ),
            NotLocalizedReason::Unreadable { message } => f.write_str(message),
            NotLocalizedReason::NoPlace { votes } => write!(
                f,
                "no place of the map resembles this view (best: {votes} votes): it may be outside the map"
            ),
            NotLocalizedReason::NoPose => write!(
                f,
                "the features agree on no pose: the view may be outside the map"
            ),
            NotLocalizedReason::FocalLength {
                joint: Some(joint), ..
            } => write!(f, "{joint}"),
            NotLocalizedReason::FocalLength { best, .. } => write!(
                f,
                "the matches fit {:.2} ± {:.2} times the camera's focal length: the image was \
                 resized or cropped, or taken with another lens; give the intrinsics that belong to \
                 it",
                best.evidence.focal_scale,
                best.evidence.focal_scale * best.evidence.focal_log_sigma,
            ),
            NotLocalizedReason::Improbable { best, .. } if best.evidence.is_doubtful_by_twin() => {
                write!(
                    f,
                    "the best pose has {} inliers, but another has {} elsewhere: the map has places that look alike, and this view does not distinguish them",
                    best.matches.len(),
                    best.evidence.twin_inliers
                )
            }
            NotLocalizedReason::Improbable { best, needed } => write!(
                f,
                "the best pose, with {} inliers, is right with a probability of only {:.3}; {needed} \
                 is needed: the view may be outside the map",
                best.matches.len(),
                best.probability
            ),
            NotLocalizedReason::Sequence {
                agreeing,
                contradicting,
                ..
            } => write!(
                f,
                "it contradicts the poses of the seconds around it: {contradicting} of them form a \
                 possible walk without it, {agreeing} with it; the place may look like another"
            ),
            NotLocalizedReason::HardlyRecognised { share, .. } => write!(
                f,
                "only {:.0} % of the frames within ten seconds are recognised: they may all be at another place that looks alike",
                100.0 * share
            ),
        }
    }
}

impl std::error::Error for NotLocalized {}

impl NotLocalized {
    /// The best pose all the same, to be shown and not to be used; `None` where there is none.
    pub fn best(&self) -> Option<&Localization> {
        match &self.reason {
            NotLocalizedReason::Improbable { best, .. }
            | NotLocalizedReason::FocalLength { best, .. }
            | NotLocalizedReason::Sequence { best, .. }
            | NotLocalizedReason::HardlyRecognised { best, .. } => Some(best),
            _ => None,
        }
    }
}
