//! Axes and where their ticks stand.

use super::number::tick_label;

/// Ticks of an axis unless said otherwise.
const TICKS: usize = 6;
/// Ticks that fit on any axis.
const MOST_TICKS: usize = 40;

/// One axis of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// What it shows, with the unit in brackets.
    pub label: String,
    /// Values at its two ends; the second is the smaller one where it runs backwards.
    pub range: [f64; 2],
    pub(crate) ticks: Vec<Tick>,
    pub(crate) is_logarithmic: bool,
}

/// A line across the plot, with what is written at its end.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tick {
    pub at: f64,
    pub label: String,
}

impl Axis {
    /// Evenly spaced, with ticks at 1, 2 or 5 times a power of ten. An empty or impossible range becomes one around its start.
    pub fn linear(label: impl Into<String>, range: [f64; 2]) -> Self {
        let range = widened(range);
        Self::stepped(label, range, tick_step((range[1] - range[0]).abs(), TICKS))
    }

    /// Evenly spaced, with ticks at multiples of `step`.
    pub fn stepped(label: impl Into<String>, range: [f64; 2], step: f64) -> Self {
        let range = widened(range);
        let (low, high) = (range[0].min(range[1]), range[0].max(range[1]));
        let step = step.max(tick_step(high - low, MOST_TICKS));
        let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 9.0) as usize;
        let first = (low / step - 1e-9).ceil() as i64;
        let last = (high / step + 1e-9).floor() as i64;
        let at = (first..=last).map(|i| i as f64 * step);
        Self {
            label: label.into(),
            range,
            ticks: at
                .map(|at| Tick {
                    at,
                    label: tick_label(at, decimals),
                })
                .collect(),
            is_logarithmic: false,
        }
    }

    /// Whole decades that hold all positive ones of some values.
    pub fn decades(label: impl Into<String>, values: impl Iterator<Item = f64>) -> Self {
        let exponents = values.filter(|v| *v > 0.0 && v.is_finite());
        let exponents = exponents.map(f64::log10);
        let (low, high) = exponents.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), e| {
            (l.min(e), h.max(e))
        });
        // Without any value there is still a decade to draw.
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let (first, last) = (
            low.floor() as i32,
            high.ceil().max(low.floor() + 1.0) as i32,
        );
        Self {
            label: label.into(),
            range: [10f64.powi(first), 10f64.powi(last)],
            ticks: (first..=last)
                .map(|exponent| Tick {
                    at: 10f64.powi(exponent),
                    label: format!("1e{exponent}").replace('-', "−"),
                })
                .collect(),
            is_logarithmic: true,
        }
    }

    /// One place per name, at 0, 1, 2 and so on.
    pub fn named(label: impl Into<String>, names: &[String]) -> Self {
        let ticks = names.iter().enumerate();
        Self {
            label: label.into(),
            range: [-0.6, names.len().max(1) as f64 - 0.4],
            ticks: ticks
                .map(|(k, name)| Tick {
                    at: k as f64,
                    label: name.clone(),
                })
                .collect(),
            is_logarithmic: false,
        }
    }

    /// How far along the axis a value lies: 0 at its start, 1 at its end.
    pub(crate) fn share(&self, value: f64) -> f64 {
        let [start, end] = self.range;
        if self.is_logarithmic {
            return (value / start).log10() / (end / start).log10();
        }
        (value - start) / (end - start)
    }
}

/// Two different finite ends.
fn widened([start, end]: [f64; 2]) -> [f64; 2] {
    if !start.is_finite() || !end.is_finite() {
        return [0.0, 1.0];
    }
    // What rounding leaves of a range is none.
    let least = 1e-9 * start.abs().max(end.abs()).max(1e-3);
    if (end - start).abs() > least {
        return [start, end];
    }
    [start - 0.5, start + 0.5]
}

/// The distance of at most `count + 1` round ticks over `span`.
pub fn tick_step(span: f64, count: usize) -> f64 {
    let rough = span.max(1e-12) / count.max(1) as f64;
    let power = 10f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|f| f * power >= rough * (1.0 - 1e-9))
        .unwrap_or(10.0);
    factor * power
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: &Axis) -> Vec<&str> {
        axis.ticks.iter().map(|t| t.label.as_str()).collect()
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let axis = Axis::linear("x", [0.0, 2.0]);
        assert_eq!(labels(&axis), ["0.0", "0.5", "1.0", "1.5", "2.0"]);
        let down = Axis::linear("y", [480.0, 0.0]);
        assert_eq!(labels(&down), ["0", "100", "200", "300", "400"]);
        assert_eq!([down.share(480.0), down.share(0.0)], [0.0, 1.0]);
        let around = Axis::linear("y", [-1.0, 1.0]);
        assert_eq!(labels(&around), ["−1.0", "−0.5", "0.0", "0.5", "1.0"]);
    }

    #[test]
    fn decades_hold_their_values() {
        let axis = Axis::decades("t", [0.02, 300.0, -1.0, f64::NAN].into_iter());
        assert_eq!(axis.range, [0.01, 1000.0]);
        assert!((axis.share(0.1) - 0.2).abs() < 1e-12);
        assert_eq!(labels(&axis)[0], "1e−2");
    }

    #[test]
    fn impossible_ranges_are_replaced() {
        for range in [
            [0.0, 0.0],
            [f64::NAN, 1.0],
            [3.0, 3.0],
            [0.0, f64::INFINITY],
        ] {
            let axis = Axis::linear("x", range);
            assert!(axis.range[1] > axis.range[0], "{range:?}");
            assert!(!axis.ticks.is_empty() && axis.ticks.len() < 20, "{range:?}");
        }
        let none = Axis::decades("x", std::iter::empty());
        assert_eq!(none.range, [1.0, 10.0]);
    }
}
