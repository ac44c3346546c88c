//! What stands on the page, in order.

use lsfb_report::{Page, badge, scroll, significant};
use lsfb_types::Limit;
use maud::{Markup, html};

use super::figure::Figure;
use super::{Report, scene, sections, table, timeline};
use crate::compare::Comparison;
use crate::relation::DeltaUnit;

pub(super) fn render(report: &Report) -> String {
    let body = html! {
        @if !report.introduction.is_empty() { p { (report.introduction) } }
        div.overview { (sections::from_above(report)) (figures(&report.figures)) }
        (scene::in_space(report))
        (comparison(&report.comparison))
        div.pair {
            (sections::errors(report))
            @for timeline in &report.timelines { (timeline::section(timeline)) }
            (sections::distributions(report))
            (sections::courses(report))
            (sections::stages(report))
        }
        @for table in &report.tables { (table::section(table)) }
        @for (title, text) in &report.texts {
            section { h2 { (title) } (scroll(&html! { pre { (text) } })) }
        }
    };
    let page = Page::new(report.title.clone())
        .body(body)
        .settings(report.provenance.clone());
    let judgement = report.judgement();
    // Without a limit nothing was judged.
    if judgement.findings().is_empty() {
        return page.to_html();
    }
    page.judged(&judgement, "").to_html()
}

fn figures(figures: &[Figure]) -> Markup {
    let bound = figures.iter().any(|f| f.limit.is_some());
    let table = html! {
        table {
            thead { tr {
                th { "figure" } th.number { "value" } th { }
                @if bound { th { "limit" } th { } }
            } }
            tbody {
                @for figure in figures {
                    tr {
                        th scope="row" { (figure.name) }
                        td.number { (significant(figure.value)) }
                        td.unit { (figure.unit) }
                        @if bound {
                            td.bound { @if let Some(limit) = figure.limit { (sign(limit)) } }
                            td { @if let Some(f) = figure.finding() { (badge(f.verdict)) } }
                        }
                    }
                }
            }
        }
    };
    html! {
        @if !figures.is_empty() { section.figures { h2 { "Figures" } (scroll(&table)) } }
    }
}

fn sign(limit: Limit) -> String {
    match limit {
        Limit::AtMost(limit) => format!("≤ {}", significant(limit)),
        Limit::AtLeast(limit) => format!("≥ {}", significant(limit)),
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
                (scroll(&html! { table {
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
                        td.number { (optional(row.ate_rotation_rmse_deg)) }
                        td.number { (optional(row.rpe_translation_rmse_m)) }
                        td.number { (optional(row.rpe_rotation_rmse_deg)) }
                        td.number { (optional(row.scale_error_percent)) }
                        td.number { (significant(100.0 * row.coverage)) }
                        td.number { (significant(row.matched_poses as f64)) }
                    } } }
                } }))
            }
        }
    }
}
