//! The report as one HTML page.

use lsfb_report::{Normal, Page, arrows, badge, bars, coverage, png, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::{LidarCameraCalibration, PoseFit};
use crate::coverage::COVERAGE_CELLS;
use crate::plots::{self, pose_rows};
use crate::transform::TransformEdge;

/// Errors at the ends of the histograms, metres.
const RANGES_M: f64 = 0.1;
const EDGES_M: f64 = 0.03;
const BINS: usize = 40;
/// Vectors are drawn so much longer than they are.
const EXAGGERATION: f64 = 10.0;

/// Values between plus and minus a limit, counted.
fn counts(values: &[f64], limit: f64) -> Vec<u32> {
    let mut bins = vec![0; BINS];
    for value in values.iter().filter(|v| v.abs() < limit) {
        let at = (0.5 * (value / limit + 1.0) * BINS as f64) as usize;
        bins[at.min(BINS - 1)] += 1;
    }
    bins
}

impl LidarCameraCalibration {
    /// What was calibrated and how well, in a few words.
    pub fn summary(&self) -> String {
        let used = self.poses.iter().filter(|p| p.rejected.is_none()).count();
        let turn = self.sigma[..3]
            .iter()
            .fold(0.0, |a: f64, b| a.max(*b))
            .to_degrees();
        let shift = self.sigma[3..].iter().fold(0.0, |a: f64, b| a.max(*b)) * 1e3;
        format!(
            "{} and LiDAR from {used} poses: standard deviation {turn:.3}° and {shift:.1} mm; board centres agree to {:.1} mm",
            self.camera,
            self.center_rms_m * 1e3
        )
    }

    /// Whether the result may be used, and how far.
    pub fn judgement(&self) -> Judgement {
        Judgement::new(self.findings.clone())
    }

    /// The transform for the joint graph.
    pub fn edge(&self) -> TransformEdge {
        TransformEdge {
            target: self.camera.clone(),
            source: "lidar".to_owned(),
            target_from_source: self.camera_from_lidar,
            covariance: Some(self.covariance),
        }
    }

    /// The page; `picture` is a PNG of the returns over an image, where there is one.
    pub fn page(&self, title: &str, picture: Option<&[u8]>) -> Page {
        let body = html! {
            section {
                h2 { "LiDAR relative to " (self.camera) }
                div.tables { (scroll(&self.pose_table())) (scroll(&self.figures())) }
                div.plots { (self.plots()) }
            }
            @if let Some(picture) = picture {
                section {
                    h2 { "LiDAR on the image" }
                    p { "Returns of one scan, red (near) to blue (far): they should end at the edge of the board." }
                    (png(picture, "LiDAR returns over an image"))
                }
            }
            section { h2 { "Poses" } (scroll(&self.pose_list())) }
        };
        Page::new(title)
            .judged(&self.judgement(), &self.summary())
            .body(body)
    }

    fn pose_table(&self) -> Markup {
        html! {
            table.numbers {
                thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
                tbody { (pose_rows(&self.camera_from_lidar, &self.covariance, [3, 1])) }
            }
        }
    }

    fn figures(&self) -> Markup {
        let mm = |m: f64| format!("{:.1}", m * 1e3);
        let with_sigma = |m: f64, sigma_m: f64| format!("{:.1} ± {:.1}", m * 1e3, sigma_m * 1e3);
        let largest = self.beam_offsets_m.values();
        let largest_m = largest.fold(0.0, |a: f64, b| a.max(b.abs()));
        let mut rows = vec![
            ("range noise, mm", mm(self.range_noise_m)),
            (
                "noise common to a beam on one board, mm",
                mm(self.beam_noise_m),
            ),
            ("largest beam offset, mm", mm(largest_m)),
            (
                "excess half width, mm",
                with_sigma(self.edge_excess_m[0], self.edge_excess_sigma_m[0]),
            ),
            (
                "excess half height, mm",
                with_sigma(self.edge_excess_m[1], self.edge_excess_sigma_m[1]),
            ),
            (
                "range offset, mm",
                with_sigma(self.range_excess_m, self.range_excess_sigma_m),
            ),
            (
                "scale of camera relative to LiDAR",
                format!("{:.4} ± {:.4}", self.scale, self.scale_sigma),
            ),
            (
                "residuals over expected noise: corners, planes, outlines",
                self.spread.map(|s| format!("{s:.2}")).join(", "),
            ),
        ];
        if let (Some(excess_m), Some(sigma_m)) = (self.dark_excess_m, self.dark_excess_sigma_m) {
            let excess = with_sigma(excess_m, sigma_m);
            rows.push(("range excess of dark over bright parts, mm", excess));
        }
        if let (Some(turn), Some(shift)) = (self.halves_rotation_rad, self.halves_translation_m) {
            let halves = format!("{:.3}°, {:.1} mm", turn.to_degrees(), shift * 1e3);
            rows.push(("every other pose vs. the rest", halves));
        }
        if let (Some(shift), Some(turn)) = (self.holdout_center_rms_m, self.holdout_normal_rms_rad)
        {
            let holdout = format!("{:.1} mm, {:.2}°", shift * 1e3, turn.to_degrees());
            rows.push(("held-out poses: centres, normals (rms)", holdout));
        }
        let offsets =
            [0, 1].map(|k| with_sigma(self.offset_error_m[k], self.offset_error_sigma_m[k]));
        rows.push((
            "plate centre relative to the given one, mm",
            offsets.join(", "),
        ));
        if let (Some(late), Some(sigma)) = (self.lidar_late_s, self.lidar_late_sigma_s) {
            let late = format!("{:+.1} ± {:.1}", late * 1e3, sigma * 1e3);
            rows.push(("delay of scan stamps relative to images, ms", late));
        }
        html! {
            table.numbers {
                tbody { @for (name, value) in rows { tr { td { (name) } td { (value) } } } }
            }
        }
    }

    fn plots(&self) -> Markup {
        let spread = |name: &str, values: &[f64], reach_m: f64| {
            let (span_mm, bins) = ([-1e3 * reach_m, 1e3 * reach_m], counts(values, reach_m));
            plots::counts(name, "error (mm)", span_mm, &bins, Normal::Unknown)
        };
        let centers: Vec<_> = self
            .residuals
            .centers_px
            .iter()
            .map(|[from, to]| (*from, [to[0] - from[0], to[1] - from[1]]))
            .collect();
        html! {
            figure {
                (coverage("corners per part of the image", &self.cells, COVERAGE_CELLS, self.image_px).draw())
                figcaption { "Corners by part of the image: dark where there are many; red parts have none" }
            }
            figure {
                (spread("range residuals to the planes", &self.residuals.ranges_m, RANGES_M))
                figcaption { "Range residuals to the planes" }
            }
            figure {
                (spread("residuals at the outlines", &self.residuals.edges_m, EDGES_M))
                figcaption { "Residuals of outline points, across the outline" }
            }
            figure {
                // Errors that all point one way, or away from one place, are no noise.
                (arrows("errors of board centres", &centers, EXAGGERATION, self.image_px).draw())
                figcaption { "Board centres: camera vs. LiDAR; errors × " (EXAGGERATION) }
            }
            figure {
                (self.bars("distance", "distance (m)", |p| p.distance_m))
                figcaption { "Distance to the board, by pose" }
            }
            figure {
                (self.bars("errors of board centres by pose", "error (mm)", |p| p.center_error_m * 1e3))
                figcaption { "Distance between board centres, by pose" }
            }
            figure {
                (self.bars("errors of board normals by pose", "error (°)", |p| p.normal_error_rad.to_degrees()))
                figcaption { "Angle between board normals, by pose" }
            }
        }
    }

    fn pose_list(&self) -> Markup {
        html! {
            table.numbers {
                thead { tr { th { "pose" } th { "distance, m" } th { "points" } th { "edges" } th { "centre, mm" } th { "normal, °" } th { "corners, px" } th { "" } } }
                tbody {
                    @for p in &self.poses {
                        tr {
                            td { (p.name) }
                            td { (format!("{:.2}", p.distance_m)) }
                            td { (p.points) }
                            td { (p.edges) }
                            td { (format!("{:.1}", p.center_error_m * 1e3)) }
                            td { (format!("{:.2}", p.normal_error_rad.to_degrees())) }
                            td { (format!("{:.2}", p.corner_rms_px)) }
                            td.words { (badge(p.verdict())) @if let Some(why) = &p.rejected { " " (why) } }
                        }
                    }
                }
            }
        }
    }

    fn bars(&self, name: &str, label: &str, value: impl Fn(&PoseFit) -> f64) -> Markup {
        let used = self.poses.iter().filter(|p| p.rejected.is_none());
        let values: Vec<(String, f64)> = used.map(|p| (p.name.clone(), value(p))).collect();
        bars(name, label, &values).draw()
    }
}
