use lsfb_geometry::{Rig, Se3};

use super::acceptance::{Agreement, FirstMatches};
use super::config::LocalizerConfig;
use super::guided_matching::{GuidedConfig, GuidedPose, Query};
use super::map_error::{FEWEST_POINTS, MapError};
use super::matches::MountedCamera;
use super::outcome::{FeatureMatch, Localization, NotLocalized, NotLocalizedReason};
use super::prior::PoseKnowledge;
use super::ransac::estimate_known_pose;
use super::voting::{Candidates, Places, Vote};
use crate::camera_fit::principal_point_fits;
use crate::descriptor_index::SearchScratch;
use crate::features::matching::DESCRIPTOR_NORM;
use crate::features::{FrameFeatures, KeypointGrid};
use crate::hd_map::{HdMap, MapNeighbour};
use crate::{Error, Refusal};

/// Finds poses in a map. Shared by threads; needs no order of queries.
#[derive(Clone, Debug)]
pub struct Localizer {
    pub(super) map: HdMap,
    pub(super) places: Places,
    pub(super) map_error: MapError,
    pub(super) config: LocalizerConfig,
    /// Whether an image that little speaks for is looked for elsewhere, and doubted where it is found there as well.
    asks_for_twins: bool,
}

/// The pose found at one place.
pub(super) struct Hypothesis {
    /// The matches by look, and how well it agrees with them.
    pub first: FirstMatches,
    pub agreement: Agreement,
    /// Points of the place.
    pub points: Vec<u32>,
    pub pose: GuidedPose,
    pub votes: u32,
}

/// The best pose of a query, and what it was chosen from.
pub(super) struct Found {
    pub hypothesis: Hypothesis,
    /// Places that were tried.
    pub places: usize,
    /// First inliers of the best pose that contradicts it.
    pub rival_inliers: usize,
    /// What was known of it beforehand says against chance: see [`PoseKnowledge::decades`].
    pub known_decades: f64,
}

/// A query with what the map says of it.
pub(super) struct MatchedQuery<'a> {
    query: &'a Query<'a>,
    /// Points that each feature of each frame may show.
    candidates: &'a [Vec<Candidates>],
    /// Points of the map's images around where the rig should be; none where nobody knows that.
    around: &'a [u32],
    votes: &'a [Vote],
    known: &'a PoseKnowledge,
}

impl<'a> MatchedQuery<'a> {
    /// With places and a pose that are not chosen by votes or by anything known.
    pub fn alone(query: &'a Query<'a>, candidates: &'a [Vec<Candidates>]) -> Self {
        Self {
            query,
            candidates,
            around: &[],
            votes: &[],
            known: &PoseKnowledge::NOTHING,
        }
    }
}

impl Localizer {
    /// A localizer in `map`; refuses a configuration without meaning, and a map of which nothing tells how far its own images are off: no
    /// pose in it would have a covariance.
    pub fn new(map: &HdMap, config: &LocalizerConfig) -> Result<Self, Error> {
        config.check_bounds("localizer")?;
        let map_error = MapError::of(map, &config.ransac.refinement);
        let map_error = map_error.ok_or(Refusal::MapErrorUnknown {
            needed: FEWEST_POINTS,
        })?;
        Ok(Self {
            map: map.clone(),
            places: Places::new(map),
            map_error,
            config: config.clone(),
            asks_for_twins: true,
        })
    }

    /// Without looking for poses elsewhere that explain a single image as well, for who asks that of many images together.
    pub(crate) fn without_twins(self) -> Self {
        Self {
            asks_for_twins: false,
            ..self
        }
    }

    /// The map.
    pub fn map(&self) -> &HdMap {
        &self.map
    }

    /// Least probability of a pose that counts as found.
    pub fn min_probability(&self) -> f64 {
        self.config.min_probability
    }

    /// Pose of `rig` from frames taken at one instant.
    pub fn localize(
        &self,
        frames: &[FrameFeatures],
        rig: &Rig,
    ) -> Result<Localization, NotLocalized> {
        self.localize_known(frames, rig, &PoseKnowledge::NOTHING)
    }

    /// [`Localizer::localize`] with what is known of the pose beforehand: where it contradicts that there is none.
    pub fn localize_known(
        &self,
        frames: &[FrameFeatures],
        rig: &Rig,
        known: &PoseKnowledge,
    ) -> Result<Localization, NotLocalized> {
        let best = self.best_pose(frames, rig, known)?;
        if best.evidence.contradicts_focal_length() {
            return Err(NotLocalized {
                reason: NotLocalizedReason::FocalLength {
                    best: Box::new(best),
                    joint: None,
                },
            });
        }
        let needed = self.config.min_probability;
        if best.probability >= needed {
            return Ok(best);
        }
        Err(NotLocalized {
            reason: NotLocalizedReason::Improbable {
                best: Box::new(best),
                needed,
            },
        })
    }

    /// The pose that most speaks for, however little that is.
    fn best_pose(
        &self,
        frames: &[FrameFeatures],
        rig: &Rig,
        known: &PoseKnowledge,
    ) -> Result<Localization, NotLocalized> {
        let cameras = self.mount(frames, rig)?;
        let candidates: Vec<Vec<Candidates>> = frames.iter().map(|f| self.look_up(f)).collect();
        let all: Vec<Candidates> = candidates.iter().flatten().cloned().collect();
        let votes = self.places.vote(&all, self.config.min_votes);
        let around = known.pose.map_or_else(Vec::new, |expected| {
            self.points_around(&cameras, &expected.world_from_rig)
        });
        if votes.is_empty() && around.is_empty() {
            let best = self.places.vote(&all, 1).first().map_or(0, |v| v.votes);
            return Err(NotLocalized {
                reason: NotLocalizedReason::NoPlace { votes: best },
            });
        }
        let grids = self.grids(frames, &cameras);
        let no_pose = NotLocalized {
            reason: NotLocalizedReason::NoPose,
        };
        let query = Query {
            map: &self.map,
            frames,
            grids: &grids,
            cameras: &cameras,
        };
        let seen = MatchedQuery {
            query: &query,
            candidates: &candidates,
            around: &around,
            votes: &votes,
            known,
        };
        let (narrow, tried) = self
            .best_at(&seen, self.config.place_images, 0)
            .ok_or(no_pose)?;
        let evidence = &narrow.evidence;
        if narrow.probability >= self.config.min_probability
            || evidence.contradicts_focal_length()
            || evidence.log10_false_alarms > NO_CHANCE_LOG10
        {
            return Ok(self.held_against_twin(narrow, &seen));
        }
        // Each of the images may overlap the view little, and more of them together enough.
        let wide = self.best_at(&seen, WIDER * self.config.place_images, tried);
        let wide = wide.map(|(wide, _)| doubted(wide, &narrow));
        let better = wide.filter(|wide| wide.probability > narrow.probability);
        Ok(self.held_against_twin(better.unwrap_or(narrow), &seen))
    }

    /// The pose with the best one elsewhere, where it would be accepted though little speaks for it.
    fn held_against_twin(&self, mut pose: Localization, seen: &MatchedQuery) -> Localization {
        let is_asked = self.asks_for_twins && pose.evidence.is_thin();
        if pose.probability < self.config.min_probability || !is_asked {
            return pose;
        }
        let (here, matches) = (&pose.world_from_rig, &pose.matches);
        let there = self.poses_elsewhere(seen.query, seen.candidates, here, matches);
        let there = there.iter().filter(|twin| {
            let there = &twin.world_from_rig;
            are_apart(here, there, ANOTHER_PLACE_M, ANOTHER_PLACE_DEG)
                && !seen.known.contradicts(there)
        });
        pose.evidence.twin_inliers = there.map(|p| p.matches.len()).max().unwrap_or(0);
        pose.probability = pose.evidence.probability();
        pose
    }

    /// The pose that most speaks for among places of so many images each, and how many places have been tried, those of before included.
    fn best_at(
        &self,
        seen: &MatchedQuery,
        place_images: usize,
        tried_before: usize,
    ) -> Option<(Localization, usize)> {
        let mut hypotheses: Vec<Hypothesis> = Vec::new();
        let mut tried: Vec<u32> = Vec::new();
        let mut places = tried_before;
        if !seen.around.is_empty() && tried_before == 0 {
            places += 1;
            hypotheses.extend(self.pose_at(seen, seen.around.to_vec(), 0));
        }
        let (max_places, in_doubt) = (self.config.max_places, self.config.max_places_in_doubt);
        for vote in seen.votes {
            let is_in_doubt = hypotheses
                .iter()
                .all(|h| h.agreement.log10_false_alarms(places) > NO_CHANCE_LOG10);
            let most = if is_in_doubt { in_doubt } else { 0 };
            if places - tried_before >= max_places.max(most) {
                break;
            }
            if tried.contains(&vote.image) {
                continue;
            }
            places += 1;
            let place = self.places.neighbourhood(vote.image, place_images);
            let points = self.places.points_of(&place);
            tried.extend(&place);
            hypotheses.extend(self.pose_at(seen, points, vote.votes));
        }
        // By what no pose searched for; the first of equals is that of the place with most votes.
        let unlikely_by_chance = |i: &usize| -hypotheses[*i].agreement.log10_false_alarms(places);
        let best = (0..hypotheses.len())
            .rev()
            .max_by(|a, b| unlikely_by_chance(a).total_cmp(&unlikely_by_chance(b)))?;
        let best = hypotheses.swap_remove(best);
        let rivals = hypotheses.iter().filter(|h| {
            h.agreement.log10_false_alarms(places) < 0.0
                && contradict(&best.pose.world_from_rig, &h.pose.world_from_rig)
        });
        let rival_inliers = rivals.map(|h| h.agreement.inliers).max().unwrap_or(0);
        let found = Found {
            hypothesis: best,
            places,
            rival_inliers,
            known_decades: seen.known.decades(),
        };
        Some((self.judge(found, seen.query)?, places))
    }

    /// The cameras of the frames: those of the map's own images as these showed them.
    pub(super) fn mount(
        &self,
        frames: &[FrameFeatures],
        rig: &Rig,
    ) -> Result<Vec<MountedCamera>, NotLocalized> {
        let mounted = frames.iter().map(|frame| {
            let stated = rig.cameras.get(&frame.camera).ok_or(NotLocalized {
                reason: NotLocalizedReason::UnknownCamera {
                    camera: frame.camera.clone(),
                },
            })?;
            let mounted = self.map.as_found(&frame.camera, stated);
            let camera = &mounted.camera;
            if !principal_point_fits(camera) {
                return Err(NotLocalized {
                    reason: NotLocalizedReason::PrincipalPointOffCentre {
                        camera: frame.camera.clone(),
                        size_px: [camera.width, camera.height],
                        principal_px: camera.principal_px(),
                    },
                });
            }
            Ok(MountedCamera {
                camera: *camera,
                rig_from_camera: mounted.rig_from_camera,
                readout_s: mounted.timing.readout_s,
            })
        });
        mounted.collect()
    }

    /// The features of frames by where they are, as [`Query`] wants them.
    pub(super) fn grids(
        &self,
        frames: &[FrameFeatures],
        cameras: &[MountedCamera],
    ) -> Vec<KeypointGrid> {
        let both = frames.iter().zip(cameras);
        both.map(|(frame, mounted)| {
            let (camera, radius) = (&mounted.camera, self.config.projection_radius_px);
            let keypoints = &frame.features.keypoints;
            KeypointGrid::new(keypoints, camera.width, camera.height, 2.0 * radius)
        })
        .collect()
    }

    pub(super) fn guided(&self) -> GuidedConfig<'_> {
        GuidedConfig {
            radius_px: self.config.projection_radius_px,
            matching: &self.config.projection_matching,
            max_error_px: self.config.ransac.max_error_px,
            refinement: &self.config.ransac.refinement,
        }
    }

    /// For each feature the map points it may show, nearest first, each point once.
    pub(super) fn look_up(&self, frame: &FrameFeatures) -> Vec<Candidates> {
        let mut scratch = SearchScratch::default();
        let config = &self.config;
        let limit = (config.max_distance * DESCRIPTOR_NORM).powi(2);
        let ratio = config.max_candidate_ratio.powi(2);
        let descriptors = &frame.features.descriptors;
        descriptors
            .iter()
            .map(|d| {
                let (nearest, compared) = (config.nearest, config.compared);
                let mut found = self
                    .map
                    .nearest(d, nearest, config.probes, compared, &mut scratch);
                let nearest = found.first().map_or(0.0, |n| n.distance_squared as f32);
                let limit = limit.min(ratio * nearest.max(1.0));
                found.retain(|n| n.distance_squared as f32 <= limit);
                let mut kept: Vec<MapNeighbour> = Vec::with_capacity(found.len());
                for n in found {
                    if !kept.iter().any(|k| k.point == n.point) {
                        kept.push(n);
                    }
                }
                kept
            })
            .collect()
    }

    /// Points of the map's images that look most as the cameras of a rig do, ascending.
    pub(super) fn points_around(
        &self,
        cameras: &[MountedCamera],
        world_from_rig: &Se3,
    ) -> Vec<u32> {
        let (places, count) = (&self.places, self.config.place_images);
        let nearest = |camera: &MountedCamera| {
            let world_from_camera = *world_from_rig * camera.rig_from_camera;
            places.nearest(&self.map, &world_from_camera, count)
        };
        let images: Vec<u32> = cameras.iter().flat_map(nearest).collect();
        places.points_of(&images)
    }

    /// The pose among the points of a place, if there is one.
    pub(super) fn pose_at(
        &self,
        seen: &MatchedQuery,
        points: Vec<u32>,
        votes: u32,
    ) -> Option<Hypothesis> {
        let MatchedQuery {
            query,
            candidates,
            known,
            ..
        } = seen;
        let mut pairs: Vec<FeatureMatch> = Vec::new();
        let mut distances: Vec<u32> = Vec::new();
        for (frame, features) in candidates.iter().enumerate() {
            for (keypoint, candidates) in features.iter().enumerate() {
                let here = candidates
                    .iter()
                    .find(|c| points.binary_search(&c.point).is_ok());
                pairs.extend(here.map(|c| FeatureMatch {
                    point: c.point,
                    frame,
                    keypoint: keypoint as u32,
                    pixel: query.frames[frame].features.keypoints[keypoint].pixel,
                }));
                distances.extend(here.map(|c| c.distance_squared));
            }
        }
        let resolved = query.resolve(&pairs);
        let estimate = estimate_known_pose(query.cameras, &resolved, known, &self.config.ransac)?;
        let pose = query.guided_pose(&points, &estimate.world_from_rig, &self.guided())?;
        if known.contradicts(&pose.world_from_rig) {
            return None;
        }
        let shown = pairs.iter().map(|p| p.point);
        let judged = distances.into_iter().zip(shown).zip(resolved);
        let judged = judged.map(|((distance, point), m)| (distance, point, m));
        let max_error_px = self.config.ransac.max_error_px;
        let first = FirstMatches::new(judged.collect(), max_error_px);
        Some(Hypothesis {
            agreement: first.agreement(query.cameras, &pose.world_from_rig, max_error_px),
            first,
            points,
            pose,
            votes,
        })
    }
}

/// Where a pose is neither chance nor probable, places of so many times as many images are tried.
const WIDER: usize = 2;

/// Decimal logarithm of the false alarms below which a pose was surely not found by chance.
const NO_CHANCE_LOG10: f64 = -10.0;

/// A pose with another as its rival, if they contradict each other.
fn doubted(mut pose: Localization, other: &Localization) -> Localization {
    if contradict(&pose.world_from_rig, &other.world_from_rig) {
        let rival = &mut pose.evidence.rival_inliers;
        *rival = other.evidence.first_inliers.max(*rival);
        pose.probability = pose.evidence.probability();
    }
    pose
}

/// A twin is another place if it is this far off: nearer ones are found where the map has a thing twice, at a wrong depth as well.
const ANOTHER_PLACE_M: f64 = 2.5;
const ANOTHER_PLACE_DEG: f64 = 60.0;

/// Poses that differ by more than this are two answers, not one with errors.
const SAME_POSE_M: f64 = 0.5;
const SAME_POSE_DEG: f64 = 10.0;

/// Whether two poses contradict each other.
pub(super) fn contradict(a: &Se3, b: &Se3) -> bool {
    are_apart(a, b, SAME_POSE_M, SAME_POSE_DEG)
}

fn are_apart(a: &Se3, b: &Se3, most_m: f64, most_deg: f64) -> bool {
    let off = a.inverse() * *b;
    off.translation.norm() > most_m || off.rotation.angle().to_degrees() > most_deg
}
