//! The frame all plots share: axes with round ticks, units, one font.

use std::ops::Range;

use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::drawing::IntoDrawingArea;
use plotters::prelude::{Cartesian2d, SVGBackend};
use plotters::style::{Color, IntoFont, ShapeStyle};

use super::number::{Ticks, tick_label};
use super::theme;
use crate::error::Error;

/// The plotting library knows whole pixels only: everything is drawn this many times larger than the page shows it.
pub(super) const FINE: u32 = 4;

/// Room left of the plot for labels, pixels.
const LEFT: u32 = 60;
/// Room below the plot for labels, pixels.
const BELOW: u32 = 42;
/// Room above and at the right.
const MARGIN: u32 = 10;
const FONT: u32 = 15;

pub(super) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Scale, Scale>>;

/// One axis.
pub(super) struct Axis {
    /// What it shows, with the unit.
    pub label: String,
    /// First and last value.
    pub range: Range<f64>,
    /// Where lines stand.
    pub ticks: Ticks,
}

/// Where values lie on an axis, and its ticks.
pub(super) struct Scale {
    range: Range<f64>,
    ticks: Ticks,
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.range.start) / (self.range.end - self.range.start);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match hint.bold_points() {
            0 => Vec::new(),
            _ => self.ticks.at.clone(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        tick_label(*value, self.ticks.decimals)
    }
}

/// A plot before anything is drawn in it.
pub(super) struct Frame {
    /// For errors and for who cannot see.
    pub name: &'static str,
    /// Size in pixels of the page at 100 %.
    pub width: u32,
    /// Height of the same.
    pub height: u32,
    /// Along.
    pub x: Axis,
    /// Up.
    pub y: Axis,
}

/// Pixels of a frame that `width` leaves to the plot itself.
pub(super) fn plot_width(width: u32) -> u32 {
    width - LEFT - MARGIN
}

/// Height of a frame whose plot has `plot_height` pixels.
pub(super) fn frame_height(plot_height: u32) -> u32 {
    plot_height + BELOW + MARGIN
}

/// Neighbours further apart in time than this are not joined by a line: nobody knows what lies between.
pub(super) fn break_secs(duration_secs: f64) -> f64 {
    (duration_secs / 50.0).max(1.0)
}

/// A line as wide as `pixels` of the page.
pub(super) fn stroke(color: impl Color, pixels: f64) -> ShapeStyle {
    color.stroke_width((pixels * f64::from(FINE)).round() as u32)
}

/// Draws the frame and what `draw` puts in it.
pub(super) fn draw(
    frame: Frame,
    draw: impl FnOnce(&mut Chart<'_, '_>) -> Result<(), String>,
) -> Result<String, Error> {
    let name = frame.name;
    let mut svg = String::new();
    draw_into(&mut svg, frame, draw).map_err(|what| Error::Plot { plot: name, what })?;
    Ok(theme::apply(&svg, name))
}

fn draw_into(
    svg: &mut String,
    frame: Frame,
    draw: impl FnOnce(&mut Chart<'_, '_>) -> Result<(), String>,
) -> Result<(), String> {
    let size = (frame.width * FINE, frame.height * FINE);
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    let Frame { x, y, .. } = frame;
    let scale = |axis: &Axis| Scale {
        range: axis.range.clone(),
        ticks: axis.ticks.clone(),
    };
    let mut chart = ChartBuilder::on(&root)
        .margin_top(MARGIN * FINE)
        .margin_right(MARGIN * FINE)
        .x_label_area_size(BELOW * FINE)
        .y_label_area_size(LEFT * FINE)
        .build_cartesian_2d(scale(&x), scale(&y))
        .map_err(|e| e.to_string())?;
    let font = |color| ("sans-serif", FONT * FINE).into_font().color(color);
    chart
        .configure_mesh()
        .bold_line_style(stroke(theme::GRID, 1.0))
        .light_line_style(plotters::style::TRANSPARENT)
        .axis_style(stroke(theme::MUTED, 1.0))
        .set_all_tick_mark_size(4 * FINE)
        .label_style(font(&theme::MUTED))
        .axis_desc_style(font(&theme::INK))
        .x_desc(x.label)
        .y_desc(y.label)
        .draw()
        .map_err(|e| e.to_string())?;
    draw(&mut chart)?;
    drop(chart);
    root.present().map_err(|e| e.to_string())
}
