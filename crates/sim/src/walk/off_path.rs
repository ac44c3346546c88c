//! A way beside the scanner's: as far off it as the place allows, never through what stands there.
//!
//! Along a route that is known to be free, places to both sides of it are tried at steps of [`LANE_M`]. Of all ways that change
//! lanes no faster than a walker turns, the one is taken whose distance from the scanner's way comes nearest to a distance
//! drawn anew every few metres (Viterbi).

use wide::f32x8;

use super::Walk;
use super::tour::Tour;
use crate::noise::{hash, stream, uniform};
use crate::world::{NO_FACET, Origin, RayPacket, World};

/// Distance between points along the route, and between lanes beside it, metres.
const STEP_M: f64 = 0.5;
const LANE_M: f64 = 0.25;
/// Least distance from the scanner's way that is asked for, metres.
const LEAST_M: f64 = 0.7;
/// What is nearer to the scanner's way than this lies on it, metres.
const ON_PATH_M: f64 = 0.5;
/// Cost of a place there, metres of distance missed: more than being too far away costs.
const ON_PATH_COST_M: f64 = 6.0;
/// Beginnings whose walks have a share of their length off the scanner's way that is at most this much smaller than the best are as good.
const AS_GOOD: f64 = 0.02;
/// Length of way for which one distance is asked for, metres.
const STRETCH_M: f64 = 12.0;
/// Cost of changing by a lane, metres of distance missed.
const CHANGE_COST_M: f64 = 0.05;
/// Room that a walker needs to all sides, metres.
const ROOM_M: f32 = 0.42;
/// Heights above the floor at which something may be in the way, metres.
const HEIGHTS_M: [f32; 8] = [0.35, 0.45, 0.6, 0.735, 1.0, 1.3, 1.6, 1.85];
/// Height from which the floor is looked for, and how far off it may be: a step of stairs, metres.
const LOOK_DOWN_M: f32 = 0.6;
const STEP_RISE_M: f32 = 0.2;
/// Points of another storey are no neighbours, metres.
const STOREY_M: f64 = 1.5;
/// Where the scanner never was on a storey, metres.
const FAR_M: f64 = 100.0;

/// Feet of a walker along a walk, about every [`STEP_M`]; `height_m` is the rig's above them.
pub(crate) fn footsteps(walk: &Walk, height_m: f64) -> Vec<[f64; 3]> {
    let mut feet: Vec<[f64; 3]> = Vec::new();
    for k in 0..=(walk.duration_s() * 20.0) as u32 {
        let [x, y, z]: [f64; 3] = walk
            .at(f64::from(k) * 0.05)
            .world_from_rig
            .translation
            .into();
        let at = [x, y, z - height_m];
        if feet.last().is_none_or(|last| apart_m(last, &at) >= STEP_M) {
            feet.push(at);
        }
    }
    feet
}

/// The corners of a closed way along `route`, up to `most_m` off the scanner's `footsteps` where nothing is in the way.
pub(crate) fn beside(
    world: &World,
    route: &[[f64; 3]],
    footsteps: &[[f64; 3]],
    most_m: f64,
    seed: u64,
) -> Vec<[f64; 3]> {
    let ground = Ground::new(world, route, most_m);
    let count = ground.feet.len();
    let rng = stream(seed, "off path", 0);
    let stretch = (STRETCH_M / STEP_M) as usize;
    let wanted_m: Vec<f64> = (0..count.div_ceil(stretch))
        .map(|_| f64::from(uniform(&rng, LEAST_M as f32, most_m.max(LEAST_M) as f32)))
        .collect();
    let costs: Vec<Vec<f64>> = (0..count)
        .map(|k| {
            ground.feet[k]
                .iter()
                .map(|foot| match foot {
                    Some(foot) => {
                        let off_m = nearest_m(foot, footsteps);
                        let on_path = if off_m < ON_PATH_M {
                            ON_PATH_COST_M
                        } else {
                            0.0
                        };
                        (off_m - wanted_m[k / stretch]).abs() + on_path
                    }
                    None => f64::INFINITY,
                })
                .collect()
        })
        .collect();
    let best = |k: usize| {
        let lanes = 0..ground.lanes;
        lanes.min_by(|a, b| costs[k][*a].total_cmp(&costs[k][*b]))
    };
    // It must end where it begins; the route itself always does.
    let lanes = best(0)
        .and_then(|lane| ground.way(&costs, lane))
        .or_else(|| ground.way(&costs, ground.lanes / 2));
    match lanes {
        Some(lanes) => (0..count)
            .filter_map(|k| ground.feet[k][lanes[k]])
            .collect(),
        None => route.to_vec(),
    }
}

/// A closed way from another beginning: one, drawn, of those from which a walk of `length_m` has the largest share of its length off the
/// scanner's `footsteps`.
pub(crate) fn begun_off_the_path(
    mut way: Vec<[f64; 3]>,
    footsteps: &[[f64; 3]],
    length_m: f64,
    seed: u64,
) -> Vec<[f64; 3]> {
    let count = way.len();
    let steps_m: Vec<f64> = (0..count)
        .map(|k| apart_m(&way[k], &way[(k + 1) % count]))
        .collect();
    let is_off: Vec<bool> = way
        .iter()
        .map(|foot| nearest_m(foot, footsteps) >= ON_PATH_M)
        .collect();
    let share_from = |begin: usize| {
        let (mut walked_m, mut off_m) = (0.0, 0.0);
        for k in (0..count).map(|k| (begin + k) % count) {
            if walked_m >= length_m {
                break;
            }
            walked_m += steps_m[k];
            off_m += if is_off[k] { steps_m[k] } else { 0.0 };
        }
        off_m / walked_m.max(1e-9)
    };
    let shares: Vec<f64> = (0..count).map(share_from).collect();
    let best = shares.iter().fold(0.0_f64, |most, share| most.max(*share));
    let good: Vec<usize> = (0..count)
        .filter(|&k| shares[k] >= best - AS_GOOD)
        .collect();
    let drawn = hash(seed ^ 0xbe91) >> 8;
    if let Some(begin) = good.get(drawn as usize % good.len().max(1)) {
        way.rotate_left(*begin);
    }
    way
}

fn nearest_m(foot: &[f64; 3], footsteps: &[[f64; 3]]) -> f64 {
    footsteps
        .iter()
        .filter(|other| (other[2] - foot[2]).abs() < STOREY_M)
        .map(|other| (other[0] - foot[0]).hypot(other[1] - foot[1]))
        .fold(FAR_M, f64::min)
}

fn apart_m(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1]).hypot(a[2] - b[2])
}

/// Where one can stand on and beside a route.
struct Ground<'a> {
    world: &'a World,
    /// For each point of the route, the feet in each lane; nothing where one cannot stand or cannot get to from the route. The
    /// middle lane is the route.
    feet: Vec<Vec<Option<[f64; 3]>>>,
    /// Directions of the route.
    ahead: Vec<[f64; 2]>,
    lanes: usize,
}

impl<'a> Ground<'a> {
    fn new(world: &'a World, route: &[[f64; 3]], most_m: f64) -> Self {
        let tour = Tour::along(route);
        let count = (tour.length_m() / STEP_M).round().max(4.0) as usize;
        let step_m = tour.length_m() / count as f64;
        let half = (most_m / LANE_M).floor() as usize;
        let mut ground = Self {
            world,
            feet: Vec::with_capacity(count),
            ahead: Vec::with_capacity(count),
            lanes: 2 * half + 1,
        };
        for k in 0..count {
            let s = k as f64 * step_m;
            let (sin, cos) = tour.heading(s).sin_cos();
            let middle = tour.point(s);
            let mut feet = vec![None; ground.lanes];
            feet[half] = Some(middle);
            for side in [-1.0, 1.0] {
                let mut last = middle;
                for lane in 1..=half {
                    let off_m = side * lane as f64 * LANE_M;
                    let foot = [middle[0] - off_m * sin, middle[1] + off_m * cos, middle[2]];
                    if !ground.is_clear(&last, &foot) || !ground.has_room(&foot) {
                        break;
                    }
                    let number = if side > 0.0 { half + lane } else { half - lane };
                    feet[number] = Some(foot);
                    last = foot;
                }
            }
            ground.feet.push(feet);
            ground.ahead.push([cos, sin]);
        }
        ground
    }

    /// The lane at each point of the cheapest way that begins and ends in `lane`.
    fn way(&self, costs: &[Vec<f64>], lane: usize) -> Option<Vec<usize>> {
        let count = self.feet.len();
        let mut reached = vec![f64::INFINITY; self.lanes];
        reached[lane] = 0.0;
        let mut from: Vec<Vec<usize>> = Vec::with_capacity(count);
        for k in 0..count {
            let next = (k + 1) % count;
            let mut cheapest = vec![f64::INFINITY; self.lanes];
            let mut origin = vec![0; self.lanes];
            for to in 0..self.lanes {
                for (leave, before) in reached.iter().enumerate().take(to + 2).skip(to.max(1) - 1) {
                    let change = CHANGE_COST_M * to.abs_diff(leave) as f64;
                    let cost = before + costs[next][to] + change;
                    if cost < cheapest[to] && self.is_way(k, leave, to) {
                        (cheapest[to], origin[to]) = (cost, leave);
                    }
                }
            }
            reached = cheapest;
            from.push(origin);
        }
        reached[lane].is_finite().then(|| {
            let mut lanes = vec![lane; count];
            for k in (1..count).rev() {
                let next = lanes[(k + 1) % count];
                lanes[k] = from[k][next];
            }
            lanes
        })
    }

    /// Whether one gets from a lane at one point of the route to a lane at the next, forwards.
    fn is_way(&self, k: usize, leave: usize, to: usize) -> bool {
        let next = (k + 1) % self.feet.len();
        let middle = self.lanes / 2;
        let (Some(p), Some(q)) = (&self.feet[k][leave], &self.feet[next][to]) else {
            return false;
        };
        let [cos, sin] = self.ahead[k];
        let forwards_m = (q[0] - p[0]) * cos + (q[1] - p[1]) * sin;
        (leave == middle && to == middle) || (forwards_m > 0.1 && self.is_clear(p, q))
    }

    /// Whether nothing is between two places to stand.
    fn is_clear(&self, from: &[f64; 3], to: &[f64; 3]) -> bool {
        let along = std::array::from_fn(|i| (to[i] - from[i]) as f32);
        self.is_free(from, along)
    }

    /// Whether there is floor below and nothing too near around.
    fn has_room(&self, foot: &[f64; 3]) -> bool {
        let eye = [foot[0] as f32, foot[1] as f32, foot[2] as f32 + LOOK_DOWN_M];
        let floor = self.world.cast(eye, [0.0, 0.0, -1.0]);
        let stands = floor.is_some_and(|hit| (hit.distance - LOOK_DOWN_M).abs() < STEP_RISE_M);
        stands
            && (0..16_u8).all(|k| {
                let (sin, cos) = (f32::from(k) * std::f32::consts::FRAC_PI_8).sin_cos();
                self.is_free(foot, [ROOM_M * cos, ROOM_M * sin, 0.0])
            })
    }

    /// Whether nothing is met at any height from a place to stand as far as `along` goes, metres.
    fn is_free(&self, foot: &[f64; 3], along: [f32; 3]) -> bool {
        let [x, y, z] = foot.map(|v| v as f32);
        let rays = RayPacket {
            origin: Origin::Each([
                f32x8::splat(x),
                f32x8::splat(y),
                f32x8::new(HEIGHTS_M.map(|height| z + height)),
            ]),
            direction: along.map(f32x8::splat),
        };
        let hit = self.world.cast_packet(&rays);
        let (facets, distances) = (hit.facet, hit.distance.to_array());
        facets
            .into_iter()
            .zip(distances)
            .all(|(facet, distance)| facet == NO_FACET || distance > 1.0)
    }
}
