//! Which views to adjust: those that differ most in place, distance and tilt.

use std::collections::BTreeSet;

use super::CameraViews;
use crate::copies::copies;
use crate::detect::Corner;

/// Centre, size and shape of a view, in units of the image.
fn descriptor(corners: &[Corner], width: f64) -> [f64; 6] {
    let n = corners.len() as f64;
    let mean = |f: &dyn Fn(&Corner) -> f64| corners.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(&|c| c.pixel.x), mean(&|c| c.pixel.y));
    let xx = mean(&|c| (c.pixel.x - x).powi(2)).sqrt();
    let yy = mean(&|c| (c.pixel.y - y).powi(2)).sqrt();
    let xy = mean(&|c| (c.pixel.x - x) * (c.pixel.y - y));
    // Which way the board is turned: correlation of place on the image with place on the board.
    let index = mean(&|c| c.index as f64);
    let turn = mean(&|c| (c.index as f64 - index) * (c.pixel.x - x));
    let spread = mean(&|c| (c.index as f64 - index).powi(2)).sqrt();
    [
        x / width,
        y / width,
        2.0 * xx / width,
        2.0 * yy / width,
        xy / (xx * yy + 1e-9) * 0.3,
        turn / (spread * xx + 1e-9) * 0.3,
    ]
}

/// Instants of views that are copies of earlier ones, and of which.
pub(crate) fn copied(camera: &CameraViews) -> Vec<(i64, i64)> {
    let views = camera.views.iter();
    copies(views.map(|(instant, corners)| (*instant, corners.as_slice())))
}

/// Instants of at most `most` views, each the farthest from those chosen before; in order of time. Copies are left out.
pub(super) fn choose(camera: &CameraViews, most: usize) -> Vec<i64> {
    let width = f64::from(camera.width);
    let copied: BTreeSet<i64> = copied(camera).into_iter().map(|c| c.0).collect();
    let all: Vec<(i64, [f64; 6])> = camera
        .views
        .iter()
        .filter(|(instant, corners)| corners.len() >= 8 && !copied.contains(instant))
        .map(|(instant, corners)| (*instant, descriptor(corners, width)))
        .collect();
    if all.len() <= most {
        return all.into_iter().map(|v| v.0).collect();
    }
    let distance = |a: &[f64; 6], b: &[f64; 6]| -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
    };
    let mut nearest = vec![f64::INFINITY; all.len()];
    let mut chosen = Vec::with_capacity(most);
    // The view with most corners first; then whatever is farthest from all chosen.
    let mut next = (0..all.len())
        .max_by_key(|k| (camera.views[&all[*k].0].len(), std::cmp::Reverse(*k)))
        .unwrap_or_default();
    while chosen.len() < most {
        chosen.push(all[next].0);
        for (k, near) in nearest.iter_mut().enumerate() {
            *near = near.min(distance(&all[k].1, &all[next].1));
        }
        next = (0..all.len())
            .max_by(|a, b| nearest[*a].total_cmp(&nearest[*b]).then(b.cmp(a)))
            .unwrap_or_default();
    }
    chosen.sort_unstable();
    chosen
}
