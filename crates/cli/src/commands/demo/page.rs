//! The demo's page: its figures, what the stages warned of, both trajectories beside the truth.

use lsfb_eval::report::{self, Distribution, Figure, Report, StageTime, Track};
use lsfb_sim::SimConfig;
use lsfb_types::{Finding, Limit};

use super::super::groundtruth::WrittenTrajectory;
use super::super::groundtruth_page::spread;
use super::super::map::WrittenMap;
use super::{Errors, Summary};

/// What the figures are no proof of.
const EASY: &str = "The demo is easy: the walk follows the scan through the same small place, and \
    the rig is known exactly. It shows that all stages work; the standard trial, lsfb bench twin, \
    measures their accuracy.";

/// Limits of the first figures: they make the report's verdict.
const MAX_ATE_M: f64 = 0.03;
const MAX_REPROJECTION_PX: f64 = 1.5;

/// The page of a demo that went through.
pub(super) fn report(
    summary: &Summary,
    judged: &Errors,
    map: &WrittenMap,
    walk: &WrittenTrajectory,
    findings: &[Finding],
    sim_config: &SimConfig,
) -> anyhow::Result<Report> {
    let (mapping, walk_report) = (&map.report, &walk.said.report);
    let distribution = |title: &str, values| Distribution {
        title: title.to_owned(),
        quantity: "reprojection error".to_owned(),
        unit: "px".to_owned(),
        values,
    };
    Ok(Report {
        title: format!("lsfb demo, seed {}", summary.seed),
        introduction: EASY.to_owned(),
        figures: vec![
            Figure::new("glasses ATE, rms", summary.ate_glasses_rms_m * 100.0, "cm")
                .with(Limit::AtMost(MAX_ATE_M * 100.0)),
            Figure::new("glasses ATE, max", summary.ate_glasses_max_m * 100.0, "cm"),
            Figure::new(
                "glasses in the map, rms",
                summary.ate_glasses_in_map_rms_m * 100.0,
                "cm",
            ),
            Figure::new("scanner ATE, rms", summary.ate_scanner_rms_m * 100.0, "cm")
                .with(Limit::AtMost(MAX_ATE_M * 100.0)),
            Figure::new("scanner ATE, max", summary.ate_scanner_max_m * 100.0, "cm"),
            Figure::new("map reprojection, rms", summary.map_reprojection_px, "px")
                .with(Limit::AtMost(MAX_REPROJECTION_PX)),
            Figure::new(
                "map reprojection before Eq. 4",
                mapping.reprojection_rms_before_px,
                "px",
            ),
            Figure::new(
                "glasses reprojection, rms",
                walk_report.map_errors.rms_px,
                "px",
            ),
            Figure::new("glasses localized", summary.glasses_localized * 100.0, "%"),
            Figure::new("map points", summary.map_points as f64, ""),
            Figure::new("messages lost", summary.lost as f64, "").with(Limit::AtMost(0.0)),
            Figure::new("parts of the walk left out", summary.left_out as f64, "")
                .with(Limit::AtMost(0.0)),
            Figure::new("wall time", summary.wall_s, "s").with(Limit::AtMost(300.0)),
            Figure::new("peak memory", summary.peak_rss_mb, "MB").with(Limit::AtMost(4096.0)),
        ],
        map_points: map
            .map
            .positions()
            .map(|point| judged.truth_from_map * point)
            .collect(),
        tracks: vec![
            Track::of("scanner", &judged.scanner, &judged.truth_scanner),
            Track::of("glasses", &judged.glasses, &judged.truth_glasses),
        ],
        histograms: vec![
            distribution(
                "Map",
                map.reprojection_errors_px
                    .iter()
                    .copied()
                    .map(f64::from)
                    .collect(),
            ),
            distribution("Glasses", spread(&walk_report.map_errors)),
        ],
        stages: summary
            .stages_s
            .iter()
            .map(|(name, wall_secs)| StageTime {
                name: name.clone(),
                wall_secs: *wall_secs,
            })
            .collect(),
        findings: findings.to_vec(),
        provenance: provenance(summary, map, walk, sim_config)?,
        ..Report::default()
    })
}

/// What was run on what, and the hashes of what came out.
fn provenance(
    summary: &Summary,
    map: &WrittenMap,
    walk: &WrittenTrajectory,
    sim_config: &SimConfig,
) -> anyhow::Result<Vec<report::Provenance>> {
    let mut lines = vec![
        ("seed".to_owned(), summary.seed.to_string()),
        ("lsfb".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ];
    for inputs in [&map.provenance.inputs, &walk.provenance.inputs] {
        let hashed = inputs.iter();
        lines.extend(hashed.map(|(name, hash)| (format!("{name}, SHA-256"), hash.clone())));
    }
    for path in [
        &summary.outputs.scan_trajectory,
        &summary.outputs.walk_trajectory,
    ] {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        lines.push((format!("{name}, SHA-256"), lsfb_recording::sha256_of(path)?));
    }
    lines.push(("simulation".to_owned(), toml::to_string(sim_config)?));
    let lines = lines.into_iter();
    Ok(lines
        .map(|(name, value)| report::Provenance { name, value })
        .collect())
}
