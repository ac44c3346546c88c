//! The report as one HTML page.

use maud::html;

use super::{Outcome, Verification};
use crate::report;

impl Outcome {
    /// As it stands in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "UNKNOWN",
            Self::Pass => "PASS",
            Self::Warn => "WARN",
            Self::Fail => "FAIL",
        }
    }
}

impl Verification {
    /// One sentence: whether the rig fits the recording.
    pub fn verdict(&self) -> String {
        let named = |outcome: Outcome| -> Vec<&str> {
            let those = self.checks.iter().filter(|c| c.outcome == outcome);
            those.map(|c| c.name.as_str()).collect()
        };
        let outcome = self.outcome();
        let sentence = match outcome {
            Outcome::Unknown => "this recording says nothing about the rig".to_owned(),
            Outcome::Pass => format!(
                "{} checks say that the rig is that of this recording",
                named(Outcome::Pass).len()
            ),
            bad => format!("look at {}", named(bad).join(", ")),
        };
        format!("{}. {sentence}.", outcome.name())
    }

    /// The page: no script, no network; pictures are named by `picture` and lie beside it.
    pub fn to_html(&self, title: &str, picture: &dyn Fn(&str) -> String) -> String {
        let body = html! {
            section {
                h2 { "Checks" }
                table {
                    thead { tr { th { "check" } th { "" } th { "value" } th { "σ" } th { "" } } }
                    tbody {
                        @for c in &self.checks {
                            tr {
                                td { (c.name) }
                                td { (c.outcome.name()) }
                                td { @if let Some(v) = c.value { (format!("{v:.2} {}", c.unit)) } }
                                td { @if let Some(s) = c.sigma { (format!("{s:.2}")) } }
                                td { (c.sentence) }
                            }
                        }
                    }
                }
            }
            @for o in &self.overlays {
                section {
                    h2 { (o.camera) }
                    p { (o.points) " returns of the LiDAR, red near to blue far: their edges should lie on those of the image." }
                    img src=(picture(&o.camera)) alt=(o.camera) style="max-width: 100%";
                }
            }
        };
        report::page(title, &self.verdict(), &[], &body)
    }
}
