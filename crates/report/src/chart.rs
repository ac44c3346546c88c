//! From a [`Plot`] to SVG, by the plotting library.

use std::ops::Range;

use maud::{Markup, PreEscaped, html};
use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::drawing::IntoDrawingArea;
use plotters::element::{Circle, EmptyElement, PathElement, Polygon, Rectangle, Text};
use plotters::prelude::{Cartesian2d, SVGBackend};
use plotters::style::{Color, IntoFont, RGBColor, ShapeStyle};

use super::axis::Axis;
use super::layout::{BELOW, FINE, LEFT, MARGIN};
use super::plot::{Ink, Layer, Plot};
use super::theme;

/// Size of the labels, pixels of the page.
const FONT: u32 = 15;
/// How much of what lies behind an area it hides.
const AREA_OPACITY: f64 = 0.35;

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Scale, Scale>>;

/// An axis as the plotting library wants it.
struct Scale(Axis);

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let span = f64::from(limit.1 - limit.0);
        limit.0 + (self.0.share(*value) * span).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match hint.bold_points() {
            0 => Vec::new(),
            _ => self.0.ticks.iter().map(|t| t.at).collect(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.0.range[0]..self.0.range[1]
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        let tick = self.0.ticks.iter().find(|t| t.at == *value);
        tick.map_or(String::new(), |t| t.label.clone())
    }
}

impl Plot {
    /// The drawing; where the plotting library refuses, a line that says so in its place.
    pub fn draw(&self) -> Markup {
        match svg(self) {
            Ok(svg) => PreEscaped(svg),
            Err(problem) => html! {
                p.problem { "The plot “" (self.name) "” could not be drawn: " (problem) }
            },
        }
    }
}

impl Plot {
    /// The drawing as an SVG file of its own, in the colours of paper; what the plotting library says against it.
    pub fn to_svg(&self) -> Result<String, String> {
        Ok(theme::on_paper(&svg(self)?))
    }
}

/// The plot as SVG, or what the plotting library says against it.
fn svg(plot: &Plot) -> Result<String, String> {
    let mut svg = String::new();
    draw_into(&mut svg, plot)?;
    Ok(theme::apply(&svg, plot))
}

fn draw_into(svg: &mut String, plot: &Plot) -> Result<(), String> {
    let size = (plot.width_px * FINE, plot.height_px * FINE);
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    let mut chart = ChartBuilder::on(&root)
        .margin_top(MARGIN * FINE)
        .margin_right(MARGIN * FINE)
        .x_label_area_size(BELOW * FINE)
        .y_label_area_size(LEFT * FINE)
        .build_cartesian_2d(Scale(plot.x.clone()), Scale(plot.y.clone()))
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
        .x_desc(plot.x.label.clone())
        .y_desc(plot.y.label.clone())
        .draw()
        .map_err(|e| e.to_string())?;
    for layer in &plot.layers {
        draw_layer(&mut chart, plot, layer)?;
    }
    drop(chart);
    root.present().map_err(|e| e.to_string())
}

fn draw_layer(chart: &mut Chart<'_, '_>, plot: &Plot, layer: &Layer) -> Result<(), String> {
    // The library turns what is no number, or has no logarithm, into a place somewhere.
    let drawable = |points: &[[f64; 2]]| -> Vec<(f64, f64)> {
        let on_axes =
            |p: &&[f64; 2]| plot.x.share(p[0]).is_finite() && plot.y.share(p[1]).is_finite();
        let points = points.iter().filter(on_axes);
        points.map(|[x, y]| (*x, *y)).collect()
    };
    let drawn = match layer {
        Layer::Line {
            points,
            ink,
            width_px,
        } => {
            let line = PathElement::new(drawable(points), stroke(color(*ink), *width_px));
            chart.draw_series([line]).map(|_| ())
        }
        Layer::Dots {
            points,
            ink,
            radius_px,
        } => {
            let radius = (radius_px * f64::from(FINE)).round() as u32;
            let dots = drawable(points).into_iter();
            let dots = dots.map(|at| Circle::new(at, radius, color(*ink).filled()));
            chart.draw_series(dots).map(|_| ())
        }
        Layer::Area { outline, ink } => {
            let area = Polygon::new(drawable(outline), color(*ink).mix(AREA_OPACITY).filled());
            chart.draw_series([area]).map(|_| ())
        }
        Layer::Names { names } => {
            let style = ("sans-serif", FONT * FINE).into_font();
            let style = style.color(&theme::INK);
            let gap = (5 * FINE) as i32;
            let names = names.iter().filter(|(at, _)| !drawable(&[*at]).is_empty());
            let names = names.map(|(at, name)| {
                let word = Text::new(name.clone(), (gap, -gap - (FONT * FINE) as i32), &style);
                EmptyElement::at((at[0], at[1])) + word
            });
            chart.draw_series(names).map(|_| ())
        }
        Layer::Boxes { boxes } => {
            let boxes = boxes.iter().map(|(from, to, ink)| {
                Rectangle::new([(from[0], from[1]), (to[0], to[1])], color(*ink).filled())
            });
            chart.draw_series(boxes).map(|_| ())
        }
    };
    drawn.map_err(|e| e.to_string())
}

fn color(ink: Ink) -> RGBColor {
    match ink {
        Ink::Series(index) => theme::series(index),
        Ink::Shade(index) => theme::shade(index),
        Ink::Truth => theme::TRUTH,
        Ink::Muted => theme::MUTED,
        Ink::Bad => theme::BAD,
    }
}

/// A line as wide as `pixels` of the page.
fn stroke(color: RGBColor, pixels: f64) -> ShapeStyle {
    color.stroke_width((pixels * f64::from(FINE)).round() as u32)
}
