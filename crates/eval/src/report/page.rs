//! The page itself.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::errors_over_time::{self, Part};
use super::figure::{Figure, Standing, Threshold};
use super::histogram::{self, Histogram, Series};
use super::number::significant;
use super::{Report, theme, top_view};
use crate::compare::Comparison;
use crate::error::Error;
use crate::pairs::DeltaUnit;
use crate::statistics::Statistics;

const STYLE: &str = include_str!("style.css");

pub(super) fn render(report: &Report) -> Result<String, Error> {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (report.title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header { h1 { (report.title) } (verdict(&report.figures)) (warnings(&report.warnings)) }
                main {
                    div.overview { (from_above(report)?) (figures(&report.figures)) }
                    (comparison(&report.comparison))
                    (errors(report)?)
                    (distributions(report)?)
                    (stages(report))
                    (provenance(report))
                }
            }
        }
    };
    Ok(page.into_string())
}

fn verdict(figures: &[Figure]) -> Markup {
    let bound = figures.iter().filter(|f| f.threshold.is_some()).count();
    let missed: Vec<&Figure> = figures
        .iter()
        .filter(|f| f.standing() == Standing::Warn)
        .collect();
    html! {
        @if bound == 0 {
        } @else if missed.is_empty() {
            p.verdict.pass {
                span.mark { "✓" }
                span { @if bound == 1 { "The one threshold is met." } @else { "All " (bound) " thresholds are met." } }
            }
        } @else {
            p.verdict.warn {
                span.mark { "!" }
                span {
                    (missed.len()) " of " (bound) @if bound == 1 { " threshold is missed: " } @else { " thresholds missed: " }
                    @for (i, figure) in missed.iter().enumerate() {
                        @if i > 0 { "; " }
                        (figure.name) " " b { (with_unit(figure.value, &figure.unit)) }
                        @if let Some(threshold) = figure.threshold { " (" (bound_in_words(threshold, &figure.unit)) ")" }
                    }
                    "."
                }
            }
        }
    }
}

fn warnings(warnings: &[String]) -> Markup {
    html! {
        @if !warnings.is_empty() {
            ul.warnings { @for warning in warnings { li { (warning) } } }
        }
    }
}

fn figures(figures: &[Figure]) -> Markup {
    let bound = figures.iter().any(|f| f.threshold.is_some());
    html! {
        @if !figures.is_empty() {
            section.figures {
                h2 { "Figures" }
                table {
                    thead { tr {
                        th { "figure" } th.number { "value" } th { }
                        @if bound { th { "threshold" } th { } }
                    } }
                    tbody {
                        @for figure in figures {
                            tr {
                                th scope="row" { (figure.name) }
                                td.number { (significant(figure.value)) }
                                td.unit { (figure.unit) }
                                @if bound {
                                    td.bound { @if let Some(t) = figure.threshold { (sign(t)) } }
                                    td { (standing(figure)) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn standing(figure: &Figure) -> Markup {
    html! {
        @match figure.standing() {
            Standing::Pass => span.badge.pass { "pass" },
            Standing::Warn => span.badge.warn { "warn" },
            Standing::Informs => {},
        }
    }
}

fn sign(threshold: Threshold) -> String {
    match threshold {
        Threshold::AtMost(limit) => format!("≤ {}", significant(limit)),
        Threshold::AtLeast(limit) => format!("≥ {}", significant(limit)),
    }
}

fn bound_in_words(threshold: Threshold, unit: &str) -> String {
    match threshold {
        Threshold::AtMost(limit) => format!("at most {}", with_unit(limit, unit)),
        Threshold::AtLeast(limit) => format!("at least {}", with_unit(limit, unit)),
    }
}

fn with_unit(value: f64, unit: &str) -> String {
    let gap = if unit.is_empty() || unit == "°" {
        ""
    } else {
        "\u{a0}"
    };
    format!("{}{gap}{unit}", significant(value))
}

fn from_above(report: &Report) -> Result<Markup, Error> {
    let Some(view) = top_view::draw(report)? else {
        return Ok(html! {});
    };
    Ok(html! {
        section.above {
            h2 { "From above" }
            figure {
                (PreEscaped(view.svg))
                figcaption {
                    (legend(report))
                    @if report.tracks.iter().any(|t| t.truth.is_some()) {
                        span.key { span.line.truth { } "truth" }
                    }
                    @if let Some([low, high]) = view.heights_m {
                        span.key {
                            "map, height " (format!("{low:.1}").replace('-', "−")) "\u{a0}m "
                            span.ramp { @for i in 0..theme::SHADES { span style=(format!("background:var(--shade{i})")) { } } }
                            " " (format!("{high:.1}").replace('-', "−")) "\u{a0}m"
                        }
                    }
                    span.key { "a dot marks the start" }
                }
            }
        }
    })
}

fn legend(report: &Report) -> Markup {
    html! {
        @for (i, track) in report.tracks.iter().enumerate() {
            span.key { span.line style=(format!("border-color:{}", theme::track_variable(i))) { } (track.name) }
        }
    }
}

fn errors(report: &Report) -> Result<Markup, Error> {
    let tracks = &report.tracks;
    let translation = errors_over_time::draw(tracks, Part::Translation)?;
    let rotation = errors_over_time::draw(tracks, Part::Rotation)?;
    let centimetres: Vec<Vec<f64>> = tracks
        .iter()
        .map(|t| t.errors.iter().map(|e| 100.0 * e.translation_m).collect())
        .collect();
    let series: Vec<Series<'_>> = centimetres
        .iter()
        .enumerate()
        .map(|(color, values)| Series { color, values })
        .collect();
    let spread = histogram::draw(
        "how translation errors spread",
        "translation error (cm)".to_owned(),
        &series,
    )?;
    let plot = |heading: &str, svg: &str| {
        html! {
            section {
                h2 { (heading) }
                figure { (PreEscaped(svg)) figcaption { (legend(report)) } }
            }
        }
    };
    Ok(html! {
        @if let (Some(translation), Some(rotation)) = (translation, rotation) {
            div.pair {
                (plot("Translation error over time", &translation))
                (plot("Rotation error over time", &rotation))
                @if let Some(spread) = spread {
                    section {
                        h2 { "How translation errors spread" }
                        figure {
                            (PreEscaped(&spread.svg))
                            figcaption {
                                @for (i, track) in tracks.iter().enumerate() {
                                    span.key {
                                        span.line style=(format!("border-color:{}", theme::track_variable(i))) { }
                                        (track.name)
                                        @if let Some(s) = spread.statistics.get(i).copied().flatten() { ": " (in_words(&s, "cm")) }
                                    }
                                }
                                (beyond(&spread))
                            }
                        }
                    }
                }
            }
        }
    })
}

fn in_words(s: &Statistics, unit: &str) -> String {
    format!(
        "rms {}, median {}, max {}",
        with_unit(s.rmse, unit),
        with_unit(s.median, unit),
        with_unit(s.max, unit)
    )
}

fn beyond(histogram: &Histogram) -> Markup {
    html! {
        @if histogram.beyond > 0.0 {
            span.key { (significant(100.0 * histogram.beyond)) "\u{a0}% lie beyond the right edge" }
        }
    }
}

fn distributions(report: &Report) -> Result<Markup, Error> {
    let mut drawn = Vec::new();
    for (i, distribution) in report.histograms.iter().enumerate() {
        let label = if distribution.unit.is_empty() {
            distribution.quantity.clone()
        } else {
            format!("{} ({})", distribution.quantity, distribution.unit)
        };
        let series = [Series {
            color: i,
            values: &distribution.values,
        }];
        if let Some(histogram) = histogram::draw("how values spread", label, &series)? {
            drawn.push((distribution, histogram));
        }
    }
    Ok(html! {
        @if !drawn.is_empty() {
            div.pair {
                @for (distribution, histogram) in &drawn {
                    section {
                        h2 { (distribution.title) }
                        figure {
                            (PreEscaped(&histogram.svg))
                            figcaption {
                                @if let Some(s) = histogram.statistics.first().copied().flatten() {
                                    span.key { (in_words(&s, &distribution.unit)) " over " (significant(s.count as f64)) " values" }
                                }
                                (beyond(histogram))
                            }
                        }
                    }
                }
            }
        }
    })
}

fn comparison(rows: &[Comparison]) -> Markup {
    let optional = |value: Option<f64>| value.map_or("–".to_owned(), significant);
    let delta = rows
        .iter()
        .find_map(|row| match (row.rpe_delta, row.rpe_delta_unit) {
            (Some(delta), Some(DeltaUnit::Degrees)) => Some(format!(" per {delta}°")),
            (Some(delta), Some(unit)) => Some(format!(" per {delta} {unit}")),
            _ => None,
        });
    let delta = delta.unwrap_or_default();
    html! {
        @if !rows.is_empty() {
            section.comparison {
                h2 { "Comparison" }
                div.scroll { table {
                    thead { tr {
                        th { "estimate" }
                        th.number { "ATE rmse (m)" } th.number { "ATE max (m)" } th.number { "ATE rmse (°)" }
                        th.number { "RPE rmse" (delta) " (m)" } th.number { "RPE rmse" (delta) " (°)" }
                        th.number { "scale error (%)" } th.number { "covered (%)" } th.number { "poses" }
                    } }
                    tbody { @for row in rows { tr {
                        th scope="row" { (row.name) }
                        td.number { (significant(row.ate_rmse_m)) }
                        td.number { (significant(row.ate_max_m)) }
                        td.number { (significant(row.ate_rotation_rmse_deg)) }
                        td.number { (optional(row.rpe_translation_rmse_m)) }
                        td.number { (optional(row.rpe_rotation_rmse_deg)) }
                        td.number { (optional(row.scale_error_percent)) }
                        td.number { (significant(100.0 * row.coverage)) }
                        td.number { (significant(row.matched_poses as f64)) }
                    } } }
                } }
            }
        }
    }
}

fn stages(report: &Report) -> Markup {
    let longest = report
        .stages
        .iter()
        .map(|s| s.wall_secs)
        .fold(0.0, f64::max)
        .max(1e-9);
    let total: f64 = report.stages.iter().map(|s| s.wall_secs).sum();
    html! {
        @if !report.stages.is_empty() {
            section.stages {
                h2 { "Time per stage" }
                table {
                    tbody {
                        @for stage in &report.stages {
                            tr {
                                th scope="row" { (stage.name) }
                                td.bar { span style=(format!("width:{:.1}%", (100.0 * stage.wall_secs / longest).clamp(0.0, 100.0))) { } }
                                td.number { (format!("{:.1}", stage.wall_secs)) "\u{a0}s" }
                            }
                        }
                    }
                    tfoot { tr { th scope="row" { "in all" } td { } td.number { (format!("{total:.1}")) "\u{a0}s" } } }
                }
            }
        }
    }
}

fn provenance(report: &Report) -> Markup {
    html! {
        @if !report.provenance.is_empty() {
            section.provenance {
                h2 { "Where this comes from" }
                dl {
                    @for entry in &report.provenance {
                        dt { (entry.name) }
                        dd { pre { (entry.value) } }
                    }
                }
            }
        }
    }
}
