//! Where in a map a scan lies, if all that is known of it beforehand is a wide region: registrations from many starts.
//!
//! The starts are a grid over three standard deviations of the pose. Each is scored by how many of a few points find something of the map;
//! the best are registered. More than one place may come of it: whoever asks decides whether the best is unmistakable.

use lsfb_geometry::{Matrix3, Matrix6, Se3, Vector3, Vector6};
use lsfb_perception::lidar::{
    LocalMap, Observability, PosePrior, Registration, RegistrationConfig, ScanFinder,
    observability, register,
};
use nalgebra::SymmetricEigen;
use rayon::prelude::*;

/// Distance between starts, metres: registration finds its way from half as far.
const STEP_M: f64 = 0.5;
/// Angle between starts about the vertical, radians.
const STEP_RAD: f64 = 0.15;
/// How much of the region is searched, in standard deviations.
const REACH_SIGMAS: f64 = 3.0;
/// Starts at most along one direction, to each side.
const MAX_STEPS: usize = 24;
/// Starts at most; a region that needs more is not searched.
const MAX_STARTS: usize = 20_000;
/// Points by which a start is scored.
const SCORING_POINTS: usize = 200;
/// A point scores where the map has something so near, metres: doors and pillars stand out from walls by little more.
const SCORING_GATE_M: f64 = 0.15;
/// Best starts that are registered, with a few points and a few iterations.
const REGISTERED_STARTS: usize = 20;
const ROUGH_POINTS: usize = 500;
const ROUGH_ITERATIONS: u32 = 12;
/// They are farther from each other than this, so that rivals are among them: metres, and radians.
const APART_M: f64 = 0.8;
const APART_RAD: f64 = 0.25;
/// Best places that are registered with all points.
const REFINED_PLACES: usize = 4;
/// Places nearer to each other than this are one: metres, and radians.
const SAME_PLACE_M: f64 = 0.3;
const SAME_PLACE_RAD: f64 = 0.05;
/// A shift along which planes are sought anew, metres.
const TRIAL_SHIFT_M: f64 = 0.12;

/// A scan to be found, in the rig's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Query<'a> {
    /// Points of the scan, metres.
    pub points_in_rig: &'a [Vector3<f64>],
    /// Where it was seen from, metres.
    pub sensor_in_rig: Vector3<f64>,
}

/// Where to look.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Region {
    /// The most probable pose.
    pub map_from_rig: Se3,
    /// Covariance of `[rotation, translation]` in its tangent.
    pub covariance: Matrix6<f64>,
    /// The vertical, in the rig's frame.
    pub up_in_rig: Vector3<f64>,
}

/// Places where a scan fits, the best first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Places {
    /// Registrations that are no two the same.
    pub found: Vec<Registration>,
}

impl Places {
    /// The best.
    pub fn best(&self) -> Option<&Registration> {
        self.found.first()
    }

    /// Share of the points that agree with the map at the best place but one; 0 where there is one alone.
    pub fn rival_overlap(&self) -> f64 {
        self.found.get(1).map_or(0.0, |r| r.inlier_ratio)
    }
}

/// Searches a region. `None` where it is too large to be searched.
pub(crate) fn search(
    query: &Query,
    region: &Region,
    map: &LocalMap,
    config: &RegistrationConfig,
) -> Option<Places> {
    let starts = starts(region)?;
    let few = thinned(query.points_in_rig, ROUGH_POINTS);
    let rough = Query {
        points_in_rig: &few,
        ..*query
    };
    let roughly = RegistrationConfig {
        max_iterations: ROUGH_ITERATIONS.min(config.max_iterations),
        ..*config
    };
    let best = best_starts(query, &starts, map);
    let places = best
        .iter()
        .map(|start| refine(&rough, start, map, &roughly))
        .collect();
    let places = distinct(places);
    let places = places.iter().take(REFINED_PLACES);
    let refined = places.map(|place| refine(query, &place.world_from_rig, map, config));
    Some(Places {
        found: distinct(refined.collect()),
    })
}

/// The best first, and of those that are the same the best alone.
fn distinct(mut places: Vec<Registration>) -> Vec<Registration> {
    places.sort_by(|a, b| b.inlier_ratio.total_cmp(&a.inlier_ratio));
    let mut found: Vec<Registration> = Vec::new();
    for place in places {
        let is_known = |other: &Registration| is_same(&other.world_from_rig, &place.world_from_rig);
        if !found.iter().any(is_known) {
            found.push(place);
        }
    }
    found
}

/// So many points at most, evenly taken.
pub(crate) fn thinned(points: &[Vector3<f64>], at_most: usize) -> Vec<Vector3<f64>> {
    let step = points.len().div_ceil(at_most).max(1);
    points.iter().step_by(step).copied().collect()
}

/// What a registration in a map sees of each direction; `None` where nothing agreed.
pub(crate) fn seen(
    query: &Query,
    place: &Registration,
    map: &LocalMap,
    config: &RegistrationConfig,
) -> Option<Observability> {
    let planes = |points: &[Vector3<f64>], pose: &Se3, gate_m: f64| {
        let mut finder = ScanFinder::new(map, points, &query.sensor_in_rig);
        finder.find_planes(pose, gate_m)
    };
    observability(query.points_in_rig, place, config, TRIAL_SHIFT_M, planes)
}

fn is_same(a: &Se3, b: &Se3) -> bool {
    let between = a.inverse() * *b;
    between.translation.norm() < SAME_PLACE_M && between.rotation.angle() < SAME_PLACE_RAD
}

fn refine(query: &Query, start: &Se3, map: &LocalMap, config: &RegistrationConfig) -> Registration {
    let prior = PosePrior {
        world_from_rig: *start,
        // Holds a scan without structure, and weighs nothing against one with.
        information: Matrix6::identity(),
    };
    let mut finder = ScanFinder::new(map, query.points_in_rig, &query.sensor_in_rig);
    register(query.points_in_rig, &prior, config, |pose, gate_m| {
        finder.find_all(pose, gate_m)
    })
}

/// The grid over a region, in a fixed order.
fn starts(region: &Region) -> Option<Vec<Se3>> {
    let of_place: Matrix3<f64> = region.covariance.fixed_view::<3, 3>(3, 3).into();
    let of_turn: Matrix3<f64> = region.covariance.fixed_view::<3, 3>(0, 0).into();
    let axes = SymmetricEigen::new(of_place);
    let offsets = |sigma: f64, step: f64| -> Option<Vec<f64>> {
        let reach = REACH_SIGMAS * sigma;
        // Half a step to each side of a start is within reach of the registration.
        let steps = (reach / step - 0.5).ceil().max(0.0);
        (steps <= MAX_STEPS as f64).then(|| {
            let steps = steps as i64;
            (-steps..=steps).map(|k| k as f64 * step).collect()
        })
    };
    let sigma = |k: usize| axes.eigenvalues[k].max(0.0).sqrt();
    let along = [0, 1, 2].map(|k| offsets(sigma(k), STEP_M));
    let [Some(x), Some(y), Some(z)] = along else {
        return None;
    };
    let up = region.up_in_rig;
    let turns = offsets(up.dot(&(of_turn * up)).max(0.0).sqrt(), STEP_RAD)?;
    let count = x.len() * y.len() * z.len() * turns.len();
    if count > MAX_STARTS {
        return None;
    }
    let mut starts = Vec::with_capacity(count);
    for a in &x {
        for b in &y {
            for c in &z {
                let shift = axes.eigenvectors * Vector3::new(*a, *b, *c);
                starts.extend(turns.iter().map(|turn| {
                    let turn = up * *turn;
                    let delta = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
                    region.map_from_rig.retract(&delta)
                }));
            }
        }
    }
    Some(starts)
}

/// Those at which most of a few points find something of the map; of neighbours the better.
fn best_starts(query: &Query, starts: &[Se3], map: &LocalMap) -> Vec<Se3> {
    let points = thinned(query.points_in_rig, SCORING_POINTS);
    let scores: Vec<u32> = starts
        .par_iter()
        .map(|start| score(&points, &query.sensor_in_rig, start, map))
        .collect();
    let mut order: Vec<usize> = (0..starts.len()).collect();
    order.sort_by_key(|k| (std::cmp::Reverse(scores[*k]), *k));
    let mut best: Vec<Se3> = Vec::new();
    for start in order.into_iter().map(|k| starts[k]) {
        if best.len() == REGISTERED_STARTS {
            break;
        }
        let is_near = |other: &Se3| {
            let between = other.inverse() * start;
            between.translation.norm() < APART_M && between.rotation.angle() < APART_RAD
        };
        if !best.iter().any(is_near) {
            best.push(start);
        }
    }
    best
}

fn score(points: &[Vector3<f64>], sensor: &Vector3<f64>, start: &Se3, map: &LocalMap) -> u32 {
    let sensor = *start * *sensor;
    let agrees = |p: &&Vector3<f64>| {
        let in_map = *start * **p;
        map.find(&in_map, &(sensor - in_map), SCORING_GATE_M)
            .is_some()
    };
    points.iter().filter(agrees).count() as u32
}
