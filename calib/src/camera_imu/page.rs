//! The report as one HTML page.

use maud::{Markup, html};

use super::report::{HISTOGRAM_SPAN, POOR_AXIS};
use super::{CameraImuCalibration, CameraOnImu, FoundImu};
use crate::plots::{self, Expected, LARGEST_SHOWN_PX};
use crate::report::{self, Bar};
use crate::residual_diagnosis::FAILED_RMS_PX;
use crate::verify::Outcome;

impl CameraImuCalibration {
    /// Whether the result may be used: not where corners miss by more than any detector does.
    pub fn outcome(&self) -> Outcome {
        let fails = |c: &CameraOnImu| c.is_another_board || c.rms_px > FAILED_RMS_PX;
        if self.board_is_another() || self.cameras.iter().any(fails) {
            Outcome::Fail
        } else if self.warnings.is_empty() {
            Outcome::Pass
        } else {
            Outcome::Warn
        }
    }

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
        report::verdict(self.outcome(), &fits, &self.warnings)
    }

    /// The page: no script, no network.
    pub fn to_html(&self, title: &str) -> String {
        let body = html! {
            @for camera in &self.cameras { (section(camera)) }
            (imu(&self.imu))
            (self.board())
        };
        report::page(title, &self.verdict(), &self.warnings, &body)
    }

    fn board(&self) -> Markup {
        let g = &self.gravity_in_target_m_s2;
        html! {
            section {
                h2 { "Board" }
                table {
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
                                td { "larger than said, %" }
                                td { (format!("{:+.2}", self.board_excess * 100.0)) }
                                td { (format!("{:.2}", self.board_excess_sigma * 100.0)) }
                            }
                        }
                        @if self.board_bend_sigma_m > 0.0 {
                            tr {
                                td { "farthest corner out of its plane, mm" }
                                td { (format!("{:.2}", self.board_bend_m * 1e3)) }
                                td { (format!("{:.2}", self.board_bend_sigma_m * 1e3)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

const AXES: [&str; 3] = ["x", "y", "z"];

fn section(c: &CameraOnImu) -> Markup {
    let (roll, pitch, yaw) = c.camera_from_rig.inverse().rotation.euler_angles();
    let place_mm = c.camera_from_rig.inverse().translation * 1e3;
    html! {
        section {
            h2 { (c.name) " on the IMU" }
            p {
                (c.views) " views, " (c.corners) " corners, " (c.outliers) " outliers, "
                (format!("{:.3}", c.rms_px)) " px rms"
                @if let Some(holdout) = c.holdout_rms_px { ", " (format!("{holdout:.3}")) " px on holdout views" }
                "."
            }
            div.row {
                table {
                    thead { tr { th { "parameter" } th { "value" } th { "σ" } } }
                    tbody {
                        @for (k, (name, angle)) in [("roll", roll), ("pitch", pitch), ("yaw", yaw)].iter().enumerate() {
                            tr {
                                td { (name) ", °" }
                                td { (format!("{:.4}", angle.to_degrees())) }
                                td { (format!("{:.4}", c.rotation_sigma_rad[k].to_degrees())) }
                            }
                        }
                        @for (k, axis) in AXES.iter().enumerate() {
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
                        tr {
                            td { "drift of the clock, ppm" }
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
                figure { (plots::coverage(&c.cells, [c.camera.width, c.camera.height])) figcaption { "Corners per part of the image" } }
                figure { (plots::vectors(&c.cell_errors_px, [c.camera.width, c.camera.height])) figcaption { "Mean error per part of the image, enlarged: the longest is " (format!("{:.2}", plots::longest(&c.cell_errors_px))) " px" } }
                figure { (plots::scatter(&c.errors_px)) figcaption { "Errors of corners within ±" (LARGEST_SHOWN_PX) " px" } }
                figure { (plots::lengths(&c.errors_px)) figcaption { "Length of the errors, 0 to " (LARGEST_SHOWN_PX) " px" } }
            }
        }
    }
}

fn imu(imu: &FoundImu) -> Markup {
    html! {
        section {
            h2 { "IMU" }
            div.row {
                table {
                    thead { tr { th { "axis" } th { "turning, rad/s rms" } th { "pushing, m/s² rms" } th { "gyroscope bias, rad/s" } th { "σ" } th { "accelerometer bias, m/s²" } th { "σ" } th { "advice" } } }
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
                                td { @if poor(&imu.rate_rms_rad_s, k) { "rotate more around " (axis) } @else { "enough" } }
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
                figure { (excitation(&imu.rate_rms_rad_s)) figcaption { "Turning about x, y and z, rad/s rms" } }
                figure { (excitation(&imu.force_rms_m_s2)) figcaption { "Pushing along x, y and z, m/s² rms" } }
                figure { (plots::histogram(&imu.gyro_histogram, HISTOGRAM_SPAN, Expected::Normal)) figcaption { "Gyroscope's residuals, in units of the stated noise; the curve is what that noise gives" } }
                figure { (plots::histogram(&imu.accel_histogram, HISTOGRAM_SPAN, Expected::Normal)) figcaption { "Accelerometer's residuals, in units of the stated noise; the curve is what that noise gives" } }
            }
        }
    }
}

/// Whether an axis is turned about far less than the one most turned about.
fn poor(rate_rms: &[f64; 3], axis: usize) -> bool {
    let most = rate_rms.iter().copied().fold(0.0, f64::max);
    rate_rms[axis] * POOR_AXIS < most
}

fn excitation(rms: &[f64; 3]) -> Markup {
    let bars: Vec<Bar> = AXES
        .iter()
        .zip(rms)
        .map(|(axis, value)| Bar {
            label: (*axis).to_owned(),
            value: *value,
        })
        .collect();
    report::bars(&bars)
}
