//! The report as one HTML page.

use lsfb_report::{Page, badge, bars, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::{EdgeConsistency, JointCalibration};
use crate::angles::PoseNumbers;

impl JointCalibration {
    /// What was joined and how well, in a few words.
    pub fn summary(&self) -> String {
        let checked = self.edges.iter().filter(|e| e.chi_square.is_some()).count();
        let largest = |value: fn(&EdgeConsistency) -> Option<f64>| {
            self.edges.iter().filter_map(value).fold(0.0, f64::max)
        };
        format!(
            "{} sensors from {} transforms, {checked} of them checked by loops, which close to {:.2}° and {:.1} mm",
            self.sensors.len(),
            self.edges.len(),
            largest(|e| e.loop_rotation_rad).to_degrees(),
            largest(|e| e.loop_translation_m) * 1e3
        )
    }

    /// Whether the result may be used, and how far.
    pub fn judgement(&self) -> Judgement {
        Judgement::new(self.findings.clone())
    }

    /// The page.
    pub fn page(&self, title: &str) -> Page {
        Page::new(title)
            .judged(&self.judgement(), &self.summary())
            .body(self.body())
    }

    fn bars(&self, name: &str, label: &str, value: fn(&EdgeConsistency) -> Option<f64>) -> Markup {
        let values: Vec<(String, f64)> = self
            .edges
            .iter()
            .filter_map(|e| Some((format!("{}–{}", e.target, e.source), value(e)?)))
            .collect();
        bars(name, label, &values).draw()
    }

    fn body(&self) -> Markup {
        html! {
            section {
                h2 { "Loops" }
                p { "Each transform compared with the path through all others (redundancy " (self.redundancy) ", variance factor " (format!("{:.2}", self.variance_factor)) ")." }
                (scroll(&self.loops()))
            }
            @if self.edges.iter().any(|e| e.chi_square.is_some()) {
                div.plots {
                    figure {
                        (self.bars("rotations of loops", "rotation (°)", |e| Some(e.loop_rotation_rad?.to_degrees())))
                        figcaption { "Rotation error of each transform around its loops" }
                    }
                    figure {
                        (self.bars("translations of loops", "translation (mm)", |e| Some(e.loop_translation_m? * 1e3)))
                        figcaption { "Translation" }
                    }
                    figure {
                        (self.bars("chi-square of loops", "χ²", |e| e.chi_square))
                        figcaption { "χ² with six degrees of freedom: 6 on average, above 22 in one of a thousand cases" }
                    }
                }
            }
            section { h2 { "Poses in the IMU frame" } (scroll(&self.poses())) }
        }
    }

    fn loops(&self) -> Markup {
        html! {
            table.numbers {
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
                            td { (badge(e.verdict)) }
                        }
                    }
                }
            }
        }
    }

    fn poses(&self) -> Markup {
        html! {
            table.numbers {
                thead { tr { th { "sensor" } th { "x ± σ, mm" } th { "y ± σ, mm" } th { "z ± σ, mm" } th { "angles ± σ, °" } } }
                tbody {
                    @for s in &self.sensors {
                        @let t = s.imu_from_sensor;
                        @let numbers = PoseNumbers::of(&t, &s.covariance);
                        @let angles = numbers.angles;
                        tr {
                            td { (s.name) }
                            @for k in 0..3 {
                                td { (format!("{:.2} ± {:.2}", t.translation[k] * 1e3, numbers.translation_sigma_m[k] * 1e3)) }
                            }
                            td {
                                @for k in 0..3 {
                                    div { (angles.names[k]) (format!(" {:.3} ± {:.4}", angles.degrees[k], numbers.angle_sigma_deg[k])) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}
