//! How a judgement is drawn: it decides nothing.

use lsfb_types::{Finding, Judgement, Verdict};
use maud::{Markup, html};

/// The headline in the verdict's colour; below it what needs a look, what is not known, and, folded, what is as it should be.
pub(crate) fn draw(judgement: &Judgement, summary: &str) -> Markup {
    let of = |verdict: Verdict| {
        let own = judgement.findings().iter();
        own.filter(move |f| f.verdict == verdict)
            .collect::<Vec<_>>()
    };
    let (unknown, passed) = (of(Verdict::Unknown), of(Verdict::Pass));
    let problems: Vec<&Finding> = judgement.problems().collect();
    html! {
        p class=(format!("verdict {}", class(judgement.verdict()))) { (judgement.headline(summary)) }
        (list(&problems))
        (list(&unknown))
        @if !passed.is_empty() {
            details.passed {
                summary { (passed.len()) " passed" }
                (list(&passed))
            }
        }
    }
}

fn list(findings: &[&Finding]) -> Markup {
    html! {
        @if !findings.is_empty() {
            ul.findings {
                @for finding in findings {
                    li {
                        (badge(finding.verdict))
                        div {
                            @if !finding.subject.is_empty() { b { (finding.subject) } " " }
                            (finding.what)
                            @if let Some(limit) = finding.crossed_limit() { span.limit { " (" (limit) ")" } }
                            @if let Some(remedy) = &finding.remedy { p.remedy { "→ " (remedy) } }
                        }
                    }
                }
            }
        }
    }
}

/// The verdict as a small coloured word.
pub fn badge(verdict: Verdict) -> Markup {
    html! { span class=(format!("badge {}", class(verdict))) { (verdict.name()) } }
}

/// Class of the style sheet.
fn class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Unknown => "unknown",
        Verdict::Pass => "pass",
        Verdict::Warn => "warn",
        Verdict::Fail => "fail",
    }
}
