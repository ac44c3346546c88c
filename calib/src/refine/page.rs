//! The report of a refinement as one HTML page.

use lsfb_report::{Normal, Page, bars, coverage, png, scroll};
use maud::{Markup, html};

use super::report::{Component, Evidence, NAMES, Refinement, RefinementReport};
use crate::coverage::COVERAGE_CELLS;
use crate::plots;

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
    /// The page.
    pub fn page(&self, title: &str) -> Page {
        let body = html! {
            @for camera in &self.cameras { (section(camera)) }
            section {
                h2 { "How this was estimated" }
                p.note {
                    "Image corners are placed on planes seen by the LiDAR and found in other images from other viewpoints. Their predicted positions depend on the LiDAR's trajectory, the planes, and the camera's pose relative to the LiDAR. "
                    "The errors of corners, planes and trajectory are estimated as well, as listed. Standard deviations include the differences between parts of the recording, and three tenths of the errors of planes and trajectory as if all parts shared them."
                }
            }
        };
        Page::new(title)
            .judged(&self.judgement(), &self.summary())
            .body(body)
    }
}

fn section(c: &Refinement) -> Markup {
    html! {
        section {
            h2 { (c.camera) }
            @if let Some(evidence) = &c.evidence {
                (numbers(&c.components, evidence))
                (figures(evidence))
            }
            @if let Some(overlays) = &c.overlays {
                div.plots {
                    @for (overlay, which) in overlays.iter().zip([Compared::Before, Compared::After]) {
                        figure.large {
                            (png(&overlay.png, which.name()))
                            figcaption { (which.name()) ": returns, red (near) to blue (far)" }
                        }
                    }
                }
            }
        }
    }
}

fn numbers(components: &[Component], e: &Evidence) -> Markup {
    let median = |px: f64| format!("{px:.2} px");
    let pose = html! {
        table.numbers {
            thead { tr { th { "camera axis (rotation about, translation along)" } th { "change" } th { "σ" } th { "difference of halves" } th { "" } } }
            tbody {
                @for (k, half) in components.iter().zip(e.halves) {
                    tr {
                        td { (k.name) ", " (k.unit()) }
                        td { @if let Some(v) = k.change { (format!("{:+.3}", k.shown(v))) } @else { "–" } }
                        td { (format!("{:.3}", k.shown(k.sigma))) }
                        td { @if k.change.is_some() { (format!("{:+.3}", k.shown(half))) } @else { "–" } }
                        td { @if k.change.is_none() { "not determined; left unchanged" } }
                    }
                }
            }
        }
    };
    let evidence = html! {
        table.numbers {
            tbody {
                tr { td { "corners on surfaces, seen" } td { (e.corners) ", " (e.observations) " times in " (e.images) " images" } }
                tr { td { "transfer error between images: initial rig" } td { (median(e.transfer.before_px)) } }
                tr { td { "refined rig" } td { (median(e.transfer.after_px)) } }
                tr { td { "in held-out parts" } td { (median(e.transfer.held_back_px)) } }
                tr { td { "χ² between halves of the recording" } td { (format!("{:.1}", e.halves_square)) " (6 expected)" } }
                tr { td { "noise of corners, of surfaces" } td { (format!("{:.2} px, {:.1} mm", e.pixel_px, e.plane_m * 1e3)) } }
                tr { td { "deviation of images from the LiDAR's trajectory" } td { (format!("{:.3}°, {:.1} mm", e.image_turn_rad.to_degrees(), e.image_shift_m * 1e3)) } }
                tr { td { "parts, variance relative to noise" } td { (e.blocks) ", " (format!("{:.1}", e.inflation)) } }
                tr { td { "camera's clock" } td { (format!("{:+.2} ± {:.2} ms", e.clock_s[0] * 1e3, e.clock_s[1] * 1e3)) } }
            }
        }
    };
    html! { div.tables { (scroll(&pose)) (scroll(&evidence)) } }
}

fn figures(e: &Evidence) -> Markup {
    let mut bins = [0u32; BINS];
    for value in e.normalized.iter().filter(|v| v.abs() < SHOWN_SIGMAS) {
        let at = (value + SHOWN_SIGMAS) / (2.0 * SHOWN_SIGMAS) * BINS as f64;
        bins[(at as usize).min(BINS - 1)] += 1;
    }
    let by_axis = |name: &str, label: &str, values: &[f64; 3], scale: f64| {
        let values = NAMES[3..].iter().zip(values);
        let values: Vec<(String, f64)> = values
            .map(|(axis, value)| ((*axis).to_owned(), value * scale))
            .collect();
        bars(name, label, &values).draw()
    };
    let span = [-SHOWN_SIGMAS, SHOWN_SIGMAS];
    html! {
        div.plots {
            figure {
                (plots::counts("normalized corner errors", "error (σ)", span, &bins, Normal::Unit))
                figcaption { "Corner errors in units of their σ; dashed: expected distribution" }
            }
            (plots::mean_errors(&e.cell_errors_px, e.size_px))
            figure {
                (coverage("corners per part of the image", &e.coverage, COVERAGE_CELLS, e.size_px).draw())
                figcaption { "Corners by part of the image: dark where there are many; red parts have none" }
            }
            figure {
                (by_axis("angular rate", "angular rate (°/s)", &e.turning_rad_s, 1f64.to_degrees()))
                figcaption { "Angular rate about the camera's axes, rms" }
            }
            figure {
                (by_axis("speed", "speed (m/s)", &e.speed_m_s, 1.0))
                figcaption { "Speed along the camera's axes, rms" }
            }
        }
    }
}
