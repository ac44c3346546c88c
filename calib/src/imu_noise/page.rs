//! The report as one HTML page.

use lsfb_report::{Axis, Ink, Layer, Page, Plot, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::{AxisNoise, ImuNoise, Noise};

impl ImuNoise {
    /// What was found, in a few words.
    pub fn summary(&self) -> String {
        format!(
            "{:.0} min at {:.0} Hz: gyroscope {:.2e} rad/s/√Hz, accelerometer {:.2e} m/s²/√Hz",
            self.duration_s / 60.0,
            self.rate_hz,
            self.gyro.density,
            self.accel.density
        )
    }

    /// Whether the result may be used, and how far.
    pub fn judgement(&self) -> Judgement {
        Judgement::new(self.findings.clone())
    }

    /// The page.
    pub fn page(&self, title: &str) -> Page {
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
        let table = |unit: &str, axes: &[AxisNoise], noise: &Noise, sigma: &Noise| {
            html! {
                table.numbers {
                    thead { tr { th { "axis" } th { "noise density, " (unit) "/√Hz" } th { "bias instability, " (unit) } th { "random walk, " (unit) "/s/√Hz" } } }
                    tbody {
                        @for axis in axes { (row(&axis.name, &axis.noise, &axis.sigma)) }
                        (row("together", noise, sigma))
                    }
                }
            }
        };
        let body = html! {
            @for (name, unit, (noise, sigma), axes) in triads {
                section {
                    h2 { (name) }
                    (scroll(&table(unit, axes, noise, sigma)))
                    figure {
                        (deviation(unit, axes, noise))
                        figcaption { "Allan deviation of each axis by cluster time; dashed: fit of all axes" }
                    }
                }
            }
        };
        Page::new(title)
            .judged(&self.judgement(), &self.summary())
            .body(body)
    }
}

/// Allan deviations over both logarithmic axes.
fn deviation(unit: &str, axes: &[AxisNoise], noise: &Noise) -> Markup {
    let of_axis = |axis: &AxisNoise| -> Vec<[f64; 2]> {
        let clusters = axis.clusters.iter();
        clusters.map(|c| [c.time_s, c.variance.sqrt()]).collect()
    };
    let measured: Vec<Vec<[f64; 2]>> = axes.iter().map(of_axis).collect();
    let all = || measured.iter().flatten();
    let times = axes.first().into_iter().flat_map(|a| &a.clusters);
    let fit = times.map(|c| [c.time_s, noise.deviation(c.time_s)]);
    let fit = Layer::line(fit.collect(), Ink::Truth);
    let (x, y) = (
        Axis::decades("cluster time (s)", all().map(|p| p[0])),
        Axis::decades(format!("Allan deviation ({unit})"), all().map(|p| p[1])),
    );
    let lines = measured.into_iter().enumerate();
    let lines = lines.map(|(k, points)| Layer::line(points, Ink::Series(k)));
    let plot = Plot {
        name: "Allan deviation".to_owned(),
        width_px: 640,
        height_px: 340,
        x,
        y,
        layers: lines.chain([fit]).collect(),
    };
    plot.draw()
}
