//! The report as one HTML page.

use maud::{Markup, html};

use super::{LidarCameraCalibration, PoseFit};
use crate::plots::{Expected, coverage, histogram};
use crate::report::{self, Bar};
use crate::residual_diagnosis::FAILED_RMS_PX;
use crate::transform::TransformEdge;
use crate::verify::Outcome;

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
    /// One sentence: whether the result may be trusted.
    pub fn verdict(&self) -> String {
        let used = self.poses.iter().filter(|p| p.rejected.is_none()).count();
        let turn = self.sigma[..3]
            .iter()
            .fold(0.0, |a: f64, b| a.max(*b))
            .to_degrees();
        let shift = self.sigma[3..].iter().fold(0.0, |a: f64, b| a.max(*b)) * 1e3;
        report::verdict(
            self.outcome(),
            &format!(
                "{} and LiDAR from {used} poses: known to {turn:.3}° and {shift:.1} mm (1 σ), middles of the board meet to {:.1} mm",
                self.camera,
                self.center_rms_m * 1e3
            ),
            &self.warnings,
        )
    }

    /// Whether the result may be used: not where corners miss by more than any detector does.
    pub fn outcome(&self) -> Outcome {
        if self.corner_rms_px > FAILED_RMS_PX {
            Outcome::Fail
        } else if self.warnings.is_empty() {
            Outcome::Pass
        } else {
            Outcome::Warn
        }
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

    /// The page: no script, no network.
    pub fn to_html(&self, title: &str) -> String {
        report::page(title, &self.verdict(), &self.warnings, &self.body())
    }

    fn body(&self) -> Markup {
        let t = &self.camera_from_lidar;
        let (roll, pitch, yaw) = t.rotation.euler_angles();
        html! {
            section {
                h2 { (self.camera) " from LiDAR" }
                div.row {
                    table {
                        thead { tr { th { "parameter" } th { "value" } th { "σ (LiDAR axes)" } } }
                        tbody {
                            @for (k, (name, value)) in [("roll", roll), ("pitch", pitch), ("yaw", yaw)].iter().enumerate() {
                                tr { td { (name) ", °" } td { (format!("{:.3}", value.to_degrees())) } td { (format!("{:.4}", self.sigma[k].to_degrees())) } }
                            }
                            @for (k, name) in ["x", "y", "z"].iter().enumerate() {
                                tr { td { (name) ", mm" } td { (format!("{:.1}", t.translation[k] * 1e3)) } td { (format!("{:.2}", self.sigma[3 + k] * 1e3)) } }
                            }
                        }
                    }
                    table {
                        tbody {
                            tr { td { "noise of one range, mm" } td { (format!("{:.1}", self.range_noise_m * 1e3)) } }
                            tr { td { "common to a beam on one board, mm" } td { (format!("{:.1}", self.beam_noise_m * 1e3)) } }
                            tr { td { "largest offset of a beam, mm" } td { (format!("{:.1}", self.beam_offsets_m.values().fold(0.0, |a: f64, b| a.max(b.abs())) * 1e3)) } }
                            tr { td { "excess of half the width, mm" } td { (format!("{:.1} ± {:.1}", self.edge_excess_m[0] * 1e3, self.edge_excess_sigma_m[0] * 1e3)) } }
                            tr { td { "excess of half the height, mm" } td { (format!("{:.1} ± {:.1}", self.edge_excess_m[1] * 1e3, self.edge_excess_sigma_m[1] * 1e3)) } }
                            tr { td { "excess of every range, mm" } td { (format!("{:.1} ± {:.1}", self.range_excess_m * 1e3, self.range_excess_sigma_m * 1e3)) } }
                            tr { td { "camera's scale over LiDAR's" } td { (format!("{:.4} ± {:.4}", self.scale, self.scale_sigma)) } }
                            @for (name, spread) in ["corners", "planes", "outlines"].iter().zip(self.spread) {
                                tr { td { "spread of " (name) " over expected" } td { (format!("{spread:.2}")) } }
                            }
                            @if let (Some(turn), Some(shift)) = (self.halves_rotation_rad, self.halves_translation_m) {
                                tr { td { "every other pose against the rest" } td { (format!("{:.3}°, {:.1} mm", turn.to_degrees(), shift * 1e3)) } }
                            }
                            @if let (Some(shift), Some(turn)) = (self.holdout_center_rms_m, self.holdout_normal_rms_rad) {
                                tr { td { "holdout poses: middles, normals (rms)" } td { (format!("{:.1} mm, {:.2}°", shift * 1e3, turn.to_degrees())) } }
                            }
                            tr { td { "plate's middle from where it was said, mm" } td { (format!("{:+.1} ± {:.1}, {:+.1} ± {:.1}", self.offset_error_m[0] * 1e3, self.offset_error_sigma_m[0] * 1e3, self.offset_error_m[1] * 1e3, self.offset_error_sigma_m[1] * 1e3)) } }
                            @if let (Some(late), Some(sigma)) = (self.lidar_late_s, self.lidar_late_sigma_s) {
                                tr { td { "scans stamped late against images, ms" } td { (format!("{:+.1} ± {:.1}", late * 1e3, sigma * 1e3)) } }
                            }
                        }
                    }
                }
                div.row {
                    figure {
                        (coverage(&self.cells, self.image_px))
                        figcaption { "Corners per part of the image" }
                    }
                    figure {
                        (histogram(&counts(&self.residuals.ranges_m, RANGES_M), [-1e3 * RANGES_M, 1e3 * RANGES_M], Expected::Unknown))
                        figcaption { "Ranges less those of their planes, mm" }
                    }
                    figure {
                        (histogram(&counts(&self.residuals.edges_m, EDGES_M), [-1e3 * EDGES_M, 1e3 * EDGES_M], Expected::Unknown))
                        figcaption { "Places on the outlines, mm across them" }
                    }
                    figure {
                        (self.vectors())
                        figcaption { "Middles of the board in the image, and where the LiDAR has them: errors × " (EXAGGERATION) }
                    }
                    figure {
                        (report::bars(&self.bars(|p| p.distance_m)))
                        figcaption { "Distance of the board, m, by pose" }
                    }
                    figure {
                        (report::bars(&self.bars(|p| p.center_error_m * 1e3)))
                        figcaption { "Distance between the board's middles, mm, by pose" }
                    }
                    figure {
                        (report::bars(&self.bars(|p| p.normal_error_rad.to_degrees())))
                        figcaption { "Angle between its normals, °, by pose" }
                    }
                }
            }
            section {
                h2 { "Poses" }
                table {
                    thead { tr { th { "pose" } th { "distance, m" } th { "points" } th { "edges" } th { "middle, mm" } th { "normal, °" } th { "corners, px" } th { "" } } }
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
                                td.warning { (p.rejected.as_deref().unwrap_or_default()) }
                            }
                        }
                    }
                }
            }
        }
    }

    /// Errors of the middles across the line of sight, drawn where the camera has them: those that all point one way, or away
    /// from one place, are no noise.
    fn vectors(&self) -> Markup {
        let [width, height] = self.image_px.map(f64::from);
        let scale = 240.0 / width.max(1.0);
        html! {
            svg viewBox=(format!("0 0 240 {:.0}", height * scale)) role="img" aria-label="vectors" {
                @for [from, to] in &self.residuals.centers_px {
                    circle cx=(format!("{:.1}", from[0] * scale)) cy=(format!("{:.1}", from[1] * scale)) r="2" {}
                    path.curve d=(format!("M{:.1} {:.1}L{:.1} {:.1}", from[0] * scale, from[1] * scale,
                        (from[0] + EXAGGERATION * (to[0] - from[0])) * scale, (from[1] + EXAGGERATION * (to[1] - from[1])) * scale)) {}
                }
            }
        }
    }

    fn bars(&self, value: impl Fn(&PoseFit) -> f64) -> Vec<Bar> {
        self.poses
            .iter()
            .filter(|p| p.rejected.is_none())
            .map(|p| Bar {
                label: p.name.clone(),
                value: value(p),
            })
            .collect()
    }
}
