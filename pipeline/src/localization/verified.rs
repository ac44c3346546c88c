//! A pose by matches that look alone made, with how many such poses chance would give: for places that are no map's.

use lsfb_geometry::{Matrix6, Se3};

use super::acceptance::FirstMatches;
use super::covariance::pose_covariance;
use super::matches::{MountedCamera, PointMatch};
use super::prior::PoseKnowledge;
use super::ransac::{RansacConfig, estimate_known_pose};
use super::refinement::refine_pose;

/// Matches nearer to each other than this are one spot, pixels.
const SPOT_PX: f64 = 3.0;

/// What matches agree on.
#[derive(Clone, Debug)]
pub(crate) struct VerifiedPose {
    pub world_from_rig: Se3,
    /// Tangent `[rotation, translation]` on the right, rad² and m²: what the matches leave open.
    pub covariance: Matrix6<f64>,
    /// The matches that agree, by their numbers.
    pub inliers: Vec<usize>,
    /// Decimal logarithm of how many poses with as many of the matches are to be expected of chance; what is known beforehand says
    /// against that.
    pub log10_false_alarms: f64,
}

/// The pose that most of the matches agree on, of those that do not contradict what is known. Each match comes with the squared distance
/// of its descriptors and the number of its point. `None` where fewer than four agree, or leave the pose open.
pub(crate) fn verified_pose(
    cameras: &[MountedCamera],
    matches: &[(u32, u32, PointMatch)],
    known: &PoseKnowledge,
    config: &RansacConfig,
) -> Option<VerifiedPose> {
    let pairs: Vec<PointMatch> = matches.iter().map(|(_, _, m)| *m).collect();
    let found = estimate_known_pose(cameras, &pairs, known, config)?;
    let agreeing: Vec<PointMatch> = found.inliers.iter().map(|k| pairs[*k]).collect();
    let refined = refine_pose(
        cameras,
        &agreeing,
        &found.world_from_rig,
        &config.refinement,
    )?;
    let huber_px = config.refinement.huber_px;
    let covariance = pose_covariance(cameras, &agreeing, &refined, huber_px)?;
    let first = FirstMatches::new(matches.to_vec(), SPOT_PX);
    let agreement = first.agreement(cameras, &refined.world_from_rig, config.max_error_px);
    Some(VerifiedPose {
        world_from_rig: refined.world_from_rig,
        covariance,
        inliers: found.inliers,
        log10_false_alarms: agreement.log10_false_alarms(1) + known.decades(),
    })
}
