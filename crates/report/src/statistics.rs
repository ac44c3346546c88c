//! Plots of how values are distributed.

use super::axis::Axis;
use super::plot::{Ink, Layer, Plot, plot_height_px, plot_width_px};

/// Room above the highest bar, as a factor.
const HEADROOM: f64 = 1.08;
/// Points of a curve that is drawn over bars.
const CURVE_STEPS: u32 = 80;
/// Dots beyond this cannot be told apart and make the page heavy.
const MOST_DOTS: usize = 4000;
/// Width of a small plot, of which three stand side by side, pixels.
const SMALL_PX: u32 = 340;

/// What the values of a histogram should be distributed like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Normal {
    /// Nobody says.
    Unknown,
    /// Normally with a standard deviation of one; drawn as a dashed curve.
    Unit,
}

/// Heights of evenly wide bins over `span`, one list per series in the order of its colours.
pub fn histogram(
    name: &str,
    (x_label, y_label): (&str, &str),
    span: [f64; 2],
    series: &[Vec<f64>],
    expected: Normal,
) -> Plot {
    let [low, high] = span;
    let mut layers = Vec::new();
    let mut highest = series.iter().flatten().copied().fold(0.0, f64::max);
    for (index, heights) in series.iter().enumerate() {
        let width = (high - low) / heights.len().max(1) as f64;
        let steps = heights.iter().enumerate().flat_map(|(i, height)| {
            let left = low + i as f64 * width;
            [[left, *height], [left + width, *height]]
        });
        let top: Vec<[f64; 2]> = steps.collect();
        // One shape: bars side by side would show seams.
        let mut outline = vec![[low, 0.0]];
        outline.extend(&top);
        outline.push([high, 0.0]);
        let ink = Ink::Series(index);
        layers.push(Layer::Area { outline, ink });
        layers.push(Layer::line(top, ink));
        if expected == Normal::Unit {
            let area = heights.iter().sum::<f64>() * width;
            let normal = |x: f64| area * (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
            highest = highest.max(normal(low.max(0.0).min(high)));
            let steps = (0..=CURVE_STEPS).map(|k| f64::from(k) / f64::from(CURVE_STEPS));
            let curve = steps.map(|share| low + share * (high - low));
            layers.push(Layer::line(
                curve.map(|x| [x, normal(x)]).collect(),
                Ink::Truth,
            ));
        }
    }
    Plot {
        name: name.to_owned(),
        width_px: SMALL_PX,
        height_px: 220,
        x: Axis::linear(x_label, span),
        y: Axis::linear(y_label, [0.0, (HEADROOM * highest).max(1e-6)]),
        layers,
    }
}

/// One bar per name. Where there are too many names to read, the bars are numbered.
pub fn bars(name: &str, y_label: &str, bars: &[(String, f64)]) -> Plot {
    const MOST_NAMED: usize = 6;
    let finite = bars.iter().map(|b| b.1).filter(|v| v.is_finite());
    let highest = finite.fold(0.0, f64::max);
    let boxes = bars.iter().enumerate().filter(|(_, b)| b.1.is_finite());
    let boxes = boxes.map(|(k, (_, value))| {
        let middle = k as f64;
        ([middle - 0.4, 0.0], [middle + 0.4, *value], Ink::Series(0))
    });
    let x = if bars.len() <= MOST_NAMED {
        let names: Vec<String> = bars.iter().map(|b| b.0.clone()).collect();
        Axis::named("", &names)
    } else {
        Axis::linear("number", [-0.6, bars.len() as f64 - 0.4])
    };
    Plot {
        name: name.to_owned(),
        width_px: SMALL_PX,
        height_px: 220,
        x,
        y: Axis::linear(y_label, [0.0, (HEADROOM * highest).max(1e-6)]),
        layers: vec![Layer::Boxes {
            boxes: boxes.collect(),
        }],
    }
}

/// Pairs of errors around zero, as far as they are shorter than `reach`; both axes have the same scale.
pub fn scatter(name: &str, unit: &str, reach: f64, errors: &[[f64; 2]]) -> Plot {
    let step = errors.len().div_ceil(MOST_DOTS).max(1);
    let near = errors.iter().step_by(step);
    let near = near.filter(|e| e[0].abs() < reach && e[1].abs() < reach);
    Plot {
        name: name.to_owned(),
        width_px: SMALL_PX,
        height_px: plot_height_px(plot_width_px(SMALL_PX)),
        x: Axis::linear(format!("x ({unit})"), [-reach, reach]),
        y: Axis::linear(format!("y ({unit})"), [reach, -reach]),
        layers: vec![
            Layer::line(vec![[-reach, 0.0], [reach, 0.0]], Ink::Muted),
            Layer::line(vec![[0.0, -reach], [0.0, reach]], Ink::Muted),
            Layer::dots(near.copied().collect(), Ink::Series(0)),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_histogram_of_normal_values_lies_under_its_curve() {
        let span = [-5.0, 5.0];
        let bins: Vec<f64> = (0..40)
            .map(|k| {
                let x: f64 = -5.0 + 0.25 * (f64::from(k) + 0.5);
                1000.0 * (-0.5 * x * x).exp()
            })
            .collect();
        let plot = histogram("errors", ("σ", "corners"), span, &[bins], Normal::Unit);
        let Some(Layer::Line { points, ink, .. }) = plot.layers.last() else {
            panic!("{plot:?}");
        };
        assert_eq!(*ink, Ink::Truth);
        assert!((points[40][1] - 1000.0).abs() < 1.0, "{:?}", points[40]);
        assert!(plot.y.range[1] > 1000.0);
    }

    #[test]
    fn bars_of_nothing_and_of_no_number_are_drawn() {
        for values in [vec![], vec![("a".to_owned(), f64::NAN)]] {
            let svg = bars("bars", "m", &values).draw().into_string();
            assert!(svg.contains("<svg") && !svg.contains("NaN"), "{svg}");
        }
    }
}
