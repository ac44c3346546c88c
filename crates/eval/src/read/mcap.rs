//! Poses out of a recording.

use std::path::Path;

use lsfb_recording::Recording;

use super::order::{Unordered, put_in_order};
use super::row::covariance_in_tangent;
use super::{Orientations, TrajectoryFile};
use crate::Error;

pub(super) fn read(path: &Path, stream: Option<&str>) -> Result<TrajectoryFile, Error> {
    let recording = Recording::open(path)?;
    let mut findings = Vec::new();
    for damage in recording.damage() {
        let finding = lsfb_types::Finding::new(
            "damaged",
            lsfb_types::Verdict::Warn,
            super::name(path),
            damage.to_string(),
        );
        findings.push(finding);
    }
    let mut poses = Vec::new();
    for reading in recording.poses(stream)? {
        let covariance = reading.covariance.as_ref();
        // A covariance that is none says nothing about the pose.
        let covariance = covariance.and_then(|c| covariance_in_tangent(c, &reading.pose).ok());
        poses.push(Unordered {
            time: reading.time,
            world_from_rig: reading.pose,
            covariance: covariance.map(Box::new),
        });
    }
    if poses.is_empty() {
        return Err(Error::NotATrajectory {
            path: path.to_owned(),
            what: "the topic has no poses".to_owned(),
        });
    }
    put_in_order(path, poses, Orientations::Known, findings)
}
