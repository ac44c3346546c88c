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
                    thead { tr { th { "check" } th { "" } th { "value" } th { "σ" } th { "limits" } th { "" } } }
                    tbody {
                        @for c in &self.checks {
                            tr {
                                td { (c.name) }
                                td { (c.outcome.name()) }
                                td { @if let Some(v) = c.value { (format!("{v:.2} {}", c.unit)) } }
                                td { @if let Some(s) = c.sigma { (format!("{s:.2}")) } }
                                td { (c.limits[0]) ", " (c.limits[1]) }
                                td.words { (c.sentence) }
                            }
                        }
                    }
                }
                p.note {
                    "A check warns beyond its first limit and fails beyond its second, where that is clear of three standard deviations; where these exceed the second limit it says nothing. "
                    "Two milliseconds move the image by a pixel while the rig turns at 1 rad/s (500 px of focal length); half a degree between camera and IMU is one per cent of every motion; "
                    "0.4° between camera and LiDAR are 2 cm at 3 m; corners are found to a third of a pixel."
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
