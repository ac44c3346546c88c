//! The page of a map: residuals before and after Eq. (4), coverage, weak stretches.

use lsfb_eval::report::{Course, Distribution, Figure, Provenance, Report, Table, Track};
use lsfb_geometry::{StampedPose, Trajectory};
use lsfb_pipeline::hd_map::{CameraResiduals, HdMap, PixelResiduals};
use lsfb_pipeline::mapping::{MappingReport, RoundReport};
use lsfb_types::{Finding, Limit, Verdict};

use super::map_control;
use super::map_distances::MarkedDistances;

/// A keyframe with fewer observations of map points than this could hardly be found in its own map.
const MIN_OBSERVATIONS_PER_KEYFRAME: u64 = 30;

/// What the page is made from.
pub struct MapPage<'a> {
    pub name: &'a str,
    pub map: &'a HdMap,
    pub report: &'a MappingReport,
    /// Of every observation, pixels.
    pub reprojection_errors_px: &'a [f32],
    /// Distances between marks.
    pub marked: Option<&'a MarkedDistances>,
}

/// What every reader of a map should know: warnings of its odometry and its mapping, and where nobody would be found.
pub fn findings(map: &HdMap, report: &MappingReport) -> Vec<Finding> {
    let mut findings = report.findings();
    findings.push(coverage(map));
    findings
}

/// Whether enough of the map is seen from everywhere on the way.
pub fn coverage(map: &HdMap) -> Finding {
    Coverage::of(map).finding()
}

impl MapPage<'_> {
    /// The page as text.
    pub fn to_html(&self) -> String {
        let coverage = Coverage::of(self.map);
        let report = self.report;
        let (before, after) = (&report.lidar_before, &report.lidar_after);
        let mm = |name: &str, metres: f64| Figure::new(name, metres * 1e3, "mm");
        let px = |name: &str, px: f64| Figure::new(name, px, "px");
        let mut findings = findings(self.map, report);
        let mut provenance = vec![Provenance {
            name: "iterations of Eq. (4)".to_owned(),
            value: rounds(report),
        }];
        provenance.extend(report.control.as_ref().map(|control| Provenance {
            name: "control points".to_owned(),
            value: map_control::text(control),
        }));
        let marked_figures = self.marked.map_or_else(Vec::new, |marked| {
            findings.extend(marked.findings());
            provenance.push(Provenance {
                name: "marks and distances".to_owned(),
                value: marked.text(),
            });
            marked.figures()
        });
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
            .chain(marked_figures)
            .collect(),
            courses: courses(report),
            tables: vec![by_camera(&report.by_camera), by_region(report)],
            map_points: self.map.positions().collect(),
            tracks: coverage.tracks("scanner"),
            histograms: coverage
                .histograms(self.reprojection_errors_px.iter().map(|e| f64::from(*e))),
            findings,
            provenance,
            ..Report::default()
        }
        .to_html()
    }
}

/// How many observations of map points each keyframe has.
pub struct Coverage {
    keyframes: Vec<StampedPose>,
    observations: Vec<u64>,
    track_lengths: Vec<u64>,
    /// Keyframes that see too little.
    pub weak: Vec<StampedPose>,
}

impl Coverage {
    /// Of a map.
    pub fn of(map: &HdMap) -> Self {
        let keyframes: Vec<StampedPose> = map.keyframes().collect();
        let mut observations = vec![0; keyframes.len()];
        let mut track_lengths = vec![0; map.point_count()];
        for (point, length) in track_lengths.iter_mut().enumerate() {
            for seen in map.observations(point as u32) {
                *length += 1;
                if let Some(count) = observations.get_mut(seen.keyframe as usize) {
                    *count += 1;
                }
            }
        }
        let of_keyframe = keyframes.iter().zip(&observations);
        let is_weak = |(_, count): &(&StampedPose, &u64)| **count < MIN_OBSERVATIONS_PER_KEYFRAME;
        let weak = of_keyframe.filter(is_weak).map(|(pose, _)| *pose).collect();
        Self {
            keyframes,
            observations,
            track_lengths,
            weak,
        }
    }

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

    /// Whether enough of the map is seen from everywhere on the way.
    pub fn finding(&self) -> Finding {
        let (weak, all) = (self.weak.len(), self.keyframes.len());
        let limit = MIN_OBSERVATIONS_PER_KEYFRAME;
        match self.weak.first() {
            None => Finding::new(
                "coverage",
                Verdict::Pass,
                "coverage",
                format!("each of {all} keyframes sees at least {limit} map points"),
            ),
            Some(first) => {
                let place = first.world_from_rig.translation;
                Finding::new(
                    "coverage",
                    Verdict::Warn,
                    "coverage",
                    format!(
                        "{weak} of {all} keyframes see fewer than {limit} map points, the first at ({:.1}, {:.1}, {:.1})",
                        place.x, place.y, place.z
                    ),
                )
                .remedy("walk there more slowly, with light and texture in view; walks cannot be localized there")
            }
        }
        .value(weak as f64, "")
        .limit(Limit::AtMost(0.0))
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
