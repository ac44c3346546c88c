//! The page itself.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::figure::{Figure, Standing, Threshold};
use super::number::{significant, with_unit};
use super::{Report, sections};
use crate::compare::Comparison;
use crate::error::Error;
use crate::relation::DeltaUnit;

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
                    div.overview { (sections::from_above(report)?) (figures(&report.figures)) }
                    (comparison(&report.comparison))
                    div.pair {
                        (sections::errors(report)?)
                        (sections::distributions(report)?)
                        (sections::stages(report))
                    }
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
                        (figure.name) " " b { (with_unit(&significant(figure.value), &figure.unit)) }
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
        Threshold::AtMost(limit) => format!("at most {}", with_unit(&significant(limit), unit)),
        Threshold::AtLeast(limit) => format!("at least {}", with_unit(&significant(limit), unit)),
    }
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
