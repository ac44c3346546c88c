//! How the rig moved while it scanned: what the gyroscope does not know. Two scans that follow each other are registered, the
//! second to planes of the first, each return at its own time.

use lsfb_geometry::{Se3, Vector3};

use crate::overlapping_planes::{OverlappingPlanesBuilder, register_to_planes};

/// Returns of the second scan that are used at most.
const MOST_RETURNS: usize = 5000;
/// Times that both scans are deskewed by the velocity found and registered again.
const ROUNDS: usize = 3;
/// Errors of the gyroscope's angle (rad) and speeds (m/s) that are expected, so that what a scene does not show stays zero.
const ANGLE_RAD: f64 = 0.003;
const SPEED_M_S: f64 = 1.5;

/// A return turned to one time by the gyroscope, and its own time after that one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    pub place: Vector3<f64>,
    pub after_s: f64,
}

/// Velocity of the rig in its own axes, m/s; `None` where the scans have little in common.
pub(super) fn velocity(first: &[Moved], second: &[Moved]) -> Option<Vector3<f64>> {
    let every = second.len().div_ceil(MOST_RETURNS).max(1);
    let mean_s = |scan: &[Moved]| scan.iter().map(|p| p.after_s).sum::<f64>() / scan.len() as f64;
    let apart_s = mean_s(second) - mean_s(first);
    if !(apart_s > 0.0) {
        return None;
    }
    let expected = [ANGLE_RAD, SPEED_M_S * apart_s];
    let mut speed = Vector3::zeros();
    for _ in 0..ROUNDS {
        let still = |point: &Moved| point.place + speed * point.after_s;
        let mut planes = OverlappingPlanesBuilder::default();
        planes.add(first.iter().map(still));
        let second: Vec<Vector3<f64>> = second.iter().step_by(every).map(still).collect();
        let start = Se3::identity();
        let (left, _) = register_to_planes(&second, start, expected, |at| planes.plane(at))?;
        speed += left.translation / apart_s;
    }
    Some(speed)
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
