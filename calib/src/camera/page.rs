//! The report as one HTML page.

use lsfb_report::{Page, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::{CalibratedCamera, CameraCalibration};
use crate::plots::{self, pose_rows};

impl CameraCalibration {
    /// What was calibrated and how well, in a few words.
    pub fn summary(&self) -> String {
        let views: usize = self.cameras.iter().map(|c| c.views).sum();
        let cameras = match self.cameras.len() {
            1 => "1 camera".to_owned(),
            n => format!("{n} cameras"),
        };
        format!("{cameras}, {views} views, {:.2} px rms", self.rms_px)
    }

    /// Whether the result may be used, and how far.
    pub fn judgement(&self) -> Judgement {
        let findings = self.cameras.iter().flat_map(|c| &c.findings);
        Judgement::new(findings.cloned().collect())
    }

    /// The page.
    pub fn page(&self, title: &str) -> Page {
        let body = html! {
            @for camera in &self.cameras { (section(camera)) }
        };
        Page::new(title)
            .judged(&self.judgement(), &self.summary())
            .body(body)
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
            "Focal length: ± {:.2} %, including a board bent by {bend}, which these views make likely; correcting for the bend would change it by {change}.",
            100.0 * sigma
        );
    }
    format!(
        "Focal length: ± {:.2} % for a flat board, ± {:.2} % for one that may be bent by 2 mm and stretched by 0.1 %. These views fit best with a bend of {bend}, which would change it by {change}.",
        100.0 * sigma,
        100.0 * c.board.focal_sigma.hypot(sigma)
    )
}

fn section(c: &CalibratedCamera) -> Markup {
    let parameters = html! {
        table.numbers {
            thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
            tbody {
                @for p in &c.parameters {
                    tr { td { (p.name) } td { (format!("{:.5}", p.value)) } td { (format!("{:.5}", p.sigma)) } }
                }
                @if c.pose_sigma != [0.0; 6] { (pose_rows(&c.camera_from_first, &c.pose_covariance, [4, 2])) }
            }
        }
    };
    html! {
        section {
            h2 { (c.name) ", " (c.camera.lens.model().name()) }
            p {
                "Found in " (c.found) " of " (c.images) " images, " (c.views) " of them used: "
                (c.corners) " corners, " (c.outliers) " outliers, "
                (format!("{:.3}", c.rms_px)) " px rms (" (format!("{:.3}", c.inlier_rms_px)) " px without outliers"
                @if let Some(holdout) = c.holdout_rms_px { ", " (format!("{holdout:.3}")) " px on held-out views" }
                ")."
            }
            p { (focal_length(c)) " Views tilted by 30° about both axes, near and far, separate focal length from distance." }
            (scroll(&parameters))
            (plots::of_corners(&c.cells, &c.cell_errors_px, &c.errors_px, [c.camera.width, c.camera.height]))
        }
    }
}
