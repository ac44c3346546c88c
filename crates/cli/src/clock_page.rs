//! The page of `lsfb clock`: two plots per device, no script, nothing from elsewhere.

use std::fmt::Write as _;

use lsfb_capture::clock::{ClockReport, DeviceClock};

const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 220.0;
const LEFT: f64 = 70.0;
const BOTTOM: f64 = 34.0;
const TOP: f64 = 10.0;
const RIGHT: f64 = 26.0;

/// The whole page.
pub fn html(recording: &str, report: &ClockReport) -> String {
    let mut out = String::from(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>Clocks</title><style>\
         body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1b1f24;background:#fff}\
         h1{font-size:1.4rem}h2{font-size:1.1rem;margin:2rem 0 .3rem}table{border-collapse:collapse;margin:.5rem 0}\
         td,th{padding:.15rem .8rem .15rem 0;text-align:right}th:first-child,td:first-child{text-align:left}\
         svg{width:100%;height:auto}.axis{stroke:#8a929b;stroke-width:1}.grid{stroke:#e3e6e9;stroke-width:1}\
         text{font-size:12px;fill:#4a525a}.delay{fill:#1f6feb;fill-opacity:.45}.stamp{fill:#bf5b04;fill-opacity:.55}\
         .step{stroke:#cf222e;stroke-width:1.5;stroke-dasharray:5 4}p{margin:.3rem 0}</style></head><body>",
    );
    let _ = write!(out, "<h1>Clocks of {}</h1>", escaped(recording));
    out.push_str(
        "<p>Estimated from the recorded counters and arrivals alone. The constant part of a transport delay cannot be seen \
         by any one-way method: it is in the offsets, and for a locked device it shows as the mean of the lower plot.</p>\
         <table><tr><th>device</th><th>skew, ppm</th><th>± (1σ)</th><th>σ of the time, µs</th><th>epochs</th>\
         <th>median delay, ms</th><th>99 %, ms</th><th>recorded stamps, rms µs</th></tr>",
    );
    for clock in &report.devices {
        let last = clock.epochs.last();
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{:+.3}</td><td>{:.3}</td><td>{:.1}</td><td>{}</td><td>{:.2}</td><td>{:.2}</td><td>{:.1}</td></tr>",
            escaped(&clock.device),
            last.map_or(f64::NAN, |e| e.skew_ppm),
            last.map_or(f64::NAN, |e| e.sigma_skew_ppm),
            last.map_or(f64::NAN, |e| e.sigma_us),
            clock.epochs.len(),
            clock.delay_p50_ms,
            clock.delay_p99_ms,
            clock.recorded_rms_us
        );
    }
    out.push_str("</table>");
    for clock in &report.devices {
        device(&mut out, clock);
    }
    out.push_str("</body></html>\n");
    out
}

fn device(out: &mut String, clock: &DeviceClock) {
    let kind = if clock.locked {
        "locked"
    } else {
        "fitted to arrival"
    };
    let _ = write!(out, "<h2>{} ({kind})</h2>", escaped(&clock.device));
    let start_ns = clock.epochs.first().map_or(0, |e| e.arrival_start_ns);
    let first_secs = clock.samples.first().map_or(0.0, |s| s.secs);
    let steps: Vec<f64> = clock
        .epochs
        .iter()
        .skip(1)
        .map(|e| first_secs + (e.arrival_start_ns - start_ns) as f64 / 1e9)
        .collect();
    let delays: Vec<[f64; 2]> = clock.samples.iter().map(|s| [s.secs, s.delay_ms]).collect();
    out.push_str("<p>Delay beyond the shortest, ms (largest 1 % cut off)</p>");
    plot(out, "delay", &delays, &steps);
    let stamps: Vec<[f64; 2]> = clock
        .samples
        .iter()
        .filter(|s| s.recorded_less_estimated_us.is_finite())
        .map(|s| [s.secs, s.recorded_less_estimated_us])
        .collect();
    if !stamps.is_empty() {
        out.push_str("<p>Recorded synchronized time less this estimate, µs</p>");
        plot(out, "stamp", &stamps, &steps);
    }
}

/// Dots over time; a dashed line where the clock was set.
fn plot(out: &mut String, class: &str, points: &[[f64; 2]], steps: &[f64]) {
    let mut values: Vec<f64> = points.iter().map(|[_, y]| *y).collect();
    values.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let at = ((values.len().saturating_sub(1)) as f64 * share) as usize;
        values.get(at).copied().unwrap_or(0.0)
    };
    let (low, high) = (quantile(0.002).min(0.0), quantile(0.99).max(0.0));
    let margin = if high - low < 1e-9 {
        1.0
    } else {
        0.05 * (high - low)
    };
    let (low, high) = (low - margin, high + margin);
    let (start, end) = (
        points.first().map_or(0.0, |p| p[0]),
        points.last().map_or(1.0, |p| p[0]).max(1e-3),
    );
    let x = |secs: f64| LEFT + (secs - start) / (end - start).max(1e-9) * (WIDTH - LEFT - RIGHT);
    let y = |value: f64| TOP + (high - value) / (high - low) * (HEIGHT - TOP - BOTTOM);
    let _ = write!(out, "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\">");
    for tick in ticks(low, high) {
        let _ = write!(
            out,
            "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{}\" y1=\"{1:.1}\" y2=\"{1:.1}\"/><text x=\"{2}\" y=\"{3:.1}\" text-anchor=\"end\">{4}</text>",
            WIDTH - RIGHT,
            y(tick),
            LEFT - 8.0,
            y(tick) + 4.0,
            number(tick)
        );
    }
    for tick in ticks(start, end) {
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{} s</text>",
            x(tick),
            HEIGHT - 12.0,
            number(tick)
        );
    }
    let _ = write!(
        out,
        "<line class=\"axis\" x1=\"{LEFT}\" x2=\"{LEFT}\" y1=\"{TOP}\" y2=\"{}\"/>",
        HEIGHT - BOTTOM
    );
    for [secs, value] in points.iter().filter(|[_, v]| (low..=high).contains(v)) {
        let _ = write!(
            out,
            "<circle class=\"{class}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"1.3\"/>",
            x(*secs),
            y(*value)
        );
    }
    for step in steps {
        let _ = write!(
            out,
            "<line class=\"step\" x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"{TOP}\" y2=\"{1}\"/>",
            x(*step),
            HEIGHT - BOTTOM
        );
    }
    out.push_str("</svg>");
}

/// Four to eight round values between two others.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let raw = (high - low).max(1e-9) / 5.0;
    let power = 10_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|m| m * power)
        .into_iter()
        .find(|s| *s >= raw)
        .unwrap_or(raw);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|n| n as f64 * step).collect()
}

fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
