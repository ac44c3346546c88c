//! `report.html`: what a run achieved, on one page that opens anywhere (`lsfb-report`).
//!
//! A [`Report`] is plain data, so that whoever ran the stages fills it in; sections without data are left out.

use std::path::Path;

use lsfb_geometry::{StampedPose, Trajectory, Vector3};
use lsfb_types::{Finding, Judgement};
use maud::Markup;

use crate::compare::Comparison;
use crate::error::Error;
use crate::evaluation::{Evaluation, PoseError};

mod course;
mod cumulative;
mod equal_scale;
mod errors_over_time;
mod figure;
mod histogram;
mod inset;
mod page;
mod scene;
mod sections;
mod table;
mod timeline;
mod top_view;

pub(crate) use equal_scale::equal_scale;
pub use figure::Figure;
pub use inset::Inset;
pub use table::Table;
pub use timeline::{Marks, Stretch, Timeline, Upward};

/// All that the page shows.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// What was run, in a few words.
    pub title: String,
    /// What its figures do not say, a sentence or two before them; empty for none.
    pub introduction: String,
    /// The figures of the run; their limits, and `findings`, make the verdict.
    pub figures: Vec<Figure>,
    /// Map points in the world, metres; drawn thinned out.
    pub map_points: Vec<Vector3<f64>>,
    /// Trajectories in the world of the map.
    pub tracks: Vec<Track>,
    /// Parts of the view from above that are drawn again, larger.
    pub insets: Vec<Inset>,
    /// From where map and trajectories are seen.
    pub view: View,
    /// Several estimates in one table, best first.
    pub comparison: Vec<Comparison>,
    /// What went on over time, one plot each.
    pub timelines: Vec<Timeline>,
    /// Distributions, one plot each: reprojection errors of map and glasses.
    pub histograms: Vec<Distribution>,
    /// What is said in cells.
    pub tables: Vec<Table>,
    /// What stands in columns already: heading and lines.
    pub texts: Vec<(String, String)>,
    /// Values that went from step to step, one plot each.
    pub courses: Vec<Course>,
    /// How long each stage took, in the order they ran.
    pub stages: Vec<StageTime>,
    /// What else the reader should know before trusting a figure.
    pub findings: Vec<Finding>,
    /// Seed, versions, configuration, hashes of the inputs: name and value, which may have several lines.
    pub provenance: Vec<(String, String)>,
}

/// From where map and trajectories are seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum View {
    /// From above: the worlds of this project have z up.
    #[default]
    Above,
    /// Along the axis on which the trajectories extend least: the worlds of others have any axis up.
    Widest,
}

/// One trajectory with what is known of its error.
#[derive(Clone, Debug)]
pub struct Track {
    /// As the legend calls it: scanner, glasses. Several of one name stand there once.
    pub name: String,
    /// Which colour; that of its place among the tracks where none is said.
    pub series: Option<usize>,
    /// The estimate, in the world of the map.
    pub estimate: Trajectory,
    /// What it should have been; drawn dashed.
    pub truth: Option<Trajectory>,
    /// Errors pose by pose.
    pub errors: Vec<PoseError>,
}

impl Track {
    /// Of a judged estimate, in the world of its truth.
    pub fn of(name: &str, evaluation: &Evaluation, truth: &Trajectory) -> Self {
        Self {
            name: name.to_owned(),
            series: None,
            estimate: evaluation.aligned_estimate.clone(),
            truth: Some(truth.clone()),
            errors: evaluation.errors.clone(),
        }
    }
}

/// Values of which the page shows how they spread.
#[derive(Clone, Debug)]
pub struct Distribution {
    /// Heading.
    pub title: String,
    /// What the values are, without the unit.
    pub quantity: String,
    /// Unit of the values.
    pub unit: String,
    /// The values, none below zero; what is not finite is left out.
    pub values: Vec<f64>,
}

/// A value after each step of an iteration.
#[derive(Clone, Debug)]
pub struct Course {
    /// Heading, and what the values are, without the unit.
    pub title: String,
    /// What a step is.
    pub quantity: String,
    /// Unit of the values.
    pub unit: String,
    /// The values, in order of the steps, none below zero; what is not finite is left out.
    pub values: Vec<f64>,
}

/// How long a stage took.
#[derive(Clone, Debug)]
pub struct StageTime {
    /// Name of the stage.
    pub name: String,
    /// Wall-clock seconds.
    pub wall_secs: f64,
}

impl Report {
    /// The page of `lsfb eval`: one estimate against the truth.
    pub fn of_evaluation(name: &str, evaluation: &Evaluation, truth: &Trajectory) -> Self {
        Self {
            title: format!("{name} evaluated against ground truth"),
            figures: figure::of_evaluation(evaluation),
            tracks: vec![Track::of(name, evaluation, truth)],
            view: View::Widest,
            findings: evaluation.findings.clone(),
            ..Self::default()
        }
    }

    /// What follows from the limits of the figures and from the findings.
    pub fn judgement(&self) -> Judgement {
        let mut findings: Vec<Finding> = self.figures.iter().filter_map(Figure::finding).collect();
        findings.extend(self.findings.iter().cloned());
        Judgement::new(findings)
    }

    /// Map and trajectories from above as an SVG file of its own; `None` where there is neither.
    pub fn above_svg(&self) -> Option<String> {
        top_view::draw(self)?.plot.to_svg().ok()
    }

    /// The insets as SVG files of their own, with their names.
    pub fn inset_svgs(&self) -> Vec<(String, String)> {
        let insets = top_view::draw_insets(self).into_iter();
        insets
            .filter_map(|(name, plot)| Some((name, plot.to_svg().ok()?)))
            .collect()
    }

    /// The page as text.
    pub fn to_html(&self) -> String {
        page::render(self)
    }

    /// Writes the page.
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        std::fs::write(path, self.to_html()).map_err(|source| Error::Io {
            path: path.to_owned(),
            source,
        })
    }
}

/// Map and trajectories from above, for pages of others.
pub(crate) fn from_above_section(report: &Report) -> Markup {
    sections::from_above(report)
}

/// Errors over time and by size, for pages of others.
pub(crate) fn errors_section(report: &Report) -> Markup {
    sections::errors(report)
}

/// Neighbours further apart in time than this are not joined by a line: nobody knows what lies between.
fn longest_joined_secs(duration_secs: f64) -> f64 {
    (duration_secs / 50.0).max(1.0)
}

/// The same for poses.
fn break_secs(poses: &[StampedPose]) -> f64 {
    let ends = poses.first().zip(poses.last());
    longest_joined_secs(ends.map_or(0.0, |(first, last)| last.time.secs_since(first.time)))
}

#[cfg(test)]
mod tests;
