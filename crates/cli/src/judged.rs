//! How a judgement stands on the terminal and in JSON: it decides nothing.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_recording::Provenance;
use lsfb_types::{Finding, Judgement, Verdict};
use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::outcome::Outcome;
use crate::standing;
pub use crate::terminal::printable;

/// Width of the column of subjects.
const SUBJECTS: usize = 22;

/// A result with the judgement beside it, as `--json` gives it: `verdict`, `findings`, `summary`, and what the command found.
#[derive(Serialize)]
pub struct Judged<'a, T: Serialize> {
    /// The verdict and the findings.
    #[serde(flatten)]
    pub judgement: &'a Judgement,
    /// The line at the top.
    pub summary: String,
    /// What the command found.
    #[serde(flatten)]
    pub result: &'a T,
}

impl<'a, T: Serialize> Judged<'a, T> {
    /// `what` says in a few words what was judged.
    pub fn new(judgement: &'a Judgement, what: &str, result: &'a T) -> Self {
        Self {
            judgement,
            summary: judgement.headline(what),
            result,
        }
    }
}

/// A page with its verdict, made of a recording and settings alone.
pub struct Page<'a> {
    pub path: &'a Path,
    /// Pictures and transforms that belong to it.
    pub beside: &'a [PathBuf],
    pub made_from: &'a Provenance,
}

/// What was said of a page that stands.
#[derive(Serialize, Deserialize)]
struct Said {
    json: String,
    text: String,
    failed: bool,
}

impl Said {
    fn print(&self, context: &Context) -> anyhow::Result<Outcome> {
        context.print_kept(&self.json, &self.text)?;
        Ok(match self.failed {
            true => Outcome::JudgementFailed,
            false => Outcome::Done,
        })
    }
}

/// Says again what was said of a page that stands; `None` where it is to be made.
pub fn said_before(
    context: &Context,
    page: &Path,
    made_from: &Provenance,
) -> Option<anyhow::Result<Outcome>> {
    let said: Said = context.standing(&[page], made_from)?;
    Some(said.print(context))
}

impl Page<'_> {
    /// Notes that the page is finished, and says what it found.
    pub fn finish<T: Serialize>(
        &self,
        context: &Context,
        judged: &Judged<'_, T>,
        text: &str,
    ) -> anyhow::Result<Outcome> {
        let said = Said {
            json: serde_json::to_string(judged)?,
            text: printable(text),
            failed: judged.judgement.verdict() == Verdict::Fail,
        };
        standing::finish(&[self.path], self.beside, self.made_from, &said)?;
        said.print(context)
    }
}

/// One line per finding, and one more where there is something to do.
pub fn lines(judgement: &Judgement) -> String {
    judgement.findings().iter().map(line).collect()
}

/// One line per finding that somebody should look at, or that is not known.
pub fn problem_lines(judgement: &Judgement) -> String {
    let unknown = judgement.findings().iter();
    let unknown = unknown.filter(|f| f.verdict == Verdict::Unknown);
    judgement.problems().chain(unknown).map(line).collect()
}

fn line(finding: &Finding) -> String {
    let mut text = format!(
        "{:<7}  {:<SUBJECTS$} {}",
        finding.verdict, finding.subject, finding.what
    );
    if let Some(limit) = finding.crossed_limit() {
        let _ = write!(text, " ({limit})");
    }
    if let Some(remedy) = &finding.remedy {
        let _ = write!(text, "\n{:<7}  {:<SUBJECTS$} → {remedy}", "", "");
    }
    text.push('\n');
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_to_do_stands_below_what_is_wrong() {
        let found = Finding::new("clock", Verdict::Warn, "clock", "follows nothing")
            .remedy("install chrony");
        let text = lines(&Judgement::new(vec![found]));
        assert_eq!(
            text,
            "WARN     clock                  follows nothing\n                                → install chrony\n"
        );
    }
}
