//! The report as one HTML page.

use maud::html;

use super::{AxisNoise, ImuNoise, Noise};
use crate::{plots, report};

impl ImuNoise {
    /// One sentence: whether the result may be trusted.
    pub fn verdict(&self) -> String {
        let fits = format!(
            "{:.0} min at {:.0} Hz: gyroscope {:.2e} rad/s/√Hz, accelerometer {:.2e} m/s²/√Hz",
            self.duration_s / 60.0,
            self.rate_hz,
            self.gyro.density,
            self.accel.density
        );
        match self.warnings.len() {
            0 => format!("PASS. {fits}; nothing speaks against these figures."),
            1 => format!("WARN. {fits}; one thing should be better."),
            n => format!("WARN. {fits}; {n} things should be better."),
        }
    }

    /// The page: no script, no network.
    pub fn to_html(&self, title: &str) -> String {
        let triads = [
            (
                "Gyroscope",
                "rad/s",
                (&self.gyro, &self.gyro_sigma),
                &self.axes[..3],
            ),
            (
                "Accelerometer",
                "m/s²",
                (&self.accel, &self.accel_sigma),
                &self.axes[3..],
            ),
        ];
        let row = |name: &str, noise: &Noise, sigma: &Noise| {
            html! {
                tr {
                    td { (name) }
                    td { (format!("{:.3e} ± {:.1e}", noise.density, sigma.density)) }
                    td { (format!("{:.3e} ± {:.1e}", noise.instability, sigma.instability)) }
                    td { (format!("{:.3e} ± {:.1e}", noise.walk, sigma.walk)) }
                }
            }
        };
        let body = html! {
            @for warning in &self.warnings { p.warning { (warning) } }
            @for (name, unit, (noise, sigma), axes) in triads {
                section {
                    h2 { (name) }
                    div.row {
                        table {
                            thead { tr { th { "axis" } th { "noise density, " (unit) "/√Hz" } th { "bias instability, " (unit) } th { "random walk, " (unit) "/s/√Hz" } } }
                            tbody {
                                @for axis in axes { (row(&axis.name, &axis.noise, &axis.sigma)) }
                                (row("together", noise, sigma))
                            }
                        }
                        figure.large {
                            (plots::log_log(&curves(axes, noise)))
                            figcaption { "Allan deviation, " (unit) ", by cluster time, s; dashed: fit of all axes" }
                        }
                    }
                }
            }
        };
        report::page(title, &self.verdict(), &[], &body)
    }
}

fn curves(axes: &[AxisNoise], noise: &Noise) -> Vec<(&'static str, Vec<[f64; 2]>)> {
    let points = |axis: &AxisNoise| {
        let clusters = axis.clusters.iter();
        clusters.map(|c| [c.time_s, c.variance.sqrt()]).collect()
    };
    let mut curves: Vec<(&str, Vec<[f64; 2]>)> =
        axes.iter().map(|a| ("measured", points(a))).collect();
    let times = axes.first().into_iter().flat_map(|a| a.clusters.iter());
    let fit = times
        .map(|c| [c.time_s, noise.deviation(c.time_s)])
        .collect();
    curves.push(("fit", fit));
    curves
}
