//! Two cameras against each other: what one sees lies on the epipolar curve in the other.
//!
//! Corners of one image are looked for around the curve that the rig draws into the other, by correlation of patches. How far
//! from the curve they are found is the error; along it is depth, which says nothing, but at its far end the curve ends: nothing is
//! farther away than infinity.

use lsfb_geometry::{Camera, Se3, Vector2};
use lsfb_perception::image::{Gray, corners};
use lsfb_perception::statistics::peak;

/// Gradients that a corner needs, grey levels squared: it must be told from others along the whole curve.
const STRONG: f64 = 2000.0;
/// Edge of a patch, pixels, and pixels in it.
const EDGE: usize = 11;
const PATCH: usize = EDGE * EDGE;
/// Grey levels by which pixels of a patch differ from their mean, rms; less is blank.
const LEAST_CONTRAST: f64 = 3.0;
/// Nearest thing expected, metres.
const NEAREST_M: f64 = 0.4;
/// Correlation of a match, and of the next best one elsewhere.
const GOOD: f64 = 0.9;
const SECOND: f64 = 0.8;
/// Drop of the correlation two pixels across the curve: an edge along the curve has none, and says nothing.
const SHARP: f64 = 0.04;
/// Places looked at along the curve at most.
const MOST_PLACES: i32 = 160;

/// Share of the first image that the second one sees, far away.
pub(super) fn overlap(first: &Camera, second: &Camera, second_from_first: &Se3) -> f64 {
    let (mut inside, mut all) = (0, 0);
    for j in 0..12 {
        for i in 0..16 {
            let pixel = Vector2::new(
                f64::from(first.width) * (f64::from(i) + 0.5) / 16.0,
                f64::from(first.height) * (f64::from(j) + 0.5) / 12.0,
            );
            all += 1;
            let seen = first
                .unproject(&pixel)
                .and_then(|ray| second.project(&(second_from_first.rotation * ray)));
            inside += usize::from(seen.is_some_and(|p| second.contains(&p, 10.0)));
        }
    }
    inside as f64 / f64::from(all)
}

/// Distances from their curves of the corners that are found up to `reach_px` from it, pixels; their sign is the side.
pub(super) fn errors_px(
    first: &Gray,
    second: &Gray,
    second_from_first: &Se3,
    reach_px: i32,
) -> Vec<f64> {
    corners(first, STRONG)
        .iter()
        .filter_map(|corner| error_px(first, second, second_from_first, corner, reach_px))
        .collect()
}

fn error_px(
    first: &Gray,
    second: &Gray,
    second_from_first: &Se3,
    corner: &Vector2<f64>,
    reach_px: i32,
) -> Option<f64> {
    let ray = first.camera.unproject(corner)?;
    let own = patch(first, corner)?;
    let at_depth = |inverse_m: f64| {
        let point = second_from_first.rotation * ray + second_from_first.translation * inverse_m;
        second.camera.project(&point)
    };
    let (far, near) = (at_depth(0.0)?, at_depth(1.0 / NEAREST_M)?);
    let places = ((far - near).norm().ceil() as i32 + 2).min(MOST_PLACES);
    let mut found: Vec<Found> = Vec::new();
    for k in -reach_px..places {
        let share = f64::from(k) / f64::from(places - 1);
        let (Some(on), Some(next)) = (
            at_depth(share / NEAREST_M),
            at_depth((share + 0.01) / NEAREST_M),
        ) else {
            continue;
        };
        let along = (next - on).try_normalize(1e-6).unwrap_or_else(Vector2::x);
        let across = Vector2::new(-along.y, along.x);
        let scores: Vec<f64> = (-reach_px..=reach_px)
            .map(|e| {
                patch(second, &(on + across * f64::from(e)))
                    .map_or(-1.0, |other| correlation(&own, &other))
            })
            .collect();
        let best = (0..scores.len()).max_by(|a, b| scores[*a].total_cmp(&scores[*b]))?;
        let sharp = [best.checked_sub(2), Some(best + 2)]
            .into_iter()
            .flatten()
            .filter_map(|k| scores.get(k))
            .all(|s| *s < scores[best] - SHARP);
        if !sharp {
            continue;
        }
        found.push(Found {
            score: scores[best],
            across_px: peak(&scores)? - f64::from(reach_px),
            along_px: f64::from(k),
        });
    }
    let best = found.iter().max_by(|a, b| a.score.total_cmp(&b.score))?;
    let second_best = found
        .iter()
        .filter(|f| (f.along_px - best.along_px).abs() > 3.0)
        .map(|f| f.score)
        .fold(-1.0, f64::max);
    // At the end of the reach the best may lie beyond.
    let inside = |px: f64| px < f64::from(reach_px) - 0.5;
    // Half a pixel is what a place along the curve is known to.
    let beyond_px = (-best.along_px - 0.5).max(0.0);
    let error_px = best.across_px.hypot(beyond_px).copysign(best.across_px);
    (best.score > GOOD
        && second_best < SECOND.max(best.score - 0.1)
        && inside(best.across_px.abs())
        && inside(beyond_px))
    .then_some(error_px)
}

/// The best place across the curve, somewhere along it.
struct Found {
    score: f64,
    across_px: f64,
    /// From infinity towards the camera.
    along_px: f64,
}

/// A patch with mean zero and norm one; `None` off the image or where it is blank.
fn patch(image: &Gray, at: &Vector2<f64>) -> Option<[f64; PATCH]> {
    let window = image.window::<EDGE>(at)?;
    let values = window.as_flattened();
    let mean = values.iter().sum::<f64>() / PATCH as f64;
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    let norm = squares.sqrt();
    if norm < LEAST_CONTRAST * (PATCH as f64).sqrt() {
        return None;
    }
    Some(std::array::from_fn(|k| (values[k] - mean) / norm))
}

fn correlation(a: &[f64; PATCH], b: &[f64; PATCH]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
