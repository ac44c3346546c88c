//! The report as one HTML page.

use maud::{Markup, html};

use super::{CalibratedCamera, CameraCalibration};
use crate::plots::{self, LARGEST_SHOWN_PX};
use crate::report;

impl CameraCalibration {
    /// One sentence: whether the result may be trusted.
    pub fn verdict(&self) -> String {
        let warnings: usize = self.cameras.iter().map(|c| c.warnings.len()).sum();
        let views: usize = self.cameras.iter().map(|c| c.views).sum();
        let cameras = match self.cameras.len() {
            1 => "1 camera".to_owned(),
            n => format!("{n} cameras"),
        };
        let fits = format!(
            "{cameras}, {views} views: corners are met to {:.2} px",
            self.rms_px
        );
        match warnings {
            0 => format!("PASS. {fits}; nothing speaks against this calibration."),
            1 => format!("WARN. {fits}; one thing should be better."),
            n => format!("WARN. {fits}; {n} things should be better."),
        }
    }

    /// The page: no script, no network.
    pub fn to_html(&self, title: &str) -> String {
        let body = html! {
            @for camera in &self.cameras { (section(camera)) }
        };
        report::page(title, &self.verdict(), &[], &body)
    }
}

fn section(c: &CalibratedCamera) -> Markup {
    html! {
        section {
            h2 { (c.name) ", " (c.camera.lens.model().name()) }
            @for warning in &c.warnings { p.warning { (warning) } }
            p {
                "Found in " (c.found) " of " (c.images) " images, " (c.views) " of them adjusted: "
                (c.corners) " corners, " (c.outliers) " outliers, "
                (format!("{:.3}", c.rms_px)) " px rms (" (format!("{:.3}", c.inlier_rms_px)) " px without outliers"
                @if let Some(held_back) = c.held_back_rms_px { ", " (format!("{held_back:.3}")) " px on views held back" }
                ")."
            }
            div.row {
                table {
                    thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
                    tbody {
                        @for p in &c.parameters {
                            tr { td { (p.name) } td { (format!("{:.5}", p.value)) } td { (format!("{:.5}", p.sigma)) } }
                        }
                        @for (k, name) in ["roll", "pitch", "yaw"].iter().enumerate() {
                            tr { td { (name) ", °" } td {} td { (format!("{:.4}", c.pose_sigma[k].to_degrees())) } }
                        }
                        @for (k, name) in ["x", "y", "z"].iter().enumerate() {
                            tr {
                                td { (name) ", mm" }
                                td { (format!("{:.2}", c.camera_from_first.translation[k] * 1e3)) }
                                td { (format!("{:.3}", c.pose_sigma[3 + k] * 1e3)) }
                            }
                        }
                    }
                }
                figure { (plots::coverage(&c.cells, [c.camera.width, c.camera.height])) figcaption { "Corners per part of the image" } }
                figure { (plots::scatter(&c.errors_px)) figcaption { "Errors within ±" (LARGEST_SHOWN_PX) " px" } }
                figure { (plots::lengths(&c.errors_px)) figcaption { "Length of the errors, 0 to " (LARGEST_SHOWN_PX) " px" } }
            }
        }
    }
}
