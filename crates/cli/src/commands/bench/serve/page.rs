//! The leaderboard's pages. Whatever others wrote is text in them, never markup.

use lsfb_eval::leaderboard::{RANKED_COVERAGE, Ranked, Score, Submission};
use lsfb_report::{Page, scroll};
use maud::{Markup, html};

/// The form, and a table for each sequence.
pub fn board(title: &str, sequences: &[(&str, Vec<Ranked>)], most_bytes: usize) -> Page {
    let body = html! {
        section {
            h2 { "Upload a trajectory" }
            form method="post" action="/submit" enctype="multipart/form-data" {
                p { label { "Team " input name="team" required maxlength="40"; } }
                p { label { "Sequence "
                    select name="sequence" {
                        @for (name, _) in sequences { option { (name) } }
                    }
                } }
                p { label { "Trajectory " input type="file" name="trajectory" required; } }
                p { button { "Upload" } }
            }
            p { "TUM text, EuRoC csv or a table with column names, at most " (most_bytes / 1_000_000) " MB. It is scored and then deleted." }
        }
        @for (name, ranked) in sequences {
            section {
                h2 { (name) }
                @if ranked.is_empty() { p { "Nobody yet." } } @else { (scroll(&table(ranked))) }
            }
        }
        p { "Teams that cover less than " (100.0 * RANKED_COVERAGE) " % of a sequence are not ranked." }
    };
    Page::new(format!("Leaderboard: {title}")).body(body)
}

/// What an upload got.
pub fn scored(submission: &Submission) -> String {
    let ranked = Ranked {
        rank: None,
        submission: submission.clone(),
    };
    let body = html! {
        section { h2 { (submission.sequence) } (scroll(&table(&[ranked]))) }
        p { a href="/" { "Back to the leaderboard" } }
    };
    Page::new("Your result").body(body).to_html()
}

/// Why an upload got nothing.
pub fn refused(why: &str) -> String {
    let body = html! {
        p { (why) }
        p { a href="/" { "Back" } }
    };
    Page::new("No result").body(body).to_html()
}

fn table(ranked: &[Ranked]) -> Markup {
    let optional = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
    };
    html! {
        table {
            thead { tr {
                th.number { "rank" } th { "team" }
                th.number { "ATE SE(3) (m)" } th.number { "scale error (%)" } th.number { "ATE Sim(3) (m)" }
                th.number { "RPE per 1 m (m)" } th.number { "covered (%)" }
            } }
            tbody { @for Ranked { rank, submission } in ranked {
                @let Score { ate_se3_m, ate_sim3_m, scale_error_percent, rpe_1m_m, covered_percent } = &submission.score;
                tr {
                    td.number { (rank.map_or_else(|| "–".to_owned(), |rank| rank.to_string())) }
                    th scope="row" { (submission.team) }
                    td.number { (optional(Some(*ate_se3_m), 3)) }
                    td.number { (optional(*scale_error_percent, 2)) }
                    td.number { (optional(*ate_sim3_m, 3)) }
                    td.number { (optional(*rpe_1m_m, 3)) }
                    td.number { (optional(Some(*covered_percent), 1)) }
                }
            } }
        }
    }
}
