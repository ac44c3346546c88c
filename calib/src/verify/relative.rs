//! How a camera turned between two images, from corners followed, whatever their distance.
//!
//! A thing seen along `a` is then seen along `R a + ρ t`: the rotation, and the camera's way `t` over the distance of the thing.
//! Of the inverse distances only their mean is known (it is taken into `t`) and about their spread. Across the way a
//! track errs by its noise; along it by that and by what it does not know of its distance:
//! `C = σ² I + (s t⊥)(s t⊥)ᵀ`, where `s` is wide, since errors of distance are common to many tracks. So a short way hardly matters, and along a long one nothing is believed: near things that pass by
//! are not taken for turning, and a camera that only turns loses nothing.

use lsfb_geometry::{Matrix3, Matrix6, UnitQuaternion, Vector2, Vector3, Vector6, so3};
use nalgebra::{Matrix2, SMatrix};

use super::frame::Registered;
use super::tracks::Track;

/// Tracks needed.
const MIN_TRACKS: usize = 16;
const ITERATIONS: usize = 15;
/// Noise of a ray that is expected, radians, and the least that is believed.
const START_NOISE_RAD: f64 = 1e-3;
const LEAST_NOISE_RAD: f64 = 1e-4;
/// Spread of inverse distances over their mean.
const DEPTH_SPREAD: f64 = 0.7;
/// How many distances there are in an image: those of neighbours are alike, and a wall aslant makes a way look like turning.
const DEPTHS: f64 = 4.0;
/// Ways over the distance of the scene that are expected.
const WAY: f64 = 0.3;
/// Normalized error at which a track's weight is halved.
const ROBUST_SCALE: f64 = 2.5;
/// Median of the length of two normal numbers.
const MEDIAN_LENGTH: f64 = 1.1774;

/// A rotation with what it is worth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relative {
    pub b_from_a: UnitQuaternion<f64>,
    /// Of a small rotation after it, 1/rad².
    pub information: Matrix3<f64>,
}

struct State {
    b_from_a: UnitQuaternion<f64>,
    way: Vector3<f64>,
    noise_rad: f64,
}

/// The rotation between two images; `None` with too few tracks.
pub(super) fn relative(tracks: &[Track], guess: &Registered) -> Option<Relative> {
    if tracks.len() < MIN_TRACKS {
        return None;
    }
    let mut state = State {
        b_from_a: guess.b_from_a,
        way: Vector3::zeros(),
        noise_rad: START_NOISE_RAD,
    };
    let mut normal = Matrix6::zeros();
    for _ in 0..ITERATIONS {
        let (matrix, right, mut lengths) = linearized(tracks, &state);
        normal = matrix;
        let step = normal.cholesky()?.solve(&right);
        state.b_from_a = so3::exp(&step.fixed_rows::<3>(0).into()) * state.b_from_a;
        state.way += step.fixed_rows::<3>(3);
        // The noise by which half of all normalized errors are as short as half of all should be.
        lengths.sort_by(f64::total_cmp);
        let share = lengths[lengths.len() / 2] / MEDIAN_LENGTH;
        state.noise_rad = (state.noise_rad * share.clamp(0.3, 3.0)).max(LEAST_NOISE_RAD);
        if step.norm() < 1e-8 {
            break;
        }
    }
    // What the unknown way takes of the rotation's information.
    let turn = normal.fixed_view::<3, 3>(0, 0);
    let mixed = normal.fixed_view::<3, 3>(0, 3);
    let way = normal.fixed_view::<3, 3>(3, 3).into_owned();
    Some(Relative {
        b_from_a: state.b_from_a,
        information: turn - mixed * way.try_inverse()? * mixed.transpose(),
    })
}

/// Normal equations over rotation and way, and the lengths of all normalized errors.
fn linearized(tracks: &[Track], state: &State) -> (Matrix6<f64>, Vector6<f64>, Vec<f64>) {
    let prior = 1.0 / (WAY * WAY);
    // All tracks together know no more of their distances than so many do.
    let shared = (tracks.len() as f64 / DEPTHS).sqrt();
    let mut normal = Matrix6::zeros();
    let mut right = Vector6::zeros();
    for k in 0..3 {
        normal[(3 + k, 3 + k)] = prior;
        right[3 + k] = -state.way[k] * prior;
    }
    let lengths = tracks
        .iter()
        .map(|track| {
            let turned = state.b_from_a * track.first;
            let place = turned + state.way;
            let distance = place.norm().max(1e-3);
            let expected = place / distance;
            let [u, v] = basis(&expected);
            let across = |x: &Vector3<f64>| Vector2::new(u.dot(x), v.dot(x));
            let error = across(&(track.second - expected));
            // exp(φ) a moves by φ × a.
            let (by_u, by_v) = (turned.cross(&u) / distance, turned.cross(&v) / distance);
            let mut by = SMatrix::<f64, 2, 6>::zeros();
            by.fixed_view_mut::<1, 3>(0, 0)
                .copy_from(&-by_u.transpose());
            by.fixed_view_mut::<1, 3>(1, 0)
                .copy_from(&-by_v.transpose());
            by.fixed_view_mut::<1, 3>(0, 3)
                .copy_from(&(-u.transpose() / distance));
            by.fixed_view_mut::<1, 3>(1, 3)
                .copy_from(&(-v.transpose() / distance));
            let along = across(&state.way) * (DEPTH_SPREAD * shared);
            let noise = state.noise_rad * state.noise_rad;
            // (σ² I + w wᵀ)⁻¹
            let information = (Matrix2::identity()
                - along * along.transpose() / (noise + along.norm_squared()))
                / noise;
            let square = (error.transpose() * information * error)[0];
            let weight = information / (1.0 + square / (ROBUST_SCALE * ROBUST_SCALE));
            normal += by.transpose() * weight * by;
            right -= by.transpose() * weight * error;
            square.sqrt()
        })
        .collect();
    (normal, right, lengths)
}

/// Two directions across a third.
fn basis(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let other = if direction.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let u = direction.cross(&other).normalize();
    [u, direction.cross(&u)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Things between one and eight metres, a camera that turns and walks: 0.3 px of noise at 350 px of focal length, a tenth of
    /// all tracks wrong.
    #[test]
    fn rotations_are_found_beside_a_walk_and_known_as_well_as_is_said() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (mut inside, runs) = (0, 300);
        for _ in 0..runs {
            let mut vector =
                |size: f64| Vector3::from_fn(|_, _| rng.random_range(-1.0..=1.0) * size);
            let b_from_a = so3::exp(&vector(0.05));
            let way = vector(0.08);
            let tracks: Vec<Track> = (0..150)
                .map(|k| {
                    let place = vector(1.0);
                    let depth = 4.5 + 3.5 * place.z;
                    let point = Vector3::new(0.8 * place.x, 0.6 * place.y, 1.0) * depth;
                    let noise = vector(1.5e-3);
                    let wrong = if k % 10 == 0 {
                        vector(0.03)
                    } else {
                        Vector3::zeros()
                    };
                    Track {
                        first: point.normalize(),
                        second: ((b_from_a * point + way).normalize() + noise + wrong).normalize(),
                    }
                })
                .collect();
            let guess = Registered {
                b_from_a: so3::exp(&vector(0.01)) * b_from_a,
                shift: Vector3::zeros(),
            };
            let found = relative(&tracks, &guess).expect("found");
            let error = so3::log(&(found.b_from_a * b_from_a.inverse()));
            assert!(error.norm() < 15e-3, "{error}");
            // 95 % of a chi-square with three degrees of freedom.
            inside += usize::from((error.transpose() * found.information * error)[0] < 7.81);
        }
        assert!(inside > 85 * runs / 100, "{inside} of {runs}");
    }
}
