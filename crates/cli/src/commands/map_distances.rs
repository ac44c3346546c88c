//! Distances between marks in a map's images: `lsfb map distances`, and the part of a map's page and verdict that they are.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_eval::report::{Figure, Report, Track};
use lsfb_eval::survey::{
    Judging, MarkDistance, compare_distances, expect_own_trajectory, judge_mark,
    judge_mark_distances, read_survey,
};
use lsfb_geometry::{Trajectory, Vector3};
use lsfb_pipeline::hd_map::{HdMap, MarkConfig, PlacedMark, PlacedMarks, read_clicks};
use lsfb_recording::{Provenance, read_tum};
use lsfb_types::{Finding, Judgement, Verdict};
use serde::{Deserialize, Serialize};

use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::files::{name_of, write};
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;
use crate::pages;

/// Lines that a reader still reads; `--json` has all.
const MOST_LINES: usize = 60;

/// Compare distances between marked points with tape measurements.
///
/// Clicks are lines of mark,camera,time_ns,u_px,v_px: name of the mark, camera, stamp of the image in
/// nanoseconds (its file name in `lsfb map export`), and pixel. Click each mark in three or more
/// images: any images with --trajectory, keyframes only without it. The measurements are a survey as
/// for `lsfb survey`: distance A B METRES, followed by σ if known. `lsfb sim` writes both for its scan:
/// marks.csv and truth/truth_marks.survey.
///
/// Exit code 4: the mean error is above 3 cm, or the largest above 5 cm.
///
/// Examples:
///   lsfb map distances map --marks marks.csv --trajectory scan.tum
///   lsfb map distances map --marks marks.csv --trajectory scan.tum --survey hall.survey --out distances.html
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct DistancesArguments {
    /// The map.
    #[arg(value_name = "MAP")]
    map: PathBuf,
    /// Clicks on the marks.
    #[arg(long, value_name = "CSV")]
    marks: PathBuf,
    /// Tape measurements between the marks.
    #[arg(long, value_name = "SURVEY")]
    survey: Option<PathBuf>,
    /// Trajectory from `lsfb map --out-trajectory` of this map, for poses of images between keyframes; any
    /// other is refused.
    #[arg(long, value_name = "TUM")]
    trajectory: Option<PathBuf>,
    /// Standard deviation of a click, in pixels; the observed scatter is used if larger.
    #[arg(long, value_name = "PX", default_value_t = MarkConfig::default().click_sigma_px)]
    click_sigma_px: f64,
    /// Also write a page.
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
}

/// Marks, their distances, and how far these are from what was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkedDistances {
    #[serde(flatten)]
    placed: PlacedMarks,
    /// Those that were measured; of all pairs where nothing was.
    distances: Vec<MarkDistance>,
    /// Mean and largest magnitude of the differences.
    #[serde(skip_serializing_if = "Option::is_none")]
    error_m: Option<[f64; 2]>,
    /// Measured distances of which an end has no place in the map.
    not_in_map: usize,
}

impl MarkedDistances {
    /// Places the marks, and compares their distances with a survey where there is one.
    pub fn of(
        map: &HdMap,
        trajectory: Option<&Trajectory>,
        marks: &Path,
        survey: Option<&Path>,
        config: &MarkConfig,
    ) -> anyhow::Result<Self> {
        let placed = map.place_marks(&read_clicks(marks)?, trajectory, config);
        let mark = |name: &String| placed.marks.iter().find(|m| m.name == *name);
        let Some(path) = survey else {
            let all = &placed.marks;
            let pairs = all.iter().enumerate();
            let pairs = pairs.flat_map(|(i, b)| all[..i].iter().map(move |a| (a, b)));
            return Ok(Self {
                distances: pairs.map(|(a, b)| distance(a, b)).collect(),
                placed,
                error_m: None,
                not_in_map: 0,
            });
        };
        let mut survey = read_survey(path)?;
        survey.points = placed
            .marks
            .iter()
            .map(|m| (m.name.clone(), Vector3::from(m.place_m)))
            .collect();
        let compared = super::about(path, compare_distances(&survey))?;
        // What the map was bent to does not judge it.
        let held = map.site().map_or(&[][..], |site| &site.control_points);
        let tapes = survey.tapes.iter();
        let distances: Vec<MarkDistance> = tapes
            .filter_map(|tape| {
                let ends = [mark(&tape.ends[0])?, mark(&tape.ends[1])?];
                let is_held = |mark: &&PlacedMark| held.contains(&mark.name);
                let judging = match ends.iter().all(is_held) {
                    true => Judging::HeldAtBothEnds,
                    false => Judging::May,
                };
                Some(distance(ends[0], ends[1]).measured(tape, judging))
            })
            .collect();
        Ok(Self {
            not_in_map: survey.tapes.len() - distances.len(),
            error_m: Some([compared.error_m.mean, compared.error_m.max]),
            distances,
            placed,
        })
    }

    /// What is to be said of them.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = self.placed.findings();
        if self.not_in_map > 0 {
            let what = format!(
                "{} measured distances end at marks that could not be placed",
                self.not_in_map
            );
            findings.push(Finding::new("distances-open", Verdict::Warn, "marks", what));
        }
        if self.error_m.is_some() {
            let marks = self.placed.marks.iter();
            findings.extend(marks.filter_map(|m| judge_mark(&m.name, m.worst_sigma_m())));
            findings.push(judge_mark_distances(&self.distances));
        }
        findings
    }

    /// For a page.
    pub fn figures(&self) -> Vec<Figure> {
        let mm = |name: &str, metres: f64| Figure::new(name, 1e3 * metres, "mm");
        let placed = &self.placed;
        let mut figures = vec![
            Figure::new("placed marks", placed.marks.len() as f64, ""),
            Figure::new("click scatter, 1 σ", placed.click_sigma_px, "px"),
        ];
        if let Some([mean_m, largest_m]) = self.error_m {
            figures.push(mm("distance error, mean", mean_m));
            figures.push(mm("distance error, max", largest_m));
        }
        figures
    }

    /// Marks and distances as lines of text.
    pub fn text(&self) -> String {
        let mut out = format!(
            "{:<12} {:>10} {:>10} {:>10} {:>8} {:>7} {:>9}\n",
            "mark", "x (m)", "y (m)", "z (m)", "σ (mm)", "clicks", "rms (px)"
        );
        for mark in self.placed.marks.iter().take(MOST_LINES) {
            let [x, y, z] = mark.place_m;
            let _ = writeln!(
                out,
                "{:<12} {x:>10.4} {y:>10.4} {z:>10.4} {:>8.1} {:>7} {:>9.2}",
                mark.name,
                1e3 * mark.worst_sigma_m(),
                mark.clicks,
                mark.reprojection_rms_px
            );
        }
        let _ = writeln!(
            out,
            "\n{:<20} {:>10} {:>8} {:>12} {:>10} {:>6}",
            "distance", "map (m)", "σ (mm)", "tape (m)", "off (mm)", "in σ"
        );
        for d in self.distances.iter().take(MOST_LINES) {
            let name = d.ends.join(" – ");
            let _ = write!(out, "{name:<20} {:>10.4} {:>8.1}", d.map_m, 1e3 * d.sigma_m);
            if let Some(m) = d.measured {
                let off_mm = 1e3 * m.error_m;
                let _ = write!(
                    out,
                    " {:>12.4} {off_mm:>10.1} {:>6.1}",
                    m.measured_m, m.sigmas
                );
            }
            out.push('\n');
        }
        if self.distances.len() > MOST_LINES {
            let _ = writeln!(
                out,
                "… and {} more (--json)",
                self.distances.len() - MOST_LINES
            );
        }
        if let Some([mean_m, largest_m]) = self.error_m {
            let _ = writeln!(
                out,
                "\nmean {:.2} cm, largest {:.2} cm (Table II of the paper: 6.61, 19.89)",
                100.0 * mean_m,
                100.0 * largest_m
            );
        }
        if !self.placed.marks.iter().all(|m| m.with_poses) {
            out += "this map does not have the covariances of its poses: σ is that of the clicks only\n";
        }
        out
    }
}

fn distance(a: &PlacedMark, b: &PlacedMark) -> MarkDistance {
    MarkDistance::new([a.name.clone(), b.name.clone()], a.distance_to(b))
}

/// Does it.
pub fn distances(arguments: &DistancesArguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = MarkConfig {
        click_sigma_px: arguments.click_sigma_px,
    };
    BadArgument::check(config.check_bounds(""), &[])?;
    let mut read: Vec<&Path> = vec![&arguments.marks];
    read.extend(arguments.survey.as_deref());
    read.extend(arguments.trajectory.as_deref());
    if let Some(out) = &arguments.out {
        context.claim(out, &read)?;
    }
    let map = super::open_map(&arguments.map)?;
    let trajectory = arguments.trajectory.as_deref().map(|path| {
        let trajectory = read_tum(path)?;
        super::about(path, expect_own_trajectory(map.keyframes(), &trajectory))?;
        anyhow::Ok(trajectory)
    });
    let trajectory = trajectory.transpose()?;
    let found = MarkedDistances::of(
        &map,
        trajectory.as_ref(),
        &arguments.marks,
        arguments.survey.as_deref(),
        &config,
    )?;
    let mut findings = found.findings();
    findings.extend(map.failed_checks());
    let judgement = Judgement::new(findings);
    let name = name_of(&arguments.map);
    if let Some(out) = &arguments.out {
        let mut provenance = Provenance::new(&config);
        for path in read {
            provenance.add_input(path)?;
        }
        provenance.add_input(&arguments.map.join(HdMap::HEADER))?;
        let page = Report {
            provenance: pages::settings(&provenance),
            ..page(&name, &map, &found, &judgement)
        };
        write(out, page.to_html())?;
        provenance.write(out)?;
    }
    let judged = Judged::new(&judgement, &name, &found);
    context.print(&judged, || {
        let mut text = format!("{}\n\n{}", judgement.headline(&name), found.text());
        let problems = problem_lines(&judgement);
        if !problems.is_empty() {
            text += &format!("\n{problems}");
        }
        text.trim_end().to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

fn page(name: &str, map: &HdMap, found: &MarkedDistances, judgement: &Judgement) -> Report {
    Report {
        title: format!("Distances in {name}"),
        figures: found.figures(),
        map_points: map.positions().collect(),
        tracks: vec![Track {
            name: "scanner".to_owned(),
            series: None,
            estimate: Trajectory::new(map.keyframes().collect()),
            truth: None,
            errors: Vec::new(),
        }],
        texts: vec![("Marks and distances".to_owned(), found.text())],
        findings: judgement.findings().to_vec(),
        ..Report::default()
    }
}
