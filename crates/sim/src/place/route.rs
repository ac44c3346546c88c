//! Closed lines through the places, for whoever walks there: feet on the floor, metres.

use super::indoor::{FLIGHT, STOREY_M};
use super::park;
use crate::config::Place;

/// Half the distance between the ways there and back of a way that does not close, metres.
const KEEP_RIGHT_M: f64 = 0.08;

/// A kind of way through a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Route {
    /// Everywhere, with loops: for the scanner.
    Scan,
    /// Around.
    Loop,
    /// Along a line and back.
    Line,
    /// Close around the middle.
    Middle,
    /// On the spot.
    Spot,
    /// In and out of rooms.
    Rooms,
}

/// The corners of a route. Where a place has no such route, its loop.
pub(crate) fn route(place: Place, route: Route) -> Vec<[f64; 3]> {
    let corners: Vec<[f64; 2]> = match (place, route) {
        (Place::Stairs, route) => return stairs(route, [0.0, 0.0]),
        (Place::LargeOffice, route) => return large(route),
        (_, Route::Spot) => {
            let [x, y] = spot(place);
            (0..12)
                .map(|k| f64::from(k) * std::f64::consts::TAU / 12.0)
                .map(|a| [x + 0.11 * a.cos(), y + 0.11 * a.sin()])
                .collect()
        }
        (Place::ExhibitionHall, Route::Line) => line([3.2, 4.0], [3.2, 26.0]),
        (Place::ExhibitionHall, Route::Scan) => hall_scan([0.0, 0.0]),
        (Place::ExhibitionHall, _) => rectangle([3.2, 4.0], [16.8, 25.0]),
        (Place::Atrium, route) => atrium(route, [0.0, 0.0]),
        (Place::WideCorridor, _) => line([1.6, 2.0], [38.4, 2.0]),
        (Place::NarrowCorridor, _) => line([1.2, 1.0], [28.8, 1.0]),
        (Place::MediumOffice, Route::Scan) => medium_scan(),
        (Place::MediumOffice, _) => rectangle([4.7, 3.6], [10.2, 30.6]),
        (Place::OfficePark, Route::Scan) => vec![
            [8.0, 8.5],
            [44.0, 8.2],
            [44.0, 37.0],
            [58.0, 37.5],
            [61.0, 42.5],
            [90.5, 42.5],
            [90.5, 7.5],
            [64.0, 7.5],
            [44.3, 8.0],
            [44.0, 38.5],
            [37.8, 39.4],
            [37.5, 62.5],
            [11.0, 62.0],
            [11.0, 91.0],
            [39.0, 91.0],
            [39.0, 64.0],
            [62.5, 63.0],
            [62.7, 44.0],
            [59.0, 40.0],
            [46.0, 39.7],
            [44.0, 37.2],
            [8.0, 37.0],
        ],
        // Around a building, then around the plaza.
        (Place::OfficePark, _) => vec![
            [7.5, 9.0],
            [44.2, 8.6],
            [44.2, 38.0],
            [38.0, 39.6],
            [36.5, 62.6],
            [62.7, 62.8],
            [62.7, 42.0],
            [42.0, 42.0],
            [38.3, 41.5],
            [37.2, 38.0],
            [7.5, 37.0],
        ],
        (Place::HousePark, Route::Rooms | Route::Scan) => house_rooms(route),
        (Place::HousePark, _) => rectangle([11.0, 15.0], [35.0, 33.0]),
        (Place::Calibration, _) => rectangle([2.4, 2.1], [2.9, 2.9]),
        (Place::Demo | Place::Imported, _) => rectangle([1.0, 1.0], [3.8, 3.0]),
    };
    corners.into_iter().map(|[x, y]| [x, y, 0.0]).collect()
}

fn spot(place: Place) -> [f64; 2] {
    match place {
        Place::ExhibitionHall => [7.8, 12.0],
        Place::Calibration => [2.6, 2.5],
        _ => place.size_m().map(|v| 0.4 * v),
    }
}

/// A way that does not close, there and back, keeping to the right.
pub(crate) fn there_and_back(way: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let shifted = |k: usize| {
        let (p, q) = (way[k.saturating_sub(1)], way[(k + 1).min(way.len() - 1)]);
        let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
        let share = KEEP_RIGHT_M / dx.hypot(dy).max(1e-6);
        [share * dy, -share * dx]
    };
    let to_side = |k: usize, sign: f64| {
        let [sx, sy] = shifted(k);
        let [x, y, z] = way[k];
        [x + sign * sx, y + sign * sy, z]
    };
    let there = (0..way.len()).map(|k| to_side(k, 1.0));
    there
        .chain((0..way.len()).rev().map(|k| to_side(k, -1.0)))
        .collect()
}

/// From one corner around to the others, anticlockwise for a positive extent.
fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Vec<[f64; 2]> {
    vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
}

/// There and back, keeping to the right.
fn line(from: [f64; 2], to: [f64; 2]) -> Vec<[f64; 2]> {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length = dx.hypot(dy);
    let side = [0.17 * dy / length, -0.17 * dx / length];
    vec![
        [from[0] + side[0], from[1] + side[1]],
        [to[0] + side[0], to[1] + side[1]],
        [to[0] - side[0], to[1] - side[1]],
        [from[0] - side[0], from[1] - side[1]],
    ]
}

fn shifted(corners: Vec<[f64; 2]>, by: [f64; 2]) -> Vec<[f64; 2]> {
    corners
        .into_iter()
        .map(|[x, y]| [x + by[0], y + by[1]])
        .collect()
}

fn hall_scan(by: [f64; 2]) -> Vec<[f64; 2]> {
    let mut all = rectangle([3.2, 4.0], [16.8, 25.0]);
    all.extend([
        [3.2, 5.0],
        [5.5, 4.6],
        [7.8, 5.5],
        [7.8, 24.0],
        [10.0, 25.2],
        [12.2, 24.0],
    ]);
    all.extend([[12.2, 5.5], [10.0, 4.4], [5.0, 4.0]]);
    shifted(all, by)
}

fn atrium(route: Route, by: [f64; 2]) -> Vec<[f64; 2]> {
    let corners = match route {
        Route::Line => line([6.5, 4.6], [54.0, 4.6]),
        Route::Middle => (0..16)
            .map(|k| f64::from(k) * std::f64::consts::TAU / 16.0)
            .map(|a| [30.0 + 4.3 * a.cos(), 7.5 + 4.0 * a.sin()])
            .collect(),
        Route::Scan => {
            let mut all = rectangle([2.4, 2.2], [57.4, 12.8]);
            all.extend([
                [2.4, 5.0],
                [8.0, 4.6],
                [50.0, 4.6],
                [50.0, 10.4],
                [8.0, 10.4],
                [7.0, 8.0],
                [6.6, 5.0],
                [3.0, 3.0],
            ]);
            all
        }
        _ => rectangle([2.6, 2.2], [57.2, 12.8]),
    };
    shifted(corners, by)
}

fn medium_scan() -> Vec<[f64; 2]> {
    let mut all = rectangle([4.7, 3.6], [10.2, 31.0]);
    // Between the rooms of the core as well.
    for y in [13.0, 21.0] {
        all.extend([
            [4.6, y + 2.0],
            [5.2, y],
            [9.8, y],
            [10.3, y + 1.6],
            [10.3, 30.6],
            [4.7, 31.0],
        ]);
    }
    all
}

fn house_rooms(route: Route) -> Vec<[f64; 2]> {
    let mut all = Vec::new();
    let houses = if route == Route::Scan { 3 } else { 1 };
    for (k, area) in park::HOUSES[..houses].iter().enumerate() {
        let ([x0, x1], [y0, y1]) = (area.x.map(f64::from), area.y.map(f64::from));
        let cy = 0.5 * (y0 + y1);
        let pitch = (x1 - x0 - 0.3) / 3.0;
        all.push([x0 - 3.0, cy - 4.0]);
        all.push([x0 - 2.0, cy]);
        for room in 0..3 {
            let x = x0 + 0.3 + pitch * f64::from(room) + 0.5 * (pitch - 0.3);
            let side = if room % 2 == 0 { 1.0 } else { -1.0 };
            let turn = cy + side * 2.5;
            all.extend([
                [x - 0.25, cy + 0.1 * side],
                [x - 0.2, cy + side],
                [x - 0.2, turn],
            ]);
            all.extend([
                [x + 0.2, turn],
                [x + 0.2, cy + side],
                [x + 0.25, cy + 0.1 * side],
            ]);
        }
        all.push([x1 + 2.0, cy]);
        if k == 1 {
            all.extend([[x1 + 3.0, y1 + 3.0], [62.6, 44.0], [62.6, 62.6]]);
            all.extend([[40.0, 63.0], [36.5, 60.0], [16.0, 60.0]]);
        }
    }
    if route == Route::Rooms {
        all.extend([
            [35.0, 32.0],
            [37.0, 40.1],
            [62.5, 40.1],
            [62.7, 62.3],
            [37.0, 62.5],
        ]);
        all.extend([[36.0, 40.5], [34.5, 33.5], [12.0, 33.5], [10.5, 24.0]]);
    } else {
        all.extend([
            [39.0, 70.0],
            [39.0, 64.0],
            [62.7, 62.6],
            [62.7, 40.1],
            [38.0, 39.6],
        ]);
        all.extend([[34.5, 33.5], [11.0, 33.5]]);
    }
    all
}

/// Down and up the stairs of a hall at `by`.
fn stairs(route: Route, by: [f64; 2]) -> Vec<[f64; 3]> {
    let [foot, head] = FLIGHT.map(f64::from);
    let top = f64::from(STOREY_M);
    let corners: Vec<[f64; 3]> = match route {
        Route::Line => vec![
            [2.1, head + 3.5, top],
            [2.1, head + 0.3, top],
            [2.1, foot - 0.3, 0.0],
            [2.1, 2.6, 0.0],
            [2.9, 2.6, 0.0],
            [2.9, foot - 0.3, 0.0],
            [2.9, head + 0.3, top],
            [2.9, head + 3.5, top],
        ],
        _ => vec![
            [2.3, head + 2.4, top],
            [2.3, head + 0.3, top],
            [2.3, foot - 0.3, 0.0],
            [2.3, 2.8, 0.0],
            [7.7, 2.8, 0.0],
            [7.7, foot - 0.3, 0.0],
            [7.7, head + 0.3, top],
            [7.7, head + 2.4, top],
        ],
    };
    corners
        .into_iter()
        .map(|[x, y, z]| [x + by[0], y + by[1], z])
        .collect()
}

/// Through the whole floor.
fn large(route: Route) -> Vec<[f64; 3]> {
    let flat = |corners: Vec<[f64; 2]>| corners.into_iter().map(|[x, y]| [x, y, 0.0]);
    let mut all: Vec<[f64; 3]> = Vec::new();
    all.extend(flat(vec![
        [17.4, 8.5],
        [18.6, 7.5],
        [21.6, 7.5],
        [22.6, 5.0],
    ]));
    if route == Route::Scan {
        all.extend(flat(atrium(Route::Scan, [20.3, 0.0])));
        all.extend(flat(vec![[22.6, 4.6]]));
    }
    all.extend(flat(vec![
        [24.0, 4.6],
        [76.0, 4.4],
        [79.0, 3.0],
        [82.0, 3.0],
    ]));
    if route == Route::Scan {
        let mut up = stairs(Route::Loop, [80.6, 0.0]);
        up.rotate_left(3);
        all.extend(up);
        all.push([82.9, 2.8, 0.0]);
    }
    all.extend(flat(vec![
        [85.6, 2.4],
        [89.0, 2.1],
        [91.0, 2.1],
        [92.2, 3.2],
        [92.2, 10.0],
    ]));
    all.extend(flat(vec![
        [92.3, 12.2],
        [92.7, 13.6],
        [94.0, 14.0],
        [118.0, 14.0],
        [121.6, 14.0],
    ]));
    all.extend(flat(vec![
        [122.5, 15.0],
        [122.5, 25.5],
        [121.8, 27.0],
        [120.4, 27.0],
    ]));
    all.extend(flat(vec![
        [119.7, 25.5],
        [119.5, 22.4],
        [110.0, 22.0],
        [67.5, 22.0],
        [66.0, 21.2],
    ]));
    all.extend(flat(vec![
        [66.0, 18.6],
        [64.8, 17.3],
        [59.0, 17.3],
        [40.0, 17.5],
    ]));
    if route == Route::Scan {
        // A look into the office on the other side.
        all.extend(flat(vec![
            [31.2, 17.6],
            [30.5, 18.5],
            [30.4, 19.9],
            [30.1, 19.9],
            [30.0, 18.5],
        ]));
        all.extend(flat(vec![[29.2, 17.4]]));
    }
    all.extend(flat(vec![[22.5, 17.3], [19.0, 17.3], [17.4, 16.0]]));
    if route == Route::Scan {
        all.extend(flat(vec![[17.2, 6.0], [15.5, 4.2]]));
        all.extend(flat(hall_scan([0.0, 0.0])));
        all.extend(flat(vec![[3.4, 5.2], [9.0, 4.4], [16.4, 5.6]]));
    }
    all
}
