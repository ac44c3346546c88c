//! How a camera turned between two images, from corners followed, whatever their distance.
//!
//! A thing seen along `a` is then seen along `b ∝ R a + ρ t`, with its own inverse distance `ρ` of which nothing is assumed: what is left
//! is how far `b` lies off the plane of `R a` and the way `t`, in units of what noise of either ray does there,
//! `e = t · (R a × b) / |t × m|` (Sampson's error for rays, `m` between `R a` and `b`). So a near thing that passes by is not taken for
//! turning, nor is a wall aslant. Where the camera does not move, no `t` fits better than another and the rotation is as good as
//! half of the numbers make it.
//!
//! Things in one plane leave two answers, and the search may end beside the best. So it begins at several rotations and ways, and of
//! the answers that fit about as well as the best the one is taken that is nearest to the rotation believed most.

use lsfb_geometry::{Matrix3, UnitQuaternion, Vector3, so3};
use nalgebra::{SMatrix, SVector};

use super::tracks::Track;

/// Tracks needed.
const MIN_TRACKS: usize = 16;
const ITERATIONS: usize = 20;
/// Noise of a ray that is expected while the way is looked for, and the least that is believed, radians.
const START_NOISE_RAD: f64 = 2e-3;
const LEAST_NOISE_RAD: f64 = 5e-5;
/// Sine of the angle to the way below which a ray says little of it.
const NEAR_WAY: f64 = 0.03;
/// Ways looked at, spread over half a sphere; of which so many are tried, with the cosine between them below a limit.
const WAYS: usize = 60;
const TRIED: usize = 3;
const ALONG: f64 = 0.87;
/// Turns of the way at most in one step, radians.
const MOST_TURN_RAD: f64 = 0.3;
/// Normalized error at which a track's weight is a quarter.
const ROBUST_SCALE: f64 = 2.5;
/// Median of the size of a normal number.
const MEDIAN_SIZE: f64 = 0.6745;
/// Noise of the best answer over that of another that may be right too.
const ALIKE: f64 = 0.8;

/// A rotation with what it is worth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relative {
    pub b_from_a: UnitQuaternion<f64>,
    /// Of a small rotation after it, 1/rad².
    pub information: Matrix3<f64>,
    noise_rad: f64,
}

/// The rotation between two images; `None` with too few tracks. The first of the starts is the one that is believed most.
pub(super) fn relative(tracks: &[Track], starts: &[UnitQuaternion<f64>]) -> Option<Relative> {
    if tracks.len() < MIN_TRACKS {
        return None;
    }
    let found: Vec<Relative> = starts
        .iter()
        .flat_map(|start| {
            let ways = first_ways(tracks, start).into_iter();
            ways.filter_map(|way| from(tracks, start, way))
        })
        .collect();
    let least = found.iter().map(|f| f.noise_rad).min_by(f64::total_cmp)?;
    let believed = starts.first()?;
    let good = found.into_iter().filter(|f| f.noise_rad * ALIKE <= least);
    good.min_by(|a, b| {
        let off = |f: &Relative| f.b_from_a.angle_to(believed);
        off(a).total_cmp(&off(b))
    })
}

fn from(tracks: &[Track], start: &UnitQuaternion<f64>, mut way: Vector3<f64>) -> Option<Relative> {
    let mut b_from_a = *start;
    let mut noise_rad = START_NOISE_RAD;
    let mut normal = Normal::zeros();
    for _ in 0..ITERATIONS {
        let errors: Vec<Error> = tracks
            .iter()
            .map(|t| Error::of(t, &b_from_a, &way))
            .collect();
        let sizes = errors.iter().map(|e| e.size.abs()).collect();
        // Half of all errors are as small as half of all should be; at first no more than halved, so that nothing is lost.
        noise_rad = (median(sizes) / MEDIAN_SIZE).clamp(0.5 * noise_rad, f64::INFINITY);
        noise_rad = noise_rad.max(LEAST_NOISE_RAD);
        normal = Normal::zeros();
        let mut right = SVector::<f64, 5>::zeros();
        for error in &errors {
            let share = 1.0 + (error.size / (ROBUST_SCALE * noise_rad)).powi(2);
            let weight = 1.0 / (noise_rad * share).powi(2);
            normal += error.by * error.by.transpose() * weight;
            right -= error.by * (error.size * weight);
        }
        // A camera at rest has no way that could be known.
        for k in 3..5 {
            normal[(k, k)] += 1.0;
        }
        let mut step = normal.cholesky()?.solve(&right);
        let turn = step.fixed_rows::<2>(3).norm();
        if turn > MOST_TURN_RAD {
            step *= MOST_TURN_RAD / turn;
        }
        let [u, v] = basis(&way);
        b_from_a = so3::exp(&step.fixed_rows::<3>(0).into()) * b_from_a;
        way = (way + u * step[3] + v * step[4]).normalize();
        if step.norm() < 1e-7 {
            break;
        }
    }
    // What the unknown way takes of the rotation's information.
    let turn = normal.fixed_view::<3, 3>(0, 0);
    let mixed = normal.fixed_view::<3, 2>(0, 3);
    let way = normal.fixed_view::<2, 2>(3, 3).into_owned();
    Some(Relative {
        b_from_a,
        information: turn - mixed * way.try_inverse()? * mixed.transpose(),
        noise_rad,
    })
}

type Normal = SMatrix<f64, 5, 5>;

/// How far a track is off, and how that moves with the rotation and across the way.
struct Error {
    size: f64,
    by: SVector<f64, 5>,
}

impl Error {
    fn of(track: &Track, b_from_a: &UnitQuaternion<f64>, way: &Vector3<f64>) -> Self {
        let turned = b_from_a * track.first;
        let b = &track.second;
        let middle = (turned + b).normalize();
        let normal = turned.cross(b);
        let lever = way.cross(&middle);
        let scale = (lever.norm_squared() + NEAR_WAY * NEAR_WAY).sqrt();
        let size = way.dot(&normal) / scale;
        // exp(φ) R a moves by φ × R a, and t · ((φ × R a) × b) = φ · (R a × (b × t)).
        let by_turn = turned.cross(&b.cross(way)) / scale;
        let by_way = |d: &Vector3<f64>| {
            (d.dot(&normal) - size * lever.dot(&d.cross(&middle)) / scale) / scale
        };
        let [u, v] = basis(way);
        Self {
            size,
            by: SVector::from([by_turn.x, by_turn.y, by_turn.z, by_way(&u), by_way(&v)]),
        }
    }
}

/// The ways that most tracks agree with, of some; each in another direction.
fn first_ways(tracks: &[Track], b_from_a: &UnitQuaternion<f64>) -> Vec<Vector3<f64>> {
    let golden = std::f64::consts::PI * (1.0 + 5.0_f64.sqrt());
    let ways = (0..WAYS).map(|k| {
        let (k, n) = (k as f64 + 0.5, WAYS as f64);
        let (z, turn) = (1.0 - k / n, golden * k);
        let across = (1.0 - z * z).sqrt();
        Vector3::new(across * turn.cos(), across * turn.sin(), z)
    });
    let cost = |way: &Vector3<f64>| -> f64 {
        let sizes = tracks.iter().map(|t| Error::of(t, b_from_a, way).size);
        sizes.map(|s| (s / START_NOISE_RAD).powi(2).ln_1p()).sum()
    };
    let mut rated: Vec<(f64, Vector3<f64>)> = ways.map(|way| (cost(&way), way)).collect();
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut taken: Vec<Vector3<f64>> = Vec::with_capacity(TRIED);
    for (_, way) in rated {
        if taken.len() < TRIED && taken.iter().all(|t| t.dot(&way).abs() < ALONG) {
            taken.push(way);
        }
    }
    taken
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    let (_, found, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    *found
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
        let (mut inside, mut far, runs) = (0, 0, 300);
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
            let start = so3::exp(&vector(0.01)) * b_from_a;
            let found = relative(&tracks, &[start]).expect("found");
            let error = so3::log(&(found.b_from_a * b_from_a.inverse()));
            far += usize::from(error.norm() > 5e-3);
            // 95 % of a chi-square with three degrees of freedom.
            inside += usize::from((error.transpose() * found.information * error)[0] < 7.81);
        }
        assert!(
            inside > 92 * runs / 100 && far <= runs / 100,
            "{inside}, {far} of {runs}"
        );
    }
}
