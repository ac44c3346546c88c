//! How the rig moved while it scanned: what the gyroscope does not know. Two scans that follow each other are registered, the
//! second to planes in cells of the first, over one velocity; each return at its own time.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix6, Vector3, Vector6};

use super::moments::{Limits, Moments};

/// Edge of a cell, metres.
const CELL_M: f64 = 0.6;
/// What is a plane in a cell.
const LIMITS: Limits = Limits {
    min_returns: 8.0,
    thick_m: 0.05,
    wide_m: 0.08,
};
/// Returns of the second scan that are used at most.
const MOST_RETURNS: usize = 5000;
/// Returns that must lie on planes.
const MIN_MATCHES: usize = 200;
const ITERATIONS: usize = 8;
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

#[derive(Default)]
struct Cell {
    moments: Moments,
    time_s: f64,
}

struct Plane {
    place: Vector3<f64>,
    normal: Vector3<f64>,
    time_s: f64,
}

/// Velocity of the rig in its own axes, m/s; `None` where the scans have little in common.
pub(super) fn velocity(first: &[Moved], second: &[Moved]) -> Option<Vector3<f64>> {
    let every = second.len().div_ceil(MOST_RETURNS).max(1);
    let (mut speed, mut angle) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
    for _ in 0..ITERATIONS {
        let planes = planes(first, &speed);
        let mut normal = Matrix6::from_diagonal(&Vector6::from_fn(|k, _| {
            let sigma = if k < 3 { SPEED_M_S } else { ANGLE_RAD };
            1.0 / (sigma * sigma)
        }));
        let mut right = Vector6::zeros();
        for k in 0..3 {
            right[k] = -speed[k] * normal[(k, k)];
            right[3 + k] = -angle[k] * normal[(3 + k, 3 + k)];
        }
        let mut matches = 0;
        for point in second.iter().step_by(every) {
            let place = point.place + speed * point.after_s + angle.cross(&point.place);
            let Some(plane) = planes.get(&cell_of(&place)) else {
                continue;
            };
            let error = plane.normal.dot(&(place - plane.place));
            let lever = point.place.cross(&plane.normal);
            let by_speed = plane.normal * (point.after_s - plane.time_s);
            let row = Vector6::new(
                by_speed.x, by_speed.y, by_speed.z, lever.x, lever.y, lever.z,
            );
            let weight = 1.0 / (1.0 + (error / SCALE_M).powi(2)) / (NOISE_M * NOISE_M);
            normal += row * row.transpose() * weight;
            right -= row * (error * weight);
            matches += 1;
        }
        if matches < MIN_MATCHES {
            return None;
        }
        let step = normal.cholesky()?.solve(&right);
        speed += step.fixed_rows::<3>(0);
        angle += step.fixed_rows::<3>(3);
        if step.norm() < 1e-4 {
            break;
        }
    }
    Some(speed)
}

fn cell_of(place: &Vector3<f64>) -> [i32; 3] {
    std::array::from_fn(|k| (place[k] / CELL_M).floor() as i32)
}

/// Planes in the cells of a scan, as the rig's velocity has its returns.
fn planes(scan: &[Moved], speed: &Vector3<f64>) -> BTreeMap<[i32; 3], Plane> {
    let mut cells: BTreeMap<[i32; 3], Cell> = BTreeMap::new();
    for point in scan {
        let place = point.place + speed * point.after_s;
        let cell = cells.entry(cell_of(&place)).or_default();
        cell.moments.add(&place);
        cell.time_s += point.after_s;
    }
    cells
        .into_iter()
        .filter_map(|(at, cell)| Some((at, cell.plane()?)))
        .collect()
}

impl Cell {
    fn plane(&self) -> Option<Plane> {
        let fitted = self.moments.plane(&LIMITS)?;
        Some(Plane {
            place: fitted.place,
            normal: fitted.normal,
            time_s: self.time_s / self.moments.count,
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
