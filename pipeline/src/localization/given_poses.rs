//! The pose of a query beside those of the map's images that saw its points, where these poses were given.
//!
//! Poses that somebody else measured are off, and those of images that are near one another are off alike: a tracker drifts, and what
//! it gave when it came by again differs from what it gave before. A point that images of both passes saw stands between the two, and an
//! image that is placed by such points stands where no image of the map does. So the poses of the images that share most points with the
//! query are adjusted together with its own and the points, by their pixels. Each is held near where it was given, the closer the nearer
//! it is to the query: where the query is among the images next to it says most of where it is among given poses. What these disagree
//! by, and how far they are, is in the covariance.

use std::collections::BTreeMap;
use std::sync::Arc;

use lsfb_geometry::{Matrix6, RigCamera, Se3, Vector3};
use lsfb_solver::{
    Diagnosis, Error, Kernel, PosePrior, Problem, SolveConfig, VectorPrior, covariance, solve,
};
use lsfb_types::median;

use super::guided_matching::{GuidedPose, Query};
use super::map_error::MapError;
use super::matches::{MountedCamera, PointMatch};
use crate::hd_map::MapObservation;
use crate::residuals::{ObservingCamera, Reprojection};

/// Images that are adjusted, at most, and points that each shares with the query at least.
const MOST_IMAGES: usize = 16;
const FEWEST_SHARED: usize = 8;
/// Standard deviations of a given pose next to the query, and of what the query's own would be off by had it been given alone, in those of
/// the map's images: chosen so that the regions of 95 % of the HoloLens office and the kitchen of 7-Scenes hold as much (`docs/figures.md`).
const GIVEN_PER_MAP_ERROR: f64 = 0.7;
pub(super) const OWN_PER_MAP_ERROR: f64 = 0.45;
/// How far an image is, distance in depths of the scene and angle between directions of view in radians taken together, where its standard deviation is twice that;
/// it grows with the third power.
const NEAR: f64 = 0.1;
/// Standard deviation of a keypoint along each axis, and the error at which its weight has fallen to one half in units of that.
const KEYPOINT_SIGMA_PX: f64 = 0.7;
const HALF_WEIGHT_SIGMAS: f64 = 2.0;
const MOST_ITERATIONS: usize = 20;
/// Keeps a point that no camera has before it any more from being undetermined, as a share of the depth.
const POINT_SIGMA_PER_DEPTH: f64 = 10.0;

/// A pose among given ones.
pub(super) struct PoseAmongGiven {
    pub world_from_rig: Se3,
    /// Tangent `[rotation, translation]` on the right: of pixels, points and given poses.
    pub covariance: Matrix6<f64>,
}

/// `None` where the poses of the map were not given but found, with their own covariances; where nothing is known of how far they are
/// off; where no image shares enough points with the query; and where these do not determine its pose.
pub(super) fn pose_among_given(
    query: &Query,
    pose: &GuidedPose,
    map_error: &MapError,
) -> Option<PoseAmongGiven> {
    let map = query.map;
    let sigmas = [map_error.rotation_rad, map_error.translation_m];
    if sigmas.iter().any(|s| !s.is_finite() || *s <= 0.0) {
        return None;
    }
    let matches = query.resolve(&pose.matches);
    let points = pose.matches.iter().map(|m| m.point);
    let seen: Vec<Vec<MapObservation>> = points.map(|p| map.observations(p).collect()).collect();
    let mut shared: BTreeMap<u32, usize> = BTreeMap::new();
    for observation in seen.iter().flatten() {
        *shared.entry(observation.keyframe).or_default() += 1;
    }
    if shared.keys().any(|k| map.keyframe_covariance(*k).is_some()) {
        return None;
    }
    let mut ranked: Vec<(u32, usize)> = shared.into_iter().collect();
    ranked.retain(|(_, points)| *points >= FEWEST_SHARED);
    ranked.sort_by_key(|(keyframe, points)| (std::cmp::Reverse(*points), *keyframe));
    ranked.truncate(MOST_IMAGES);
    let looks_along = |pose: &Se3, rig_from_camera: &Se3| {
        pose.rotation * (rig_from_camera.rotation * Vector3::z())
    };
    let mut given = BTreeMap::new();
    for (keyframe, _) in ranked {
        let world_from_rig = map.keyframe(keyframe)?.world_from_rig;
        let mut saw = seen.iter().flatten().filter(|o| o.keyframe == keyframe);
        let name = map.cameras().get(usize::from(saw.next()?.camera))?;
        let mounted = map.rig().cameras.get(name)?;
        let view = GivenView {
            world_from_rig,
            looks_along: looks_along(&world_from_rig, &mounted.rig_from_camera),
        };
        given.insert(keyframe, view);
    }
    if given.is_empty() {
        return None;
    }
    let own = &pose.world_from_rig;
    let depths = matches
        .iter()
        .map(|m| (m.point_in_world - own.translation).norm());
    let depth = median(depths.collect()).filter(|depth| *depth > 0.0)?;
    let camera = query.cameras.get(matches.first()?.camera)?;
    let adjustment = Adjustment {
        query,
        matches: &matches,
        seen: &seen,
        given: &given,
        looks_along: looks_along(own, &camera.rig_from_camera),
        depth,
        sigmas,
    };
    adjustment.solved(own).ok().flatten()
}

/// A given pose, and where in the world its camera looks.
struct GivenView {
    world_from_rig: Se3,
    looks_along: Vector3<f64>,
}

struct Adjustment<'a> {
    query: &'a Query<'a>,
    matches: &'a [PointMatch],
    /// Where the map's images saw the point of each match.
    seen: &'a [Vec<MapObservation>],
    /// Poses of these images, by keyframe.
    given: &'a BTreeMap<u32, GivenView>,
    /// Where the query's camera looks.
    looks_along: Vector3<f64>,
    depth: f64,
    /// Of a given pose: radians, metres.
    sigmas: [f64; 2],
}

impl Adjustment<'_> {
    fn solved(&self, start: &Se3) -> Result<Option<PoseAmongGiven>, Error> {
        let mut problem = Problem::new();
        let own = problem.add_block(*start);
        let mut poses = BTreeMap::new();
        for (keyframe, given) in self.given {
            let block = problem.add_block(given.world_from_rig);
            let [turn, place] = self.sigmas.map(|s| s * self.farness(given, start));
            let prior = PosePrior::isotropic(given.world_from_rig, turn, place);
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
            poses.insert(*keyframe, block.id());
        }
        let (map, query) = (self.query.map, self.query);
        let own_cameras: Vec<_> = query.cameras.iter().map(observing).collect();
        let of_map = map.cameras().iter().map(|name| map.rig().cameras.get(name));
        let map_cameras: Vec<_> = of_map.map(|c| c.map(ObservingCamera::new)).collect();
        let kernel = Kernel::Cauchy {
            scale: HALF_WEIGHT_SIGMAS,
        };
        let reprojection = |camera: &Arc<ObservingCamera>, pixel| Reprojection {
            camera: camera.clone(),
            pixel,
            sigma_px: KEYPOINT_SIGMA_PX,
        };
        let loose = Vector3::repeat(POINT_SIGMA_PER_DEPTH * self.depth);
        for (m, seen) in self.matches.iter().zip(self.seen) {
            let Some(camera) = own_cameras.get(m.camera) else {
                continue;
            };
            let point = problem.add_eliminated_point(m.point_in_world);
            let somewhere = VectorPrior::new(m.point_in_world, loose);
            problem.add_residual(somewhere, &[point.id()], Kernel::Squared)?;
            let residual = reprojection(camera, m.pixel);
            problem.add_residual(residual, &[own.id(), point.id()], kernel)?;
            for o in seen {
                let camera = map_cameras
                    .get(usize::from(o.camera))
                    .and_then(Option::as_ref);
                if let Some((pose, camera)) = poses.get(&o.keyframe).zip(camera) {
                    let residual = reprojection(camera, o.pixel.map(f64::from).into());
                    problem.add_residual(residual, &[*pose, point.id()], kernel)?;
                }
            }
        }
        let config = SolveConfig {
            max_iterations: MOST_ITERATIONS,
            diagnosis: Diagnosis::Off,
            ..SolveConfig::default()
        };
        solve(&mut problem, &config)?;
        let known = covariance(&problem, &[own.id()])?;
        let matrix = known.joint();
        let covariance = Matrix6::from_fn(|row, column| matrix[(row, column)]);
        let is_finite = covariance.iter().all(|v| v.is_finite());
        Ok(is_finite.then(|| PoseAmongGiven {
            world_from_rig: problem.value(own),
            covariance,
        }))
    }

    /// Standard deviations of a given pose this far from the query, in those of one next to it, times its share of the map's error. A camera held upside
    /// down sees the same from there.
    fn farness(&self, given: &GivenView, own: &Se3) -> f64 {
        let apart_m = (given.world_from_rig.translation - own.translation).norm();
        let turned_rad = given.looks_along.angle(&self.looks_along);
        let far = (apart_m / self.depth).hypot(turned_rad);
        GIVEN_PER_MAP_ERROR * (1.0 + (far / NEAR).powi(3))
    }
}

fn observing(mounted: &MountedCamera) -> Arc<ObservingCamera> {
    ObservingCamera::new(&RigCamera {
        camera: mounted.camera,
        rig_from_camera: mounted.rig_from_camera,
        timing: Default::default(),
        sigmas: Default::default(),
    })
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, Rig, StampedPose};
    use lsfb_types::{Timestamp, no_progress};

    use super::super::map_error::FEWEST_POINTS;
    use super::super::outcome::FeatureMatch;
    use super::super::{Localizer, LocalizerConfig};
    use super::*;
    use crate::features::{Feature, Features, FrameFeatures, Keypoint, KeypointGrid};
    use crate::hd_map::{
        HdMap, HdMapConfig, KeyframeImage, MapContent, MapPoint, PointObservation,
    };
    use crate::{Error, Refusal};

    /// By how much the given poses of the first pass are off along x, and those of the second the other way.
    const DRIFT_M: f64 = 0.03;
    const POINTS: u32 = 60;

    fn rig() -> Rig {
        let mut rig = Rig::empty("one");
        let camera = RigCamera {
            camera: Camera::pinhole(640, 480, [400.0; 2], [319.5, 239.5]),
            rig_from_camera: Se3::identity(),
            timing: Default::default(),
            sigmas: Default::default(),
        };
        rig.cameras = [("cam0".to_owned(), camera)].into();
        rig
    }

    fn points() -> Vec<Vector3<f64>> {
        let along = |i: u32, step: u32, count: u32| f64::from(i * step % count) / f64::from(count);
        (0..POINTS)
            .map(|i| {
                let (x, y, z) = (along(i, 7, 60), along(i, 11, 53), along(i, 13, 47));
                Vector3::new(-1.0 + 3.5 * x, -1.0 + 2.5 * y, 3.0 + 2.0 * z)
            })
            .collect()
    }

    fn at(x: f64, y: f64) -> Se3 {
        Se3::new(Default::default(), Vector3::new(x, y, 0.0))
    }

    /// As a camera there sees them.
    fn features(pose: &Se3) -> Features {
        let camera = rig().cameras["cam0"].camera;
        let seen = points().into_iter().map(|p| {
            let pixel = camera.project(&(pose.inverse() * p)).expect("in front");
            Keypoint {
                pixel: [pixel.x as f32, pixel.y as f32],
                scale_px: 2.0,
                angle_rad: 0.0,
                response: 0.1,
            }
        });
        Features {
            keypoints: seen.collect(),
            descriptors: (0..POINTS as u8).map(|i| [i; 128]).collect(),
        }
    }

    /// Two passes, 0.6 m apart, whose given poses differ, and points between what they say.
    fn map_of_two_passes() -> HdMap {
        map_with(POINTS as usize)
    }

    /// The same with fewer points.
    fn map_with(most_points: usize) -> HdMap {
        let truth: Vec<Se3> = [0.0, 0.6]
            .into_iter()
            .flat_map(|y| (0..6).map(move |i| at(0.3 * f64::from(i), y)))
            .collect();
        let keyframes: Vec<StampedPose> = truth
            .iter()
            .zip(0..)
            .map(|(pose, number)| StampedPose {
                time: Timestamp::from_nanos(number),
                world_from_rig: at(if number < 6 { DRIFT_M } else { -DRIFT_M }, 0.0) * *pose,
            })
            .collect();
        let images: Vec<KeyframeImage> = truth
            .iter()
            .enumerate()
            .map(|(keyframe, pose)| KeyframeImage {
                keyframe,
                camera: "cam0".to_owned(),
                features: features(pose),
            })
            .collect();
        let points = points()
            .into_iter()
            .take(most_points)
            .zip(0..)
            .map(|(point, keypoint)| MapPoint {
                point_in_world: point,
                observations: (0..images.len())
                    .map(|image| PointObservation { image, keypoint })
                    .collect(),
                reprojection_rms_px: 0.5,
            });
        let content = MapContent {
            rig: &rig(),
            keyframes: &keyframes,
            images: &images,
            points: &points.collect::<Vec<_>>(),
            feature: &Feature::Sift,
            provenance: "made up",
        };
        HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("consistent content")
    }

    fn among_given(map: &HdMap, truth: &Se3, map_error: &MapError) -> Option<PoseAmongGiven> {
        let mounted = &rig().cameras["cam0"];
        let cameras = [MountedCamera {
            camera: mounted.camera,
            rig_from_camera: mounted.rig_from_camera,
            readout_s: 0.0,
        }];
        let frames = [FrameFeatures {
            camera: "cam0".to_owned(),
            features: features(truth),
        }];
        let grids = [KeypointGrid::new(
            &frames[0].features.keypoints,
            640,
            480,
            20.0,
        )];
        let query = Query {
            map,
            frames: &frames,
            grids: &grids,
            cameras: &cameras,
        };
        let matches = (0..POINTS).map(|point| FeatureMatch {
            point,
            frame: 0,
            keypoint: point,
            pixel: frames[0].features.keypoints[point as usize].pixel,
        });
        let pose = GuidedPose {
            // Where the points have it.
            world_from_rig: *truth,
            matches: matches.collect(),
            tolerance_px: 2.0,
            reprojection_rms_px: 0.5,
            covariance: Matrix6::identity(),
        };
        pose_among_given(&query, &pose, map_error)
    }

    const MAP_ERROR: MapError = MapError {
        rotation_rad: 0.01,
        translation_m: DRIFT_M,
    };

    #[test]
    fn a_query_of_one_pass_is_where_that_pass_was_given() {
        let map = map_of_two_passes();
        for (y, given_m) in [(0.0, DRIFT_M), (0.6, -DRIFT_M)] {
            let truth = at(0.75, y);
            let found = among_given(&map, &truth, &MAP_ERROR).expect("a pose");
            let off = found.world_from_rig.translation - truth.translation;
            // Points alone have it in the middle, 3 cm off.
            assert!((off.x - given_m).abs() < 0.4 * DRIFT_M, "{off:?}");
            assert!(
                off.y.abs() < 0.1 * DRIFT_M && off.z.abs() < 0.1 * DRIFT_M,
                "{off:?}"
            );
            let sigma_m = found.covariance[(3, 3)].sqrt();
            assert!((0.1..2.0).contains(&(sigma_m / DRIFT_M)), "{sigma_m}");
        }
    }

    /// The farther the images are, the less is said of where among them a query is.
    #[test]
    fn far_from_all_images_the_pose_is_known_less() {
        let map = map_of_two_passes();
        let sigma_m = |x: f64| {
            let found = among_given(&map, &at(x, 0.0), &MAP_ERROR).expect("a pose");
            found.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt()
        };
        assert!(sigma_m(3.0) > 2.0 * sigma_m(0.75));
    }

    /// Naively no image that shares points meant a map without any error, and poses in it known to millimetres.
    #[test]
    fn a_map_that_does_not_tell_its_error_is_refused() {
        let config = LocalizerConfig::default();
        let found = |points| Localizer::new(&map_with(points), &config).map(|l| l.map_error);
        let of_all = found(POINTS as usize).expect("known");
        assert!(of_all.translation_m > 0.1 * DRIFT_M, "{of_all:?}");
        let few = found(FEWEST_POINTS - 1);
        assert!(
            matches!(few, Err(Error::Refused(Refusal::MapErrorUnknown { .. }))),
            "{few:?}"
        );
    }

    #[test]
    fn poses_that_were_found_are_taken_as_they_are() {
        let map = map_of_two_passes();
        let truth = at(0.75, 0.0);
        let exact = MapError::default();
        assert!(among_given(&map, &truth, &exact).is_none());
        let known = map.with_keyframe_covariances(vec![Some(Matrix6::identity() * 1e-6); 12]);
        assert!(among_given(&known, &truth, &MAP_ERROR).is_none());
    }
}
