//! The page of a map: residuals before and after Eq. (4), coverage, weak stretches.

use lsfb_eval::report::{Course, Distribution, Figure, Report, Table, Track};
use lsfb_geometry::{StampedPose, Trajectory};
use lsfb_pipeline::hd_map::{CameraResiduals, HdMap, PixelResiduals};
use lsfb_pipeline::mapping::{MappingReport, RoundReport};
use lsfb_recording::Provenance;
use lsfb_types::Judgement;

use super::map_control;
use super::map_coverage::{Coverage, MIN_OBSERVATIONS_PER_KEYFRAME};
use super::map_distances::MarkedDistances;
use crate::pages;

/// What the page is made from.
pub struct MapPage<'a> {
    pub name: &'a str,
    pub map: &'a HdMap,
    pub report: &'a MappingReport,
    /// Of every observation, pixels.
    pub reprojection_errors_px: &'a [f32],
    /// Distances between marks.
    pub marked: Option<&'a MarkedDistances>,
    pub judgement: &'a Judgement,
    pub made_from: &'a Provenance,
}

impl MapPage<'_> {
    /// The page as text.
    pub fn to_html(&self) -> String {
        let coverage = Coverage::of(self.map);
        let report = self.report;
        let (before, after) = (&report.lidar_before, &report.lidar_after);
        let mm = |name: &str, metres: f64| Figure::new(name, metres * 1e3, "mm");
        let px = |name: &str, px: f64| Figure::new(name, px, "px");
        let mut texts = vec![("Iterations of Eq. (4)".to_owned(), rounds(report))];
        let control = report.control.as_ref().map(map_control::text);
        texts.extend(control.map(|text| ("Control points".to_owned(), text)));
        let marked = self.marked.map(MarkedDistances::text);
        texts.extend(marked.map(|text| ("Marks and distances".to_owned(), text)));
        Report {
            title: format!("Map of {}", self.name),
            figures: vec![
                px(
                    "reprojection error before Eq. 4, rms",
                    report.reprojection_rms_before_px,
                ),
                px("reprojection, rms", report.reprojection_rms_px),
                px("reprojection, median", report.reprojection_median_px),
                mm("distance from planes before, rms", before.plane_rms_m),
                mm("distance from planes, rms", after.plane_rms_m),
                mm("distance from edges before, rms", before.edge_rms_m),
                mm("distance from edges, rms", after.edge_rms_m),
            ]
            .into_iter()
            .chain(coverage.figures(report.dropped_observations, report.outlier_share))
            .chain(report.control.iter().flat_map(map_control::figures))
            .chain(self.marked.iter().flat_map(|marked| marked.figures()))
            .collect(),
            courses: courses(report),
            tables: vec![by_camera(&report.by_camera), by_region(report)],
            map_points: self.map.positions().collect(),
            tracks: coverage.tracks("scanner"),
            histograms: coverage
                .histograms(self.reprojection_errors_px.iter().map(|e| f64::from(*e))),
            texts,
            findings: self.judgement.findings().to_vec(),
            provenance: pages::settings(self.made_from),
            ..Report::default()
        }
        .to_html()
    }
}

impl Coverage {
    /// The keyframes under this name, and those that see too little.
    pub fn tracks(&self, name: &str) -> Vec<Track> {
        let tracks = [
            track(name, self.keyframes.clone()),
            track("poorly covered", self.weak.clone()),
        ];
        let tracks = tracks.into_iter();
        tracks.filter(|track| !track.estimate.is_empty()).collect()
    }

    /// How much is in the map, and what was left out of it: observations, and their share beyond the limit.
    pub fn figures(&self, dropped_observations: u64, outlier_share: f64) -> [Figure; 6] {
        let count = |name: &str, value: u64| Figure::new(name, value as f64, "");
        [
            count("map points", self.track_lengths.len() as u64),
            count("keyframes", self.keyframes.len() as u64),
            count("observations", self.track_lengths.iter().sum()),
            count("unused observations", dropped_observations),
            Figure::new("unused observations, share", 100.0 * outlier_share, "%"),
            count("poorly covered keyframes", self.weak.len() as u64),
        ]
    }

    /// Distributions of these reprojection errors, and of the observations.
    pub fn histograms(&self, errors_px: impl Iterator<Item = f64>) -> Vec<Distribution> {
        vec![
            distribution("Reprojection", "reprojection error", "px", errors_px),
            distribution(
                "Coverage",
                "observations per keyframe",
                "",
                self.observations.iter().map(|n| *n as f64),
            ),
            distribution(
                "Tracks",
                "observations per point",
                "",
                self.track_lengths.iter().map(|n| *n as f64),
            ),
        ]
    }
}

pub fn track(name: &str, poses: Vec<StampedPose>) -> Track {
    Track {
        name: name.to_owned(),
        series: None,
        estimate: Trajectory::new(poses),
        truth: None,
        errors: Vec::new(),
    }
}

fn distribution(
    title: &str,
    quantity: &str,
    unit: &str,
    values: impl Iterator<Item = f64>,
) -> Distribution {
    Distribution {
        title: title.to_owned(),
        quantity: quantity.to_owned(),
        unit: unit.to_owned(),
        values: values.collect(),
    }
}

/// Reprojection of each camera before and after.
pub fn by_camera(cameras: &[CameraResiduals]) -> Table {
    let rows = cameras.iter().map(|camera| {
        let mut row = vec![camera.camera.clone(), camera.after.count.to_string()];
        row.extend(pixels(&camera.before));
        row.extend(pixels(&camera.after));
        row
    });
    table(
        "Residuals by camera",
        &["camera", "keypoints"],
        &PIXELS,
        rows.collect(),
    )
}

/// Residuals before and after Eq. (4), and coverage, of each region on the way.
fn by_region(report: &MappingReport) -> Table {
    let rows = report.by_region.iter().map(|region| {
        let [x, y, z] = region.center_m;
        let is_weak = region.fewest_observations < MIN_OBSERVATIONS_PER_KEYFRAME;
        let mut row = vec![
            format!("({x:.1}, {y:.1}, {z:.1})"),
            region.keyframes.to_string(),
            format!("{:.0}", region.median_observations),
            format!(
                "{}{}",
                region.fewest_observations,
                if is_weak { ": weak" } else { "" }
            ),
        ];
        row.extend(pixels(&region.before));
        row.extend(pixels(&region.after));
        let (before, after) = (&region.lidar_before, &region.lidar_after);
        let distances = [
            (before.plane_matches, before.plane_rms_m),
            (after.plane_matches, after.plane_rms_m),
            (before.edge_matches, before.edge_rms_m),
            (after.edge_matches, after.edge_rms_m),
        ];
        row.extend(distances.map(|(count, rms_m)| measured(count, 1e3 * rms_m, 1)));
        row
    });
    let head = [
        &PIXELS[..],
        &[
            "planes before, mm rms",
            "planes, mm rms",
            "edges before, mm rms",
            "edges, mm rms",
        ],
    ];
    table(
        "Residuals and coverage by 5 m region, along the trajectory",
        &[
            "centre, m",
            "keyframes",
            "observations per keyframe, median",
            "fewest",
        ],
        &head.concat(),
        rows.collect(),
    )
}

/// What [`pixels`] gives before and after Eq. (4).
const PIXELS: [&str; 4] = [
    "reprojection before, px rms",
    "outliers before, %",
    "reprojection, px rms",
    "outliers, %",
];

fn pixels(residuals: &PixelResiduals) -> [String; 2] {
    [
        measured(residuals.count, residuals.rms_px, 2),
        measured(residuals.count, 100.0 * residuals.outlier_share, 1),
    ]
}

/// A number, or that nothing was measured.
fn measured(count: u64, value: f64, digits: usize) -> String {
    match count {
        0 => "none".to_owned(),
        _ => format!("{value:.digits$}"),
    }
}

fn table(title: &str, first: &[&str], head: &[&str], rows: Vec<Vec<String>>) -> Table {
    let head = first.iter().chain(head).map(|name| (*name).to_owned());
    Table {
        title: title.to_owned(),
        head: head.collect(),
        rows,
    }
}

/// How far keyframes still moved, and what the scans still lay apart, round by round.
fn courses(report: &MappingReport) -> Vec<Course> {
    let course = |title: &str, unit: &str, value: &dyn Fn(&RoundReport) -> f64| Course {
        title: title.to_owned(),
        quantity: "iteration of correspondences and Eq. (4)".to_owned(),
        unit: unit.to_owned(),
        values: report.rounds.iter().map(value).collect(),
    };
    vec![
        course("Largest movement of a keyframe", "mm", &|r| 1e3 * r.moved_m),
        course("Plane matches", "", &|r| r.plane_matches as f64),
        course("Final cost of Eq. (4)", "", &|r| r.final_cost),
    ]
}

/// One line a round.
fn rounds(report: &MappingReport) -> String {
    let lines = report.rounds.iter().enumerate().map(|(i, r)| {
        format!(
            "{}: {} planes, {} edges, {} observations; cost {:.1} → {:.1} in {} iterations; moved at most {:.1} mm, {:.3}°",
            i + 1,
            r.plane_matches,
            r.edge_matches,
            r.observations,
            r.initial_cost,
            r.final_cost,
            r.iterations,
            r.moved_m * 1e3,
            r.turned_deg
        )
    });
    lines.collect::<Vec<_>>().join("\n")
}
