//! The stages of a map as they are kept.

use lsfb_geometry::StampedPose;

use super::control::Hold;
use super::inertial::InertialEstimate;
use super::keyframes::{Keyframe, Keyframes};
use super::rounds::{Optimised, Rounds};
use super::weights::Contradicted;
use super::{MappingReport, ScanOffsets};
use crate::features::{Features, Keypoint};
use crate::hd_map::{KeyframeImage, MapPoint, PointObservation, SiteFrame};
use crate::kept_stages::{ByteReader, Keep, keep_fields, put_told, take_told};
use crate::surface::Agreement;
use lsfb_perception::imu::ImuBias;

keep_fields! {
    Keypoint { pixel, scale_px, angle_rad, response }
    Features { keypoints, descriptors }
    KeyframeImage { keyframe, camera, features }
    PointObservation { image, keypoint }
    MapPoint { point_in_world, observations, reprojection_rms_px }
    Optimised { poses, points, covariances, refined, site }
    Contradicted { rotation, translation }
    Agreement { on_planes, beams, contradicted }
    ScanOffsets {
        scans,
        median_m,
        worst_m,
        worst_after_secs,
        turn_deg,
        shift_m,
        least_m,
        visits_apart_m,
        visits_after_secs,
        unseen_secs,
        unseen_after_secs
    }
    Hold { centred_from_world, marks, map_factor }
    SiteFrame { origin_m, control_points }
    ImuBias { gyro_rad_s, accel_m_s2 }
    InertialEstimate { velocities_m_s, biases, gravity_m_s2 }
    Rounds { done, most, poses, matched, contradicted, hold, inertial, told }
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

impl Keep for MappingReport {
    fn put(&self, out: &mut Vec<u8>) {
        put_told(self, out);
        self.reprojection_errors_px.put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        let report: Self = take_told(from)?;
        Some(Self {
            reprojection_errors_px: Vec::take(from)?,
            ..report
        })
    }
}
