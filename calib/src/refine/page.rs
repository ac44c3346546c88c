//! The report of a refinement as one HTML page.

use maud::{Markup, html};

use super::report::{Component, Evidence, NAMES, Refinement, RefinementReport};
use crate::plots::{self, Expected};
use crate::report::{self, Bar};

/// Errors are drawn within so many standard deviations, in so many bins.
const SHOWN_SIGMAS: f64 = 5.0;
const BINS: usize = 50;

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
    /// The page: no script, no network; pictures are named by `picture` and lie beside it.
    pub fn to_html(&self, title: &str, picture: &dyn Fn(&str, Compared) -> String) -> String {
        let body = html! {
            @for camera in &self.cameras { (section(camera, picture)) }
            section {
                h2 { "How this is known" }
                p.note {
                    "Corners of images are put onto planes that the LiDAR saw, and found in other images from elsewhere: where they should be rests on the LiDAR's way, on the planes, and on the pose of the camera to the LiDAR. "
                    "Corners, planes and the way may err by what the table says, which is measured along. Standard deviations take in by how much parts of the recording differ, and three tenths of the errors of planes and of the way as if all parts shared them."
                }
            }
        };
        report::page(title, &self.verdict(), &[], &body)
    }
}

fn section(c: &Refinement, picture: &dyn Fn(&str, Compared) -> String) -> Markup {
    html! {
        section {
            h2 { (c.camera) }
            @if c.edge.is_some() { p { (c.sentence) "." } } @else { p.warning { (c.sentence) "." } }
            @if let Some(advice) = &c.advice { p.warning { (advice) "." } }
            @if let Some(evidence) = &c.evidence {
                (numbers(&c.components, evidence))
                (figures(evidence))
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

fn numbers(components: &[Component], e: &Evidence) -> Markup {
    let median = |px: f64| format!("{px:.2} px");
    html! {
        div.row {
            table {
                thead { tr { th { "about or along the camera's axis" } th { "change" } th { "σ" } th { "halves differ" } th { "" } } }
                tbody {
                    @for (k, half) in components.iter().zip(e.halves) {
                        tr {
                            td { (k.name) ", " (k.unit()) }
                            td { @if let Some(v) = k.change { (format!("{:+.3}", k.shown(v))) } @else { "–" } }
                            td { (format!("{:.3}", k.shown(k.sigma))) }
                            td { @if k.change.is_some() { (format!("{:+.3}", k.shown(half))) } @else { "–" } }
                            td.warning { @if k.change.is_none() { "not determined: left as it was" } }
                        }
                    }
                }
            }
            table {
                tbody {
                    tr { td { "corners on surfaces, seen" } td { (e.corners) ", " (e.observations) " times in " (e.images) " images" } }
                    tr { td { "corners put from image to image: as the rig was" } td { (median(e.transfer.before_px)) } }
                    tr { td { "now" } td { (median(e.transfer.after_px)) } }
                    tr { td { "in parts held back" } td { (median(e.transfer.held_back_px)) } }
                    tr { td { "halves of the recording, squared in σ" } td { (format!("{:.1}", e.halves_square)) " (6 expected)" } }
                    tr { td { "noise of a corner, of surfaces" } td { (format!("{:.2} px, {:.1} mm", e.pixel_px, e.plane_m * 1e3)) } }
                    tr { td { "the LiDAR's way, by image" } td { (format!("{:.3}°, {:.1} mm", e.image_turn_rad.to_degrees(), e.image_shift_m * 1e3)) } }
                    tr { td { "parts, variance over that of noise" } td { (e.blocks) ", " (format!("{:.1}", e.inflation)) } }
                    tr { td { "camera's clock" } td { (format!("{:+.2} ± {:.2} ms", e.clock_s[0] * 1e3, e.clock_s[1] * 1e3)) } }
                }
            }
        }
    }
}

fn figures(e: &Evidence) -> Markup {
    let mut bins = [0u32; BINS];
    for value in e.normalized.iter().filter(|v| v.abs() < SHOWN_SIGMAS) {
        let at = (value + SHOWN_SIGMAS) / (2.0 * SHOWN_SIGMAS) * BINS as f64;
        bins[(at as usize).min(BINS - 1)] += 1;
    }
    let by_axis = |values: &[f64; 3], scale: f64, unit: &str| -> Vec<Bar> {
        let bar = |(k, value): (usize, &f64)| Bar {
            label: format!("{}, {unit}", NAMES[3 + k]),
            value: value * scale,
        };
        values.iter().enumerate().map(bar).collect()
    };
    let in_words =
        |values: &[f64; 3], scale: f64| values.map(|v| format!("{:.2}", v * scale)).join(", ");
    let degrees = 1f64.to_degrees();
    html! {
        div.row {
            figure {
                (plots::histogram(&bins, [-SHOWN_SIGMAS, SHOWN_SIGMAS], Expected::Normal))
                figcaption { "errors of corners over their σ" }
            }
            figure {
                (plots::vectors(&e.cell_errors_px, e.size_px))
                figcaption { "mean errors, the longest " (format!("{:.3}", plots::longest(&e.cell_errors_px))) " px" }
            }
            figure {
                (plots::coverage(&e.coverage, e.size_px))
                figcaption { "where corners were seen" }
            }
            figure {
                (report::bars(&by_axis(&e.turning_rad_s, degrees, "°/s")))
                figcaption { "turning about x, y, z: " (in_words(&e.turning_rad_s, degrees)) " °/s rms" }
            }
            figure {
                (report::bars(&by_axis(&e.speed_m_s, 1.0, "m/s")))
                figcaption { "way along x, y, z: " (in_words(&e.speed_m_s, 1.0)) " m/s rms" }
            }
        }
    }
}
