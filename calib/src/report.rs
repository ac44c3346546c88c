//! What the pages of all steps have in common.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::verify::Outcome;

const STYLE: &str = include_str!("style.css");
/// Bars that still have room for their labels.
const MOST_LABELS: usize = 4;

/// A bar of a chart.
pub(crate) struct Bar {
    pub label: String,
    pub value: f64,
}

/// The sentence at the top: PASS, WARN or FAIL, what was found, and the first of what speaks against it.
pub(crate) fn verdict(outcome: Outcome, found: &str, warnings: &[String]) -> String {
    let outcome_name = outcome.name();
    let against = match warnings {
        [] => "nothing speaks against this calibration".to_owned(),
        [only] => only.clone(),
        [first, rest @ ..] => format!("{first}; and {} more", rest.len()),
    };
    let advice = match outcome {
        Outcome::Fail => " Do not use it.",
        _ => "",
    };
    format!("{outcome_name}. {found}; {against}.{advice}")
}

/// A page with the verdict at the top: no script, no network.
pub(crate) fn page(title: &str, verdict: &str, warnings: &[String], body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                p.verdict { (verdict) }
                @for warning in warnings { p.warning { (warning) } }
                (body)
            }
        }
    };
    page.into_string()
}

/// Bars side by side, each with its label and value as a tooltip; few of them bear their labels.
pub(crate) fn bars(bars: &[Bar]) -> Markup {
    let most = bars
        .iter()
        .map(|b| b.value)
        .filter(|v| v.is_finite())
        .fold(1e-12, f64::max);
    let width = 240.0 / bars.len().max(1) as f64;
    html! {
        svg viewBox="0 -16 240 194" role="img" aria-label="bars" {
            path.axis d="M0 160H240" {}
            @for (k, bar) in bars.iter().enumerate() {
                @let height = 155.0 * (bar.value / most).clamp(0.0, 1.0);
                rect.seen x=(format!("{:.1}", k as f64 * width)) y=(format!("{:.1}", 160.0 - height))
                    width=(format!("{:.1}", width * 0.85)) height=(format!("{height:.1}")) {
                    title { (bar.label) ": " (format!("{:.3}", bar.value)) }
                }
                @if bars.len() <= MOST_LABELS {
                    text x=(format!("{:.1}", (k as f64 + 0.43) * width)) y="173" text-anchor="middle" font-size="10" { (bar.label) }
                }
            }
            path.axis d="M0 5H240" {}
            text x="236" y="0" text-anchor="end" font-size="10" { (format!("{most:.3}")) }
        }
    }
}
