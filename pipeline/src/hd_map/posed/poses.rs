//! Poses of a list as its images show them, where the list is thought to be a little off: bundle adjustment with the listed poses as a prior.

use std::collections::BTreeMap;
use std::sync::Arc;

use lsfb_geometry::{Rig, StampedPose, Vector3};
use lsfb_perception::statistics::median;
use lsfb_solver::{Kernel, PosePrior, Problem, SolveConfig, VectorPrior};
use lsfb_types::{Bounds, ProgressFn};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::features::tracks::Track;
use crate::features::triangulation::TriangulationConfig;
use crate::hd_map::{
    CERTAIN_VIEWS, KeyframeImage, MapPoint, ReconstructionConfig, find_tracks, triangulate_tracks,
};
use crate::residuals::{ObservingCamera, Reprojection};
use crate::solve::solve_or_stop;

/// How far listed poses are thought to be off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PoseRefinement {
    /// Whether poses are refined at all.
    pub enabled: bool,
    /// 1 σ of a listed rotation, degrees.
    pub rotation_sigma_deg: f64,
    /// 1 σ of a listed place, as a share of the depth of the scene.
    pub place_sigma_per_depth: f64,
}

impl Default for PoseRefinement {
    fn default() -> Self {
        Self {
            enabled: false,
            rotation_sigma_deg: 0.5,
            place_sigma_per_depth: 0.01,
        }
    }
}

lsfb_types::bounds! {
    PoseRefinement {
        enabled: any,
        rotation_sigma_deg: number(Bounds::POSITIVE),
        place_sigma_per_depth: number(Bounds::POSITIVE),
    }
}

/// Images are matched and adjusted in turns until poses rest, at most so often.
const ROUNDS: usize = 8;
/// Poses that move and turn less from one round to the next rest: share of the depth, radians.
const RESTING_PER_DEPTH: f64 = 2e-5;
const RESTING_RAD: f64 = 2e-5;
/// Matches are looked for two standard deviations of a pose from their epipolar lines at first, half as far in each round, and no farther than this, pixels.
const PRIOR_SIGMAS: f64 = 2.0;
const WIDEST_PX: f64 = 40.0;
/// Standard deviations beyond which an observation counts less.
const HUBER_SIGMAS: f64 = 2.0;
/// No image is better than this, pixels.
const LEAST_SIGMA_PX: f64 = 0.1;
/// Keeps a point that no camera has before it any more from being undetermined, as a share of the depth.
const POINT_SIGMA_PER_DEPTH: f64 = 10.0;
/// A pose that moves by more of its standard deviations is not a little off.
const MOST_SIGMAS: f64 = 5.0;

/// Poses as images show them.
pub(super) struct RefinedPoses {
    pub keyframes: Vec<StampedPose>,
    /// Of the last round.
    pub tracks: Vec<Track>,
    /// Keyframes that moved farther than the list is thought to be off.
    pub far: Vec<usize>,
}

/// Refines the poses of keyframes; `depth` is that of the scene, in their unit.
pub(super) fn refined_poses(
    rig: &Rig,
    listed: &[StampedPose],
    images: &[KeyframeImage],
    depth: f64,
    config: (&PoseRefinement, &ReconstructionConfig),
    progress: ProgressFn,
) -> Result<RefinedPoses, Error> {
    let (prior, reconstruction) = config;
    let (turn_sigma, place_sigma) = (
        prior.rotation_sigma_deg.to_radians(),
        prior.place_sigma_per_depth * depth,
    );
    let focals = rig.cameras.values().map(|c| c.camera.focal_px()[0]);
    let off_px = turn_sigma.hypot(prior.place_sigma_per_depth) * focals.fold(0.0, f64::max);
    let mut keyframes = listed.to_vec();
    let mut tracks = Vec::new();
    for round in 0..ROUNDS {
        let slack_px = (PRIOR_SIGMAS * off_px).min(WIDEST_PX) * 0.5f64.powi(round as i32);
        let slack = |px: f64| px + if slack_px < 0.5 { 0.0 } else { slack_px };
        let wide = ReconstructionConfig {
            max_epipolar_px: slack(reconstruction.max_epipolar_px),
            triangulation: TriangulationConfig {
                max_reprojection_px: slack(reconstruction.triangulation.max_reprojection_px),
                ..reconstruction.triangulation.clone()
            },
            ..reconstruction.clone()
        };
        tracks = find_tracks(rig, &keyframes, images, &wide, progress)?;
        let triangulation = &wide.triangulation;
        let mut points = triangulate_tracks(rig, &keyframes, images, &tracks, triangulation)?;
        points.retain(|point| point.observations.len() >= CERTAIN_VIEWS);
        let before = keyframes.clone();
        let mut problem = Problem::new();
        let mut poses = Vec::with_capacity(keyframes.len());
        for (keyframe, listed) in keyframes.iter().zip(listed) {
            let block = problem.add_block(keyframe.world_from_rig);
            let known = PosePrior::isotropic(listed.world_from_rig, turn_sigma, place_sigma);
            problem.add_residual(known, &[block.id()], Kernel::Squared)?;
            poses.push(block);
        }
        let blocks: Vec<_> = poses.iter().map(|pose| pose.id()).collect();
        add_points(&mut problem, rig, images, &points, &blocks, depth)?;
        solve_or_stop("poses", &mut problem, &SolveConfig::default(), progress)?;
        let mut rests = slack_px < 0.5;
        for ((keyframe, block), before) in keyframes.iter_mut().zip(&poses).zip(&before) {
            keyframe.world_from_rig = problem.value(*block);
            let moved = before.world_from_rig.inverse() * keyframe.world_from_rig;
            rests &= moved.translation.norm() < RESTING_PER_DEPTH * depth
                && moved.rotation.angle() < RESTING_RAD;
        }
        if rests {
            break;
        }
    }
    let far = |(was, is): (&StampedPose, &StampedPose)| {
        let moved = was.world_from_rig.inverse() * is.world_from_rig;
        moved.translation.norm() > MOST_SIGMAS * place_sigma
            || moved.rotation.angle() > MOST_SIGMAS * turn_sigma
    };
    let both = listed.iter().zip(&keyframes).enumerate();
    let far = both
        .filter(|(_, pair)| far(*pair))
        .map(|(k, _)| k)
        .collect();
    Ok(RefinedPoses {
        keyframes,
        tracks,
        far,
    })
}

fn add_points(
    problem: &mut Problem,
    rig: &Rig,
    images: &[KeyframeImage],
    points: &[MapPoint],
    poses: &[lsfb_solver::BlockId],
    depth: f64,
) -> Result<(), Error> {
    let cameras: BTreeMap<&str, Arc<ObservingCamera>> = rig
        .cameras
        .iter()
        .map(|(name, camera)| (name.as_str(), ObservingCamera::new(camera)))
        .collect();
    let errors_px = points.iter().map(|p| p.reprojection_rms_px).collect();
    // Of two numbers.
    let sigma_px = (median(errors_px).unwrap_or(0.0) / 2f64.sqrt()).max(LEAST_SIGMA_PX);
    let kernel = Kernel::Huber {
        scale: HUBER_SIGMAS,
    };
    let sigma = Vector3::repeat(POINT_SIGMA_PER_DEPTH * depth);
    for point in points {
        let block = problem.add_eliminated_point(point.point_in_world);
        let loose = VectorPrior::new(point.point_in_world, sigma);
        problem.add_residual(loose, &[block.id()], Kernel::Squared)?;
        for o in &point.observations {
            let image = &images[o.image];
            let Some(camera) = cameras.get(image.camera.as_str()) else {
                continue;
            };
            let residual = Reprojection {
                camera: camera.clone(),
                pixel: image.features.keypoints[o.keypoint as usize].pixel_f64(),
                sigma_px,
            };
            problem.add_residual(residual, &[poses[image.keyframe], block.id()], kernel)?;
        }
    }
    Ok(())
}
