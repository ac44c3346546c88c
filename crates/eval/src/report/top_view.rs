//! Map and trajectories from above, metres the same length on both axes.

use std::collections::BTreeMap;

use lsfb_geometry::{Trajectory, Vector3};
use plotters::element::{Circle, EmptyElement};
use plotters::series::LineSeries;
use plotters::style::Color;

use super::chart::{self, Axis, Frame, frame_height, plot_width, stroke};
use super::number::{tick_step, ticks};
use super::{Report, theme};
use crate::error::Error;

const WIDTH: u32 = 680;
/// Of the plot itself, pixels.
const MIN_HEIGHT: u32 = 200;
const MAX_HEIGHT: u32 = 620;
/// More dots cannot be told apart, and make the page heavy.
const MAX_DOTS: usize = 5_000;

/// A drawn top view.
pub(super) struct TopView {
    pub svg: String,
    /// Lowest and highest map point drawn; absent without a map.
    pub heights_m: Option<[f64; 2]>,
}

/// `None` where there is neither map nor trajectory.
pub(super) fn draw(report: &Report) -> Result<Option<TopView>, Error> {
    let Some(bounds) = Bounds::of(report) else {
        return Ok(None);
    };
    let dots = thinned(&report.map_points, bounds);
    let heights_m = height_range(&dots);
    let (frame, dot_px) = frame(bounds);
    let svg = chart::draw(frame, |chart| {
        chart
            .draw_series(dots.iter().map(|dot| {
                let color = theme::shade(shade(dot.z, heights_m));
                EmptyElement::at((dot.x, dot.y)) + Circle::new((0, 0), dot_px, color.filled())
            }))
            .map_err(|e| e.to_string())?;
        for (i, track) in report.tracks.iter().enumerate() {
            let line = LineSeries::new(path(&track.estimate), stroke(theme::track(i), 2.2));
            chart.draw_series(line).map_err(|e| e.to_string())?;
        }
        for (i, track) in report.tracks.iter().enumerate() {
            if let Some(truth) = &track.truth {
                let line = LineSeries::new(path(truth), stroke(theme::TRUTH, 1.0));
                chart.draw_series(line).map_err(|e| e.to_string())?;
            }
            let start = path(&track.estimate).next();
            chart
                .draw_series(start.map(|at| {
                    let (size, color) = (5 * chart::FINE, theme::track(i));
                    EmptyElement::at(at) + Circle::new((0, 0), size, color.filled())
                }))
                .map_err(|e| e.to_string())?;
        }
        Ok(())
    })?;
    Ok(Some(TopView { svg, heights_m }))
}

fn path(trajectory: &Trajectory) -> impl Iterator<Item = (f64, f64)> {
    trajectory
        .poses()
        .iter()
        .map(|p| {
            (
                p.world_from_rig.translation.x,
                p.world_from_rig.translation.y,
            )
        })
        .filter(|(x, y)| x.is_finite() && y.is_finite())
}

#[derive(Clone, Copy)]
struct Bounds {
    x: [f64; 2],
    y: [f64; 2],
}

impl Bounds {
    /// All of the trajectories, and the map but for its outermost half percent: a stray point must not shrink the rest.
    fn of(report: &Report) -> Option<Self> {
        let tracks = report
            .tracks
            .iter()
            .flat_map(|t| path(&t.estimate).chain(t.truth.iter().flat_map(path)));
        let (mut xs, mut ys): (Vec<f64>, Vec<f64>) = tracks.unzip();
        let map = |of: fn(&Vector3<f64>) -> f64| {
            let mut values: Vec<f64> = report
                .map_points
                .iter()
                .map(of)
                .filter(|v| v.is_finite())
                .collect();
            values.sort_by(f64::total_cmp);
            let beyond = values.len() / 200;
            values.drain(..beyond);
            values.truncate(values.len() - beyond.min(values.len()));
            values
        };
        xs.extend(map(|p| p.x));
        ys.extend(map(|p| p.y));
        let range = |values: &[f64]| {
            let low = values.iter().copied().reduce(f64::min)?;
            let high = values.iter().copied().reduce(f64::max)?;
            let edge = 0.03 * (high - low) + 0.05;
            Some([low - edge, high + edge])
        };
        Some(Self {
            x: range(&xs)?,
            y: range(&ys)?,
        })
    }

    fn contains(&self, point: &Vector3<f64>) -> bool {
        (self.x[0]..=self.x[1]).contains(&point.x) && (self.y[0]..=self.y[1]).contains(&point.y)
    }
}

/// A frame of equal scale, and the radius of a dot in it.
fn frame(bounds: Bounds) -> (Frame, u32) {
    let [mut x, mut y] = [bounds.x, bounds.y];
    let plot_w = f64::from(plot_width(WIDTH));
    let wanted = plot_w * (y[1] - y[0]) / (x[1] - x[0]);
    let plot_h = wanted.round().clamp(MIN_HEIGHT.into(), MAX_HEIGHT.into());
    let metres_per_pixel = ((x[1] - x[0]) / plot_w).max((y[1] - y[0]) / plot_h);
    for (range, pixels) in [(&mut x, plot_w), (&mut y, plot_h)] {
        let missing = metres_per_pixel * pixels - (range[1] - range[0]);
        *range = [range[0] - 0.5 * missing, range[1] + 0.5 * missing];
    }
    // One distance of lines for both axes.
    let step = tick_step(x[1] - x[0], 8).max(tick_step(y[1] - y[0], 8));
    let axis = |label: &str, range: [f64; 2]| Axis {
        label: label.to_owned(),
        range: range[0]..range[1],
        ticks: ticks(
            range[0],
            range[1],
            ((range[1] - range[0]) / step).ceil() as usize,
        ),
    };
    let frame = Frame {
        name: "map and trajectories from above",
        width: WIDTH,
        height: frame_height(plot_h as u32),
        x: axis("x (m)", x),
        y: axis("y (m)", y),
    };
    (frame, 4)
}

/// One point, the highest, of each cell of a grid that is as fine as [`MAX_DOTS`] allows.
fn thinned(points: &[Vector3<f64>], bounds: Bounds) -> Vec<Vector3<f64>> {
    let inside: Vec<&Vector3<f64>> = points
        .iter()
        .filter(|p| p.iter().all(|v| v.is_finite()) && bounds.contains(p))
        .collect();
    let mut cell_m = (bounds.x[1] - bounds.x[0]).max(bounds.y[1] - bounds.y[0]) / 600.0;
    loop {
        let mut cells: BTreeMap<(i64, i64), Vector3<f64>> = BTreeMap::new();
        for p in &inside {
            let cell = ((p.x / cell_m).floor() as i64, (p.y / cell_m).floor() as i64);
            let kept = cells.entry(cell).or_insert(**p);
            if p.z > kept.z {
                *kept = **p;
            }
        }
        if cells.len() <= MAX_DOTS {
            return cells.into_values().collect();
        }
        cell_m *= 1.25;
    }
}

fn height_range(points: &[Vector3<f64>]) -> Option<[f64; 2]> {
    let low = points.iter().map(|p| p.z).reduce(f64::min)?;
    let high = points.iter().map(|p| p.z).reduce(f64::max)?;
    Some([low, high])
}

fn shade(height_m: f64, heights_m: Option<[f64; 2]>) -> u8 {
    let Some([low, high]) = heights_m else {
        return 0;
    };
    let place = (height_m - low) / (high - low).max(1e-9);
    (place * f64::from(theme::SHADES)) as u8
}
