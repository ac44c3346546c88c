//! A survey on one page: its marks, and the trajectory through them, as the paper's Fig. 6 shows them.

use lsfb_geometry::Vector3;
use lsfb_report::{Ink, Layer, Page, Plot, ink_css, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::check::MarkReport;
use super::distances::DistanceReport;
use super::solution::{Mark, SurveySolution};
use crate::report::equal_scale;

/// Points of a line beyond which nothing more is seen.
const MOST_POINTS: usize = 4_000;
/// A cross is this share of the drawing wide.
const CROSS: f64 = 0.012;
/// Of the ellipse that holds 95 of 100, standard deviations: the root of the quantile of χ² with two degrees of freedom.
const REGION_SIGMAS: f64 = 2.4477;

/// What is drawn; parts that are absent are left out.
#[derive(Clone, Copy, Debug, Default)]
pub struct SurveyView<'a> {
    /// The marks.
    pub solution: Option<&'a SurveySolution>,
    /// A trajectory at them.
    pub at_marks: Option<&'a MarkReport>,
    /// Distances of a map.
    pub distances: Option<&'a DistanceReport>,
}

impl SurveyView<'_> {
    /// The page.
    pub fn page(&self, name: &str, judgement: &Judgement) -> Page {
        let body = html! {
            @if let Some(solution) = self.solution { (self.plan(solution)) }
            div.pair {
                @if let Some(report) = self.at_marks { (errors_at_marks(report)) }
                @if let Some(report) = self.distances { (errors_of_distances(report)) }
            }
            @if let Some(solution) = self.solution { (measurements(solution)) }
        };
        Page::new(format!("Survey {name}"))
            .judged(judgement, name)
            .body(body)
    }

    /// Marks as crosses, with the region that each is in, enlarged until it is seen, and the trajectory from above.
    fn plan(&self, solution: &SurveySolution) -> Markup {
        let paths: Vec<Vec<[f64; 2]>> = self.at_marks.map_or_else(Vec::new, |report| {
            let all = report.pieces.iter().map(Vec::len).sum::<usize>();
            let step = all.div_ceil(MOST_POINTS).max(1);
            let line = |piece: &Vec<Vector3<f64>>| {
                let points = piece.iter().step_by(step).chain(piece.last());
                points.map(|p| [p.x, p.y]).collect()
            };
            report.pieces.iter().map(line).collect()
        });
        let places = solution.marks.iter().map(|m| [m.x_m, m.y_m]);
        let seen: Vec<[f64; 2]> = places.chain(paths.iter().flatten().copied()).collect();
        let range = |axis: usize| {
            let values = seen.iter().map(|p| p[axis]).filter(|v| v.is_finite());
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
            let edge = 0.05 * (high - low) + 0.2;
            [low - edge, high + edge]
        };
        let mut plot = equal_scale(
            "marks and trajectory",
            ["x (m)".to_owned(), "y (m)".to_owned()],
            [range(0), range(1)],
        );
        let width_m = plot.x.range[1] - plot.x.range[0];
        let times = enlargement(&solution.marks, width_m);
        plot.layers = regions(&solution.marks, times);
        let path = |points| Layer::line(points, Ink::Series(0));
        plot.layers.extend(paths.into_iter().map(path));
        plot.layers
            .extend(crosses(&solution.marks, CROSS * width_m));
        html! {
            section {
                h2 { "Marks from above" }
                figure {
                    (plot.draw())
                    figcaption {
                        span.key { span.line style=(format!("border-color: {}", ink_css(1))) {} "marks" }
                        @if self.at_marks.is_some() {
                            span.key { span.line style=(format!("border-color: {}", ink_css(0))) {} "trajectory, aligned to the marks" }
                        }
                        @if let Some(times) = times {
                            span { "areas: 95 % confidence of a mark, magnified " (times) " times" }
                        }
                    }
                }
            }
        }
    }
}

/// By which round number regions are enlarged, so that the largest is seen and does not hide the plan; `None` where there is none.
fn enlargement(marks: &[Mark], width_m: f64) -> Option<f64> {
    let sizes = marks.iter().map(|m| m.sigma_x_m.max(m.sigma_y_m));
    let largest = sizes.filter(|s| s.is_finite()).fold(0.0, f64::max);
    let times = 0.04 * width_m / (REGION_SIGMAS * largest);
    let power = 10f64.powf(times.log10().floor());
    let round = [5.0, 2.0, 1.0].map(|f| f * power);
    let fitting = round.into_iter().find(|r| *r <= times);
    (largest > 0.0).then(|| fitting.unwrap_or(power).max(1.0))
}

fn regions(marks: &[Mark], times: Option<f64>) -> Vec<Layer> {
    let Some(times) = times else {
        return Vec::new();
    };
    let outline = |mark: &Mark| {
        let around = (0..48).map(|i| f64::from(i) * std::f64::consts::TAU / 48.0);
        let reach = [mark.sigma_x_m, mark.sigma_y_m].map(|s| times * REGION_SIGMAS * s);
        let outline =
            around.map(|a| [mark.x_m + reach[0] * a.cos(), mark.y_m + reach[1] * a.sin()]);
        Layer::Area {
            outline: outline.collect(),
            ink: Ink::Series(1),
        }
    };
    marks.iter().map(outline).collect()
}

fn crosses(marks: &[Mark], size_m: f64) -> Vec<Layer> {
    let mut layers = Vec::new();
    for mark in marks {
        for [dx, dy] in [[1.0, 1.0], [1.0, -1.0]].map(|d: [f64; 2]| d.map(|v| v * size_m)) {
            let ends = [
                [mark.x_m - dx, mark.y_m - dy],
                [mark.x_m + dx, mark.y_m + dy],
            ];
            layers.push(Layer::line(ends.to_vec(), Ink::Series(1)));
        }
    }
    let names = marks.iter().map(|m| ([m.x_m, m.y_m], m.name.clone()));
    layers.push(Layer::Names {
        names: names.collect(),
    });
    layers
}

/// Where the device was, seen from each mark.
fn errors_at_marks(report: &MarkReport) -> Markup {
    let errors: Vec<([f64; 2], String)> = report
        .marks
        .iter()
        .map(|m| ([100.0 * m.error_m[0], 100.0 * m.error_m[1]], m.mark.clone()))
        .collect();
    let farthest = errors.iter().flat_map(|(at, _)| at.map(f64::abs));
    let reach = 1.15 * farthest.fold(0.1, f64::max);
    let ring_cm = 100.0 * report.ate_m.rmse;
    let circle = (0..=72).map(|i| f64::from(i) * std::f64::consts::TAU / 72.0);
    let plot = Plot {
        layers: vec![
            Layer::line(
                circle
                    .map(|a| [ring_cm * a.cos(), ring_cm * a.sin()])
                    .collect(),
                Ink::Muted,
            ),
            Layer::Dots {
                points: errors.iter().map(|(at, _)| *at).collect(),
                ink: Ink::Series(0),
                radius_px: 3.5,
            },
            Layer::Names { names: errors },
        ],
        ..equal_scale(
            "errors at the marks",
            ["along x (cm)".to_owned(), "along y (cm)".to_owned()],
            [[-reach, reach]; 2],
        )
    };
    let table = html! {
        table.numbers {
            thead { tr { th { "mark" } th { "at (s)" } th { "for (s)" } th { "x (cm)" } th { "y (cm)" } th { "z (cm)" } th { "error (cm)" } } }
            tbody {
                @for mark in &report.marks {
                    tr {
                        td { (mark.mark) }
                        td { (format!("{:.1}", mark.start_secs)) }
                        td { (format!("{:.1}", mark.duration_secs)) }
                        @for v in mark.error_m { td { (format!("{:.2}", 100.0 * v)) } }
                        td { (format!("{:.2}", 100.0 * mark.distance_m)) }
                    }
                }
            }
        }
    };
    html! {
        section {
            h2 { "Errors at the marks" }
            figure {
                (plot.draw())
                figcaption { span { "the ring is the rms error, " (format!("{ring_cm:.2} cm")) } }
            }
            (scroll(&table))
            p.note {
                (format!("{} marks, {} other rests", report.marks.len(), report.other_rests))
                @if !report.missing.is_empty() { ", no rest at " (report.missing.join(", ")) }
                "."
            }
        }
    }
}

fn errors_of_distances(report: &DistanceReport) -> Markup {
    let table = html! {
        table.numbers {
            thead { tr { th { "distance" } th { "measured (m)" } th { "map (m)" } th { "error (cm)" } } }
            tbody {
                @for d in &report.distances {
                    tr {
                        td { (d.ends.join("–")) }
                        td { (format!("{:.4}", d.measured_m)) }
                        td { (format!("{:.4}", d.map_m)) }
                        td { (format!("{:.2}", 100.0 * d.error_m)) }
                    }
                }
            }
        }
    };
    html! {
        section {
            h2 { "Distances of the map" }
            (scroll(&table))
            p.note {
                (format!("Off by {:.2} cm on average, at most {:.2} cm.", 100.0 * report.error_m.mean, 100.0 * report.error_m.max))
            }
        }
    }
}

fn measurements(solution: &SurveySolution) -> Markup {
    let or_dash = |value: Option<f64>, digits: usize| {
        value.map_or("–".to_owned(), |v| format!("{v:.digits$}"))
    };
    let table = html! {
        table.numbers {
            thead { tr { th { "measurement" } th { "measured (m)" } th { "residual (mm)" } th { "redundancy" } th { "w" } th { "detectable (mm)" } th { } } }
            tbody {
                @for o in &solution.observations {
                    tr {
                        td { (o.what) }
                        td { (or_dash(o.measured_m, 4)) }
                        td { (format!("{:.2}", 1000.0 * o.residual_m)) }
                        td { (format!("{:.2}", o.redundancy)) }
                        td { (or_dash(o.w, 2)) }
                        td { (or_dash(o.smallest_blunder_m.map(|m| 1000.0 * m), 1)) }
                        td.words { @if o.left_out { "left out" } }
                    }
                }
            }
        }
    };
    html! {
        section {
            h2 { "Measurements" }
            (scroll(&table))
            p.note {
                "Redundancy is the share of an error that shows in its residual, w is the residual over its standard deviation; a blunder of the size "
                "in the last column would be detected with 80 % probability."
            }
        }
    }
}
