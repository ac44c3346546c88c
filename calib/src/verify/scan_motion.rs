//! How the rig moved while it scanned: what the gyroscope does not know. Two scans that follow each other are registered, the
//! second to planes in cells of the first, over one velocity; each return at its own time.

use lsfb_geometry::{Matrix6, Vector3, Vector6};
use lsfb_perception::gauss_newton::{NormalEquations, minimise, until_shorter_than};
use lsfb_perception::lidar::{CellMap, Plane, PointSums, cell_key};

/// Edge of a cell, metres.
const CELL_M: f64 = 0.6;
/// What is a plane in a cell: returns, and how thick and wide they lie at most and at least, standard deviations in metres.
const MIN_RETURNS: u32 = 8;
const THICK_M: f64 = 0.05;
const WIDE_M: f64 = 0.08;
/// Returns of the second scan that are used at most.
const MOST_RETURNS: usize = 5000;
/// Returns that must lie on planes.
const MIN_MATCHES: usize = 200;
const ITERATIONS: u32 = 8;
/// A step shorter than this ends the search: m/s, radians.
const SHORTEST: f64 = 1e-4;
/// Distance from a plane at which a return's weight is halved, metres.
const SCALE_M: f64 = 0.06;
/// Speeds and errors of the gyroscope's angle that are expected, so that what a scene does not show stays zero.
const SPEED_M_S: f64 = 1.5;
const ANGLE_RAD: f64 = 0.003;
/// Spread of a return's distance from its plane, metres.
const NOISE_M: f64 = 0.04;

/// A return turned to one time by the gyroscope, and its own time after that one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    pub place: Vector3<f64>,
    pub after_s: f64,
}

/// Returns of a cell.
#[derive(Default)]
struct Cell {
    sums: PointSums,
    time_s: f64,
}

/// A plane, and when it was seen on average.
struct TimedPlane {
    plane: Plane,
    time_s: f64,
}

/// Velocity of the rig in its own axes, m/s; `None` where the scans have little in common.
pub(super) fn velocity(first: &[Moved], second: &[Moved]) -> Option<Vector3<f64>> {
    let every = second.len().div_ceil(MOST_RETURNS).max(1);
    let rest = Vector6::from_fn(|k, _| {
        let sigma = if k < 3 { SPEED_M_S } else { ANGLE_RAD };
        1.0 / (sigma * sigma)
    });
    // Velocity, then the error of the gyroscope's angle.
    let terms = |unknowns: &Vector6<f64>| {
        let speed: Vector3<f64> = unknowns.fixed_rows::<3>(0).into();
        let angle: Vector3<f64> = unknowns.fixed_rows::<3>(3).into();
        let planes = planes(first, &speed);
        let mut terms = NormalEquations::default();
        let mut matches = 0;
        for point in second.iter().step_by(every) {
            let place = point.place + speed * point.after_s + angle.cross(&point.place);
            let Some(found) = planes.get(&cell_of(&place)) else {
                continue;
            };
            let normal = &found.plane.normal;
            let error = normal.dot(&(place - found.plane.point));
            let by_angle = point.place.cross(normal);
            let by_speed = normal * (point.after_s - found.time_s);
            let derivative = Vector6::new(
                by_speed.x, by_speed.y, by_speed.z, by_angle.x, by_angle.y, by_angle.z,
            );
            let weight = 1.0 / (1.0 + (error / SCALE_M).powi(2)) / (NOISE_M * NOISE_M);
            terms.add(error, &derivative, weight);
            matches += 1;
        }
        terms.add_prior(unknowns, &Matrix6::from_diagonal(&rest));
        (matches >= MIN_MATCHES).then_some(terms)
    };
    let found = minimise(
        Vector6::zeros(),
        ITERATIONS,
        terms,
        until_shorter_than(SHORTEST),
    )?;
    Some(found.value.fixed_rows::<3>(0).into())
}

fn cell_of(place: &Vector3<f64>) -> u64 {
    cell_key(place, 1.0 / CELL_M)
}

/// Planes in the cells of a scan, as the rig's velocity has its returns.
fn planes(scan: &[Moved], speed: &Vector3<f64>) -> CellMap<TimedPlane> {
    let mut cells: CellMap<Cell> = CellMap::default();
    for point in scan {
        let place = point.place + speed * point.after_s;
        let cell = cells.entry(cell_of(&place)).or_default();
        cell.sums.add(&place);
        cell.time_s += point.after_s;
    }
    cells
        .into_iter()
        .filter_map(|(at, cell)| Some((at, cell.plane()?)))
        .collect()
}

impl Cell {
    fn plane(&self) -> Option<TimedPlane> {
        if self.sums.count() < MIN_RETURNS {
            return None;
        }
        let plane = self.sums.plane()?;
        (plane.thickness_m < THICK_M && plane.breadth_m > WIDE_M).then(|| TimedPlane {
            plane,
            time_s: self.time_s / f64::from(self.sums.count()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_walk_through_a_room_is_seen() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let speed = Vector3::new(0.8, -0.2, 0.1);
        let mut scan = |start_s: f64| -> Vec<Moved> {
            (0..12_000)
                .map(|k| {
                    let share = f64::from(k) / 12_000.0;
                    let after_s = start_s + 0.1 * share;
                    let azimuth = std::f64::consts::TAU * share;
                    let height: f64 = rng.random_range(-0.4..0.3);
                    let ray = Vector3::new(azimuth.cos(), azimuth.sin(), height);
                    let at = speed * after_s;
                    let wall = (0..3)
                        .map(|k| {
                            let side: f64 = [4.0, 3.0, 1.3][k];
                            (side.copysign(ray[k]) - at[k]) / ray[k]
                        })
                        .fold(f64::INFINITY, f64::min);
                    let noise = 0.02 * rng.random_range(-1.7..1.7);
                    let place = ray * wall + ray.normalize() * noise;
                    Moved { place, after_s }
                })
                .collect()
        };
        let (first, second) = (scan(-0.05), scan(0.05));
        let found = velocity(&first, &second).expect("a room");
        assert!((found - speed).norm() < 0.05, "{found}");
    }
}
