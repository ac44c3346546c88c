use std::fmt;

use lsfb_geometry::{Matrix6, Rig, Se3};
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use super::matches::{MountedCamera, PointMatch};
use super::ransac::{RansacConfig, estimate_pose};
use super::refinement::refine_pose;
use super::voting::{Candidates, Places};
use crate::features::matching::{DESCRIPTOR_NORM, MatchConfig, Prediction, match_projected};
use crate::features::{FrameFeatures, KeypointGrid};
use crate::hd_map::{HdMap, SearchScratch};
use crate::{Error, hd_map};

/// Configuration of [`Localizer`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LocalizerConfig {
    /// Map descriptors looked up for each feature.
    pub nearest: usize,
    /// Inverted lists of the index searched for each feature.
    pub probes: usize,
    /// Largest descriptor distance of a candidate, in units of the descriptor's norm.
    pub max_distance: f32,
    /// A candidate may be this much farther than the nearest one.
    pub max_candidate_ratio: f32,
    /// Places with fewer votes are dropped.
    pub min_votes: u32,
    /// Places tried, most votes first.
    pub max_places: usize,
    /// Map images taken together as one place: those that share most points.
    pub place_images: usize,
    /// The pose search.
    pub ransac: RansacConfig,
    /// Radius around a projected point in which its feature is looked for, pixels.
    pub projection_radius_px: f64,
    /// Matching of projected points.
    pub projection_matching: MatchConfig,
    /// A pose counts as found with more inliers than this.
    pub min_inliers: usize,
}

impl Default for LocalizerConfig {
    fn default() -> Self {
        Self {
            nearest: 25,
            probes: 8,
            max_distance: 0.75,
            max_candidate_ratio: 1.15,
            min_votes: 6,
            max_places: 3,
            place_images: 12,
            ransac: RansacConfig::default(),
            projection_radius_px: 6.0,
            projection_matching: MatchConfig {
                max_ratio: 0.9,
                max_distance: 0.75,
            },
            min_inliers: 30,
        }
    }
}

lsfb_types::bounds! {
    LocalizerConfig {
        nearest: number(Bounds::AT_LEAST_ONE),
        probes: number(Bounds::AT_LEAST_ONE),
        max_distance: number(Bounds::NOT_NEGATIVE),
        max_candidate_ratio: number(Bounds::NOT_NEGATIVE),
        min_votes: any,
        max_places: any,
        place_images: any,
        ransac: section,
        projection_radius_px: number(Bounds::POSITIVE),
        projection_matching: section,
        min_inliers: any,
    }
}

/// A feature that shows a map point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureMatch {
    /// Index of the map point.
    pub point: u32,
    /// Index of the frame among the query's.
    pub frame: usize,
    /// Index of its keypoint.
    pub keypoint: u32,
}

/// A pose in the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Localization {
    /// Pose of the rig.
    pub world_from_rig: Se3,
    /// Its inliers, by frame and keypoint.
    pub matches: Vec<FeatureMatch>,
    /// Root mean square of their reprojection errors, pixels.
    pub reprojection_rms_px: f64,
    /// Information of the pose, tangent `[rotation, translation]`, per square pixel of noise: see
    /// [`RefinedPose`](super::RefinedPose).
    pub information: Matrix6<f64>,
    /// Votes of the place where it was found.
    pub votes: u32,
}

/// Why there is no pose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotLocalizedReason {
    /// A frame's camera is not on the rig.
    UnknownCamera {
        /// The camera.
        camera: String,
    },
    /// No place got enough votes.
    NoPlace {
        /// Votes of the best one.
        votes: u32,
    },
    /// No place gave a pose that enough matches support.
    TooFewInliers {
        /// Inliers of the best pose.
        inliers: usize,
        /// How many there must be.
        needed: usize,
    },
}

/// A query that could not be localized.
#[derive(Clone, Debug, PartialEq, Eq)]
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
                    "camera {camera} is not on the rig: give the rig of these images"
                )
            }
            NotLocalizedReason::NoPlace { votes } => write!(
                f,
                "no place of the map resembles this view (best: {votes} votes): it may be outside the map"
            ),
            NotLocalizedReason::TooFewInliers { inliers, needed } => write!(
                f,
                "only {inliers} features agree on a pose, {needed} are needed: the view may be outside the map"
            ),
        }
    }
}

impl std::error::Error for NotLocalized {}

/// Finds poses in a map. Shared by threads; needs no order of queries.
#[derive(Clone, Debug)]
pub struct Localizer {
    map: HdMap,
    places: Places,
    config: LocalizerConfig,
}

/// One frame of a query, prepared.
struct Query<'a> {
    frame: &'a FrameFeatures,
    grid: KeypointGrid,
}

impl Localizer {
    /// A localizer in `map`; refuses a configuration without meaning.
    pub fn new(map: &HdMap, config: &LocalizerConfig) -> Result<Self, Error> {
        config.check_bounds("localizer")?;
        Ok(Self {
            map: map.clone(),
            places: Places::new(map),
            config: config.clone(),
        })
    }

    /// The map.
    pub fn map(&self) -> &HdMap {
        &self.map
    }

    /// Pose of `rig` from frames taken at one instant.
    pub fn localize(
        &self,
        frames: &[FrameFeatures],
        rig: &Rig,
    ) -> Result<Localization, NotLocalized> {
        let cameras = mount(frames, rig)?;
        let candidates: Vec<Vec<Candidates>> = frames.iter().map(|f| self.look_up(f)).collect();
        let all: Vec<Candidates> = candidates.iter().flatten().cloned().collect();
        let votes = self.places.vote(&all, self.config.min_votes);
        if votes.is_empty() {
            let best = self.places.vote(&all, 1).first().map_or(0, |v| v.votes);
            return Err(NotLocalized {
                reason: NotLocalizedReason::NoPlace { votes: best },
            });
        }
        let queries: Vec<Query> = frames
            .iter()
            .zip(&cameras)
            .map(|(frame, mounted)| {
                let (camera, radius) = (&mounted.camera, self.config.projection_radius_px);
                let keypoints = &frame.features.keypoints;
                let grid = KeypointGrid::new(keypoints, camera.width, camera.height, 2.0 * radius);
                Query { frame, grid }
            })
            .collect();
        let mut best: Option<Localization> = None;
        let mut tried: Vec<u32> = Vec::new();
        for vote in &votes {
            if tried.contains(&vote.image) {
                continue;
            }
            let place = self
                .places
                .neighbourhood(vote.image, self.config.place_images);
            let points = self.places.points_of(&place);
            tried.extend(&place);
            let found = self.pose_at(&queries, &cameras, &candidates, &points, vote.votes);
            let count = |l: &Option<Localization>| l.as_ref().map_or(0, |l| l.matches.len());
            if count(&found) > count(&best) {
                best = found;
            }
            // A pose with several times the support it needs will not be beaten by a place with fewer votes.
            let enough = count(&best) > 3 * self.config.min_inliers;
            if enough || tried.len() >= self.config.max_places * self.config.place_images {
                break;
            }
        }
        let inliers = best.as_ref().map_or(0, |l| l.matches.len());
        best.filter(|_| inliers > self.config.min_inliers)
            .ok_or(NotLocalized {
                reason: NotLocalizedReason::TooFewInliers {
                    inliers,
                    needed: self.config.min_inliers + 1,
                },
            })
    }

    /// For each feature the map points it may show, nearest first, each point once.
    fn look_up(&self, frame: &FrameFeatures) -> Vec<Candidates> {
        let mut scratch = SearchScratch::default();
        let config = &self.config;
        let limit = (config.max_distance * DESCRIPTOR_NORM).powi(2);
        let ratio = config.max_candidate_ratio.powi(2);
        let descriptors = &frame.features.descriptors;
        descriptors
            .iter()
            .map(|d| {
                let mut found = self
                    .map
                    .nearest(d, config.nearest, config.probes, &mut scratch);
                let nearest = found.first().map_or(0.0, |n| n.distance_squared as f32);
                let limit = limit.min(ratio * nearest.max(1.0));
                found.retain(|n| n.distance_squared as f32 <= limit);
                let mut kept: Vec<hd_map::MapNeighbour> = Vec::with_capacity(found.len());
                for n in found {
                    if !kept.iter().any(|k| k.point == n.point) {
                        kept.push(n);
                    }
                }
                kept
            })
            .collect()
    }

    /// The pose among these points, if there is one.
    fn pose_at(
        &self,
        queries: &[Query],
        cameras: &[MountedCamera],
        candidates: &[Vec<Candidates>],
        points: &[u32],
        votes: u32,
    ) -> Option<Localization> {
        let mut pairs: Vec<FeatureMatch> = Vec::new();
        for (frame, features) in candidates.iter().enumerate() {
            for (keypoint, candidates) in features.iter().enumerate() {
                let here = candidates
                    .iter()
                    .find(|c| points.binary_search(&c.point).is_ok());
                pairs.extend(here.map(|c| FeatureMatch {
                    point: c.point,
                    frame,
                    keypoint: keypoint as u32,
                }));
            }
        }
        let estimate = estimate_pose(cameras, &self.resolve(queries, &pairs), &self.config.ransac)?;
        let mut pose = estimate.world_from_rig;
        let mut found: Option<Localization> = None;
        for _ in 0..3 {
            let pairs = self.project(queries, cameras, points, &pose);
            let Some(refined) = self.refine(queries, cameras, &pairs, &pose, votes) else {
                break;
            };
            let before = found.as_ref().map_or(0, |f| f.matches.len());
            if refined.matches.len() <= before {
                break;
            }
            pose = refined.world_from_rig;
            found = Some(refined);
        }
        found
    }

    fn resolve(&self, queries: &[Query], pairs: &[FeatureMatch]) -> Vec<PointMatch> {
        pairs
            .iter()
            .map(|p| PointMatch {
                camera: p.frame,
                pixel: queries[p.frame].frame.features.keypoints[p.keypoint as usize].pixel_f64(),
                point_in_world: self.map.position(p.point).unwrap_or_default(),
            })
            .collect()
    }

    /// Pairs of the points with the features near their projections.
    fn project(
        &self,
        queries: &[Query],
        cameras: &[MountedCamera],
        points: &[u32],
        world_from_rig: &Se3,
    ) -> Vec<FeatureMatch> {
        let mut pairs = Vec::new();
        for (frame, (query, mounted)) in queries.iter().zip(cameras).enumerate() {
            let camera_from_world = (*world_from_rig * mounted.rig_from_camera).inverse();
            let mut visible = Vec::new();
            let mut predictions = Vec::new();
            for &point in points {
                let Some(position) = self.map.position(point) else {
                    continue;
                };
                let pixel = mounted.camera.project(&(camera_from_world * position));
                if let Some(pixel) = pixel.filter(|p| mounted.camera.contains(p, 0.0)) {
                    visible.push(point);
                    predictions.push(Prediction {
                        pixel,
                        descriptors: self.map.descriptors(point),
                    });
                }
            }
            let matches = match_projected(
                &predictions,
                &query.grid,
                &query.frame.features.descriptors,
                self.config.projection_radius_px,
                &self.config.projection_matching,
            );
            pairs.extend(matches.iter().map(|m| FeatureMatch {
                point: visible[m.first as usize],
                frame,
                keypoint: m.second,
            }));
        }
        pairs.sort_unstable_by_key(|p| (p.frame, p.keypoint));
        pairs
    }

    /// The pose of least robust error, and the pairs that agree with it.
    fn refine(
        &self,
        queries: &[Query],
        cameras: &[MountedCamera],
        pairs: &[FeatureMatch],
        start: &Se3,
        votes: u32,
    ) -> Option<Localization> {
        let max_error_px = self.config.ransac.max_error_px;
        let refinement = &self.config.ransac.refinement;
        let resolved = self.resolve(queries, pairs);
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
                .filter(|(_, e)| *e <= tolerance * max_error_px)
                .map(|(m, _)| *m)
                .collect();
            pose = refine_pose(cameras, &agreeing, &pose, refinement)?.world_from_rig;
        }
        let errors = errors(&pose);
        let inlier = |i: &usize| errors[*i] <= max_error_px;
        let inliers: Vec<usize> = (0..pairs.len()).filter(inlier).collect();
        let agreeing: Vec<PointMatch> = inliers.iter().map(|i| resolved[*i]).collect();
        let refined = refine_pose(cameras, &agreeing, &pose, refinement)?;
        let squares: f64 = inliers.iter().map(|i| errors[*i].powi(2)).sum();
        Some(Localization {
            world_from_rig: refined.world_from_rig,
            matches: inliers.iter().map(|i| pairs[*i]).collect(),
            reprojection_rms_px: (squares / inliers.len() as f64).sqrt(),
            information: refined.information,
            votes,
        })
    }
}

fn mount(frames: &[FrameFeatures], rig: &Rig) -> Result<Vec<MountedCamera>, NotLocalized> {
    frames
        .iter()
        .map(|frame| {
            let mounted = rig.cameras.get(&frame.camera).ok_or(NotLocalized {
                reason: NotLocalizedReason::UnknownCamera {
                    camera: frame.camera.clone(),
                },
            })?;
            Ok(MountedCamera {
                camera: mounted.camera,
                rig_from_camera: mounted.rig_from_camera,
            })
        })
        .collect()
}
