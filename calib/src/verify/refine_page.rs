//! The report of a refinement as one HTML page.

use maud::{Markup, html};

use super::refine::{Component, Refinement, RefinementReport};
use crate::report;

/// Which of the two pictures of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compared {
    /// With the rig's pose.
    Before,
    /// With the pose found.
    After,
}

impl Compared {
    /// As it stands in names of files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Before => "before",
            Self::After => "after",
        }
    }
}

impl RefinementReport {
    /// One sentence: what was found, and what was not.
    pub fn verdict(&self) -> String {
        let found = self.cameras.iter().filter(|c| c.edge.is_some()).count();
        let summary = format!(
            "{found} of {} cameras were placed to the LiDAR without a board",
            self.cameras.len()
        );
        let partly = self.cameras.iter().flat_map(|c| &c.components);
        let missing = partly.filter(|c| c.change.is_none()).count();
        if found == 0 {
            return format!("FAIL. {summary}: see why below.");
        }
        if found < self.cameras.len() || missing > 0 {
            return format!(
                "WARN. {summary}; some numbers are not determined and were left as they were."
            );
        }
        format!("PASS. {summary}, in all six numbers.")
    }

    /// The page: no script, no network; pictures are named by `picture` and lie beside it.
    pub fn to_html(&self, title: &str, picture: &dyn Fn(&str, Compared) -> String) -> String {
        let body = html! {
            @for camera in &self.cameras { (section(camera, picture)) }
        };
        report::page(title, &self.verdict(), &[], &body)
    }
}

fn section(c: &Refinement, picture: &dyn Fn(&str, Compared) -> String) -> Markup {
    html! {
        section {
            h2 { (c.camera) }
            @if c.edge.is_some() { p { (c.sentence) "." } } @else { p.warning { (c.sentence) "." } }
            @if !c.components.is_empty() {
                p {
                    "Mutual information of brightness in LiDAR and images: " (format!("{:.4}", c.score[0]))
                    " nats as the rig was, " (format!("{:.4}", c.score[1])) " now."
                    @if let Some([turn, sigma]) = c.edges_turn_rad {
                        " Edges would turn the camera by another " (format!("{:.2}° ± {:.2}°", turn.to_degrees(), sigma.to_degrees())) "."
                    }
                }
                table {
                    thead { tr { th { "about or along the camera's axis" } th { "change" } th { "σ" } th { "" } } }
                    tbody {
                        @for k in &c.components {
                            tr {
                                td { (k.name) ", " (k.unit()) }
                                td { @if let Some(v) = k.change { (format!("{:+.3}", k.shown(v))) } @else { "–" } }
                                td { @if let Some(s) = k.sigma { (format!("{:.3}", k.shown(s))) } @else { "unknown" } }
                                td.warning { @if k.change.is_none() { "not determined: left as it was" } }
                            }
                        }
                    }
                }
                div.row {
                    @for k in &c.components {
                        figure {
                            (profile(k))
                            figcaption { (k.name) ", " (k.unit()) ": score around the result" @if k.change.is_some() { "; dashed: as the rig was" } }
                        }
                    }
                }
            }
            @if c.overlays.is_some() {
                div.row {
                    @for which in [Compared::Before, Compared::After] {
                        figure.large {
                            img src=(picture(&c.camera, which)) alt=(which.name()) style="max-width: 100%";
                            figcaption { (which.name()) ": returns red near to blue far" }
                        }
                    }
                }
            }
        }
    }
}

/// The score along one number.
fn profile(c: &Component) -> Markup {
    let (width, height) = (240.0, 120.0);
    let reach = c.profile.iter().map(|p| p[0].abs()).fold(1e-12, f64::max);
    let scores = || c.profile.iter().map(|p| p[1]);
    let (low, high) = (
        scores().fold(f64::INFINITY, f64::min),
        scores().fold(f64::NEG_INFINITY, f64::max),
    );
    let x = |v: f64| 0.5 * width * (1.0 + v / reach);
    let y = |v: f64| height - 10.0 - (height - 20.0) * (v - low) / (high - low).max(1e-12);
    let path: String = c
        .profile
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let word = if k == 0 { "M" } else { "L" };
            format!("{word}{:.1} {:.1}", x(p[0]), y(p[1]))
        })
        .collect();
    let before = c.change.map(|v| -v).filter(|v| v.abs() < reach);
    html! {
        svg viewBox=(format!("0 0 {width} {}", height + 16.0)) role="img" aria-label="profile" {
            path.axis d=(format!("M0 {height}H{width}M{:.1} 0V{height}", x(0.0))) {}
            @if let Some(v) = before { path.curve.fit d=(format!("M{:.1} 0V{height}", x(v))) {} }
            path.curve d=(path) {}
            @for share in [-1.0, 0.0, 1.0] {
                text x=(format!("{:.1}", x(share * reach))) y=(height + 13.0) font-size="10"
                    text-anchor=(if share < 0.0 { "start" } else if share > 0.0 { "end" } else { "middle" }) {
                    (format!("{:.1}", c.shown(share * reach)))
                }
            }
        }
    }
}
