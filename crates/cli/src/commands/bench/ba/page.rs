//! The page: time of each update, and each solver in a few figures.

use lsfb_report::{Axis, Ink, Layer, Page, Plot, ink_css};
use maud::html;

use super::runs::{Run, Summary};

const SIZE_PX: [u32; 2] = [760, 340];

/// Like the paper's Fig. 4.
pub fn page_of(runs: &[Run], summaries: &[Summary], about: &str) -> Page {
    let last = runs.iter().flat_map(|run| run.updates.last());
    let last = last.map(|u| u.keyframe).max().unwrap_or(1);
    let times = runs
        .iter()
        .flat_map(|run| run.updates.iter().map(|u| u.cpu_ms));
    let lines = runs.iter().enumerate().map(|(k, run)| {
        let points = run.updates.iter().map(|u| [u.keyframe as f64, u.cpu_ms]);
        Layer::line(points.filter(|p| p[1] > 0.0).collect(), Ink::Series(k))
    });
    let plot = Plot {
        name: "CPU time of each update".to_owned(),
        width_px: SIZE_PX[0],
        height_px: SIZE_PX[1],
        x: Axis::linear("keyframes", [0.0, last as f64]),
        y: Axis::decades("CPU time (ms)", times),
        layers: lines.collect(),
    };
    let legend = html! {
        @for (k, run) in runs.iter().enumerate() {
            span.key { span.line style=(format!("border-color:{}", ink_css(k))) {} (run.name) " " }
        }
    };
    Page::new("Bundle adjustment, keyframe by keyframe").body(html! {
        section {
            h2 { "Time per update" }
            p { (about) }
            figure { (plot.draw()) figcaption { (legend) } }
        }
        section {
            h2 { "Results" }
            @for summary in summaries { p { (summary.line()) } }
        }
    })
}
