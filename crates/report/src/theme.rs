//! Colours. The plotting library knows no style sheet: plots are drawn in stand-in colours, which become variables of the
//! page's style sheet, so that light, dark and print each have their own.

use plotters::style::RGBColor;

use super::layout::{BELOW, FINE, LEFT, MARGIN, SERIES};
use super::page::STYLE;
use super::plot::{Plot, SHADES};

/// Text and axes.
pub(crate) const INK: RGBColor = RGBColor(0, 0, 1);
/// Tick labels.
pub(crate) const MUTED: RGBColor = RGBColor(0, 0, 2);
/// Grid lines.
pub(crate) const GRID: RGBColor = RGBColor(0, 0, 3);
/// The truth, or what is expected: dashed wherever it is a line.
pub(crate) const TRUTH: RGBColor = RGBColor(0, 0, 4);
/// What is wrong.
pub(crate) const BAD: RGBColor = RGBColor(0, 0, 5);

/// Colour of the `index`-th series.
pub(crate) fn series(index: usize) -> RGBColor {
    RGBColor(0, 1, (index % usize::from(SERIES)) as u8)
}

/// A shade from the lightest, 0.
pub(crate) fn shade(index: u8) -> RGBColor {
    RGBColor(0, 2, index.min(SHADES - 1))
}

/// A drawing of a page as a file of its own: colours as the style sheet first says them, for light pages.
pub(crate) fn on_paper(svg: &str) -> String {
    let light = STYLE.split(['{', '}']).nth(1).unwrap_or_default();
    let mut own = svg.replacen(
        "<svg",
        "<svg xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\"",
        1,
    );
    for rule in light.split(';') {
        if let Some((name, value)) = rule.split_once(':') {
            own = own.replace(&format!("var({})", name.trim()), value.trim());
        }
    }
    own
}

/// Replaces stand-in colours and the fixed size, drops what is the default anyway, and writes down for the page's script where
/// the axes are.
pub(crate) fn apply(svg: &str, plot: &Plot) -> String {
    let mut themed = svg
        .replace(" opacity=\"1\"", "")
        .replace(" xmlns=\"http://www.w3.org/2000/svg\"", "")
        .replace(" stroke=\"none\" stroke-width=\"1\"", "")
        .replace(
            "stroke=\"#000004\"",
            "stroke=\"var(--ink)\" stroke-dasharray=\"26 18\"",
        );
    for (stand_in, variable) in [
        ("#000001", "var(--ink)"),
        ("#000002", "var(--muted)"),
        ("#000003", "var(--grid)"),
        ("#000004", "var(--ink)"),
        ("#000005", "var(--fail)"),
    ] {
        themed = themed.replace(stand_in, variable);
    }
    for i in 0..SERIES {
        themed = themed.replace(&format!("#00010{i}"), &format!("var(--track{i})"));
    }
    for i in 0..SHADES {
        themed = themed.replace(&format!("#00020{i}"), &format!("var(--shade{i})"));
    }
    // The width of the page decides, not a number of pixels.
    match (themed.find(" width="), themed.find(" viewBox=")) {
        (Some(from), Some(to)) if from < to => {
            themed.replace_range(from..to, &format!(" role=\"img\"{}", attributes(plot)));
        }
        _ => {}
    }
    themed
}

/// Name for who cannot see; ranges of the axes, and the rectangle between them in units of the drawing.
fn attributes(plot: &Plot) -> String {
    let (right, bottom) = (plot.width_px - MARGIN, plot.height_px - BELOW);
    let edges = [LEFT, MARGIN, right, bottom].map(|edge| edge * FINE);
    let [x, y] = [&plot.x, &plot.y];
    format!(
        " aria-label=\"{}\" data-edges=\"{edges:?}\" data-x=\"{:?}\" data-y=\"{:?}\" data-log=\"[{},{}]\" data-labels=\"{}|{}\"",
        escaped(&plot.name),
        x.range,
        y.range,
        x.is_logarithmic,
        y.is_logarithmic,
        escaped(&x.label),
        escaped(&y.label),
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('"', "&quot;")
        .replace('<', "&lt;")
}
