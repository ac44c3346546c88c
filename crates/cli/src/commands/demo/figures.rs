//! The figures of a demo and their limits, which with the findings of its stages make its verdict.

use lsfb_eval::report::Figure;
use lsfb_pipeline::ground_truth::GroundTruthReport;
use lsfb_pipeline::mapping::MappingReport;
use lsfb_types::Limit;

use super::Summary;

const MAX_ATE_M: f64 = 0.03;
const MAX_REPROJECTION_PX: f64 = 1.5;
const MAX_WALL_S: f64 = 300.0;
const MAX_PEAK_RSS_MB: f64 = 4096.0;

/// All figures; those without a limit inform.
pub(super) fn figures(
    summary: &Summary,
    mapping: &MappingReport,
    walk_report: &GroundTruthReport,
) -> Vec<Figure> {
    vec![
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
        Figure::new("wall time", summary.wall_s, "s").with(Limit::AtMost(MAX_WALL_S)),
        Figure::new("peak memory", summary.peak_rss_mb, "MB").with(Limit::AtMost(MAX_PEAK_RSS_MB)),
    ]
}
