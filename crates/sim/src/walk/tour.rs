//! Where people walk: a closed line around the table, out of the door, along the corridor and back.

use crate::noise::{stream, uniform};
use crate::world::FloorPlan;

/// Spacing of the points of a [`Tour`], metres.
const STEP_M: f64 = 0.01;
/// Metres before and after a point over which its curvature is measured.
const CURVATURE_REACH_M: f64 = 0.15;

/// Spacing of the corners put on straight stretches, metres: the rounding of a bend reaches about as far.
const CORNER_M: f64 = 0.45;

/// A closed line on the floor, sampled densely.
#[derive(Clone, Debug)]
pub(crate) struct Tour {
    points: Vec<[f64; 3]>,
    /// Heading without jumps: it grows by a whole number of turns over a lap.
    headings: Vec<f64>,
    turns: f64,
}

impl Tour {
    /// The tour of a building; `seed` varies it a little.
    pub(crate) fn new(plan: &FloorPlan, seed: u64) -> Self {
        let rng = stream(seed, "tour", 0);
        let jitter = |spread: f32| f64::from(uniform(&rng, -spread, spread));
        let [cx, cy] = plan.table_centre().map(f64::from);
        let door_x = f64::from(plan.doorway_x_m);
        let [y0, y1] = plan.corridor_y_m.map(f64::from);
        let middle = 0.5 * (y0 + y1);
        let end = f64::from(plan.corridor_x_m[1]) - 1.35;
        let (rx, ry) = (1.36, 1.16);
        let mut corners: Vec<[f64; 2]> = Vec::new();
        let around = |corners: &mut Vec<[f64; 2]>, from: i32, to: i32| {
            for degrees in (from..=to).step_by(20) {
                let (s, c) = f64::from(degrees).to_radians().sin_cos();
                corners.push([cx + rx * c + jitter(0.03), cy + ry * s + jitter(0.03)]);
            }
        };
        around(&mut corners, 60, 200);
        corners.extend([
            [door_x - 0.02, 0.95],
            [door_x, 0.45],
            [door_x, -0.1],
            [door_x + 0.02, -0.5],
            [door_x + 0.2, middle - 0.02],
        ]);
        let steps = ((end - door_x - 0.6) / 0.45) as i32;
        let along = |k: i32| door_x + 0.6 + (end - door_x - 0.6) * f64::from(k) / f64::from(steps);
        corners.extend((0..=steps).map(|k| [along(k), middle - 0.2 + 0.07 * f64::from(k).sin()]));
        corners.extend([
            [end + 0.42, middle - 0.2],
            [end + 0.58, middle],
            [end + 0.42, middle + 0.2],
        ]);
        corners.extend(
            (0..=steps)
                .rev()
                .map(|k| [along(k), middle + 0.12 + 0.05 * f64::from(k).cos()]),
        );
        corners.extend([
            [door_x + 0.15, middle + 0.2],
            [door_x, -0.45],
            [door_x, 0.05],
            [door_x + 0.02, 0.5],
        ]);
        around(&mut corners, 240, 400);
        let corners: Vec<[f64; 3]> = corners.into_iter().map(|[x, y]| [x, y, 0.0]).collect();
        Self::through(&corners)
    }

    /// The closed line straight from corner to corner, rounded at the corners.
    pub(crate) fn along(corners: &[[f64; 3]]) -> Self {
        let n = corners.len();
        let mut dense = Vec::new();
        for k in 0..n {
            let (p, q) = (corners[k], corners[(k + 1) % n]);
            let length = (q[0] - p[0]).hypot(q[1] - p[1]).hypot(q[2] - p[2]);
            let steps = (length / CORNER_M).ceil().max(1.0);
            for i in 0..steps as usize {
                let u = i as f64 / steps;
                dense.push(std::array::from_fn(|axis| {
                    p[axis] + u * (q[axis] - p[axis])
                }));
            }
        }
        Self::through(&dense)
    }

    /// The closed cubic B-spline of the corners, at equal steps of arc length.
    fn through(corners: &[[f64; 3]]) -> Self {
        let n = corners.len();
        let fine = if n > 200 { 40 } else { 200 };
        let curve = |i: usize| {
            let (k, u) = (i / fine, (i % fine) as f64 / fine as f64);
            let basis = [
                (1.0 - u).powi(3) / 6.0,
                (3.0 * u.powi(3) - 6.0 * u * u + 4.0) / 6.0,
                (-3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0) / 6.0,
                u.powi(3) / 6.0,
            ];
            std::array::from_fn::<f64, 3, _>(|axis| {
                (0..4).map(|j| basis[j] * corners[(k + j) % n][axis]).sum()
            })
        };
        let dense: Vec<[f64; 3]> = (0..=n * fine).map(curve).collect();
        let mut travelled = vec![0.0];
        for pair in dense.windows(2) {
            let flat = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
            let step = flat.hypot(pair[1][2] - pair[0][2]);
            travelled.push(travelled[travelled.len() - 1] + step);
        }
        let length = travelled[travelled.len() - 1];
        let count = (length / STEP_M).round() as usize;
        let mut points = Vec::with_capacity(count);
        let mut at = 0;
        for k in 0..count {
            let s = length * k as f64 / count as f64;
            while at + 2 < travelled.len() && travelled[at + 1] < s {
                at += 1;
            }
            let u = (s - travelled[at]) / (travelled[at + 1] - travelled[at]);
            points.push(std::array::from_fn(|i| {
                dense[at][i] + u * (dense[at + 1][i] - dense[at][i])
            }));
        }
        let mut headings: Vec<f64> = Vec::with_capacity(count);
        let mut previous = 0.0;
        for k in 0..count {
            let (p, q) = (points[k], points[(k + 1) % count]);
            let raw = (q[1] - p[1]).atan2(q[0] - p[0]);
            let heading =
                raw + std::f64::consts::TAU * ((previous - raw) / std::f64::consts::TAU).round();
            headings.push(heading);
            previous = heading;
        }
        let turns = ((headings[count - 1] - headings[0]) / std::f64::consts::TAU).round();
        Self {
            points,
            headings,
            turns,
        }
    }

    pub(crate) fn length_m(&self) -> f64 {
        self.points.len() as f64 * STEP_M
    }

    /// The point `s` metres from the start; laps follow each other.
    pub(crate) fn point(&self, s: f64) -> [f64; 3] {
        let (i, u, _) = self.locate(s);
        let (p, q) = (self.points[i], self.points[(i + 1) % self.points.len()]);
        std::array::from_fn(|axis| p[axis] + u * (q[axis] - p[axis]))
    }

    /// Direction of the line, radians from x, without jumps.
    pub(crate) fn heading(&self, s: f64) -> f64 {
        let (i, u, lap) = self.locate(s);
        let wrap = std::f64::consts::TAU * self.turns;
        let next = if i + 1 < self.headings.len() {
            self.headings[i + 1]
        } else {
            self.headings[0] + wrap
        };
        self.headings[i] + u * (next - self.headings[i]) + lap * wrap
    }

    /// Change of heading per metre.
    pub(crate) fn curvature(&self, s: f64) -> f64 {
        (self.heading(s + CURVATURE_REACH_M) - self.heading(s - CURVATURE_REACH_M))
            / (2.0 * CURVATURE_REACH_M)
    }

    /// Index of the point before, fraction of the step, and lap.
    fn locate(&self, s: f64) -> (usize, f64, f64) {
        let position = s / STEP_M;
        let lap = (position / self.points.len() as f64).floor();
        let within = position - lap * self.points.len() as f64;
        let i = (within as usize).min(self.points.len() - 1);
        (i, within - i as f64, lap)
    }
}
