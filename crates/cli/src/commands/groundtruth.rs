//! `lsfb groundtruth`: a walk and an HD map → trajectory.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::bail;
use lsfb_eval::radio::{PlacedReading, read_table};
use lsfb_geometry::Trajectory;
use lsfb_pipeline::ground_truth::{
    GroundTruth, GroundTruthConfig, GroundTruthReport, ground_truth_in_stages,
    ground_truth_together,
};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::kept_stages::KeptStages;
use lsfb_recording::{Provenance, Recording, read_tum};
use lsfb_types::{Finding, Judgement, Verdict};
use serde::{Deserialize, Serialize};

use super::groundtruth_page::WalkPage;
use super::models::ModelFolder;
use super::surroundings::Surroundings;
use super::walk_files::WalkFiles;
use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::files;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;
use crate::refused::Refused;
use crate::standing;

/// Compute the ground-truth trajectory of a walk in an HD map.
///
/// Poses that are uncertain, or that move when parts of the map are withheld, are left out; the exit
/// code is then 3 and the findings say why. Exit code 4: do not use the trajectory, because the map's
/// scale differs from the IMU's by more than 5 % (map-scale), images and IMU agree only with IMU errors
/// above 12 σ (imu-errors), a camera is more than 10 σ off the rig file (camera-off), or the barometer
/// puts part of the walk on another floor (barometer); or there is none, because the walk was refused.
///
/// The finding place-not-checked says for how long the place could not be told from one built alike;
/// looks-alike warns of a walk that fits nearly as well elsewhere. Trust those poses only if there is
/// no such place.
///
/// Written beside WALK.tum: WALK_covariance.txt (poses with covariance, for `lsfb eval`),
/// WALK_states.csv and WALK_states.mcap (states at the IMU's rate), WALK_cross_check.txt. All files and
/// findings are explained in docs/groundtruth.md.
///
/// A trajectory that is up to date is not computed again; an interrupted run resumes after the images
/// that it had localized.
///
/// Examples:
///   lsfb groundtruth walk.mcap --map map --out walk.tum
///   lsfb groundtruth walk.mcap --map map --out walk.tum --out-report walk.html
///   lsfb groundtruth phone.mcap --with glasses.mcap --map map --out phone.tum
///   lsfb groundtruth walk2.mcap --map map --radio radio.csv --out walk2.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording of a walk with a phone or glasses.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// HD map (folder).
    #[arg(long, value_name = "FOLDER")]
    map: PathBuf,
    /// Trajectory to write, in the map's world frame.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Also write a page: the trajectory in the map, its standard deviations over time, what was left out
    /// and why. Not written for a walk that is refused.
    #[arg(long, value_name = "HTML")]
    out_report: Option<PathBuf>,
    /// Another walk through the same map, for example of another device, to solve together with this one;
    /// may be repeated. Its trajectory goes beside this one's, as WALK_with_OTHER.tum.
    #[arg(long, value_name = "MCAP")]
    with: Vec<PathBuf>,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Wi-Fi and Bluetooth readings of other walks in this map, a table of `lsfb dataset radio`. A walk
    /// that did not receive the same signals where it was is refused.
    #[arg(long, value_name = "CSV")]
    radio: Option<PathBuf>,
    #[command(flatten)]
    models: ModelFolder,
}

/// Computes, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: GroundTruthConfig = super::config_or_default(arguments.config.as_deref())?;
    let job = WalkJob {
        recording: &arguments.recording,
        others: &arguments.with,
        map: &arguments.map,
        out: &arguments.out,
        out_report: arguments.out_report.as_deref(),
        config: &config,
        radio: arguments.radio.as_deref(),
        models: &arguments.models,
    };
    let mut read: Vec<&Path> = vec![&arguments.recording];
    for other in &arguments.with {
        let is_same = |path: &&Path| files::is_same(path, other) || files::is_copy(path, other);
        if let Some(same) = read.iter().find(|path| is_same(path)) {
            bail!(BadArgument::new(format!(
                "{}: --with takes other walks, each once, but this is {}: solving a walk with itself adds nothing",
                other.display(),
                same.display()
            )));
        }
        read.push(other);
    }
    let found = job.compute(context, |result| context.claim(result, &read))?;
    let judgement = Judgement::new(found.said.findings());
    context.print(
        &Judged::new(&judgement, "the trajectory", &found.said),
        || {
            let mut text = poses_of(&arguments.out, &found.said.report);
            for (name, other) in &found.said.with {
                text += &poses_of(&arguments.out.with_file_name(name), &other.report);
            }
            for camera in judgement.findings().iter().filter(|f| f.code == "camera") {
                text += &format!("  {}\n", camera.sentence());
            }
            text + &problem_lines(&judgement)
        },
    )?;
    Ok(match (judgement.verdict(), found.said.is_whole()) {
        (Verdict::Fail, _) => Outcome::JudgementFailed,
        (_, false) => Outcome::DataLost,
        _ => Outcome::Done,
    })
}

/// How much of a walk was solved.
fn poses_of(trajectory: &Path, r: &GroundTruthReport) -> String {
    format!(
        "{}: {} poses, {} of {} query frames localized, {} bridged, reprojection {:.3} px rms\n",
        trajectory.display(),
        r.poses,
        r.localized,
        r.looked_up,
        r.bridged,
        r.map_errors.rms_px
    )
}

/// A trajectory that was written, and where it comes from.
pub struct WrittenTrajectory {
    pub trajectory: Trajectory,
    pub said: Said,
    pub provenance: Provenance,
}

/// What is said of a trajectory, and kept beside it.
#[derive(Serialize, Deserialize)]
pub struct Said {
    #[serde(flatten)]
    pub report: GroundTruthReport,
    /// What the walk's barometer and radio say of it.
    pub surroundings: Surroundings,
    /// The same of walks that were solved together with it, by the files of their trajectories.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub with: BTreeMap<String, Self>,
}

impl Said {
    /// All that is to be judged.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = self.report.findings();
        findings.extend(self.surroundings.findings());
        for (name, other) in &self.with {
            let named = |found: Finding| Finding {
                subject: format!("{name}, {}", found.subject),
                ..found
            };
            findings.extend(other.findings().into_iter().map(named));
        }
        findings
    }

    /// Codes of what is not as it should be; of what forbids to use the trajectory with the verdict.
    pub fn problem_codes(&self) -> Vec<String> {
        let code = |finding: Finding| match finding.verdict {
            Verdict::Warn => Some(finding.code.into_owned()),
            Verdict::Fail => Some(format!("{} {}", finding.code, finding.verdict)),
            Verdict::Unknown | Verdict::Pass => None,
        };
        self.findings().into_iter().filter_map(code).collect()
    }

    /// Whether nothing is left out of any walk.
    fn is_whole(&self) -> bool {
        self.report.is_whole() && self.with.values().all(Self::is_whole)
    }

    /// Why the trajectory must not be used, a sentence each; empty where nothing forbids it.
    fn failures(&self) -> Vec<String> {
        let failed = |f: &Finding| f.verdict == Verdict::Fail;
        let failed = self.findings().into_iter().filter(failed);
        failed.map(|finding| finding.sentence()).collect()
    }

    /// Whether the trajectory must not be used.
    pub fn is_failed(&self) -> bool {
        Judgement::new(self.findings()).verdict() == Verdict::Fail
    }
}

/// A trajectory to be computed of a walk.
pub struct WalkJob<'a> {
    pub recording: &'a Path,
    /// Walks that are solved together with it.
    pub others: &'a [PathBuf],
    pub map: &'a Path,
    pub out: &'a Path,
    /// A page about it.
    pub out_report: Option<&'a Path>,
    pub config: &'a GroundTruthConfig,
    /// Readings of others at their places.
    pub radio: Option<&'a Path>,
    /// Weights for maps of learned features.
    pub models: &'a ModelFolder,
}

impl WalkJob<'_> {
    /// Computes the trajectory and writes it with where it comes from, unless it stands. `claim` is asked before anything is
    /// replaced.
    pub fn compute(
        &self,
        context: &Context,
        claim: impl Fn(&Path) -> anyhow::Result<()>,
    ) -> anyhow::Result<WrittenTrajectory> {
        let (walk, hd_map) = (context.open(self.recording)?, super::open_map(self.map)?);
        let learned = self.models.learned(hd_map.feature())?;
        let config = GroundTruthConfig {
            learned: learned.or_else(|| self.config.learned.clone()),
            ..self.config.clone()
        };
        let mut provenance = Provenance::new(&config);
        provenance.add_input(self.recording)?;
        provenance.add_rig(&super::about(self.recording, walk.rig())?);
        let mut others = Vec::with_capacity(self.others.len());
        for path in self.others {
            let other = context.open(path)?;
            provenance.add_input(path)?;
            provenance.add_rig(&super::about(path, other.rig())?);
            others.push(other);
        }
        // The map's header has the hashes of its other files.
        provenance.add_input(&self.map.join(HdMap::HEADER))?;
        let files = WalkFiles::of_walks(self.out, self.others);
        let heard = self.radio.map(read_table).transpose()?;
        if let Some(table) = self.radio {
            provenance.add_input(table)?;
        }
        let outputs = files.iter().map(WalkFiles::trajectory);
        let outputs: Vec<&Path> = outputs.chain(self.out_report).collect();
        if let Some(said) = context.standing(&outputs, &provenance) {
            return Ok(WrittenTrajectory {
                trajectory: read_tum(self.out)?,
                said,
                provenance,
            });
        }
        outputs.iter().try_for_each(|result| claim(result))?;
        let beside: Vec<PathBuf> = files.iter().flat_map(WalkFiles::beside).collect();
        beside.iter().try_for_each(|file| claim(file))?;
        let stages = files
            .iter()
            .map(|f| context.kept_stages(f.trajectory(), &provenance));
        let stages: Vec<KeptStages> = stages.collect::<anyhow::Result<_>>()?;
        let recordings: Vec<&Recording> = std::iter::once(&walk).chain(&others).collect();
        let walks: Vec<_> = recordings.iter().copied().zip(&stages).collect();
        let show = |p| context.show(p);
        let found = match &walks[..] {
            [(walk, stages)] => {
                let found = ground_truth_in_stages(walk, &hd_map, &config, stages, &show);
                found.map(|found| vec![found])
            }
            walks => ground_truth_together(walks, &hd_map, &config, &show),
        };
        let kept = |found, kept: &KeptStages| kept.kept_if_stopped(found);
        let found = super::about(self.recording, stages.iter().fold(found, kept))?;
        let forget = || stages.iter().try_for_each(KeptStages::remove);
        let mut said = match said_of(&recordings, &found, heard.as_deref()) {
            Ok(said) => said.into_iter(),
            Err(refused) => {
                forget()?;
                return Err(refused);
            }
        };
        let (Some(own), Some(first)) = (said.next(), found.first()) else {
            bail!("no walk was solved");
        };
        let names = files.iter().skip(1).map(|f| files::name_of(f.trajectory()));
        let said = Said {
            with: names.zip(said).collect(),
            ..own
        };
        standing::forget(&outputs)?;
        let failed = provenance.with_failures(said.failures());
        for (files, found) in files.iter().zip(&found) {
            files.write(found)?;
            failed.write(files.trajectory())?;
        }
        if let Some(path) = self.out_report {
            let page = WalkPage {
                name: &self.recording.display().to_string(),
                map: &hd_map,
                found: first,
                findings: said.findings(),
                provenance: &provenance,
            };
            super::write(path, page.to_html())?;
            provenance.write(path)?;
        }
        standing::finish(&outputs, &beside, &provenance, &said)?;
        forget()?;
        Ok(WrittenTrajectory {
            trajectory: first.trajectory.clone(),
            said,
            provenance,
        })
    }
}

/// What is said of each walk; an error where barometer or radio forbid to solve walks together.
fn said_of(
    recordings: &[&Recording],
    found: &[GroundTruth],
    heard: Option<&[PlacedReading]>,
) -> anyhow::Result<Vec<Said>> {
    let mut all = Vec::with_capacity(found.len());
    for (recording, found) in recordings.iter().zip(found) {
        let surroundings = Surroundings::of(recording, found, heard)?;
        let failed = surroundings.findings().find(|f| f.verdict == Verdict::Fail);
        if let (Some(failed), true) = (failed, recordings.len() > 1) {
            let refused = Finding {
                what: format!(
                    "this walk must not be solved together with others, which it would bend: {}",
                    failed.what
                ),
                subject: recording.path().display().to_string(),
                ..failed
            };
            return Err(Refused(refused).into());
        }
        all.push(Said {
            report: found.report.clone(),
            surroundings,
            with: BTreeMap::new(),
        });
    }
    Ok(all)
}
