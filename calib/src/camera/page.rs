//! The report as one HTML page.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::{COVERAGE_CELLS, CalibratedCamera, CameraCalibration};

const STYLE: &str = include_str!("style.css");

/// Errors beyond this leave the scatter plot, pixels.
const LARGEST_SHOWN_PX: f64 = 1.0;
/// Points drawn at most.
const MOST_POINTS: usize = 4000;
const HISTOGRAM_BINS: usize = 40;

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
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    title { (title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    h1 { (title) }
                    p.verdict { (self.verdict()) }
                    @for camera in &self.cameras { (section(camera)) }
                }
            }
        };
        page.into_string()
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
                figure { (coverage(c)) figcaption { "Corners per part of the image" } }
                figure { (scatter(c)) figcaption { "Errors within ±" (LARGEST_SHOWN_PX) " px" } }
                figure { (histogram(c)) figcaption { "Length of the errors, 0 to " (LARGEST_SHOWN_PX) " px" } }
            }
        }
    }
}

fn coverage(c: &CalibratedCamera) -> Markup {
    let [columns, rows] = COVERAGE_CELLS;
    let most = f64::from(c.cells.iter().copied().max().unwrap_or(1).max(1));
    let height = 240.0 * f64::from(c.camera.height) / f64::from(c.camera.width.max(1));
    let (w, h) = (240.0 / columns as f64, height / rows as f64);
    html! {
        svg viewBox=(format!("0 0 240 {height:.0}")) role="img" aria-label="coverage" {
            @for (k, n) in c.cells.iter().enumerate() {
                rect x=(format!("{:.1}", (k % columns) as f64 * w)) y=(format!("{:.1}", (k / columns) as f64 * h))
                    width=(format!("{w:.1}")) height=(format!("{h:.1}"))
                    class=(if *n == 0 { "empty" } else { "seen" })
                    fill-opacity=(format!("{:.2}", if *n == 0 { 1.0 } else { 0.2 + 0.8 * (f64::from(*n) / most).sqrt() })) {}
            }
        }
    }
}

fn scatter(c: &CalibratedCamera) -> Markup {
    let step = c.errors_px.len().div_ceil(MOST_POINTS).max(1);
    let scale = 120.0 / LARGEST_SHOWN_PX;
    html! {
        svg viewBox="-120 -120 240 240" role="img" aria-label="errors" {
            path.axis d="M-120 0H120M0 -120V120" {}
            @for [x, y] in c.errors_px.iter().step_by(step).filter(|e| e[0].hypot(e[1]) < LARGEST_SHOWN_PX) {
                circle cx=(format!("{:.1}", x * scale)) cy=(format!("{:.1}", y * scale)) r="1" {}
            }
        }
    }
}

fn histogram(c: &CalibratedCamera) -> Markup {
    let mut bins = [0u32; HISTOGRAM_BINS];
    for [x, y] in &c.errors_px {
        let bin = (x.hypot(*y) / LARGEST_SHOWN_PX * HISTOGRAM_BINS as f64) as usize;
        if let Some(count) = bins.get_mut(bin) {
            *count += 1;
        }
    }
    let most = f64::from(bins.iter().copied().max().unwrap_or(1).max(1));
    let width = 240.0 / HISTOGRAM_BINS as f64;
    html! {
        svg viewBox="0 0 240 160" role="img" aria-label="histogram" {
            path.axis d="M0 160H240" {}
            @for (k, n) in bins.iter().enumerate() {
                @let height = 155.0 * f64::from(*n) / most;
                rect.seen x=(format!("{:.1}", k as f64 * width)) y=(format!("{:.1}", 160.0 - height))
                    width=(format!("{:.1}", width * 0.9)) height=(format!("{height:.1}")) {}
            }
        }
    }
}
