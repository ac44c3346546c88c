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

use lsfb_geometry::{Matrix3, UnitQuaternion, Vector3};
use lsfb_solver::directions_across;
use nalgebra::{SVector, UnitVector3};

use super::tracking::Track;
use crate::statistics::median;
use lsfb_solver::gauss_newton::{NormalEquations, minimise, until_shorter_than};

/// Tracks needed.
const MIN_TRACKS: usize = 16;
const ITERATIONS: u32 = 20;
/// A step shorter than this ends the search, radians.
const STILL_RAD: f64 = 1e-7;
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
/// Information of the way that is always there, 1/rad²: a camera at rest has no way that could be known.
const WAY_INFORMATION: f64 = 1.0;
/// Normalized error at which a track's weight is a quarter.
const ROBUST_SCALE: f64 = 2.5;
/// Median of the size of a normal number.
const MEDIAN_SIZE: f64 = 0.6745;
/// Noise of the best answer over that of another that may be right too.
const ALIKE: f64 = 0.8;

/// A rotation with what it is worth.
#[derive(Clone, Copy, Debug)]
pub struct RelativeRotation {
    /// Directions of the first camera in the second.
    pub b_from_a: UnitQuaternion<f64>,
    /// Of its error, perturbed on the right: 1/rad².
    pub information: Matrix3<f64>,
    noise_rad: f64,
}

/// A rotation and the way between two images.
type Unknowns = (UnitQuaternion<f64>, UnitVector3<f64>);

/// The rotation between two images; `None` with too few tracks. The first of the starts is the one that is believed most.
pub fn relative_rotation(
    tracks: &[Track],
    starts: &[UnitQuaternion<f64>],
) -> Option<RelativeRotation> {
    if tracks.len() < MIN_TRACKS {
        return None;
    }
    let found: Vec<RelativeRotation> = starts
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
        let off = |f: &RelativeRotation| f.b_from_a.angle_to(believed);
        off(a).total_cmp(&off(b))
    })
}

fn from(
    tracks: &[Track],
    start: &UnitQuaternion<f64>,
    way: UnitVector3<f64>,
) -> Option<RelativeRotation> {
    let mut noise_rad = START_NOISE_RAD;
    let terms = |(b_from_a, way): &Unknowns| {
        let errors: Vec<Error> = tracks.iter().map(|t| Error::of(t, b_from_a, way)).collect();
        let sizes = errors.iter().map(|e| e.size.abs()).collect();
        // Half of all errors are as small as half of all should be; at first no more than halved, so that nothing is lost.
        noise_rad = (median(sizes)? / MEDIAN_SIZE).clamp(0.5 * noise_rad, f64::INFINITY);
        noise_rad = noise_rad.max(LEAST_NOISE_RAD);
        let mut terms = NormalEquations::default();
        for error in &errors {
            let share = 1.0 + (error.size / (ROBUST_SCALE * noise_rad)).powi(2);
            let weight = 1.0 / (noise_rad * share).powi(2);
            terms.add(error.size, &error.by, weight);
        }
        for k in 3..5 {
            terms.information[(k, k)] += WAY_INFORMATION;
        }
        Some(terms)
    };
    let inspect = |step: &mut SVector<f64, 5>| {
        let turn = step.fixed_rows::<2>(3).norm();
        if turn > MOST_TURN_RAD {
            *step *= MOST_TURN_RAD / turn;
        }
        until_shorter_than(STILL_RAD)(step)
    };
    let found = minimise((*start, way), ITERATIONS, terms, inspect)?;
    // What the unknown way takes of the rotation's information.
    let turn = found.information.fixed_view::<3, 3>(0, 0);
    let mixed = found.information.fixed_view::<3, 2>(0, 3);
    let way = found.information.fixed_view::<2, 2>(3, 3).into_owned();
    Some(RelativeRotation {
        b_from_a: found.value.0,
        information: turn - mixed * way.try_inverse()? * mixed.transpose(),
        noise_rad,
    })
}

/// How far a track is off, and how that moves with the rotation and the way.
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
        // R exp(φ) a moves by R (φ × a), and t · (R (φ × a) × b) = φ · (a × Rᵀ (b × t)).
        let pull = b_from_a.inverse_transform_vector(&b.cross(way));
        let by_turn = track.first.cross(&pull) / scale;
        let across = directions_across(way);
        let by_way = |k: usize| {
            let d: Vector3<f64> = across.column(k).into();
            (d.dot(&normal) - size * lever.dot(&d.cross(&middle)) / scale) / scale
        };
        Self {
            size,
            by: SVector::from([by_turn.x, by_turn.y, by_turn.z, by_way(0), by_way(1)]),
        }
    }
}

/// The ways that most tracks agree with, of some; each in another direction.
fn first_ways(tracks: &[Track], b_from_a: &UnitQuaternion<f64>) -> Vec<UnitVector3<f64>> {
    let golden = std::f64::consts::PI * (1.0 + 5.0_f64.sqrt());
    let ways = (0..WAYS).map(|k| {
        let (k, n) = (k as f64 + 0.5, WAYS as f64);
        let (z, turn) = (1.0 - k / n, golden * k);
        let across = (1.0 - z * z).sqrt();
        UnitVector3::new_normalize(Vector3::new(across * turn.cos(), across * turn.sin(), z))
    });
    let cost = |way: &Vector3<f64>| -> f64 {
        let sizes = tracks.iter().map(|t| Error::of(t, b_from_a, way).size);
        sizes.map(|s| (s / START_NOISE_RAD).powi(2).ln_1p()).sum()
    };
    let mut rated: Vec<(f64, UnitVector3<f64>)> = ways.map(|way| (cost(&way), way)).collect();
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut taken: Vec<UnitVector3<f64>> = Vec::with_capacity(TRIED);
    for (_, way) in rated {
        if taken.len() < TRIED && taken.iter().all(|t| t.dot(&way).abs() < ALONG) {
            taken.push(way);
        }
    }
    taken
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::so3;

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
            let start = so3::retract(&b_from_a, &vector(0.01));
            let found = relative_rotation(&tracks, &[start]).expect("found");
            let error = so3::local(&b_from_a, &found.b_from_a);
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
