//! The report as one HTML page.

use maud::{Markup, html};

use super::{CameraImuCalibration, CameraOnImu, FoundImu};
use crate::plots::{self, LARGEST_SHOWN_PX};
use crate::report;

impl CameraImuCalibration {
    /// One sentence: whether the result may be trusted.
    pub fn verdict(&self) -> String {
        let rms: Vec<String> = self
            .cameras
            .iter()
            .map(|c| format!("{} {:.2} px", c.name, c.rms_px))
            .collect();
        let fits = format!(
            "Corners are met to {}; gyroscope and accelerometer to {:.1} and {:.1} times their stated noise",
            rms.join(", "),
            self.imu.gyro_ratio,
            self.imu.accel_ratio
        );
        match self.warnings.len() {
            0 => format!("PASS. {fits}; nothing speaks against this calibration."),
            1 => format!("WARN. {fits}; one thing should be better."),
            n => format!("WARN. {fits}; {n} things should be better."),
        }
    }

    /// The page: no script, no network.
    pub fn to_html(&self, title: &str) -> String {
        let body = html! {
                    @for warning in &self.warnings { p.warning { (warning) } }
                    @for camera in &self.cameras { (section(camera)) }
        @if self.board_bend_sigma_m > 0.0 {
                        p { "Corners lie up to " (format!("{:.2} ± {:.2}", self.board_bend_m * 1e3, self.board_bend_sigma_m * 1e3)) " mm out of the board's plane." }
                    }
                    (imu(&self.imu))
                };
        report::page(title, &self.verdict(), &[], &body)
    }
}

fn section(c: &CameraOnImu) -> Markup {
    let place_mm = c.camera_from_rig.inverse().translation * 1e3;
    html! {
        section {
            h2 { (c.name) " on the IMU" }
            p {
                (c.views) " views, " (c.corners) " corners, " (c.outliers) " outliers, "
                (format!("{:.3}", c.rms_px)) " px rms"
                @if let Some(held_back) = c.held_back_rms_px { ", " (format!("{held_back:.3}")) " px on views held back" }
                "."
            }
            div.row {
                table {
                    thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
                    tbody {
                        @for (k, axis) in ["x", "y", "z"].iter().enumerate() {
                            tr { td { "turn about " (axis) ", °" } td {} td { (format!("{:.4}", c.rotation_sigma_rad[k].to_degrees())) } }
                        }
                        @for (k, axis) in ["x", "y", "z"].iter().enumerate() {
                            tr {
                                td { "place " (axis) ", mm" }
                                td { (format!("{:.2}", place_mm[k])) }
                                td { (format!("{:.3}", c.position_sigma_m[k] * 1e3)) }
                            }
                        }
                        tr {
                            td { "clock, ms" }
                            td { (format!("{:+.3}", c.rig_from_camera_s * 1e3)) }
                            td { (format!("{:.4}", c.rig_from_camera_sigma_s * 1e3)) }
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
                figure { (plots::coverage(&c.cells, [c.camera.width, c.camera.height])) figcaption { "Corners per part of the image" } }
                figure { (plots::scatter(&c.errors_px)) figcaption { "Errors within ±" (LARGEST_SHOWN_PX) " px" } }
                figure { (plots::lengths(&c.errors_px)) figcaption { "Length of the errors, 0 to " (LARGEST_SHOWN_PX) " px" } }
            }
        }
    }
}

fn imu(imu: &FoundImu) -> Markup {
    let axes = ["x", "y", "z"];
    html! {
        section {
            h2 { "IMU" }
            div.row {
                table {
                    thead { tr { th { "axis" } th { "turning, rad/s rms" } th { "pushing, m/s² rms" } th { "gyroscope bias, rad/s" } th { "σ" } th { "accelerometer bias, m/s²" } th { "σ" } } }
                    tbody {
                        @for (k, axis) in axes.iter().enumerate() {
                            tr {
                                td { (axis) }
                                td { (format!("{:.2}", imu.rate_rms_rad_s[k])) }
                                td { (format!("{:.2}", imu.force_rms_m_s2[k])) }
                                td { (format!("{:+.5}", imu.gyro_bias_rad_s[k])) }
                                td { (format!("{:.5}", imu.gyro_bias_sigma_rad_s[k])) }
                                td { (format!("{:+.4}", imu.accel_bias_m_s2[k])) }
                                td { (format!("{:.4}", imu.accel_bias_sigma_m_s2[k])) }
                            }
                        }
                    }
                }
                @if !imu.axes.is_empty() {
                    table {
                        thead { tr { th { "error of axes" } th { "value" } th { "σ" } } }
                        tbody {
                            @for p in &imu.axes {
                                tr { td { (p.name) } td { (format!("{:+.5}", p.value)) } td { (format!("{:.5}", p.sigma)) } }
                            }
                        }
                    }
                }
                figure { (plots::histogram(&imu.gyro_histogram)) figcaption { "Gyroscope's residuals, ±5 times the stated noise" } }
                figure { (plots::histogram(&imu.accel_histogram)) figcaption { "Accelerometer's residuals, ±5 times the stated noise" } }
            }
        }
    }
}
