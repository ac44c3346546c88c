//! Control points of a map: as lines of text, and as figures of its page.

use std::fmt::Write as _;

use lsfb_eval::report::Figure;
use lsfb_pipeline::hd_map::SiteFrame;
use lsfb_pipeline::mapping::ControlReport;

/// Lines that a reader still reads; `--json` has all.
const MOST_LINES: usize = 60;

/// For the page of a map.
pub fn figures(report: &ControlReport) -> Vec<Figure> {
    let mm = |name: &str, metres: f64| Figure::new(name, 1e3 * metres, "mm");
    let [before_m, after_m] = report.rms_m();
    let held = report.marks.iter().filter(|mark| mark.holds).count();
    vec![
        Figure::new("control points used", held as f64, ""),
        mm("control point error before, rms", before_m),
        mm("control point error, rms", after_m),
    ]
}

/// Each control point as a line.
pub fn text(report: &ControlReport) -> String {
    let mut out = format!(
        "{:<14} {:>11} {:>10} {:>12} {:>7} {:>6}\n",
        "control point", "before (mm)", "after (mm)", "others (mm)", "in σ", "clicks"
    );
    for mark in report.marks.iter().take(MOST_LINES) {
        let from_others_m = mark.from_others_m.iter().map(|m| m * m).sum::<f64>().sqrt();
        let _ = writeln!(
            out,
            "{:<14} {:>11.1} {:>10.1} {:>12.1} {:>7.1} {:>6}{}",
            mark.name,
            1e3 * mark.before_m,
            1e3 * mark.after_m,
            1e3 * from_others_m,
            mark.from_others_sigmas,
            mark.clicks,
            if mark.holds { "" } else { "  left out" }
        );
    }
    if report.marks.len() > MOST_LINES {
        let more = report.marks.len() - MOST_LINES;
        let _ = writeln!(out, "… and {more} more (--json)");
    }
    out
}

/// The frame in which a map stands.
pub fn of_site(site: &SiteFrame) -> String {
    let [x, y, z] = site.origin_m;
    let shift = match site.origin_m == [0.0; 3] {
        true => String::new(),
        false => format!(" less ({x}, {y}, {z}) m"),
    };
    format!(
        "in the surveyed frame{shift}, from {} control points: {}",
        site.control_points.len(),
        site.control_points.join(", ")
    )
}
