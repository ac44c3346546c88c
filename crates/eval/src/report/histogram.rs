//! How values spread: shares of equally wide bins.

use plotters::element::{PathElement, Polygon};
use plotters::style::Color;

use super::chart::{self, Axis, Frame, stroke};
use super::number::{tick_step, ticks};
use super::theme;
use crate::error::Error;
use crate::statistics::Statistics;

const BINS: usize = 40;
/// Share of the values that the plot must show; the few beyond are told in words.
const SHOWN: f64 = 0.995;

/// Values of one colour.
pub(super) struct Series<'a> {
    /// Which colour of the trajectories.
    pub color: usize,
    /// The values, none below zero.
    pub values: &'a [f64],
}

/// A drawn histogram.
pub(super) struct Histogram {
    pub svg: String,
    /// Of all finite values, also those beyond the plot; in the order of the series.
    pub statistics: Vec<Option<Statistics>>,
    /// Share beyond the last bin, 0 to 1, over all series.
    pub beyond: f64,
}

/// `None` where there is no value.
pub(super) fn draw(
    name: &'static str,
    label: String,
    series: &[Series<'_>],
) -> Result<Option<Histogram>, Error> {
    let finite: Vec<Vec<f64>> = series
        .iter()
        .map(|s| s.values.iter().copied().filter(|v| v.is_finite()).collect())
        .collect();
    let mut all: Vec<f64> = finite.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    let Some(&largest) = all.get((all.len() as f64 * SHOWN) as usize).or(all.last()) else {
        return Ok(None);
    };
    let step = tick_step(largest.max(1e-9), 6) / 2.0;
    let end = step * (largest / step).ceil().max(1.0);
    let width = end / BINS as f64;
    let shares: Vec<Vec<f64>> = finite.iter().map(|values| shares(values, width)).collect();
    let most = shares.iter().flatten().copied().fold(0.0, f64::max);
    let top = (1.08 * most).max(1e-6);
    let frame = Frame {
        name,
        width: 560,
        height: 260,
        x: Axis {
            label,
            range: 0.0..end,
            ticks: ticks(0.0, end, 7),
        },
        y: Axis {
            label: "share (%)".to_owned(),
            range: 0.0..top,
            ticks: ticks(0.0, top, 5),
        },
    };
    let svg = chart::draw(frame, |chart| {
        for (shares, series) in shares.iter().zip(series) {
            let color = theme::track(series.color);
            let steps = shares.iter().enumerate().flat_map(|(i, &share)| {
                [(i as f64 * width, share), ((i + 1) as f64 * width, share)]
            });
            let outline: Vec<(f64, f64)> = steps.collect();
            // One shape: bars side by side would show seams.
            let area = [(0.0, 0.0)].into_iter().chain(outline.iter().copied());
            let area: Vec<(f64, f64)> = area.chain([(end, 0.0)]).collect();
            chart
                .draw_series([Polygon::new(area, color.mix(0.35).filled())])
                .map_err(|e| e.to_string())?;
            chart
                .draw_series([PathElement::new(outline, stroke(color, 1.4))])
                .map_err(|e| e.to_string())?;
        }
        Ok(())
    })?;
    let beyond = all.iter().filter(|v| **v > end).count() as f64 / all.len() as f64;
    Ok(Some(Histogram {
        svg,
        statistics: finite.iter().map(|values| Statistics::of(values)).collect(),
        beyond,
    }))
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
        let series = [Series {
            color: 0,
            values: &values,
        }];
        let drawn = draw("test", "error (px)".to_owned(), &series)
            .expect("drawn")
            .expect("values");
        assert!((drawn.beyond - 1.0 / 1001.0).abs() < 1e-12);
        assert_eq!(drawn.statistics[0].map(|s| s.count), Some(1001));
        let shares = shares(&values, 1.0 / BINS as f64);
        assert!((shares.iter().sum::<f64>() - 100.0 * 1000.0 / 1001.0).abs() < 1e-9);
        assert!((shares[0] - 100.0 * 25.0 / 1001.0).abs() < 1e-9);
        assert!(draw("none", String::new(), &[]).expect("empty").is_none());
    }
}
