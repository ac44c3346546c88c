//! Distances between marks in a map's images: `lsfb map distances`, and the part of a map's page and verdict that they are.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_eval::report::{Figure, Provenance as Line, Report, Track};
use lsfb_eval::survey::{Tape, compare_distances, read_survey};
use lsfb_geometry::{StampedPose, Trajectory, Vector3};
use lsfb_pipeline::hd_map::{HdMap, MarkConfig, PlacedMark, PlacedMarks, read_clicks};
use lsfb_recording::{Provenance, read_tum};
use lsfb_types::{Finding, Judgement, Limit, Verdict};
use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::files::{name_of, write};
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;

/// What is asked of a map of centimetres, metres: mean and largest difference from what was measured. The paper's has 6.61 and 19.89 cm.
const MEAN_M: f64 = 0.03;
const LARGEST_M: f64 = 0.05;
/// A difference of more standard deviations is not by chance.
const CHANCE_SIGMAS: f64 = 4.0;
/// A distance that clicks and tape do not tell better than this judges no map, metres, 1 σ.
const JUDGING_SIGMA_M: f64 = 0.5 * LARGEST_M;
/// A trajectory that a map was written with passes through its keyframes, but for the digits of files: metres and degrees.
const SAME_M: f64 = 0.005;
const SAME_DEG: f64 = 0.1;
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

/// A distance in the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct MarkDistance {
    ends: [String; 2],
    map_m: f64,
    /// Standard deviation of that.
    sigma_m: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    measured: Option<Measured>,
}

/// What a tape says of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Measured {
    measured_m: f64,
    /// Map less measured.
    error_m: f64,
    /// The same in standard deviations of both.
    sigmas: f64,
    /// Whether it is told well enough to judge the map, and not between two marks that hold the map.
    judges: bool,
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
                distances: pairs.map(|(a, b)| distance(a, b, None)).collect(),
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
                let judged = !ends.iter().all(is_held);
                Some(distance(ends[0], ends[1], Some((tape, judged))))
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
        let mut findings = Vec::new();
        let warn = |name: &'static str, subject: &str, what: String| {
            Finding::new(name, Verdict::Warn, subject, what)
        };
        for mark in &self.placed.unplaced {
            let finding = warn(
                "mark-unplaced",
                &mark.name,
                format!("could not be placed: {}", mark.reason),
            );
            findings.push(
                finding.remedy("click it again, in three images or more, from several sides"),
            );
        }
        for mark in &self.placed.marks {
            if mark.left_out > 0 {
                let what = format!(
                    "{} of its {} clicks disagree with the others and are not used",
                    mark.left_out,
                    mark.left_out + mark.clicks
                );
                findings.push(warn("mark-clicks", &mark.name, what).remedy(
                    "check the clicks in those images; if they are right, the map is bent there",
                ));
            }
            if !mark.is_checked() {
                let what = "has only two clicks: a wrong one would not be noticed".to_owned();
                findings.push(
                    warn("mark-unchecked", &mark.name, what).remedy("click it in a third image"),
                );
            }
        }
        if self.placed.clicks_without_pose > 0 {
            let what = format!(
                "{} clicks are in images without a known pose, or of a camera that the map does not have",
                self.placed.clicks_without_pose
            );
            findings.push(warn("clicks-without-pose", "marks", what).remedy(
                "give the trajectory of the map (--trajectory), or click in images of its keyframes",
            ));
        }
        if self.not_in_map > 0 {
            let what = format!(
                "{} measured distances end at marks that could not be placed",
                self.not_in_map
            );
            findings.push(warn("distances-open", "marks", what));
        }
        for mark in &self.placed.marks {
            let sigma_m = mark.worst_sigma_m();
            if self.error_m.is_some() && sigma_m > JUDGING_SIGMA_M {
                let what = format!("standard deviation is {:.1} cm, too large", 100.0 * sigma_m);
                findings.push(
                    warn("mark-weak", &mark.name, what)
                        .value(sigma_m, "m")
                        .limit(Limit::AtMost(JUDGING_SIGMA_M))
                        .remedy("click it in images taken farther apart"),
                );
            }
        }
        findings.extend(self.error_m.map(|_| self.agreement()));
        findings
    }

    fn agreement(&self) -> Finding {
        let measured = || self.distances.iter().filter_map(|d| d.measured);
        let beyond = measured()
            .filter(|m| m.sigmas.abs() > CHANCE_SIGMAS)
            .count();
        let judging: Vec<f64> = measured()
            .filter(|m| m.judges)
            .map(|m| m.error_m.abs())
            .collect();
        let (all, count) = (self.distances.len(), judging.len());
        let mean_m = judging.iter().sum::<f64>() / count.max(1) as f64;
        let largest_m = judging.iter().copied().fold(0.0, f64::max);
        let verdict = match mean_m <= MEAN_M && largest_m <= LARGEST_M {
            false => Verdict::Fail,
            true if beyond > 0 => Verdict::Warn,
            true if count == 0 => Verdict::Unknown,
            true => Verdict::Pass,
        };
        let what = format!(
            "{count} of {all} distances, those accurate to {:.1} cm or better and not between two control points, off by {:.1} mm on average (limit {:.0}), at most {:.1} mm; {beyond} of all by more than {CHANCE_SIGMAS} σ",
            100.0 * JUDGING_SIGMA_M,
            1e3 * mean_m,
            1e3 * MEAN_M,
            1e3 * largest_m
        );
        Finding::new("distances", verdict, "marks", what)
            .value(largest_m, "m")
            .limit(Limit::AtMost(LARGEST_M))
            .remedy("measure the worst distance again; if it is right, the map is bent there")
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

/// With a tape's length goes whether it may judge the map.
fn distance(a: &PlacedMark, b: &PlacedMark, tape: Option<(&Tape, bool)>) -> MarkDistance {
    let [map_m, sigma_m] = a.distance_to(b);
    MarkDistance {
        ends: [a.name.clone(), b.name.clone()],
        map_m,
        sigma_m,
        measured: tape.map(|(tape, may_judge)| {
            let error_m = map_m - tape.distance_m;
            let both_m = sigma_m.hypot(tape.sigma_m);
            Measured {
                measured_m: tape.distance_m,
                error_m,
                sigmas: error_m / both_m,
                judges: may_judge && both_m <= JUDGING_SIGMA_M,
            }
        }),
    }
}

/// Does it.
pub fn distances(arguments: &DistancesArguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = MarkConfig {
        click_sigma_px: arguments.click_sigma_px,
    };
    anyhow::ensure!(
        config.click_sigma_px > 0.0 && config.click_sigma_px.is_finite(),
        "--click-sigma-px must be above zero"
    );
    let mut read: Vec<&Path> = vec![&arguments.marks];
    read.extend(arguments.survey.as_deref());
    read.extend(arguments.trajectory.as_deref());
    if let Some(out) = &arguments.out {
        context.claim(out, &read)?;
    }
    let map = super::open_map(&arguments.map)?;
    let trajectory = arguments.trajectory.as_deref().map(|path| {
        let trajectory = read_tum(path)?;
        check_passes_through(map.keyframes(), &trajectory, path)?;
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
    findings.extend(
        map.failures()
            .iter()
            .map(|what| Finding::new("map-failed", Verdict::Fail, "map", what.clone())),
    );
    let judgement = Judgement::new(findings);
    let name = name_of(&arguments.map);
    if let Some(out) = &arguments.out {
        write(out, page(&name, &map, &found, &judgement).to_html())?;
        let mut provenance = Provenance::new(&config);
        for path in read {
            provenance.add_input(path)?;
        }
        provenance.add_input(&arguments.map.join(HdMap::HEADER))?;
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

/// Refuses a trajectory that is not the map's: its own distances would be judged, and a bent map would pass.
fn check_passes_through(
    keyframes: impl Iterator<Item = StampedPose>,
    trajectory: &Trajectory,
    path: &Path,
) -> anyhow::Result<()> {
    let moves: Vec<[f64; 2]> = keyframes
        .filter_map(|keyframe| {
            let moved = keyframe.world_from_rig.inverse() * trajectory.at(keyframe.time)?;
            Some([
                moved.translation.norm(),
                moved.rotation.angle().to_degrees(),
            ])
        })
        .collect();
    const WANTED: &str = "give the trajectory that `lsfb map --out-trajectory` wrote with the map";
    anyhow::ensure!(
        !moves.is_empty(),
        "{}: no keyframe of the map lies within this trajectory: {WANTED}",
        path.display()
    );
    let [far_m, far_deg] = moves.iter().fold([0.0; 2], |most, moved| {
        [0, 1].map(|i| f64::max(most[i], moved[i]))
    });
    anyhow::ensure!(
        far_m <= SAME_M && far_deg <= SAME_DEG,
        "{}: this is not the trajectory of this map: at its keyframes it differs by up to {:.1} cm and {far_deg:.2}°; {WANTED}",
        path.display(),
        100.0 * far_m
    );
    Ok(())
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
        findings: judgement.findings().to_vec(),
        provenance: vec![Line {
            name: "marks and distances".to_owned(),
            value: found.text(),
        }],
        ..Report::default()
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Se3, UnitQuaternion};
    use lsfb_types::Timestamp;

    use super::*;

    /// The true trajectory of a map that was bent by decimetres: FAIL became WARN, exit code 0.
    #[test]
    fn a_trajectory_that_is_not_the_maps_is_refused() {
        let along = |stretch: f64, secs: std::ops::Range<i64>| -> Vec<StampedPose> {
            secs.map(|secs| StampedPose {
                time: Timestamp::from_nanos(secs * 1_000_000_000),
                world_from_rig: Se3::new(
                    UnitQuaternion::identity(),
                    Vector3::new(stretch * secs as f64, 0.0, 0.0),
                ),
            })
            .collect()
        };
        let keyframes: Vec<_> = along(1.0, 0..9).into_iter().step_by(3).collect();
        let said = |trajectory| {
            let trajectory = Trajectory::new(trajectory);
            check_passes_through(keyframes.iter().copied(), &trajectory, Path::new("t.tum"))
                .err()
                .map(|error| error.to_string())
        };
        assert_eq!(said(along(1.0, 0..9)), None);
        assert_eq!(said(along(1.0, 0..5)), None, "it need not reach all");
        let other = said(along(1.01, 0..9)).expect("refused");
        assert!(other.contains("up to 6.0 cm and 0.00°"), "{other}");
        let later = said(along(1.0, 20..30)).expect("refused");
        assert!(later.contains("no keyframe"), "{later}");
    }
}
