//! Ranges to dark and to bright parts of a board: a pulse that comes back weaker crosses the receiver's threshold later, so that it seems
//! to have come from farther away. On the checkerboard of acfr_cam_lidar a VLP-16 measures black squares 9 mm farther than white ones, which
//! turns the planes through its boards by 0.3 to 0.8°.
//!
//! Along a chord, a plane and an offset of the beam are a straight line over the way: what dark returns have beyond it is theirs, whatever
//! the plane. Which returns are dark is asked of each board alone (N. Otsu, "A threshold selection method from gray-level histograms",
//! IEEE Trans. SMC 9, 1979), as sensors differ in what their intensities mean.

use nalgebra::{Matrix2, Vector2};

use super::plane::{Chord, Plane};
use super::solved::{DarkExcess, Used};

/// Returns a chord needs to say something.
const MIN_POINTS: usize = 6;
/// Chords needed on all boards together, and standard deviations that the difference must be from zero.
const MIN_CHORDS: usize = 12;
const DEVIATIONS: f64 = 4.0;

/// What one chord says of it: sums over its returns, straight lines taken off.
struct OfChord {
    /// Of the product of darkness and range error, metres.
    product: f64,
    /// Of darkness squared.
    square: f64,
}

/// Finds it and takes it off the dark returns, where it is more than chance.
pub(super) fn take_off(used: &mut [Used]) -> Option<DarkExcess> {
    let limits: Vec<Option<u8>> = used.iter().map(|u| limit(&u.chords)).collect();
    let chords = used.iter().zip(&limits).flat_map(|(u, limit)| {
        let of_chord = move |chord| of_chord(chord, &u.fit.plane, (*limit)?);
        u.chords.iter().filter_map(of_chord)
    });
    let found = excess(&chords.collect::<Vec<_>>())?;
    if found.excess_m.abs() < DEVIATIONS * found.sigma_m {
        return None;
    }
    for (u, limit) in used.iter_mut().zip(limits) {
        let Some(limit) = limit else { continue };
        for chord in &mut u.chords {
            for (point, intensity) in chord.points.iter_mut().zip(&chord.intensities) {
                if *intensity <= limit {
                    *point *= 1.0 - found.excess_m / point.norm();
                }
            }
        }
    }
    Some(found)
}

/// The brightest of the dark returns of a board: where two groups differ most. `None` where all are alike.
fn limit(chords: &[Chord]) -> Option<u8> {
    let mut counts = [0_u32; 256];
    for intensity in chords.iter().flat_map(|c| &c.intensities) {
        counts[usize::from(*intensity)] += 1;
    }
    let sums = |from: usize, to: usize| {
        let own = counts[from..to].iter().enumerate();
        own.fold([0.0; 2], |[count, sum], (k, n)| {
            let n = f64::from(*n);
            [count + n, sum + n * (from + k) as f64]
        })
    };
    let between = |limit: usize| {
        let ([dark, dark_sum], [bright, bright_sum]) = (sums(0, limit + 1), sums(limit + 1, 256));
        let apart = bright_sum / bright - dark_sum / dark;
        dark * bright * apart * apart
    };
    (0..255_u8)
        .map(|limit| (limit, between(usize::from(limit))))
        .filter(|(_, square)| square.is_finite())
        .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
        .map(|(limit, _)| limit)
}

fn of_chord(chord: &Chord, plane: &Plane, limit: u8) -> Option<OfChord> {
    let returns: Vec<[f64; 3]> = chord
        .points
        .iter()
        .zip(&chord.intensities)
        .filter_map(|(point, intensity)| {
            let dark = f64::from(u8::from(*intensity <= limit));
            // Where the ray meets the plane: noise along an oblique ray would make the way depend on the error.
            let place = plane.local(&plane.meet(&point.try_normalize(1e-6)?)?);
            Some([place.x, dark, plane.range_error_m(point)?])
        })
        .collect();
    if returns.len() < MIN_POINTS {
        return None;
    }
    let (mut normal, mut of_dark, mut of_error) =
        (Matrix2::zeros(), Vector2::zeros(), Vector2::zeros());
    let (mut product, mut square) = (0.0, 0.0);
    for [way, dark, error_m] in returns {
        let line = Vector2::new(1.0, way);
        normal += line * line.transpose();
        of_dark += line * dark;
        of_error += line * error_m;
        product += dark * error_m;
        square += dark * dark;
    }
    let line_of_dark = normal.cholesky()?.solve(&of_dark);
    Some(OfChord {
        product: product - line_of_dark.dot(&of_error),
        square: square - line_of_dark.dot(&of_dark),
    })
}

/// The mean over all chords, with the spread between them.
fn excess(chords: &[OfChord]) -> Option<DarkExcess> {
    let square: f64 = chords.iter().map(|c| c.square).sum();
    let telling = chords.iter().filter(|c| c.square > 1e-6).count();
    if telling < MIN_CHORDS {
        return None;
    }
    let excess_m = chords.iter().map(|c| c.product).sum::<f64>() / square;
    let left = chords.iter().map(|c| c.product - c.square * excess_m);
    let variance = left.map(|l| l * l).sum::<f64>() / (square * square);
    Some(DarkExcess {
        excess_m,
        sigma_m: variance.sqrt(),
    })
}
