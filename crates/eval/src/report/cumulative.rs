//! Which share of the poses is at least so good: errors in order, side by side for all trajectories.

use lsfb_report::{Axis, Ink, Layer, Plot};
use maud::Markup;

use super::Track;

/// More steps cannot be told apart.
const MAX_STEPS: usize = 400;
/// Better than this no figure is of use, metres: an error of zero has a place on the axis too.
const LEAST_M: f64 = 1e-6;

/// `None` where no trajectory has errors.
pub(super) fn draw(tracks: &[Track]) -> Option<Markup> {
    let sorted: Vec<Vec<f64>> = tracks.iter().map(errors_m).collect();
    if sorted.iter().all(Vec::is_empty) {
        return None;
    }
    let lines = sorted.iter().enumerate();
    let plot = Plot {
        name: "share of poses by translation error".to_owned(),
        width_px: 560,
        height_px: 260,
        x: Axis::decades("translation error (m)", sorted.iter().flatten().copied()),
        y: Axis::linear("poses with at most this error (%)", [0.0, 100.0]),
        layers: lines
            .map(|(i, errors)| Layer::line(steps(errors), Ink::Series(i)))
            .collect(),
    };
    Some(plot.draw())
}

fn errors_m(track: &Track) -> Vec<f64> {
    let errors = track.errors.iter().map(|e| e.translation_m.max(LEAST_M));
    let mut errors: Vec<f64> = errors.filter(|e| e.is_finite()).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

/// Errors with the share of poses up to them, per cent; the largest is always among them.
fn steps(sorted: &[f64]) -> Vec<[f64; 2]> {
    let count = sorted.len();
    let every = count.div_ceil(MAX_STEPS).max(1);
    let places = (0..count).filter(|i| (count - 1 - i).is_multiple_of(every));
    places
        .map(|i| [sorted[i], 100.0 * (i + 1) as f64 / count as f64])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_grows_to_all() {
        let sorted: Vec<f64> = (1..=1000).map(|i| f64::from(i) * 0.001).collect();
        let steps = steps(&sorted);
        assert!(steps.len() <= MAX_STEPS);
        assert!(
            steps
                .windows(2)
                .all(|w| w[0][0] < w[1][0] && w[0][1] < w[1][1])
        );
        let half = steps.iter().find(|s| s[1] >= 50.0).expect("the median");
        assert!((half[0] - 0.5).abs() < 0.003, "{half:?}");
        assert_eq!(steps.last(), Some(&[1.0, 100.0]));
    }
}
