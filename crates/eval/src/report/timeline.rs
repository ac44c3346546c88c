//! What went on over time: values, instants, and stretches that are coloured by what they mean.

use lsfb_report::{Axis, Ink, Layer, Plot, ink_css};
use maud::{Markup, html};

use super::longest_joined_secs;

/// Of the width of the plot, what a stretch of a single instant takes up: less cannot be seen.
const LEAST_SHARE: f64 = 0.004;
/// Half of the height of a stretch in its row.
const HALF_ROW: f64 = 0.35;
/// Colours of stretches; further meanings share the last.
const COLOURS: usize = 5;

/// A plot along time.
#[derive(Clone, Debug)]
pub struct Timeline {
    /// Heading.
    pub title: String,
    /// What is above one another.
    pub upward: Upward,
    /// First and last time on the axis, seconds since the start.
    pub secs: [f64; 2],
    /// Values or instants, in the colours of their order.
    pub marks: Vec<Marks>,
    /// Stretches of time.
    pub stretches: Vec<Stretch>,
}

/// What the upward axis shows.
#[derive(Clone, Debug, PartialEq)]
pub enum Upward {
    /// Values, none below zero.
    Values {
        /// What they are, without the unit.
        quantity: String,
        /// Their unit.
        unit: String,
    },
    /// Rows with names, the lowest first: row `k` is at the value `k`.
    Rows(Vec<String>),
}

/// Values or instants of one kind.
#[derive(Clone, Debug)]
pub struct Marks {
    /// As the legend calls them.
    pub name: String,
    /// Seconds since the start, and the value; in order of time.
    pub points: Vec<[f64; 2]>,
    /// Whether neighbours are joined by a line, where no stretch and no long time lies between.
    pub is_line: bool,
}

/// A stretch of time that means something.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// What; stretches of one name have one colour.
    pub name: String,
    /// First and last instant, seconds since the start.
    pub secs: [f64; 2],
    /// The row in which it is; without one it goes through all of the plot.
    pub row: Option<usize>,
}

/// The plot with its legend; nothing where there is nothing to show.
pub(super) fn section(timeline: &Timeline) -> Markup {
    let Some(plot) = plot(timeline) else {
        return html! {};
    };
    let rows = matches!(timeline.upward, Upward::Rows(_));
    html! {
        section {
            h2 { (timeline.title) }
            figure {
                (plot.draw())
                figcaption {
                    // Rows have their names beside them.
                    @if !rows {
                        @for (k, marks) in timeline.marks.iter().enumerate() {
                            span.key { span.line style=(format!("border-color:{}", ink_css(k))) { } (marks.name) }
                        }
                    }
                    @for (k, name) in names(timeline).iter().enumerate() {
                        span.key { span.line style=(format!("border-color:{}", css(k))) { } (name) }
                    }
                }
            }
        }
    }
}

/// `None` where nothing is marked.
fn plot(timeline: &Timeline) -> Option<Plot> {
    let marked = timeline.marks.iter().flat_map(|m| &m.points);
    let finite = marked.filter(|p| p[0].is_finite() && p[1].is_finite());
    let (count, most) = finite.fold((0, 0.0_f64), |(n, most), p| (n + 1, most.max(p[1])));
    if count == 0 && timeline.stretches.is_empty() {
        return None;
    }
    let y = match &timeline.upward {
        Upward::Values { quantity, unit } => Axis::linear(
            format!("{quantity} ({unit})"),
            [0.0, (1.08 * most).max(1e-6)],
        ),
        Upward::Rows(names) => Axis::named("", names),
    };
    let mut layers = stretches(timeline, y.range);
    for (k, marks) in timeline.marks.iter().enumerate() {
        let ink = Ink::Series(k);
        match marks.is_line {
            true => {
                let pieces = pieces(timeline, &marks.points);
                layers.extend(pieces.map(|piece| Layer::line(piece.to_vec(), ink)));
            }
            false => layers.push(Layer::dots(marks.points.clone(), ink)),
        }
    }
    Some(Plot {
        name: timeline.title.clone(),
        width_px: 560,
        height_px: 260,
        x: Axis::linear("time since start (s)", timeline.secs),
        y,
        layers,
    })
}

/// One layer for each meaning.
fn stretches(timeline: &Timeline, [bottom, top]: [f64; 2]) -> Vec<Layer> {
    let [start, end] = timeline.secs;
    let least_secs = LEAST_SHARE * (end - start);
    let mut layers = Vec::new();
    for (k, name) in names(timeline).iter().enumerate() {
        for stretch in timeline.stretches.iter().filter(|s| s.name == *name) {
            let [from, to] = stretch.secs;
            let missing = (0.5 * (least_secs - (to - from))).max(0.0);
            let (from, to) = (from - missing, to + missing);
            let [low, high] = match stretch.row {
                Some(row) => [row as f64 - HALF_ROW, row as f64 + HALF_ROW],
                None => [bottom, top],
            };
            layers.push(match stretch.row {
                Some(_) => Layer::Boxes {
                    boxes: vec![([from, low], [to, high], ink(k))],
                },
                None => Layer::Area {
                    outline: vec![[from, low], [to, low], [to, high], [from, high]],
                    ink: ink(k),
                },
            });
        }
    }
    layers
}

/// What the stretches mean, each once, in the order in which they are first met.
fn names(timeline: &Timeline) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for stretch in &timeline.stretches {
        if !names.contains(&stretch.name.as_str()) {
            names.push(&stretch.name);
        }
    }
    names
}

fn ink(meaning: usize) -> Ink {
    match COLOURS - 1 {
        last if meaning < last => Ink::Series(last - 1 - meaning),
        _ => Ink::Bad,
    }
}

fn css(meaning: usize) -> String {
    match ink(meaning) {
        Ink::Series(series) => ink_css(series),
        _ => "var(--fail)".to_owned(),
    }
}

/// Parts of a line: neighbours with a stretch, or a long time, between them are not joined.
fn pieces<'a>(
    timeline: &'a Timeline,
    points: &'a [[f64; 2]],
) -> impl Iterator<Item = &'a [[f64; 2]]> {
    let longest_secs = longest_joined_secs(timeline.secs[1] - timeline.secs[0]);
    points.chunk_by(move |a, b| {
        let between = |s: &Stretch| a[0] < s.secs[0] && s.secs[1] < b[0];
        b[0] - a[0] <= longest_secs && !timeline.stretches.iter().any(between)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeline(stretches: Vec<Stretch>) -> Timeline {
        Timeline {
            title: "deviation".to_owned(),
            upward: Upward::Values {
                quantity: "deviation".to_owned(),
                unit: "mm".to_owned(),
            },
            secs: [0.0, 10.0],
            marks: vec![Marks {
                name: "position".to_owned(),
                points: (0..100).map(|k| [0.1 * f64::from(k), 2.0]).collect(),
                is_line: true,
            }],
            stretches,
        }
    }

    fn uncertain(secs: [f64; 2]) -> Stretch {
        Stretch {
            name: "uncertain".to_owned(),
            secs,
            row: None,
        }
    }

    #[test]
    fn a_line_does_not_go_on_through_a_stretch_that_is_left_out() {
        let whole = timeline(Vec::new());
        assert_eq!(pieces(&whole, &whole.marks[0].points).count(), 1);
        let parted = timeline(vec![uncertain([3.04, 3.06])]);
        assert_eq!(pieces(&parted, &parted.marks[0].points).count(), 2);
    }

    #[test]
    fn a_single_instant_is_seen_and_named_once() {
        let plot = plot(&timeline(vec![uncertain([4.0; 2]), uncertain([6.0; 2])])).expect("marks");
        let Some(Layer::Area { outline, .. }) = plot.layers.first() else {
            panic!("{plot:?}");
        };
        assert!(outline[1][0] - outline[0][0] > 0.03, "{outline:?}");
        let drawn = section(&timeline(vec![uncertain([4.0; 2]), uncertain([6.0; 2])]));
        assert_eq!(drawn.into_string().matches("uncertain").count(), 1);
    }

    #[test]
    fn nothing_is_drawn_of_nothing() {
        let mut empty = timeline(Vec::new());
        empty.marks[0].points = vec![[f64::NAN, 1.0]];
        assert!(section(&empty).into_string().is_empty());
    }
}
