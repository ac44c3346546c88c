//! The page of a localization: how many frames were placed, and why others were not, with pictures of some of these.

use lsfb_pipeline::features::FeatureDetector;
use lsfb_pipeline::localization::Localizer;
use lsfb_report::{Page, scroll};
use lsfb_types::Judgement;
use maud::{Markup, PreEscaped, html};

use super::Summary;
use super::drawing::draw;
use super::input::Input;
use super::matches::Inliers;
use crate::context::Context;

/// Frames that are shown: evenly over all that were lost.
const SHOWN: usize = 24;

/// What the frames show.
pub struct PageInput<'a> {
    pub input: &'a Input,
    /// Of the instants of a walk.
    pub times: &'a [lsfb_types::Timestamp],
    /// Of each frame.
    pub inliers: &'a [Inliers],
}

/// The page.
pub fn page(
    (summary, judgement): (&Summary, &Judgement),
    page_input: &PageInput,
    localizer: &Localizer,
    detector: &mut FeatureDetector,
    context: &Context,
) -> anyhow::Result<Page> {
    let frames = &summary.frames;
    let lost: Vec<usize> = (0..frames.len())
        .filter(|k| !frames[*k].localized)
        .collect();
    let step = lost.len().div_ceil(SHOWN).max(1);
    let chosen: Vec<usize> = lost.iter().copied().step_by(step).collect();
    let mut pictures = Vec::with_capacity(chosen.len());
    let shown = page_input.input.shown(&chosen, page_input.times)?;
    for (done, (k, shown)) in chosen.iter().zip(shown).enumerate() {
        context.show(lsfb_types::Progress {
            stage: "pictures",
            done: done as u64,
            total: chosen.len() as u64,
        })?;
        // What cannot be read, for its size say, has its reason beside it all the same.
        let answer = (&frames[*k], &page_input.inliers[*k]);
        let drawn = shown.and_then(|shown| draw(localizer, detector, &shown, answer));
        pictures.push(drawn.ok());
    }
    let gallery = chosen.iter().zip(pictures).map(|(k, picture)| {
        let reason = frames[*k].reason.as_deref().unwrap_or_default();
        html! {
            section {
                h3 { (frames[*k].frame) }
                p { (reason) }
                @if let Some(svg) = picture { (PreEscaped(svg)) }
            }
        }
    });
    let gallery: Vec<Markup> = gallery.collect();
    let body = html! {
        section {
            h2 { "Localized" }
            pre { (super::text(summary)) }
        }
        @if !lost.is_empty() {
            section {
                h2 { "Why frames were not localized" }
                (scroll(&reasons(summary)))
            }
            section {
                h2 { "Lost frames" }
                p {
                    "Grey: features. Green: inliers of the rejected best pose. Red: reprojection errors, magnified ten times."
                }
                @for one in &gallery { (one) }
            }
        }
    };
    let page = Page::new("Localization").judged(judgement, "");
    Ok(page.body(body))
}

/// Lost frames by their reasons, without the numbers in these, the most frequent first.
fn reasons(summary: &Summary) -> Markup {
    let lost = summary.frames.iter().filter(|f| !f.localized);
    let mut counts: Vec<(String, usize)> = Vec::new();
    for frame in lost {
        let kind = without_numbers(frame.reason.as_deref().unwrap_or_default());
        match counts.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, count)) => *count += 1,
            None => counts.push((kind, 1)),
        }
    }
    // The sort is stable: of equals the one that came first.
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    html! {
        table.numbers {
            thead { tr { th { "frames" } th.words { "reason" } } }
            tbody {
                @for (reason, count) in &counts { tr { td { (count) } td.words { (reason) } } }
            }
        }
    }
}

/// A sentence with one sign for each number.
fn without_numbers(text: &str) -> String {
    let mut kind = String::with_capacity(text.len());
    let mut in_number = false;
    for c in text.chars() {
        let goes_on = c.is_ascii_digit() || (in_number && c == '.');
        if goes_on && !in_number {
            kind.push('#');
        }
        if !goes_on {
            kind.push(c);
        }
        in_number = goes_on;
    }
    kind
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_counted_without_their_numbers() {
        assert_eq!(
            without_numbers("the matches fit 0.51 ± 0.02 times; 12 votes"),
            "the matches fit # ± # times; # votes"
        );
    }
}
