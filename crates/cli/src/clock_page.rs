//! The page of `lsfb clock`.

use lsfb_capture::clock::{ClockReport, DeviceClock};
use lsfb_report::{Axis, Ink, Layer, Page, Plot, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

/// Share of the values that a plot must show at its top.
const SHOWN: f64 = 0.99;

/// The whole page.
pub fn page(recording: &str, report: &ClockReport, judgement: &Judgement) -> Page {
    let body = html! {
        p.note {
            "Estimated from the recorded counters and arrivals alone. The constant part of a \
             transport delay cannot be observed by any one-way method: it is part of the offsets, \
             and for a locked device it shows as the mean of the lower plot."
        }
        @if !report.devices.is_empty() { section { h2 { "Clocks" } (scroll(&table(report))) } }
        @for clock in &report.devices { (device(clock)) }
    };
    Page::new(format!("Clocks of {recording}"))
        .judged(judgement, &report.summary())
        .body(body)
}

fn table(report: &ClockReport) -> Markup {
    html! {
        table.numbers {
            thead { tr {
                th { "device" } th { "skew, ppm" } th { "σ, ppm" } th { "σ of the time, µs" } th { "epochs" }
                th { "median delay, ms" } th { "99th percentile of delays, ms" } th { "recorded stamps, rms µs" }
            } }
            tbody {
                @for clock in &report.devices {
                    tr {
                        td { (clock.device) }
                        @if let Some(last) = clock.epochs.last() {
                            td { (format!("{:+.3}", last.skew_ppm)) }
                            td { (format!("{:.3}", last.sigma_skew_ppm)) }
                            td { (format!("{:.1}", last.sigma_us)) }
                        } @else { td { "–" } td { "–" } td { "–" } }
                        td { (clock.epochs.len()) }
                        td { (format!("{:.2}", clock.delay_p50_ms)) }
                        td { (format!("{:.2}", clock.delay_p99_ms)) }
                        td { (format!("{:.1}", clock.recorded_rms_us)) }
                    }
                }
            }
        }
    }
}

fn device(clock: &DeviceClock) -> Markup {
    let kind = if clock.locked {
        "locked"
    } else {
        "fitted to arrivals"
    };
    let start_ns = clock.epochs.first().map_or(0, |e| e.arrival_start_ns);
    let first_secs = clock.samples.first().map_or(0.0, |s| s.secs);
    let steps: Vec<f64> = clock
        .epochs
        .iter()
        .skip(1)
        .map(|e| first_secs + (e.arrival_start_ns - start_ns) as f64 / 1e9)
        .collect();
    let delays: Vec<[f64; 2]> = clock.samples.iter().map(|s| [s.secs, s.delay_ms]).collect();
    let stamps: Vec<[f64; 2]> = clock
        .samples
        .iter()
        .map(|s| [s.secs, s.recorded_less_estimated_us])
        .filter(|[_, us]| us.is_finite())
        .collect();
    html! {
        section {
            h2 { (clock.device) ", " (kind) }
            figure {
                (plot("delay above the minimum", "delay (ms)", &delays, &steps, 0).draw())
                figcaption { "Delay above the minimum; the largest 1 % is cut off" @if !steps.is_empty() { "; red lines: its counter or the host's clock was set" } }
            }
            @if !stamps.is_empty() {
                figure {
                    (plot("recorded − estimated time", "difference (µs)", &stamps, &steps, 1).draw())
                    figcaption { "Recorded synchronized time − this estimate" }
                }
            }
        }
    }
}

/// Dots over time, and a line where the clock was set.
fn plot(name: &str, y_label: &str, points: &[[f64; 2]], steps: &[f64], series: usize) -> Plot {
    let mut values: Vec<f64> = points.iter().map(|[_, y]| *y).collect();
    values.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let at = (values.len().saturating_sub(1) as f64 * share) as usize;
        values.get(at).copied().unwrap_or(0.0)
    };
    let (low, high) = (quantile(1.0 - SHOWN).min(0.0), quantile(SHOWN).max(0.0));
    let margin = (0.05 * (high - low)).max(1e-3);
    let range = [low - margin, high + margin];
    let ends = points.first().zip(points.last());
    let shown = points
        .iter()
        .filter(|[_, y]| (range[0]..=range[1]).contains(y));
    let mut layers = vec![Layer::dots(shown.copied().collect(), Ink::Series(series))];
    let line = |secs: &f64| Layer::line(vec![[*secs, range[0]], [*secs, range[1]]], Ink::Bad);
    layers.extend(steps.iter().map(line));
    Plot {
        name: name.to_owned(),
        width_px: 900,
        height_px: 260,
        x: Axis::linear("time (s)", ends.map_or([0.0, 1.0], |(a, b)| [a[0], b[0]])),
        y: Axis::linear(y_label, range),
        layers,
    }
}
