//! The report as one HTML page.

use maud::{Markup, html};

use super::JointCalibration;
use crate::report::{self, Bar};
use crate::verify::Outcome;

impl JointCalibration {
    /// One sentence: whether the result may be trusted.
    pub fn verdict(&self) -> String {
        let checked = self.edges.iter().filter(|e| e.chi_square.is_some()).count();
        let largest = |value: fn(&super::EdgeConsistency) -> Option<f64>| {
            self.edges.iter().filter_map(value).fold(0.0, f64::max)
        };
        let found = format!(
            "{} sensors from {} transforms, {checked} of them checked by loops, which close to {:.2}° and {:.1} mm",
            self.sensors.len(),
            self.edges.len(),
            largest(|e| e.loop_rotation_rad).to_degrees(),
            largest(|e| e.loop_translation_m) * 1e3
        );
        report::verdict(self.outcome(), &found, &self.warnings)
    }

    /// Whether the result may be used: not where an edge contradicts the others.
    pub fn outcome(&self) -> Outcome {
        if self.has_outlier() {
            Outcome::Fail
        } else if self.warnings.is_empty() {
            Outcome::Pass
        } else {
            Outcome::Warn
        }
    }

    /// Whether an edge contradicts the others.
    pub fn has_outlier(&self) -> bool {
        self.edges.iter().any(|e| e.outlier)
    }

    /// The page: no script, no network.
    pub fn to_html(&self, title: &str) -> String {
        report::page(title, &self.verdict(), &self.warnings, &self.body())
    }

    fn bars(&self, value: fn(&super::EdgeConsistency) -> Option<f64>) -> Vec<Bar> {
        self.edges
            .iter()
            .filter_map(|e| {
                Some(Bar {
                    label: format!("{} from {}", e.target, e.source),
                    value: value(e)?,
                })
            })
            .collect()
    }

    fn body(&self) -> Markup {
        html! {
            section {
                h2 { "Loops" }
                p { "Each transform against the path through all others (redundancy " (self.redundancy) ", variance factor " (format!("{:.2}", self.variance_factor)) ")." }
                table {
                    thead { tr { th { "transform" } th { "covariance" } th { "rotation, °" } th { "translation, mm" } th { "χ² (6)" } th { "" } } }
                    tbody {
                        @for e in &self.edges {
                            tr {
                                td { (e.target) " from " (e.source) }
                                td { @if e.measured { "measured" } @else { "paper" } }
                                @if let (Some(turn), Some(shift), Some(chi)) = (e.loop_rotation_rad, e.loop_translation_m, e.chi_square) {
                                    td { (format!("{:.3}", turn.to_degrees())) }
                                    td { (format!("{:.2}", shift * 1e3)) }
                                    td { (format!("{chi:.1}")) }
                                } @else { td { "–" } td { "–" } td { "–" } }
                                td.warning { @if e.outlier { "contradicts" } }
                            }
                        }
                    }
                }
            }
            @if self.edges.iter().any(|e| e.chi_square.is_some()) {
                div.row {
                    figure {
                        (report::bars(&self.bars(|e| Some(e.loop_rotation_rad?.to_degrees()))))
                        figcaption { "Rotation that each transform misses its loops by, °" }
                    }
                    figure {
                        (report::bars(&self.bars(|e| Some(e.loop_translation_m? * 1e3))))
                        figcaption { "Translation, mm" }
                    }
                    figure {
                        (report::bars(&self.bars(|e| e.chi_square)))
                        figcaption { "χ² of six numbers: six on average, above 22 in one of a thousand" }
                    }
                }
            }
            section {
                h2 { "Poses in the IMU" }
                table {
                    thead { tr { th { "sensor" } th { "x, mm" } th { "y, mm" } th { "z, mm" } th { "roll, °" } th { "pitch, °" } th { "yaw, °" } th { "σ rotation, °" } th { "σ translation, mm" } } }
                    tbody {
                        @for s in &self.sensors {
                            @let t = s.imu_from_sensor;
                            @let (roll, pitch, yaw) = t.rotation.euler_angles();
                            tr {
                                td { (s.name) }
                                @for k in 0..3 { td { (format!("{:.2}", t.translation[k] * 1e3)) } }
                                @for angle in [roll, pitch, yaw] { td { (format!("{:.3}", angle.to_degrees())) } }
                                td { @for k in 0..3 { (format!("{:.4} ", s.sigma[k].to_degrees())) } }
                                td { @for k in 3..6 { (format!("{:.2} ", s.sigma[k] * 1e3)) } }
                            }
                        }
                    }
                }
            }
        }
    }
}
