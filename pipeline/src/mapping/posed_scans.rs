//! Poses of scans as their planes and edges show them: the LiDAR terms of Eq. (4) alone, for clouds that nobody took images beside.

use lsfb_geometry::{Rig, Se3, StampedPose, Vector3};
use lsfb_solver::SolveConfig;
use lsfb_types::{Bounds, Finding, Limit, ProgressFn, Timestamp, Verdict};
use serde::{Deserialize, Serialize};

use super::adjustment::{Terms, adjust};
use super::keyframes::{Keyframe, Keyframes};
use super::rounds::{RESTING_DEG, RESTING_M, largest_move};
use super::scan_pairs::{Compared, scan_correspondences, scan_pairs};
use super::weights::{Contradicted, Weights, lidar_residuals};
use super::{LidarResiduals, MappingConfig};
use crate::lidar_features::{LidarFeatureConfig, LidarFeatures};
use crate::{Error, Refusal};

/// A scan without motion in it, and where it is thought to have been taken.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedScan {
    /// When.
    pub time: Timestamp,
    /// Where the sensor was.
    pub world_from_lidar: Se3,
    /// Points on surfaces, in the frame of the sensor, metres. Points that lie on none do no harm.
    pub on_surfaces: Vec<Vector3<f64>>,
    /// Points on edges alike; none where nobody looked for edges.
    pub on_edges: Vec<Vector3<f64>>,
}

/// Parameters of [`refine_scan_poses`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScanPoseConfig {
    /// 1 σ of the given motion from one scan to the next: rotation, degrees.
    pub rotation_sigma_deg: f64,
    /// And translation, metres.
    pub translation_sigma_m: f64,
    /// Standard deviation of one range, metres.
    pub range_noise_m: f64,
    /// Features and correspondences once the poses are nearly right; before that both are wider.
    pub lidar_features: LidarFeatureConfig,
    /// When each minimisation stops.
    pub solver: SolveConfig,
}

impl Default for ScanPoseConfig {
    fn default() -> Self {
        Self {
            rotation_sigma_deg: 3.0,
            translation_sigma_m: 0.3,
            range_noise_m: 0.02,
            lidar_features: LidarFeatureConfig {
                plane_cell_m: 1.2,
                ..LidarFeatureConfig::default()
            },
            solver: SolveConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    ScanPoseConfig {
        rotation_sigma_deg: number(Bounds::POSITIVE),
        translation_sigma_m: number(Bounds::POSITIVE),
        range_noise_m: number(Bounds::POSITIVE),
        lidar_features: section,
        solver: section,
    }
}

/// Cells and gates, as multiples of those that are asked for: a turn by a few degrees moves what is far away by more than a small cell.
const SCALES: [f64; 3] = [5.0, 2.5, 1.0];
/// Rounds of correspondences and minimisation with each, at most.
const ROUNDS: usize = 12;
/// A scan of which less lies on surfaces of the others does not belong where it ended.
const LEAST_MATCHED: f64 = 0.3;
/// A motion that is so many of its standard deviations from what was given.
const MOST_SIGMAS: f64 = 3.0;

/// Where scans are, and what that is worth.
#[derive(Clone, Debug, PartialEq)]
pub struct RefinedScans {
    /// The poses; the first is as it was given.
    pub poses: Vec<StampedPose>,
    /// What is to be said of them.
    pub report: ScanPoseReport,
}

/// What is to be said of refined poses of scans.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanPoseReport {
    /// Scans.
    pub scans: u64,
    /// Distances of features from those that they correspond to in the end, at the given poses.
    pub lidar_before: LidarResiduals,
    /// The same at the refined poses.
    pub lidar_after: LidarResiduals,
    /// Farthest that a scan moved, metres.
    pub moved_m: f64,
    /// Farthest that one turned, degrees.
    pub turned_deg: f64,
    /// Farthest that a motion from scan to scan is from what was given, in standard deviations of what was.
    pub sigmas: f64,
    /// Least share of planes that lie on surfaces of one of the scans joined before, where scans are joined to the first one by one, the best match next.
    pub least_matched: f64,
    /// Index of the scan that was joined by it.
    pub least_matched_scan: u64,
    /// Whether poses and correspondences had come to rest.
    pub rests: bool,
}

impl ScanPoseReport {
    /// Everything that was looked at, good or not.
    pub fn findings(&self) -> Vec<Finding> {
        let fits = self.least_matched >= LEAST_MATCHED;
        let matched = Finding::new(
            "scan-apart",
            if fits { Verdict::Pass } else { Verdict::Fail },
            "scans",
            format!(
                "scan {} (from 0) shares at most {:.0} % of its planes with any scan connected to the first one",
                self.least_matched_scan,
                1e2 * self.least_matched
            ),
        )
        .value(1e2 * self.least_matched, "%")
        .limit(Limit::AtLeast(1e2 * LEAST_MATCHED))
        .remedy("start from better poses, or leave out that scan");
        let rests = Finding::new(
            "not-at-rest",
            Verdict::Warn.unless(self.rests),
            "poses",
            match self.rests {
                true => "poses and correspondences converged".to_owned(),
                false => "poses and correspondences did not converge within the allowed iterations"
                    .to_owned(),
            },
        )
        .remedy("start from better poses");
        let far = Finding::new(
            "moved-far",
            Verdict::Warn.unless(self.sigmas <= MOST_SIGMAS),
            "poses",
            format!(
                "the motion between scans differs from the given one by up to {:.1} standard deviations",
                self.sigmas
            ),
        )
        .value(self.sigmas, "σ")
        .limit(Limit::AtMost(MOST_SIGMAS))
        .remedy("check that the scans fit, and set how well the motion is known (translation_sigma_m, rotation_sigma_deg)");
        vec![matched, rests, far]
    }
}

/// Refines the poses of scans by planes and edges that they see both; the first is held.
///
/// Correspondences and Eq. (4) take turns, with wide cells and gates at first. The given motion from scan to scan holds what the surfaces do not.
pub fn refine_scan_poses(
    scans: &[PosedScan],
    config: &ScanPoseConfig,
    progress: ProgressFn<'_>,
) -> Result<RefinedScans, Error> {
    config.check_bounds("scan_poses")?;
    if scans.len() < 2 {
        let scans = scans.len();
        return Err(Refusal::TooFewScans { scans }.into());
    }
    let mapping = MappingConfig {
        odometry_rotation_sigma_deg: config.rotation_sigma_deg,
        odometry_translation_sigma_m: config.translation_sigma_m,
        solver: config.solver,
        ..MappingConfig::default()
    };
    // The motion is as well known whatever the time from one scan to the next.
    let frame = |(k, scan): (usize, &PosedScan)| Keyframe {
        time: Timestamp::from_nanos(k as i64 * 1_000_000_000),
        world_from_rig: scan.world_from_lidar,
        lidar: None,
    };
    let mut keyframes = Keyframes {
        frames: scans.iter().enumerate().map(frame).collect(),
        images: Vec::new(),
    };
    let given = keyframes.poses();
    let rig = Rig::empty("lidar");
    let mut found = Vec::new();
    let mut rests = false;
    for scale in SCALES {
        let features = LidarFeatureConfig {
            plane_cell_m: scale * config.lidar_features.plane_cell_m,
            gate_m: scale * config.lidar_features.gate_m,
            ..config.lidar_features.clone()
        };
        for (frame, scan) in keyframes.frames.iter_mut().zip(scans) {
            let (planes, edges) = (&scan.on_surfaces, &scan.on_edges);
            let of_scan = LidarFeatures::of_points(planes, edges, config.range_noise_m, &features);
            frame.lidar = Some(of_scan);
        }
        let settings = MappingConfig {
            lidar_features: features,
            ..mapping.clone()
        };
        let blind_s = vec![0.0; given.len()];
        for _ in 0..ROUNDS {
            let pairs = scan_pairs(&keyframes.frames, &settings);
            found = scan_correspondences(&keyframes.frames, &pairs, &settings);
            let lidar = lidar_residuals(&keyframes.frames, &found);
            let terms = Terms {
                scans: &found,
                odometry: &given,
                blind_s: &blind_s,
                weights: Weights {
                    contradicted: Contradicted::default(),
                    ..Weights::estimate(&lidar, &[], &settings.correlation)
                },
                control: None,
                imu: None,
            };
            let before = keyframes.poses();
            adjust(&rig, &mut keyframes, &mut [], &terms, &settings, progress)?;
            let [moved_m, turned_rad] = largest_move(&before, &keyframes.poses());
            rests = moved_m < RESTING_M && turned_rad.to_degrees() < RESTING_DEG;
            if rests {
                break;
            }
        }
    }
    let lidar_after = lidar_residuals(&keyframes.frames, &found);
    let poses = keyframes.poses();
    let weakest = weakest_join(scans.len(), &matched_shares(&keyframes.frames, &found));
    keyframes.place(&given);
    let [moved_m, turned_rad] = largest_move(&given, &poses);
    let report = ScanPoseReport {
        scans: scans.len() as u64,
        lidar_before: lidar_residuals(&keyframes.frames, &found),
        lidar_after,
        moved_m,
        turned_deg: turned_rad.to_degrees(),
        sigmas: most_sigmas(&given, &poses, config),
        least_matched: weakest.1,
        least_matched_scan: weakest.0 as u64,
        rests,
    };
    let stamped = poses.iter().zip(scans).map(|(pose, scan)| StampedPose {
        time: scan.time,
        world_from_rig: pose.world_from_rig,
    });
    Ok(RefinedScans {
        poses: stamped.collect(),
        report,
    })
}

/// Share of the planes of the second of two scans that lie on surfaces of the first.
fn matched_shares(frames: &[Keyframe], found: &[Compared]) -> Vec<([usize; 2], f64)> {
    let planes_of = |n: usize| frames[n].lidar.as_ref().map_or(0, |l| l.planes().len());
    let shares = found.iter().map(|(pair, both)| {
        let share = both.planes.len() as f64 / planes_of(pair.n).max(1) as f64;
        ([pair.m, pair.n], share)
    });
    shares.collect()
}

/// Scans are joined to the first one by one, each time the one that matches one of those joined best. Of all these the weakest: its number, and the share of planes that
/// lie on surfaces of the other. Where scans fall into groups that match within themselves alone, that is what joins the groups.
fn weakest_join(scans: usize, shares: &[([usize; 2], f64)]) -> (usize, f64) {
    let mut best: Vec<f64> = vec![0.0; scans];
    let mut waiting: Vec<usize> = (1..scans).collect();
    let mut weakest = (0, f64::INFINITY);
    let mut joined = 0;
    while !waiting.is_empty() {
        for (pair, share) in shares {
            let other = match pair {
                [a, b] if *a == joined => *b,
                [a, b] if *b == joined => *a,
                _ => continue,
            };
            best[other] = best[other].max(*share);
        }
        let next =
            (0..waiting.len()).max_by(|a, b| best[waiting[*a]].total_cmp(&best[waiting[*b]]));
        joined = waiting.remove(next.unwrap_or_default());
        if best[joined] < weakest.1 {
            weakest = (joined, best[joined]);
        }
    }
    weakest
}

/// Farthest that a motion from scan to scan is from what was given.
fn most_sigmas(given: &[StampedPose], found: &[StampedPose], config: &ScanPoseConfig) -> f64 {
    let motion = |pair: &[StampedPose]| pair[0].world_from_rig.inverse() * pair[1].world_from_rig;
    let pairs = given.windows(2).zip(found.windows(2));
    let sigmas = pairs.map(|(was, is)| {
        let off = motion(was).inverse() * motion(is);
        let turned = off.rotation.angle() / config.rotation_sigma_deg.to_radians();
        let shifted = off.translation.norm() / config.translation_sigma_m;
        turned.max(shifted)
    });
    sigmas.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::weakest_join;

    #[test]
    fn groups_that_match_within_themselves_alone_are_held_by_what_joins_them() {
        let within = [([0, 1], 0.9), ([2, 3], 0.8), ([1, 4], 0.7)];
        assert_eq!(weakest_join(5, &within).1, 0.0);
        let bridged = [&within[..], &[([4, 3], 0.4), ([0, 2], 0.1)]].concat();
        assert_eq!(weakest_join(5, &bridged), (3, 0.4));
    }
}
