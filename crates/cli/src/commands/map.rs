//! `lsfb map`: a scan → HD map, and the tools for maps.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_pipeline::hd_map::{HdMap, MarkConfig, read_clicks, read_control_points};
use lsfb_pipeline::mapping::{
    Control, Inputs, MappingConfig, MappingReport, Start, build_map_in_stages,
};
use lsfb_pipeline::stored_clouds::StoredClouds;
use lsfb_recording::{Provenance, read_tum, write_tum};
use lsfb_types::Judgement;
use serde::{Deserialize, Serialize};

use super::map_control;
use super::map_coverage::findings;
use super::map_distances::MarkedDistances;
use super::map_posed::PosedMapJob;
use super::map_report::MapPage;
use super::map_settings;
use super::map_surface::check_source;
use super::map_tools::{self, Tool};
use super::models::ModelFolder;
use crate::context::Context;
use crate::outcome::Outcome;
use crate::standing;

/// Build an HD map from a recording or posed images; inspect, export, crop or merge maps.
///
/// A map that is up to date is not built again, and an interrupted run resumes from OUT.unfinished.
/// Poses of images may be in any unit of length; the map keeps it.
///
/// Examples:
///   lsfb map scan.mcap --out map --out-trajectory scan.tum --out-report map.html
///   lsfb map scan.mcap --trajectory other-slam.tum --out map
///   lsfb map scan.mcap --trajectory scan.tum --stored-clouds clouds.mcap --out map
///   lsfb map scan.mcap --marks marks.csv --survey hall.survey --out map --out-report map.html
///   lsfb map scan.mcap --marks marks.csv --control-points control_points.csv --out map --out-trajectory scan.tum
///   lsfb map --posed-images hololens_office --holdout-every 5 --out office-map --out-report map.html
///   lsfb map --posed-images hololens_office --feature xfeat --out office-map
///   lsfb map --posed-images nerfstudio/scene --out scene-map
///   lsfb map info map
#[derive(clap::Args)]
#[command(
    verbatim_doc_comment,
    after_long_help = map_settings::help_of_map(),
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
pub struct Arguments {
    #[command(subcommand)]
    tool: Option<Tool>,
    #[command(flatten)]
    build: Option<BuildArguments>,
}

#[derive(clap::Args)]
struct BuildArguments {
    /// Recording of the scanner.
    #[arg(
        value_name = "MCAP",
        required_unless_present = "posed_images",
        conflicts_with = "posed_images"
    )]
    recording: Option<PathBuf>,
    /// Images with known poses: a folder with nerfstudio's transforms.json; a kapture; a COLMAP project or
    /// model; a folder with K.txt, poses_T_world_cam_rowmajor4x4.txt and images/; a 7-Scenes sequence; or a
    /// Strecha scene.
    #[arg(long, value_name = "FOLDER")]
    posed_images: Option<PathBuf>,
    /// Start Eq. 4 from this trajectory of the rig, made by another SLAM system, instead of from the
    /// odometry.
    #[arg(long, value_name = "TUM", conflicts_with = "posed_images")]
    trajectory: Option<PathBuf>,
    /// Take planes and edges from the scans of this recording that `lsfb odometry --out-clouds` stored.
    #[arg(long, value_name = "MCAP", conflicts_with = "posed_images")]
    stored_clouds: Option<PathBuf>,
    /// Clicks on marks in the recording's images, as for `lsfb map distances`; the distances between them
    /// become part of the verdict and the page.
    #[arg(long, value_name = "CSV", conflicts_with = "posed_images")]
    marks: Option<PathBuf>,
    /// Tape measurements between those marks.
    #[arg(long, value_name = "SURVEY", requires = "marks")]
    survey: Option<PathBuf>,
    /// Surveyed coordinates of at least three of those marks, not all on one line: lines of
    /// mark,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m (or a single sigma_m) in metres, z up. The map is
    /// fixed to those that agree, and it and its trajectory are then in their frame.
    #[arg(long, value_name = "CSV", requires = "marks")]
    control_points: Option<PathBuf>,
    /// Hold out every n-th of those images, to localize them later.
    #[arg(long, value_name = "N", requires = "posed_images", value_parser = clap::value_parser!(u32).range(2..))]
    holdout_every: Option<u32>,
    /// Map to write (folder).
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Also write the scanner's trajectory.
    #[arg(long, value_name = "TUM", conflicts_with = "posed_images")]
    out_trajectory: Option<PathBuf>,
    /// Also write a page: residuals before and after Eq. 4 (of posed images: reprojection errors, before and
    /// after cameras and poses were refined), coverage, poorly covered stretches.
    #[arg(long, value_name = "HTML")]
    out_report: Option<PathBuf>,
    /// Features of the map: sift (the default), or a network added with `lsfb models add`; aliked-t16 is
    /// recommended, aliked-n16rot for cameras that roll (docs/features.md).
    #[arg(long, value_name = "NAME")]
    feature: Option<String>,
    /// Folder of model weights; by default $LSFB_MODELS, otherwise lsfb/models in $XDG_DATA_HOME.
    // No flattened struct: with one inside, this optional struct would never be there.
    #[arg(long, value_name = "FOLDER")]
    models: Option<PathBuf>,
    /// Settings instead of the defaults; `lsfb map --help` lists them.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

#[derive(Serialize)]
struct MapSummary<'a, R> {
    map: PathBuf,
    points: usize,
    keyframes: usize,
    observations: usize,
    #[serde(flatten)]
    judgement: &'a Judgement,
    report: R,
}

/// What is said of a map of a recording.
#[derive(Serialize)]
struct Reported<'a> {
    #[serde(flatten)]
    report: &'a MappingReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    marks: Option<&'a MarkedDistances>,
}

/// Builds, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    if let Some(tool) = &arguments.tool {
        return map_tools::run(tool, context);
    }
    let arguments = arguments.build.as_ref().context("give a recording")?;
    if let Some(folder) = &arguments.posed_images {
        return from_posed_images(folder, arguments, context);
    }
    let recording = arguments.recording.as_deref().context("give a recording")?;
    let mut config = map_settings::mapping(arguments.config.as_deref())?;
    if let Some(name) = &arguments.feature {
        config.learned = ModelFolder::new(arguments.models.as_deref()).feature(name)?;
    }
    let job = MapJob {
        recording,
        out: &arguments.out,
        out_trajectory: arguments.out_trajectory.as_deref(),
        out_report: arguments.out_report.as_deref(),
        config: &config,
        start: arguments.trajectory.as_deref(),
        clouds: arguments.stored_clouds.as_deref(),
        marks: arguments.marks.as_deref().map(|clicks| MarkFiles {
            clicks,
            survey: arguments.survey.as_deref(),
            control_points: arguments.control_points.as_deref(),
        }),
    };
    let read = job.inputs();
    let built = job.build(context, |result| context.claim(result, &read))?;
    let marked = built.marked.as_ref();
    let judgement = built.judgement();
    let r = &built.report;
    let report = Reported {
        report: r,
        marks: marked,
    };
    let summary = summary(&arguments.out, &built.map, &judgement, report);
    context.print(&summary, || {
        let text = format!(
            "{}: {} points, {} observations in {} images, reprojection {:.3} px rms, median {:.3} px ({:.3} px rms before Eq. 4)",
            arguments.out.display(),
            r.points,
            r.observations,
            r.images,
            r.reprojection_rms_px,
            r.reprojection_median_px,
            r.reprojection_rms_before_px
        );
        let marks = marked.map_or_else(String::new, |m| format!("\n\n{}", m.text()));
        let control = r.control.as_ref();
        let control = control.map_or_else(String::new, |c| format!("\n\n{}", map_control::text(c)));
        text + &sentences(&judgement) + control.trim_end() + marks.trim_end()
    })?;
    Ok(match Outcome::of(judgement.verdict()) {
        Outcome::Done if !r.is_whole() => Outcome::DataLost,
        outcome => outcome,
    })
}

/// A map that was written, and where it comes from.
pub struct WrittenMap {
    pub map: HdMap,
    pub report: MappingReport,
    /// Of every observation in the map.
    pub reprojection_errors_px: Vec<f32>,
    /// Distances between marks, where there are any.
    pub marked: Option<MarkedDistances>,
    pub provenance: Provenance,
}

impl WrittenMap {
    /// What page, terminal and JSON say of it.
    pub fn judgement(&self) -> Judgement {
        judgement_of(&self.map, &self.report, self.marked.as_ref())
    }
}

fn judgement_of(
    map: &HdMap,
    report: &MappingReport,
    marked: Option<&MarkedDistances>,
) -> Judgement {
    let mut findings = findings(map, report);
    findings.extend(marked.iter().flat_map(|marked| marked.findings()));
    Judgement::new(findings)
}

/// What is said of a map that stands.
#[derive(Serialize, Deserialize)]
struct Said {
    report: MappingReport,
    reprojection_errors_px: Vec<f32>,
    marked: Option<MarkedDistances>,
}

/// Clicks on marks, and what was measured between these.
#[derive(Clone, Copy)]
pub struct MarkFiles<'a> {
    pub clicks: &'a Path,
    pub survey: Option<&'a Path>,
    /// Surveyed places of some of them, which hold the map.
    pub control_points: Option<&'a Path>,
}

/// A map to be built of a recording.
pub struct MapJob<'a> {
    pub recording: &'a Path,
    pub out: &'a Path,
    pub out_trajectory: Option<&'a Path>,
    pub out_report: Option<&'a Path>,
    pub config: &'a MappingConfig,
    /// The trajectory to start from instead of the odometry's.
    pub start: Option<&'a Path>,
    /// The scans as the odometry stored them.
    pub clouds: Option<&'a Path>,
    pub marks: Option<MarkFiles<'a>>,
}

impl MapJob<'_> {
    /// All files that it reads.
    fn inputs(&self) -> Vec<&Path> {
        let mut read = vec![self.recording];
        read.extend(self.start);
        read.extend(self.clouds);
        if let Some(marks) = self.marks {
            read.push(marks.clicks);
            read.extend(marks.survey);
            read.extend(marks.control_points);
        }
        read
    }

    /// Builds the map and writes it, its trajectory and where both come from, unless they stand. `claim` is asked before
    /// anything is replaced.
    pub fn build(
        &self,
        context: &Context,
        claim: impl Fn(&Path) -> anyhow::Result<()>,
    ) -> anyhow::Result<WrittenMap> {
        let outputs: Vec<&Path> = [Some(self.out), self.out_trajectory, self.out_report]
            .into_iter()
            .flatten()
            .collect();
        let scan = context.open(self.recording)?;
        let mut provenance = Provenance::new(self.config);
        for path in self.inputs() {
            provenance.add_input(path)?;
        }
        provenance.add_rig(&super::about(self.recording, scan.rig())?);
        if let Some(Said {
            report,
            reprojection_errors_px,
            marked,
        }) = context.standing(&outputs, &provenance)
        {
            return Ok(WrittenMap {
                map: super::open_map(self.out)?,
                report,
                reprojection_errors_px,
                marked,
                provenance,
            });
        }
        let start = self.start.map(|path| {
            check_source(path, self.recording)?;
            anyhow::Ok(read_tum(path)?)
        });
        let start = start.transpose()?;
        let clouds = self.clouds.map(|path| {
            check_source(path, self.recording)?;
            let features = &self.config.lidar_features;
            anyhow::Ok(StoredClouds::open(path, &scan, features, &|p| {
                context.show(p)
            })?)
        });
        let clouds = clouds.transpose()?;
        let control = self
            .marks
            .and_then(|marks| Some((marks.clicks, marks.control_points?)));
        let control = control.map(|(clicks, points)| {
            let control = Control::new(read_control_points(points)?, &read_clicks(clicks)?);
            super::about(points, control)
        });
        let control = control.transpose()?;
        outputs.iter().try_for_each(|result| claim(result))?;
        let stages = context.kept_stages(self.out, &provenance)?;
        let inputs = Inputs {
            recording: &scan,
            start: start.as_ref().map_or(Start::Odometry, Start::Given),
            clouds: clouds.as_ref(),
            control: control.as_ref(),
        };
        let result = super::about(
            self.recording,
            build_map_in_stages(&inputs, self.config, &stages, &|p| context.show(p)),
        )?;
        let marked = self.marks.map(|marks| {
            let (along, config) = (Some(&result.trajectory), MarkConfig::default());
            MarkedDistances::of(&result.map, along, marks.clicks, marks.survey, &config)
        });
        let marked = marked.transpose()?;
        standing::forget(&outputs)?;
        result.map.write(self.out)?;
        provenance.write(self.out)?;
        if let Some(path) = self.out_trajectory {
            write_tum(path, &result.trajectory)?;
            let failures = result.map.failures().to_vec();
            provenance.with_failures(failures).write(path)?;
        }
        let errors_px = result.report.reprojection_errors_px.iter();
        let said = Said {
            reprojection_errors_px: errors_px.map(|px| *px as f32).collect(),
            report: result.report,
            marked,
        };
        if let Some(path) = self.out_report {
            let page = MapPage {
                name: &self.recording.display().to_string(),
                map: &result.map,
                report: &said.report,
                reprojection_errors_px: &said.reprojection_errors_px,
                marked: said.marked.as_ref(),
                judgement: &judgement_of(&result.map, &said.report, said.marked.as_ref()),
                made_from: &provenance,
            };
            super::write(path, page.to_html())?;
            provenance.write(path)?;
        }
        standing::finish(&outputs, &[], &provenance, &said)?;
        stages.remove()?;
        Ok(WrittenMap {
            map: result.map,
            report: said.report,
            reprojection_errors_px: said.reprojection_errors_px,
            marked: said.marked,
            provenance,
        })
    }
}

fn from_posed_images(
    folder: &Path,
    arguments: &BuildArguments,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let mut config = map_settings::posed_map(arguments.config.as_deref())?;
    if let Some(name) = &arguments.feature {
        config.learned = ModelFolder::new(arguments.models.as_deref()).feature(name)?;
    }
    let job = PosedMapJob {
        folder,
        holdout_every: arguments.holdout_every.unwrap_or(0),
        out: &arguments.out,
        out_report: arguments.out_report.as_deref(),
        config: &config,
    };
    let built = job.build(context)?;
    let judgement = Judgement::new(built.findings);
    let r = &built.report;
    let summary = summary(&arguments.out, &built.map, &judgement, r);
    context.print(&summary, || {
        let listed = r.as_listed.map_or_else(String::new, |listed| {
            format!(
                " ({:.3} px with the cameras and poses given)",
                listed.reprojection_rms_px
            )
        });
        let text = format!(
            "{}: {} points, {} observations in {} images of {} keyframes, reprojection {:.3} px rms, median {:.3} px{listed}",
            arguments.out.display(),
            r.points,
            r.observations,
            r.images,
            r.keyframes,
            r.reprojection_rms_px,
            r.reprojection_median_px
        );
        text + &sentences(&judgement)
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// What needs a look, a line each.
fn sentences(judgement: &Judgement) -> String {
    let lines = judgement.problems();
    lines.map(|f| format!("\n  {}", f.sentence())).collect()
}

fn summary<'a, R>(
    out: &Path,
    map: &HdMap,
    judgement: &'a Judgement,
    report: R,
) -> MapSummary<'a, R> {
    MapSummary {
        map: out.to_owned(),
        points: map.point_count(),
        keyframes: map.keyframe_count(),
        observations: map.observation_count(),
        judgement,
        report,
    }
}
