//! The report as one HTML page.

use lsfb_report::{
    Axis, Ink, Layer, Normal, Page, Plot, bars, ink_css, rounded, scroll, with_unit,
};
use maud::{Markup, html};

use super::judgement::{POOR_AXIS, shown_in};
use super::report::HISTOGRAM_SPAN;
use super::{CameraImuCalibration, CameraOnImu, FoundImu, SplitEstimate};
use crate::plots::{self, pose_rows};

impl CameraImuCalibration {
    /// What was calibrated and how well, in a few words.
    pub fn summary(&self) -> String {
        let rms: Vec<String> = self
            .cameras
            .iter()
            .map(|c| format!("{} {:.2} px rms", c.name, c.rms_px))
            .collect();
        format!(
            "{}; gyroscope and accelerometer residuals {:.1} and {:.1} times their specified noise",
            rms.join(", "),
            self.imu.gyro_ratio,
            self.imu.accel_ratio
        )
    }

    /// The page.
    pub fn page(&self, title: &str) -> Page {
        let body = html! {
            @for camera in &self.cameras { (section(camera)) }
            (imu(&self.imu))
            (self.board())
            @if !self.halves.is_empty() { (halves(&self.halves)) }
        };
        Page::new(title)
            .judged(&self.judgement(), &self.summary())
            .body(body)
    }

    fn board(&self) -> Markup {
        let g = &self.gravity_in_target_m_s2;
        let table = html! {
            table.numbers {
                thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
                tbody {
                    @for (k, axis) in AXES.iter().enumerate() {
                        tr {
                            td { "gravity along its " (axis) ", m/s²" }
                            td { (format!("{:+.4}", g[k])) }
                            td { (format!("{:.4}", self.gravity_sigma_m_s2[k])) }
                        }
                    }
                    @if self.board_is_measured {
                        tr {
                            td { "excess over specified size, %" }
                            td { (format!("{:+.2}", self.board_excess * 100.0)) }
                            td { (format!("{:.2}", self.board_excess_sigma * 100.0)) }
                        }
                    }
                    @if self.board_bend_sigma_m > 0.0 {
                        tr {
                            td { "largest distance of a corner from the plane, mm" }
                            td { (format!("{:.2}", self.board_bend_m * 1e3)) }
                            td { (format!("{:.2}", self.board_bend_sigma_m * 1e3)) }
                        }
                    }
                }
            }
        };
        html! { section { h2 { "Board" } (scroll(&table)) } }
    }
}

const AXES: [&str; 3] = ["x", "y", "z"];

fn section(c: &CameraOnImu) -> Markup {
    // The inverse of a pose is perturbed by what its adjoint makes of that, turned round.
    let adjoint = c.camera_from_rig.adjoint();
    let covariance = adjoint * c.covariance * adjoint.transpose();
    let parameters = html! {
        table.numbers {
            thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
            tbody {
                (pose_rows(&c.camera_from_rig.inverse(), &covariance, [4, 2]))
                tr {
                    td { "clock, ms" }
                    td { (format!("{:+.3}", c.rig_from_camera_s * 1e3)) }
                    td { (format!("{:.4}", c.rig_from_camera_sigma_s * 1e3)) }
                }
                tr {
                    td { "clock drift, ppm" }
                    td { (format!("{:+.1}", c.clock_drift * 1e6)) }
                    td { (format!("{:.1}", c.clock_drift_sigma * 1e6)) }
                }
                @if c.readout_s != 0.0 {
                    tr {
                        td { "readout, ms" }
                        td { (format!("{:.3}", c.readout_s * 1e3)) }
                        td { (format!("{:.4}", c.readout_sigma_s * 1e3)) }
                    }
                }
                @for p in &c.lens {
                    tr { td { (p.name) } td { (format!("{:.5}", p.value)) } td { (format!("{:.5}", p.sigma)) } }
                }
            }
        }
    };
    html! {
        section {
            h2 { (c.name) " relative to the IMU" }
            p {
                (c.views) " views, " (c.corners) " corners, " (c.outliers) " outliers, "
                (format!("{:.3}", c.rms_px)) " px rms"
                @if let Some(holdout) = c.holdout_rms_px { ", " (format!("{holdout:.3}")) " px on held-out views" }
                "."
            }
            (scroll(&parameters))
            (plots::of_corners(&c.cells, &c.cell_errors_px, &c.errors_px, [c.camera.width, c.camera.height]))
        }
    }
}

fn imu(imu: &FoundImu) -> Markup {
    let motion = html! {
        table.numbers {
            thead { tr { th { "axis" } th { "angular rate, rad/s rms" } th { "specific force, m/s² rms" } th { "gyroscope bias, rad/s" } th { "σ" } th { "accelerometer bias, m/s²" } th { "σ" } th { "advice" } } }
            tbody {
                @for (k, axis) in AXES.iter().enumerate() {
                    tr {
                        td { (axis) }
                        td { (format!("{:.2}", imu.rate_rms_rad_s[k])) }
                        td { (format!("{:.2}", imu.force_rms_m_s2[k])) }
                        td { (format!("{:+.5}", imu.gyro_bias_rad_s[k])) }
                        td { (format!("{:.5}", imu.gyro_bias_sigma_rad_s[k])) }
                        td { (format!("{:+.4}", imu.accel_bias_m_s2[k])) }
                        td { (format!("{:.4}", imu.accel_bias_sigma_m_s2[k])) }
                        td { @if poor(&imu.rate_rms_rad_s, k) { "rotate more about " (axis) } @else { "enough" } }
                    }
                }
            }
        }
    };
    let axes = html! {
        table.numbers {
            thead { tr { th { "axis error" } th { "value" } th { "σ" } } }
            tbody {
                @for p in &imu.axes {
                    tr { td { (p.name) } td { (format!("{:+.5}", p.value)) } td { (format!("{:.5}", p.sigma)) } }
                }
            }
        }
    };
    let residuals = |name: &str, bins: &[u32]| {
        plots::counts(name, "specified noise", HISTOGRAM_SPAN, bins, Normal::Unit)
    };
    html! {
        section {
            h2 { "IMU" }
            div.tables {
                (scroll(&motion))
                @if !imu.axes.is_empty() { (scroll(&axes)) }
            }
            div.plots {
                figure { (excitation("angular rate", "angular rate (rad/s)", &imu.rate_rms_rad_s)) figcaption { "Angular rate about x, y and z, rms" } }
                figure { (excitation("specific force", "specific force (m/s²)", &imu.force_rms_m_s2)) figcaption { "Specific force along x, y and z without gravity, rms" } }
                figure { (residuals("gyroscope's residuals", &imu.gyro_histogram)) figcaption { "Gyroscope residuals in units of the specified noise; dashed: expected distribution" } }
                figure { (residuals("accelerometer's residuals", &imu.accel_histogram)) figcaption { "Accelerometer residuals in units of the specified noise; dashed: expected distribution" } }
            }
        }
    }
}

/// Whether an axis is turned about far less than the one most turned about.
fn poor(rate_rms: &[f64; 3], axis: usize) -> bool {
    let most = rate_rms.iter().copied().fold(0.0, f64::max);
    rate_rms[axis] * POOR_AXIS < most
}

fn excitation(name: &str, label: &str, rms: &[f64; 3]) -> Markup {
    let values = AXES.iter().zip(rms);
    let values: Vec<(String, f64)> = values.map(|(axis, v)| ((*axis).to_owned(), *v)).collect();
    bars(name, label, &values).draw()
}

/// Half the width of an error bar's ends, and how far the two halves stand apart, as shares of the distance between parameters.
const BAR_END: f64 = 0.12;
const HALF_APART: f64 = 0.16;
const SPLIT_PLOT_PX: [u32; 2] = [900, 300];

/// What either half of the recording says for itself.
fn halves(halves: &[SplitEstimate]) -> Markup {
    let table = html! {
        table.numbers {
            thead { tr { th { "number" } th { "parameter" } th { "first half − whole" } th { "second half − whole" } th { "difference, σ" } } }
            tbody {
                @for (k, split) in halves.iter().enumerate() {
                    tr {
                        td { (k) }
                        td { (split.name) }
                        @for half in 0..2 { td { (with_sigma(split, half)) } }
                        td { (format!("{:.1}", split.deviations())) }
                    }
                }
            }
        }
    };
    html! {
        section {
            h2 { "Halves of the recording" }
            p {
                "Results of the first half ("
                span style=(format!("color:{}", ink_css(0))) { "●" }
                ") and the second half ("
                span style=(format!("color:{}", ink_css(1))) { "●" }
                ") alone, to first order, relative to the result of the whole recording, in standard deviations of that difference; bars show one standard deviation."
            }
            (split_plot(halves).draw())
            (scroll(&table))
        }
    }
}

fn with_sigma(split: &SplitEstimate, half: usize) -> String {
    let (factor, unit) = shown_in(&split.name);
    let [value, sigma] = [split.from_whole[half], split.sigma[half]].map(|v| rounded(v * factor));
    with_unit(&format!("{value} ± {sigma}"), unit)
}

fn split_plot(halves: &[SplitEstimate]) -> Plot {
    let mut layers = Vec::new();
    let mut farthest: f64 = 1.0;
    for half in 0..2 {
        let ink = Ink::Series(half);
        let mut dots = Vec::with_capacity(halves.len());
        for (k, split) in halves.iter().enumerate() {
            let [_, of_difference] = split.difference();
            let in_sigmas = |v: f64| v / of_difference.max(f64::MIN_POSITIVE);
            let (value, sigma) = (
                in_sigmas(split.from_whole[half]),
                in_sigmas(split.sigma[half]),
            );
            let at = k as f64 + HALF_APART * (2.0 * half as f64 - 1.0);
            let [low, high] = [value - sigma, value + sigma];
            farthest = farthest.max(high.abs()).max(low.abs());
            for (from, to) in [
                ([at, low], [at, high]),
                ([at - BAR_END, low], [at + BAR_END, low]),
                ([at - BAR_END, high], [at + BAR_END, high]),
            ] {
                layers.push(Layer::line(vec![from, to], ink));
            }
            dots.push([at, value]);
        }
        layers.push(Layer::Dots {
            points: dots,
            ink,
            radius_px: 3.0,
        });
    }
    let reach = 1.05 * farthest;
    let [width_px, height_px] = SPLIT_PLOT_PX;
    Plot {
        name: "halves of the recording".to_owned(),
        width_px,
        height_px,
        x: Axis::linear("number of the parameter", [-0.6, halves.len() as f64 - 0.4]),
        y: Axis::linear("half − whole (σ)", [-reach, reach]),
        layers,
    }
}
