//! Colours. The plotting library knows no style sheet: plots are drawn in stand-in colours, which become variables of the
//! page's style sheet, so that light, dark and print each have their own.

use plotters::style::RGBColor;

/// Text and axes.
pub(super) const INK: RGBColor = RGBColor(0, 0, 1);
/// Tick labels.
pub(super) const MUTED: RGBColor = RGBColor(0, 0, 2);
/// Grid lines.
pub(super) const GRID: RGBColor = RGBColor(0, 0, 3);
/// The truth: dashed wherever it is a line.
pub(super) const TRUTH: RGBColor = RGBColor(0, 0, 4);

/// Number of colours for trajectories.
pub(super) const TRACKS: u8 = 4;
/// Number of shades for the height of map points.
pub(super) const SHADES: u8 = 5;

/// Colour of the `index`-th trajectory.
pub(super) fn track(index: usize) -> RGBColor {
    RGBColor(0, 1, (index % usize::from(TRACKS)) as u8)
}

/// Shade of a map point; 0 is lowest.
pub(super) fn shade(index: u8) -> RGBColor {
    RGBColor(0, 2, index.min(SHADES - 1))
}

/// The same colour for HTML.
pub(super) fn track_variable(index: usize) -> String {
    format!("var(--track{})", index % usize::from(TRACKS))
}

/// Replaces stand-in colours and the fixed size, and drops what is the default anyway.
pub(super) fn apply(svg: &str, label: &str) -> String {
    let mut themed = svg
        .replace(" opacity=\"1\"", "")
        .replace(" stroke=\"none\" stroke-width=\"1\"", "")
        .replace(
            "stroke=\"#000004\"",
            "stroke=\"var(--ink)\" stroke-dasharray=\"26 18\"",
        );
    for (stand_in, variable) in [
        ("#000001", "var(--ink)"),
        ("#000002", "var(--muted)"),
        ("#000003", "var(--grid)"),
    ] {
        themed = themed.replace(stand_in, variable);
    }
    for i in 0..TRACKS {
        themed = themed.replace(&format!("#00010{i}"), &format!("var(--track{i})"));
    }
    for i in 0..SHADES {
        themed = themed.replace(&format!("#00020{i}"), &format!("var(--shade{i})"));
    }
    // The width of the page decides, not a number of pixels.
    match (themed.find(" width="), themed.find(" viewBox=")) {
        (Some(from), Some(to)) if from < to => {
            let label = label
                .replace('&', "&amp;")
                .replace('"', "&quot;")
                .replace('<', "&lt;");
            themed.replace_range(from..to, &format!(" role=\"img\" aria-label=\"{label}\""));
        }
        _ => {}
    }
    themed
}
