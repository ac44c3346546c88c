//! Plots of the reports as SVG.

use maud::{Markup, html};

use crate::coverage::COVERAGE_CELLS;

/// Errors beyond this leave the plots, pixels.
pub(crate) const LARGEST_SHOWN_PX: f64 = 1.0;
/// Points drawn at most.
const MOST_POINTS: usize = 4000;
const ERROR_BINS: usize = 40;
const CURVE_STEPS: usize = 80;

/// Corners per cell of an image.
pub(crate) fn coverage(cells: &[u32], size_px: [u32; 2]) -> Markup {
    let [columns, rows] = COVERAGE_CELLS;
    let most = f64::from(cells.iter().copied().max().unwrap_or(1).max(1));
    let height = 240.0 * f64::from(size_px[1]) / f64::from(size_px[0].max(1));
    let (w, h) = (240.0 / columns as f64, height / rows as f64);
    html! {
        svg viewBox=(format!("0 0 240 {height:.0}")) role="img" aria-label="coverage" {
            @for (k, n) in cells.iter().enumerate() {
                rect x=(format!("{:.1}", (k % columns) as f64 * w)) y=(format!("{:.1}", (k / columns) as f64 * h))
                    width=(format!("{w:.1}")) height=(format!("{h:.1}"))
                    class=(if *n == 0 { "empty" } else { "seen" })
                    fill-opacity=(format!("{:.2}", if *n == 0 { 1.0 } else { 0.2 + 0.8 * (f64::from(*n) / most).sqrt() })) {}
            }
        }
    }
}

/// Errors of corners as points around their mean of zero.
pub(crate) fn scatter(errors_px: &[[f64; 2]]) -> Markup {
    let step = errors_px.len().div_ceil(MOST_POINTS).max(1);
    let scale = 120.0 / LARGEST_SHOWN_PX;
    html! {
        svg viewBox="-120 -120 240 240" role="img" aria-label="errors" {
            path.axis d="M-120 0H120M0 -120V120" {}
            @for [x, y] in errors_px.iter().step_by(step).filter(|e| e[0].hypot(e[1]) < LARGEST_SHOWN_PX) {
                circle cx=(format!("{:.1}", x * scale)) cy=(format!("{:.1}", y * scale)) r="1" {}
            }
        }
    }
}

/// Mean errors per cell of an image as arrows from the cells' middles, the longest as long as a cell is wide.
pub(crate) fn vectors(cell_errors_px: &[[f64; 2]], size_px: [u32; 2]) -> Markup {
    let [columns, rows] = COVERAGE_CELLS;
    let height = 240.0 * f64::from(size_px[1]) / f64::from(size_px[0].max(1));
    let (w, h) = (240.0 / columns as f64, height / rows as f64);
    let scale = w / longest(cell_errors_px).max(1e-9);
    html! {
        svg viewBox=(format!("0 0 240 {height:.0}")) role="img" aria-label="mean errors" {
            @for (k, [x, y]) in cell_errors_px.iter().enumerate().filter(|(_, e)| **e != [0.0; 2]) {
                @let (u, v) = (((k % columns) as f64 + 0.5) * w, ((k / columns) as f64 + 0.5) * h);
                path.vector d=(format!("M{u:.1} {v:.1}l{:.1} {:.1}", x * scale, y * scale)) {}
                circle cx=(format!("{u:.1}")) cy=(format!("{v:.1}")) r="1.2" {}
            }
        }
    }
}

/// Length of the longest mean error, pixels.
pub(crate) fn longest(cell_errors_px: &[[f64; 2]]) -> f64 {
    let lengths = cell_errors_px.iter().map(|e| e[0].hypot(e[1]));
    lengths.fold(0.0, f64::max)
}

/// Lengths of the errors of corners.
pub(crate) fn lengths(errors_px: &[[f64; 2]]) -> Markup {
    let mut bins = [0u32; ERROR_BINS];
    for [x, y] in errors_px {
        let bin = (x.hypot(*y) / LARGEST_SHOWN_PX * ERROR_BINS as f64) as usize;
        if let Some(count) = bins.get_mut(bin) {
            *count += 1;
        }
    }
    histogram(&bins, [0.0, LARGEST_SHOWN_PX], Expected::Unknown)
}

/// What the values of a histogram should be distributed like.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Expected {
    /// Nobody says.
    Unknown,
    /// Normally with a standard deviation of one; drawn as a curve.
    Normal,
}

/// Counts as bars over an axis that spans the bins.
pub(crate) fn histogram(bins: &[u32], span: [f64; 2], expected: Expected) -> Markup {
    let [low, high] = span;
    let total: f64 = bins.iter().copied().map(f64::from).sum();
    let bin = (high - low) / bins.len().max(1) as f64;
    let normal = |x: f64| total * bin * (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    let curve = |share: f64| normal(low + share * (high - low));
    let most = f64::from(bins.iter().copied().max().unwrap_or(1).max(1));
    let most = match expected {
        Expected::Unknown => most,
        Expected::Normal => most.max(normal(0.0)),
    };
    let width = 240.0 / bins.len().max(1) as f64;
    let line = (0..=CURVE_STEPS).map(|k| {
        let share = k as f64 / CURVE_STEPS as f64;
        let command = if k == 0 { 'M' } else { 'L' };
        let height = 155.0 * curve(share) / most;
        format!("{command}{:.1} {:.1}", share * 240.0, 160.0 - height)
    });
    html! {
        svg viewBox="0 0 240 178" role="img" aria-label="histogram" {
            @for (k, n) in bins.iter().enumerate() {
                @let height = 155.0 * f64::from(*n) / most;
                rect.seen x=(format!("{:.1}", k as f64 * width)) y=(format!("{:.1}", 160.0 - height))
                    width=(format!("{:.1}", width * 0.9)) height=(format!("{height:.1}")) {}
            }
            @if expected == Expected::Normal { path class="curve fit" d=(line.collect::<String>()) {} }
            path.axis d="M0 160H240M0.5 160v4M120 160v4M239.5 160v4" {}
            @for (u, anchor, value) in [(2, "start", low), (120, "middle", 0.5 * (low + high)), (238, "end", high)] {
                text x=(u) y="174" text-anchor=(anchor) font-size="10" { (value) }
            }
        }
    }
}

/// Curves over logarithmic axes; each has a class of the style sheet and its points.
pub(crate) fn log_log(curves: &[(&str, Vec<[f64; 2]>)]) -> Markup {
    let positive = || {
        let points = curves.iter().flat_map(|c| c.1.iter());
        points.filter(|p| p[0] > 0.0 && p[1] > 0.0 && p[0].is_finite() && p[1].is_finite())
    };
    let decades = |axis: usize| {
        let low = positive()
            .map(|p| p[axis].log10())
            .fold(f64::INFINITY, f64::min);
        let high = positive()
            .map(|p| p[axis].log10())
            .fold(f64::NEG_INFINITY, f64::max);
        // An empty plot has a decade too.
        if low > high {
            [0.0, 1.0]
        } else {
            [low.floor(), high.ceil().max(low.floor() + 1.0)]
        }
    };
    let (x, y) = (decades(0), decades(1));
    let (width, height) = (480.0, 300.0);
    let at = |p: &[f64; 2]| {
        let share = |v: f64, d: [f64; 2]| (v.log10() - d[0]) / (d[1] - d[0]);
        [share(p[0], x) * width, height - share(p[1], y) * height]
    };
    let path = |points: &[[f64; 2]]| {
        let good = points.iter().filter(|p| p[0] > 0.0 && p[1] > 0.0);
        let words: Vec<String> = good
            .enumerate()
            .map(|(k, p)| {
                let [u, v] = at(p);
                format!("{}{u:.1} {v:.1}", if k == 0 { 'M' } else { 'L' })
            })
            .collect();
        words.concat()
    };
    html! {
        svg.wide viewBox=(format!("-50 -10 {} {}", width + 60.0, height + 40.0)) role="img" aria-label="log-log plot" {
            @for decade in x[0] as i32..=x[1] as i32 {
                @let [u, _] = at(&[10f64.powi(decade), 10f64.powf(y[0])]);
                path.axis d=(format!("M{u:.1} 0V{height}")) {}
                text x=(format!("{u:.1}")) y=(format!("{}", height + 18.0)) text-anchor="middle" { "1e" (decade) }
            }
            @for decade in y[0] as i32..=y[1] as i32 {
                @let [_, v] = at(&[10f64.powf(x[0]), 10f64.powi(decade)]);
                path.axis d=(format!("M0 {v:.1}H{width}")) {}
                text x="-6" y=(format!("{:.1}", v + 4.0)) text-anchor="end" { "1e" (decade) }
            }
            @for (class, points) in curves {
                path class=(format!("curve {class}")) d=(path(points)) {}
            }
        }
    }
}
