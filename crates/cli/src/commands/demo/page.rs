//! The demo's page: its figures, what the stages warned of, both trajectories beside the truth.

use lsfb_eval::report::{Distribution, Figure, Report, StageTime, Track};
use lsfb_sim::SimConfig;
use lsfb_types::Finding;

use super::super::groundtruth::WrittenTrajectory;
use super::super::groundtruth_page::spread;
use super::super::map::WrittenMap;
use super::{Errors, Summary};

/// What the figures are no proof of.
const EASY: &str = "The demo is easy: the walk follows the scan through the same small place, and \
    the rig is known exactly. It shows that all stages work; the standard trial, lsfb bench twin, \
    measures their accuracy.";

/// The page of a demo that went through.
pub(super) fn report(
    summary: &Summary,
    judged: &Errors,
    map: &WrittenMap,
    walk: &WrittenTrajectory,
    (figures, findings): (Vec<Figure>, Vec<Finding>),
    sim_config: &SimConfig,
) -> anyhow::Result<Report> {
    let walk_report = &walk.said.report;
    let distribution = |title: &str, values| Distribution {
        title: title.to_owned(),
        quantity: "reprojection error".to_owned(),
        unit: "px".to_owned(),
        values,
    };
    Ok(Report {
        title: format!("lsfb demo, seed {}", summary.seed),
        introduction: EASY.to_owned(),
        figures,
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
        findings,
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
) -> anyhow::Result<Vec<(String, String)>> {
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
    Ok(lines)
}
