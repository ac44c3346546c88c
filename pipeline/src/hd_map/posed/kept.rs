//! The stages of a map of posed images as they are kept.

use super::RefinedPoses;
use crate::features::tracks::{Track, TrackedKeypoint};
use crate::kept_stages::keep_fields;

keep_fields! {
    TrackedKeypoint { image, keypoint }
    Track { keypoints }
    RefinedPoses { keyframes, tracks, far }
}
