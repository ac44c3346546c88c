//! The page of a trial.

use lsfb_report::{Page, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::result::Run;
use super::summary::{Group, MeanAndWorst};

/// The whole page.
pub fn page(runs: &[Run], groups: &[Group], judgement: &Judgement, title: &str) -> Page {
    let body = html! {
        p.note {
            "Simulated recordings: walks go beside the scanner's path, and rigs are calibrated with \
             a simulated board. Walk errors are given after aligning each walk, as in the paper's \
             Tables IV and V; wrong poses are counted in the map's frame without alignment. Jitter \
             is the trajectory's motion above 5 Hz that is not in the truth; image-to-image jitter \
             is the second difference of the errors, also given for images localized one by one. \
             The map is in view where enough of its points lie in the image and were mapped from a \
             similar side and distance, by the device's true pose. \
             docs/twin.md lists what remains too easy."
        }
        section {
            h2 { "Summary" }
            p.note { "Walks in places as they were scanned: mean (worst) over the runs with a trajectory." }
            (scroll(&summary(groups)))
        }
        section { h2 { "Runs" } (scroll(&errors(runs))) }
        section { h2 { "Time and memory" } (scroll(&costs(runs))) }
        section { h2 { "Calibrated vs. true rigs" } (scroll(&rigs(runs))) }
    };
    Page::new(title)
        .judged(judgement, &format!("{} runs", runs.len()))
        .body(body)
}

fn number(value: Option<f64>, factor: f64, digits: usize) -> String {
    value.map_or("–".to_owned(), |v| format!("{:.digits$}", factor * v))
}

fn mean_and_worst(value: Option<MeanAndWorst>, factor: f64, digits: usize) -> String {
    value.map_or("–".to_owned(), |v| {
        format!(
            "{:.digits$} ({:.digits$})",
            factor * v.mean,
            factor * v.worst
        )
    })
}

fn summary(groups: &[Group]) -> Markup {
    html! {
        table.numbers {
            thead { tr {
                th { "place, device" } th { "walks" } th { "refused" } th { "ATE rms, cm" } th { "target, cm" }
                th { "ATE of localization alone, cm" } th { "image-to-image jitter, mm" } th { "single-image jitter, mm" }
                th { "error between frames, mm" } th { "error between frames, °" } th { "poses within 95 %, %" }
                th { "map in view, s" } th { "poses available there, %" }
            } }
            tbody {
                @for group in groups {
                    tr {
                        td { (group.name()) }
                        td { (group.walks) }
                        td { (group.refused) }
                        td { (mean_and_worst(group.ate_rms_m, 100.0, 2)) }
                        td { (number(group.ate_asked_m, 100.0, 1)) }
                        td { (mean_and_worst(group.localized_ate_rms_m, 100.0, 2)) }
                        td { (mean_and_worst(group.jitter_solved_m, 1e3, 2)) }
                        td { (mean_and_worst(group.jitter_localized_m, 1e3, 2)) }
                        td { (mean_and_worst(group.between_frames_m, 1e3, 2)) }
                        td { (mean_and_worst(group.between_frames_deg, 1.0, 3)) }
                        td { (number(group.within_95, 100.0, 1)) }
                        td { (format!("{:.0}", group.map_in_view_s)) }
                        td { (number(group.answered(), 100.0, 0)) }
                    }
                }
            }
        }
    }
}

fn errors(runs: &[Run]) -> Markup {
    html! {
        table.numbers {
            thead { tr {
                th { "run" } th { "motion" } th { "distance from path (10, 50, 90 %), m" } th { "scanner ATE, cm" } th { "drift, %" }
                th { "reprojection, px" } th { "localized, %" } th { "correct, %" } th { "ATE rms, cm" }
                th { "ATE max, cm" } th { "in the map, cm" } th { "jitter, mm" }
                th { "image-to-image jitter, mm" } th { "single-image jitter, mm" } th { "ratio" } th { "error between frames, mm" }
                th { "error between frames, °" } th { "ATE of localization alone, cm" } th { "poses within 95 %, %" } th { "exported" } th { "wrong" }
                th { "left out, s" } th { "map in view, s" } th { "poses available there, s" } th { "warnings" } th { "refused" }
            } }
            tbody {
                @for run in runs {
                    tr {
                        td { (run.name()) }
                        td { (run.motion) }
                        td {
                            (number(run.off_path_p10_m, 1.0, 2)) ", " (number(run.off_path_m, 1.0, 2)) ", "
                            (number(run.off_path_p90_m, 1.0, 2))
                        }
                        td { (number(run.scanner_ate_rms_m, 100.0, 2)) }
                        td { (number(run.drift_percent, 1.0, 2)) }
                        td { (number(run.reprojection_px, 1.0, 2)) }
                        td { (number(run.localized, 100.0, 0)) }
                        td { (number(run.localized_right, 100.0, 0)) }
                        td { (number(run.ate_rms_m, 100.0, 2)) }
                        td { (number(run.ate_max_m, 100.0, 2)) }
                        td { (number(run.in_map_rms_m, 100.0, 2)) }
                        td { (number(run.jitter_m, 1e3, 2)) }
                        td { (number(run.jitter_solved_m, 1e3, 2)) }
                        td { (number(run.jitter_localized_m, 1e3, 2)) }
                        td { (number(run.jitter_ratio, 1.0, 0)) }
                        td { (number(run.between_frames_m, 1e3, 2)) }
                        td { (number(run.between_frames_deg, 1.0, 3)) }
                        td { (number(run.localized_ate_rms_m, 100.0, 2)) }
                        td { (number(run.within_95, 100.0, 1)) }
                        td { (run.exported) }
                        td { (run.exported_wrong) }
                        td { (format!("{:.1}", run.dropped_s)) }
                        td { (number(run.map_in_view_s, 1.0, 1)) }
                        td { (number(run.answered_in_view_s, 1.0, 1)) }
                        td.words { (run.problem_codes.join(", ")) }
                        td.words { (run.refused.as_deref().unwrap_or_default()) }
                    }
                }
            }
        }
    }
}

fn costs(runs: &[Run]) -> Markup {
    html! {
        @if runs.iter().any(|run| run.beside_others) {
            p.note {
                "Runs marked * had stages that ran while other places were processed: their times are longer than alone, and the \
                 memory of these places is included. --at-once 1 measures each stage on its own."
            }
        }
        table.numbers {
            thead { tr { th { "run" } th { "stages, s" } th { "peak memory by stage, MB" } } }
            tbody {
                @for run in runs {
                    tr {
                        td { (run.name()) }
                        td.words { (by_stage(&run.stages_s)) }
                        td.words { (by_stage(&run.stages_peak_rss_mb)) @if run.beside_others { " *" } }
                    }
                }
            }
        }
    }
}

fn by_stage(values: &[(String, f64)]) -> String {
    let all: Vec<String> = values
        .iter()
        .map(|(stage, value)| format!("{stage} {value:.0}"))
        .collect();
    all.join(", ")
}

fn rigs(runs: &[Run]) -> Markup {
    let mut listed = Vec::new();
    for run in runs {
        for off in &run.rigs_off {
            if !listed.contains(&(run.seed, off)) {
                listed.push((run.seed, off));
            }
        }
    }
    html! {
        table.numbers {
            thead { tr {
                th { "sensor" } th { "seed" } th { "rotation, °" } th { "translation, mm" } th { "focal length, %" } th { "clock, ms" }
            } }
            tbody {
                @for (seed, off) in listed {
                    tr {
                        td { (off.sensor) }
                        td { (seed) }
                        td { (format!("{:.3}", off.rotation_deg)) }
                        td { (format!("{:.1}", off.translation_mm)) }
                        td { (number(off.focal_percent, 1.0, 3)) }
                        td { (number(off.clock_ms, 1.0, 3)) }
                    }
                }
            }
        }
    }
}
