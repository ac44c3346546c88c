//! How values spread: shares of equally wide bins.

use lsfb_report::{Normal, Plot, tick_step};
use maud::Markup;

use crate::statistics::Statistics;

const BINS: usize = 40;
/// Share of the values that the plot must show; the few beyond are told in words.
const SHOWN: f64 = 0.995;

/// A drawn histogram.
pub(super) struct Histogram {
    pub drawing: Markup,
    /// Of all finite values, also those beyond the plot; in the order of the series.
    pub statistics: Vec<Option<Statistics>>,
    /// Share beyond the last bin, 0 to 1, over all series.
    pub beyond: f64,
}

/// One list of values, none below zero, for each colour; `None` where there is no value.
pub(super) fn draw(name: &str, label: &str, series: &[&[f64]]) -> Option<Histogram> {
    let finite: Vec<Vec<f64>> = series
        .iter()
        .map(|values| values.iter().copied().filter(|v| v.is_finite()).collect())
        .collect();
    let mut all: Vec<f64> = finite.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    let shown = all.get((all.len() as f64 * SHOWN) as usize);
    let largest = *shown.or(all.last())?;
    let step = tick_step(largest.max(1e-9), 6) / 2.0;
    let end = step * (largest / step).ceil().max(1.0);
    let width = end / BINS as f64;
    let shares: Vec<Vec<f64>> = finite.iter().map(|values| shares(values, width)).collect();
    let labels = (label, "share (%)");
    let plot = Plot {
        width_px: 560,
        height_px: 260,
        ..lsfb_report::histogram(name, labels, [0.0, end], &shares, Normal::Unknown)
    };
    let beyond = all.iter().filter(|v| **v > end).count() as f64 / all.len() as f64;
    Some(Histogram {
        drawing: plot.draw(),
        statistics: finite.iter().map(|values| Statistics::of(values)).collect(),
        beyond,
    })
}

/// Per cent of all values in each bin.
fn shares(values: &[f64], width: f64) -> Vec<f64> {
    let mut counts = vec![0usize; BINS];
    for value in values {
        let bin = (value / width).max(0.0) as usize;
        // The upper edge belongs to the last bin; rounding must not push it out.
        let bin = if *value <= width * BINS as f64 * (1.0 + 1e-12) {
            bin.min(BINS - 1)
        } else {
            bin
        };
        if let Some(count) = counts.get_mut(bin) {
            *count += 1;
        }
    }
    let all = values.len().max(1) as f64;
    counts.into_iter().map(|c| 100.0 * c as f64 / all).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_a_bin_or_beyond() {
        let values: Vec<f64> = (0..1000)
            .map(|i| f64::from(i) / 1000.0)
            .chain([50.0])
            .collect();
        let drawn = draw("test", "error (px)", &[&values]).expect("values");
        assert!((drawn.beyond - 1.0 / 1001.0).abs() < 1e-12);
        assert_eq!(drawn.statistics[0].map(|s| s.count), Some(1001));
        let shares = shares(&values, 1.0 / BINS as f64);
        assert!((shares.iter().sum::<f64>() - 100.0 * 1000.0 / 1001.0).abs() < 1e-9);
        assert!((shares[0] - 100.0 * 25.0 / 1001.0).abs() < 1e-9);
        assert!(draw("none", "", &[]).is_none());
    }
}
