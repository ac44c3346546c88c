//! The report as one HTML page.

use lsfb_report::{Page, badge, png, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::Verification;

impl Verification {
    /// The page. `judgement` is that of the whole command, which may know more than the checks.
    pub fn page(&self, title: &str, judgement: &Judgement) -> Page {
        let body = html! {
            section {
                h2 { "Checks" }
                (scroll(&self.table()))
                p.note {
                    "A significant value (more than three standard deviations) warns above the first limit and fails above the second. Where three standard deviations exceed the second limit, the result is unknown. "
                    "Two milliseconds move the image by a pixel while the rig rotates at 1 rad/s (500 px of focal length); half a degree between camera and IMU is one per cent of every motion; "
                    "0.4° between camera and LiDAR are 2 cm at 3 m; corners are found to a third of a pixel."
                }
            }
            @for o in &self.overlays {
                section {
                    h2 { (o.camera) }
                    p { (o.points) " LiDAR returns, red (near) to blue (far): their edges should lie on those of the image." }
                    (png(&o.png, &o.camera))
                }
            }
        };
        Page::new(title)
            .judged(judgement, &self.summary())
            .body(body)
    }

    fn table(&self) -> Markup {
        html! {
            table.numbers {
                thead { tr { th { "check" } th { "" } th { "value" } th { "σ" } th { "limits" } } }
                tbody {
                    @for c in &self.checks {
                        tr {
                            td { (c.name) }
                            td { (badge(c.outcome)) }
                            td { @if let Some(v) = c.value { (format!("{v:.2} {}", c.unit)) } }
                            td { @if let Some(s) = c.sigma { (format!("{s:.2}")) } }
                            td { (c.limits[0]) ", " (c.limits[1]) }
                        }
                    }
                }
            }
        }
    }
}
