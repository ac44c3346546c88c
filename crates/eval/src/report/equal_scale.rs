//! Plots whose axes have one scale: a metre along is as long as a metre up.

use lsfb_report::{Axis, Plot, plot_height_px, plot_width_px, tick_step};

const WIDTH: u32 = 680;
/// Of the plot itself, pixels.
const MIN_HEIGHT: u32 = 200;
const MAX_HEIGHT: u32 = 620;

/// An empty plot that shows at least both ranges, with the labels of its axes.
pub(crate) fn equal_scale(name: &str, labels: [String; 2], ranges: [[f64; 2]; 2]) -> Plot {
    let [mut x, mut y] = ranges;
    let plot_w = f64::from(plot_width_px(WIDTH));
    let wanted = plot_w * (y[1] - y[0]) / (x[1] - x[0]);
    let plot_h = wanted.round().clamp(MIN_HEIGHT.into(), MAX_HEIGHT.into());
    let units_per_pixel = ((x[1] - x[0]) / plot_w).max((y[1] - y[0]) / plot_h);
    for (range, pixels) in [(&mut x, plot_w), (&mut y, plot_h)] {
        let missing = units_per_pixel * pixels - (range[1] - range[0]);
        *range = [range[0] - 0.5 * missing, range[1] + 0.5 * missing];
    }
    // One distance of lines for both axes.
    let step = tick_step(x[1] - x[0], 8).max(tick_step(y[1] - y[0], 8));
    let [along, up] = labels;
    Plot {
        name: name.to_owned(),
        width_px: WIDTH,
        height_px: plot_height_px(plot_h as u32),
        x: Axis::stepped(along, x, step),
        y: Axis::stepped(up, y, step),
        layers: Vec::new(),
    }
}
