//! Answers of queries as they are kept.

use super::acceptance::Evidence;
use super::joint_focal_length::JointFocalLength;
use super::outcome::{FeatureMatch, Localization, NotLocalized, NotLocalizedReason};
use crate::kept_stages::{ByteReader, Keep, keep_fields, put_told, take_told};

keep_fields! {
    FeatureMatch { point, frame, keypoint, pixel }
    JointFocalLength { log_scale, log_sigma, images }
    Localization { world_from_rig, covariance, matches, reprojection_rms_px, votes, evidence, probability }
    NotLocalized { reason }
}

impl Keep for Evidence {
    fn put(&self, out: &mut Vec<u8>) {
        put_told(self, out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        take_told(from)
    }
}

impl Keep for NotLocalizedReason {
    fn put(&self, out: &mut Vec<u8>) {
        let kind = |kind: u8, out: &mut Vec<u8>| kind.put(out);
        match self {
            Self::UnknownCamera { camera } => {
                kind(0, out);
                camera.put(out);
            }
            Self::PrincipalPointOffCentre {
                camera,
                size_px,
                principal_px,
            } => {
                kind(1, out);
                camera.put(out);
                size_px.put(out);
                principal_px.put(out);
            }
            Self::ImageSize {
                camera,
                expected_px,
                found_px,
            } => {
                kind(2, out);
                camera.put(out);
                expected_px.put(out);
                found_px.put(out);
            }
            Self::Unreadable { message } => {
                kind(3, out);
                message.put(out);
            }
            Self::NoPlace { votes } => {
                kind(4, out);
                votes.put(out);
            }
            Self::NoPose => kind(5, out),
            Self::FocalLength { best, joint } => {
                kind(6, out);
                best.put(out);
                joint.put(out);
            }
            Self::Improbable { best, needed } => {
                kind(7, out);
                best.put(out);
                needed.put(out);
            }
            Self::Sequence {
                best,
                agreeing,
                contradicting,
            } => {
                kind(8, out);
                best.put(out);
                agreeing.put(out);
                contradicting.put(out);
            }
            Self::HardlyRecognised { best, share } => {
                kind(9, out);
                best.put(out);
                share.put(out);
            }
        }
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        Some(match u8::take(from)? {
            0 => Self::UnknownCamera {
                camera: Keep::take(from)?,
            },
            1 => Self::PrincipalPointOffCentre {
                camera: Keep::take(from)?,
                size_px: Keep::take(from)?,
                principal_px: Keep::take(from)?,
            },
            2 => Self::ImageSize {
                camera: Keep::take(from)?,
                expected_px: Keep::take(from)?,
                found_px: Keep::take(from)?,
            },
            3 => Self::Unreadable {
                message: Keep::take(from)?,
            },
            4 => Self::NoPlace {
                votes: Keep::take(from)?,
            },
            5 => Self::NoPose,
            6 => Self::FocalLength {
                best: Keep::take(from)?,
                joint: Keep::take(from)?,
            },
            7 => Self::Improbable {
                best: Keep::take(from)?,
                needed: Keep::take(from)?,
            },
            8 => Self::Sequence {
                best: Keep::take(from)?,
                agreeing: Keep::take(from)?,
                contradicting: Keep::take(from)?,
            },
            9 => Self::HardlyRecognised {
                best: Keep::take(from)?,
                share: Keep::take(from)?,
            },
            _ => return None,
        })
    }
}
