//! How a value went from step to step.

use lsfb_report::{Axis, Ink, Layer, Plot};
use maud::Markup;

use super::Course;

/// `None` where there are fewer than two finite values.
pub(super) fn draw(course: &Course) -> Option<Markup> {
    let points: Vec<[f64; 2]> = (1..)
        .zip(&course.values)
        .filter(|(_, value)| value.is_finite())
        .map(|(step, value)| [f64::from(step), *value])
        .collect();
    let last = points.last().filter(|_| points.len() > 1)?[0];
    let largest = points.iter().fold(0.0, |most, p| f64::max(most, p[1]));
    let label = match course.unit.as_str() {
        "" => course.title.clone(),
        unit => format!("{} ({unit})", course.title),
    };
    let plot = Plot {
        name: course.title.clone(),
        width_px: 560,
        height_px: 200,
        x: Axis::linear(course.quantity.clone(), [1.0, last]),
        y: Axis::linear(label, [0.0, f64::max(1.05 * largest, 1e-9)]),
        layers: vec![Layer::line(points, Ink::Series(0))],
    };
    Some(plot.draw())
}
