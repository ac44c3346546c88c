//! The report as one HTML page.

use maud::{Markup, html};

use super::{CalibratedCamera, CameraCalibration};
use crate::plots::{self, LARGEST_SHOWN_PX};
use crate::report;
use crate::residual_diagnosis::FAILED_RMS_PX;
use crate::verify::Outcome;

impl CameraCalibration {
    /// Whether the result may be used: not where corners miss by more than any detector does.
    pub fn outcome(&self) -> Outcome {
        let fails = |c: &CalibratedCamera| c.is_another_board || c.inlier_rms_px > FAILED_RMS_PX;
        if self.cameras.iter().any(fails) {
            Outcome::Fail
        } else if self.cameras.iter().any(|c| !c.warnings.is_empty()) {
            Outcome::Warn
        } else {
            Outcome::Pass
        }
    }

    /// One sentence: whether the result may be trusted.
    pub fn verdict(&self) -> String {
        let warnings: Vec<String> = self
            .cameras
            .iter()
            .flat_map(|c| c.warnings.iter().map(|w| format!("{}: {w}", c.name)))
            .collect();
        let views: usize = self.cameras.iter().map(|c| c.views).sum();
        let cameras = match self.cameras.len() {
            1 => "1 camera".to_owned(),
            n => format!("{n} cameras"),
        };
        let fits = format!(
            "{cameras}, {views} views: corners are met to {:.2} px",
            self.rms_px
        );
        report::verdict(self.outcome(), &fits, &warnings)
    }

    /// The page: no script, no network.
    pub fn to_html(&self, title: &str) -> String {
        let body = html! {
            @for camera in &self.cameras { (section(camera)) }
        };
        report::page(title, &self.verdict(), &[], &body)
    }
}

/// How well the focal length is known, in words.
fn focal_length(c: &CalibratedCamera) -> String {
    let sigma = c.parameters[0].sigma / c.parameters[0].value;
    let bend = format!(
        "{:.1} ± {:.1} mm",
        c.board.bend_m * 1e3,
        c.board.bend_sigma_m * 1e3
    );
    let change = format!("{:+.2} %", 100.0 * c.board.focal_change);
    if c.board.is_likely {
        return format!(
            "Focal length: ± {:.2} %, with a board in it that is bent by {bend}, as these views make likely; it would change by {change} with that one.",
            100.0 * sigma
        );
    }
    format!(
        "Focal length if the board is flat: ± {:.2} %; if it may be bent by 2 mm and stretched by 0.1 %: ± {:.2} %, and {change} with the bend of {bend} that these views have best.",
        100.0 * sigma,
        100.0 * c.board.focal_sigma.hypot(sigma)
    )
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
                @if let Some(holdout) = c.holdout_rms_px { ", " (format!("{holdout:.3}")) " px on holdout views" }
                ")."
            }
            p { (focal_length(c)) " Views tilted by 30° about both axes, near and far, tell focal length from distance." }
            div.row {
                table {
                    thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
                    tbody {
                        @for p in &c.parameters {
                            tr { td { (p.name) } td { (format!("{:.5}", p.value)) } td { (format!("{:.5}", p.sigma)) } }
                        }
                        @if c.pose_sigma != [0.0; 6] { (pose(c)) }
                    }
                }
                figure { (plots::coverage(&c.cells, [c.camera.width, c.camera.height])) figcaption { "Corners per part of the image" } }
                figure { (plots::vectors(&c.cell_errors_px, [c.camera.width, c.camera.height])) figcaption { "Mean error per part of the image, enlarged: the longest is " (format!("{:.2}", plots::longest(&c.cell_errors_px))) " px" } }
                figure { (plots::scatter(&c.errors_px)) figcaption { "Errors of corners within ±" (LARGEST_SHOWN_PX) " px" } }
                figure { (plots::lengths(&c.errors_px)) figcaption { "Length of the errors, 0 to " (LARGEST_SHOWN_PX) " px" } }
            }
        }
    }
}

/// Rows of the first camera's pose in this one.
fn pose(c: &CalibratedCamera) -> Markup {
    let (roll, pitch, yaw) = c.camera_from_first.rotation.euler_angles();
    html! {
        @for (k, (name, value)) in [("roll", roll), ("pitch", pitch), ("yaw", yaw)].iter().enumerate() {
            tr {
                td { (name) ", °" }
                td { (format!("{:.4}", value.to_degrees())) }
                td { (format!("{:.4}", c.pose_sigma[k].to_degrees())) }
            }
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
