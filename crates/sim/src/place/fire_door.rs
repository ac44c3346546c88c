//! A door that stands open otherwise, closed.

use super::route::{Route, route, there_and_back};
use super::site::{Passage, Site};
use crate::config::SimConfig;
use crate::noise::hash;
use crate::world::ClosedDoor;
use crate::world::builder::{Faces, Placement};
use crate::world::material::Material;

/// Nobody comes nearer to the closed door than this along their way, metres.
const BEFORE_M: f64 = 1.0;
/// How long before they turn at the door ways begin, metres: whoever walks a short part sees it.
const APPROACH_M: f64 = 6.0;
/// Share of the speed on the straight that a scanner surely makes, bends and rests included.
const PACE: f64 = 0.5;
/// Thickness of its leaves, metres.
const LEAF_M: f32 = 0.06;

/// Closes one of the open doors, of those that the scanner goes through where there are any; none where the place has no door.
pub(super) fn close(site: &mut Site, config: &SimConfig) {
    let openings = [&site.passages[..], &site.shutters[..]].concat();
    let scan = scanned(config);
    let doors: Vec<ClosedDoor> = openings.iter().map(door).collect();
    let crossed: Vec<usize> = (0..doors.len())
        .filter(|&k| {
            scan.windows(2)
                .any(|p| crossing(&doors[k], p[0], p[1]).is_some())
        })
        .collect();
    let drawn = hash(config.seed ^ 0xf12e) >> 8;
    let number = match (crossed.len(), doors.len()) {
        (0, 0) => return,
        (0, all) => drawn as usize % all,
        (some, _) => crossed[drawn as usize % some],
    };
    hang(site, &openings[number]);
    site.plan.closed = Some(doors[number]);
}

/// The scanner's way, as far as it surely goes.
fn scanned(config: &SimConfig) -> Vec<[f64; 3]> {
    let mut way = route(config.place, Route::Scan);
    way.extend(way.first().copied());
    let mut left_m = match config.scan.duration_s {
        0.0 => f64::INFINITY,
        seconds => PACE * seconds * config.scan.speed_m_s,
    };
    let mut part = Vec::new();
    for pair in way.windows(2) {
        part.push(pair[0]);
        let long_m = apart(pair[0], pair[1]);
        if long_m >= left_m {
            part.push(between(pair[0], pair[1], left_m / long_m));
            return part;
        }
        left_m -= long_m;
    }
    part.extend(way.last().copied());
    part
}

/// The middle of an opening.
fn door(opening: &Passage) -> ClosedDoor {
    let [w, d] = opening.area.size();
    let [cx, cy] = opening.area.centre();
    let ([x0, x1], [y0, y1]) = (opening.area.x, opening.area.y);
    ClosedDoor {
        ends: match w < d {
            true => [[cx, y0, opening.z], [cx, y1, opening.z]],
            false => [[x0, cy, opening.z], [x1, cy, opening.z]],
        },
        height_m: opening.height,
    }
}

/// Two leaves of painted steel with a bar across and a sign on either side.
fn hang(site: &mut Site, opening: &Passage) {
    let door = door(opening);
    let [p, q] = door.ends;
    let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
    let (wide, high) = (dx.hypot(dy), door.height_m);
    let out = site.out();
    for (origin, yaw) in [(p, dy.atan2(dx)), (q, (-dy).atan2(-dx))] {
        let side = Placement::new(origin, yaw);
        for k in 0..2 {
            let (l, r) = (0.5 * wide * k as f32, 0.5 * wide * (k + 1) as f32);
            let (low, high) = ([l, -0.5 * LEAF_M, 0.0], [r, 0.0, high]);
            out.cuboid(&side, low, high, Faces::Hanging, Material::FIRE_DOOR);
            let bar = Material::METAL.toned(0.15);
            let (low, high) = ([l + 0.08, -0.12, 1.0], [r - 0.08, -0.08, 1.05]);
            out.cuboid(&side, low, high, Faces::All, bar);
        }
        let sign = Material::SIGN.toned(0.25);
        let (low, high) = (
            [0.25 * wide - 0.15, -0.035, 1.55],
            [0.25 * wide + 0.15, -0.03, 1.7],
        );
        out.cuboid(&side, low, high, Faces::Hanging, sign);
    }
}

/// A closed way that stays on one side of a closed door: the longest part of `way` between two crossings, there and back where it does not
/// close. It begins some metres before the door. A way that does not lead through the door is left as it is.
pub(crate) fn this_side(door: &ClosedDoor, way: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let n = way.len();
    // Where it crosses: after which corner, and how far along.
    let crossings: Vec<(usize, f64)> = (0..n)
        .filter_map(|k| Some((k, crossing(door, way[k], way[(k + 1) % n])?)))
        .collect();
    let parts = (0..crossings.len()).map(|c| {
        let (first, u) = crossings[c];
        let (last, v) = crossings[(c + 1) % crossings.len()];
        // Once around where there is a single crossing.
        let corners = match (last + n - first) % n {
            0 if v > u => 0,
            0 => n,
            some => some,
        };
        let mut part = vec![between(way[first], way[(first + 1) % n], u)];
        part.extend((1..=corners).map(|k| way[(first + k) % n]));
        part.push(between(way[last], way[(last + 1) % n], v));
        part
    });
    let longest = parts.max_by(|a, b| length(a).total_cmp(&length(b)));
    let Some(part) = longest.and_then(|part| shortened(&part)) else {
        return way;
    };
    let (first, last) = (part[0], part[part.len() - 1]);
    let mut closed = match is_left(door, first) == is_left(door, last) {
        true => part,
        false => there_and_back(&part),
    };
    // From here on to the end of the part is the approach.
    let mut left_m = APPROACH_M;
    let end = match is_left(door, first) == is_left(door, last) {
        true => closed.len(),
        false => closed.len() / 2,
    };
    for k in (1..end).rev() {
        let long_m = apart(closed[k - 1], closed[k]);
        if long_m >= left_m {
            let start = between(closed[k], closed[k - 1], left_m / long_m);
            closed.insert(k, start);
            closed.rotate_left(k);
            break;
        }
        left_m -= long_m;
    }
    closed
}

/// Without its ends, which lie at the door; `None` where nothing is left.
fn shortened(part: &[[f64; 3]]) -> Option<Vec<[f64; 3]>> {
    let cut = |points: Vec<[f64; 3]>| {
        let mut left_m = BEFORE_M;
        for k in 1..points.len() {
            let long_m = apart(points[k - 1], points[k]);
            if long_m > left_m {
                let mut rest = vec![between(points[k - 1], points[k], left_m / long_m)];
                rest.extend_from_slice(&points[k..]);
                rest.reverse();
                return rest;
            }
            left_m -= long_m;
        }
        Vec::new()
    };
    let part = cut(cut(part.to_vec()));
    (part.len() > 1).then_some(part)
}

/// How far along a stretch meets a closed door, as a share; `None` where it does not.
pub(super) fn crossing(door: &ClosedDoor, from: [f64; 3], to: [f64; 3]) -> Option<f64> {
    if is_left(door, from) == is_left(door, to) {
        return None;
    }
    let (a, b) = (side(door, from), side(door, to));
    let share = a / (a - b);
    let at = between(from, to, share);
    let [p, q] = door.ends.map(|end| end.map(f64::from));
    let way = [q[0] - p[0], q[1] - p[1]];
    let along =
        ((at[0] - p[0]) * way[0] + (at[1] - p[1]) * way[1]) / (way[0] * way[0] + way[1] * way[1]);
    let up = at[2] - p[2];
    let within = (0.0..=1.0).contains(&along) && (-0.5..f64::from(door.height_m)).contains(&up);
    within.then_some(share)
}

/// On which side of a door's plane a point is: the sign.
fn side(door: &ClosedDoor, at: [f64; 3]) -> f64 {
    let [p, q] = door.ends.map(|end| end.map(f64::from));
    (q[0] - p[0]) * (at[1] - p[1]) - (q[1] - p[1]) * (at[0] - p[0])
}

fn is_left(door: &ClosedDoor, at: [f64; 3]) -> bool {
    side(door, at) >= 0.0
}

fn between(p: [f64; 3], q: [f64; 3], share: f64) -> [f64; 3] {
    std::array::from_fn(|i| p[i] + share * (q[i] - p[i]))
}

fn apart(p: [f64; 3], q: [f64; 3]) -> f64 {
    let [x, y, z]: [f64; 3] = std::array::from_fn(|i| q[i] - p[i]);
    x.hypot(y).hypot(z)
}

fn length(way: &[[f64; 3]]) -> f64 {
    way.windows(2).map(|p| apart(p[0], p[1])).sum()
}
