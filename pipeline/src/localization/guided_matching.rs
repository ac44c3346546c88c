//! The map projected with a pose: pairs near the projections, and the pose that they agree on.

use lsfb_geometry::{Matrix3, Matrix6, Se3, Vector2};
use lsfb_types::median;

use super::covariance::pose_covariance;
use super::matches::{MountedCamera, PointMatch};
use super::outcome::FeatureMatch;
use super::refinement::{RefinementConfig, refine_pose, settle};
use crate::features::matching::{MatchConfig, Prediction, match_projected};
use crate::features::{FrameFeatures, KeypointGrid};
use crate::hd_map::HdMap;

/// How to look for projected points.
pub(super) struct GuidedConfig<'a> {
    pub radius_px: f64,
    pub matching: &'a MatchConfig,
    pub max_error_px: f64,
    pub refinement: &'a RefinementConfig,
}

/// The images of a query, before the map.
pub(super) struct Query<'a> {
    pub map: &'a HdMap,
    pub frames: &'a [FrameFeatures],
    pub grids: &'a [KeypointGrid],
    pub cameras: &'a [MountedCamera],
}

/// A pose with the pairs that agree with it.
pub(super) struct GuidedPose {
    pub world_from_rig: Se3,
    pub matches: Vec<FeatureMatch>,
    /// Error up to which pairs are its inliers, pixels.
    pub tolerance_px: f64,
    pub reprojection_rms_px: f64,
    pub covariance: Matrix6<f64>,
}

/// How often guided matching is repeated while it finds more.
const ROUNDS: usize = 3;

impl Query<'_> {
    /// The pose near `start` that most of these points agree with when they are looked for where it expects them.
    pub fn guided_pose(
        &self,
        points: &[u32],
        start: &Se3,
        config: &GuidedConfig,
    ) -> Option<GuidedPose> {
        let mut found: Option<GuidedPose> = None;
        for _ in 0..ROUNDS {
            let pose = found.as_ref().map_or(*start, |f| f.world_from_rig);
            let pairs = self.project(points, &pose, &Vector2::zeros(), config);
            let before = found.as_ref().map_or(0, |f| f.matches.len());
            match self.refine(&pairs.matches, &pose, config) {
                Some(refined) if refined.matches.len() > before => found = Some(refined),
                _ => break,
            }
        }
        found
    }

    /// Inliers where the points are not: the mean over projections moved aside in four directions.
    pub fn decoy_inliers(&self, points: &[u32], pose: &GuidedPose, config: &GuidedConfig) -> f64 {
        let world_from_rig = &pose.world_from_rig;
        let aside = 5.0 * config.radius_px;
        let directions = [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
        let shares = directions.map(|(x, y)| {
            let pairs = self.project(
                points,
                world_from_rig,
                &(Vector2::new(x, y) * aside),
                config,
            );
            let near = pairs.offsets_px.iter().filter(|o| **o <= pose.tolerance_px);
            near.count() as f64 / pairs.projected.max(1) as f64
        });
        let whole = self.project(points, world_from_rig, &Vector2::zeros(), config);
        shares.iter().sum::<f64>() / shares.len() as f64 * whole.projected as f64
    }

    /// Pixel and map point of each pair.
    pub fn resolve(&self, pairs: &[FeatureMatch]) -> Vec<PointMatch> {
        pairs
            .iter()
            .map(|p| {
                let keypoint = &self.frames[p.frame].features.keypoints[p.keypoint as usize];
                let quality = self.map.quality(p.point);
                PointMatch {
                    camera: p.frame,
                    pixel: keypoint.pixel_f64(),
                    point_in_world: self.map.position(p.point).unwrap_or_default(),
                    point_covariance_m2: quality.map_or_else(Matrix3::zeros, |q| q.covariance_m2),
                }
            })
            .collect()
    }

    /// Pairs of the points with the features near their projections, which are moved by `aside_px`.
    fn project(
        &self,
        points: &[u32],
        world_from_rig: &Se3,
        aside_px: &Vector2<f64>,
        config: &GuidedConfig,
    ) -> ProjectedPairs {
        let mut pairs = ProjectedPairs::default();
        let mut found: Vec<(FeatureMatch, f64)> = Vec::new();
        let all = self.frames.iter().zip(self.grids).zip(self.cameras);
        for (index, ((frame, grid), mounted)) in all.enumerate() {
            let camera_from_world = (*world_from_rig * mounted.rig_from_camera).inverse();
            let mut visible = Vec::new();
            let mut predictions = Vec::new();
            for &point in points {
                let Some(position) = self.map.position(point) else {
                    continue;
                };
                let pixel = mounted.camera.project(&(camera_from_world * position));
                let pixel = pixel.map(|p| p + aside_px);
                if let Some(pixel) = pixel.filter(|p| mounted.camera.contains(p, 0.0)) {
                    visible.push(point);
                    predictions.push(Prediction {
                        pixel,
                        descriptors: self.map.descriptors(point),
                    });
                }
            }
            pairs.projected += predictions.len();
            let matches = match_projected(
                &predictions,
                grid,
                &frame.features.descriptors,
                config.radius_px,
                config.matching,
            );
            found.extend(matches.iter().map(|m| {
                let keypoint = &frame.features.keypoints[m.second as usize];
                let pair = FeatureMatch {
                    point: visible[m.first as usize],
                    frame: index,
                    keypoint: m.second,
                    pixel: keypoint.pixel,
                };
                let seen = keypoint.pixel_f64();
                (pair, (predictions[m.first as usize].pixel - seen).norm())
            }));
        }
        found.sort_unstable_by_key(|(p, _)| (p.frame, p.keypoint));
        (pairs.matches, pairs.offsets_px) = found.into_iter().unzip();
        pairs
    }

    /// The pose of least robust error, and the pairs that agree with it.
    fn refine(
        &self,
        pairs: &[FeatureMatch],
        start: &Se3,
        config: &GuidedConfig,
    ) -> Option<GuidedPose> {
        let (cameras, refinement) = (self.cameras, config.refinement);
        let resolved = self.resolve(pairs);
        let errors = |pose: &Se3| -> Vec<f64> {
            let error = |m: &PointMatch| {
                let mounted = &cameras[m.camera];
                let camera_from_world = (*pose * mounted.rig_from_camera).inverse();
                let seen = mounted
                    .camera
                    .project(&(camera_from_world * m.point_in_world));
                seen.map_or(f64::INFINITY, |pixel| (pixel - m.pixel).norm())
            };
            resolved.iter().map(error).collect()
        };
        let mut pose = *start;
        // The first pose may be a little off: let more agree with it than in the end.
        for tolerance in [2.0, 1.0] {
            let agreeing: Vec<PointMatch> = resolved
                .iter()
                .zip(errors(&pose))
                .filter(|(_, e)| *e <= tolerance * config.max_error_px)
                .map(|(m, _)| *m)
                .collect();
            pose = refine_pose(cameras, &agreeing, &pose, refinement)?.world_from_rig;
        }
        let errors = errors(&pose);
        let tolerance_px = tolerance_px(&errors, config.max_error_px);
        let inlier = |i: &usize| errors[*i] <= tolerance_px;
        let inliers: Vec<usize> = (0..pairs.len()).filter(inlier).collect();
        let agreeing: Vec<PointMatch> = inliers.iter().map(|i| resolved[*i]).collect();
        let refined = refine_pose(cameras, &agreeing, &pose, refinement)?;
        let refined = settle(cameras, &agreeing, refined, refinement);
        let squares: f64 = inliers.iter().map(|i| errors[*i].powi(2)).sum();
        Some(GuidedPose {
            world_from_rig: refined.world_from_rig,
            matches: inliers.iter().map(|i| pairs[*i]).collect(),
            tolerance_px,
            reprojection_rms_px: (squares / inliers.len() as f64).sqrt(),
            covariance: pose_covariance(cameras, &agreeing, &refined, refinement.huber_px)?,
        })
    }
}

/// Inliers lie within this many standard deviations.
const TOLERATED_SIGMAS: f64 = 2.5;
/// However well the others fit, a pair this near agrees too, pixels.
const MIN_TOLERANCE_PX: f64 = 2.0;

/// What counts as agreement where these are the errors of the pairs: how exact map, lens and keypoints are differs from place to place.
fn tolerance_px(errors_px: &[f64], max_error_px: f64) -> f64 {
    let near = errors_px.iter().copied().filter(|e| *e <= max_error_px);
    // Half of the lengths of errors with standard deviation 1 along each axis lie below √(2 ln 2).
    let median_px = median(near.collect()).unwrap_or(max_error_px);
    let sigma_px = median_px / (2.0 * std::f64::consts::LN_2).sqrt();
    (TOLERATED_SIGMAS * sigma_px).clamp(MIN_TOLERANCE_PX.min(max_error_px), max_error_px)
}

/// Pairs near projected points.
#[derive(Default)]
struct ProjectedPairs {
    /// By frame and keypoint.
    matches: Vec<FeatureMatch>,
    /// Distance of each from the projection, pixels.
    offsets_px: Vec<f64>,
    /// Points projected into an image.
    projected: usize,
}
