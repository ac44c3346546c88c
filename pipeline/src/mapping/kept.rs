//! The stages of a map as they are kept.

use lsfb_geometry::StampedPose;
use serde::{Deserialize, Serialize};

use super::keyframes::{Keyframe, Keyframes};
use super::weights::Contradicted;
use super::{MappingReport, Optimised, Rounds};
use crate::features::{Features, Keypoint};
use crate::hd_map::{KeyframeImage, MapPoint, PointObservation};
use crate::kept_stages::{ByteReader, Keep};
use crate::surface::Agreement;

/// A type whose fields are kept one after the other.
macro_rules! keep_fields {
    ($($kept:ident { $($field:ident),* })*) => {$(
        impl Keep for $kept {
            fn put(&self, out: &mut Vec<u8>) {
                $(self.$field.put(out);)*
            }
            fn take(from: &mut ByteReader<'_>) -> Option<Self> {
                Some(Self { $($field: Keep::take(from)?),* })
            }
        }
    )*};
}

keep_fields! {
    Keypoint { pixel, scale_px, angle_rad, response }
    Features { keypoints, descriptors }
    KeyframeImage { keyframe, camera, features }
    PointObservation { image, keypoint }
    MapPoint { point_in_world, observations, reprojection_rms_px }
    Optimised { poses, points, covariances, refined }
    Contradicted { rotation, translation }
    Agreement { on_planes, beams, contradicted }
    Rounds { done, poses, matched, contradicted, told }
}

impl Keep for Keyframes {
    /// Without the features of the scans, which are found again.
    fn put(&self, out: &mut Vec<u8>) {
        self.poses().put(out);
        self.images.put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        let poses: Vec<StampedPose> = Keep::take(from)?;
        let images: Vec<KeyframeImage> = Keep::take(from)?;
        let frames: Vec<Keyframe> = poses
            .into_iter()
            .map(|pose| Keyframe {
                time: pose.time,
                world_from_rig: pose.world_from_rig,
                lidar: None,
            })
            .collect();
        Some(Self { frames, images })
    }
}

/// A report in TOML, whose numbers come back bit for bit, those that are none as well.
#[derive(Serialize, Deserialize)]
struct Told<R> {
    report: R,
}

impl Keep for MappingReport {
    fn put(&self, out: &mut Vec<u8>) {
        // What is no TOML is not read back, and computed again.
        let text = toml::to_string(&Told { report: self });
        text.unwrap_or_default().put(out);
        self.reprojection_errors_px.put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        let Told { report } = toml::from_str::<Told<Self>>(&String::take(from)?).ok()?;
        Some(Self {
            reprojection_errors_px: Vec::take(from)?,
            ..report
        })
    }
}
