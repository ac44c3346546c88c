//! Runs of a plan: started, limited, judged, remembered.

mod judging;
mod medians;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::thread;

use lsfb_recording::{Recording, sha256_of};
use lsfb_types::{Finding, Progress, ProgressFn, Verdict};
use serde::{Deserialize, Serialize};

use super::cause::Cause;
use super::command::{filled, words};
use super::export::{Layout, export};
use super::plan::{Plan, Scale, Sequence, System};
use super::process::{self, Limits};
use crate::alignment::AlignmentMode;
use crate::{Error, ReadOptions, read_trajectory};
pub(super) use judging::{judge, read_estimate};
pub(super) use medians::median;
pub use medians::table_of;

/// Findings that make figures doubtful however good they are, the gravest first.
const ODD: [&str; 8] = [
    "same",
    "mirrored",
    "follows",
    "clock",
    "lever",
    "axes",
    "duplicate-stamps",
    "no-stamps",
];

/// What one run came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Sequence.
    pub sequence: String,
    /// System.
    pub system: String,
    /// Number of the run, from one.
    pub run: usize,
    /// What it was made of: another command, input, truth or limit makes another run.
    pub made_of: String,
    /// Time it took, seconds.
    pub wall_secs: f64,
    /// Largest memory, MB.
    pub peak_mb: u64,
    /// Share of the truth covered, 0 to 1; absent where it was not judged.
    pub covered: Option<f64>,
    /// Error after SE(3) alignment, metres.
    pub se3_m: Option<f64>,
    /// 100 · |1 − s|.
    pub scale_percent: Option<f64>,
    /// Error after Sim(3) alignment, metres.
    pub sim3_m: Option<f64>,
    /// Why there are no figures.
    pub cause: Option<Cause>,
    /// What the judge found odd where there are figures.
    pub remark: Option<String>,
    /// Its trajectory, seen from the folder of the run.
    pub trajectory: PathBuf,
    /// Stamps of the trajectory's rows, where it has none.
    pub times: Option<PathBuf>,
}

impl RunResult {
    /// Where the run lies in the folder of all.
    pub fn folder(&self, out: &Path) -> PathBuf {
        folder_of(out, &self.sequence, &self.system, self.run)
    }
}

fn folder_of(out: &Path, sequence: &str, system: &str, run: usize) -> PathBuf {
    out.join(sequence).join(system).join(format!("run-{run}"))
}

/// Runs what has not been run before; results lie in `out` by sequence, system and run.
pub fn run_plan(
    plan: &Plan,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<Vec<RunResult>, Error> {
    let mut jobs = Vec::new();
    for sequence in &plan.sequences {
        let prepared = prepare(plan, sequence, out)?;
        for system in &plan.systems {
            for run in 1..=plan.runs {
                jobs.push(Job {
                    plan,
                    sequence,
                    system,
                    run,
                    folder: folder_of(out, &sequence.name, &system.name, run),
                    prepared: prepared.clone(),
                });
            }
        }
    }
    let total = jobs.len() as u64;
    let queue = Mutex::new(jobs.iter().enumerate());
    let results: Mutex<Vec<Option<Result<RunResult, Error>>>> =
        Mutex::new(jobs.iter().map(|_| None).collect());
    let done = || {
        let results = results.lock().map(|r| r.iter().flatten().count());
        Progress {
            stage: "SLAM systems",
            done: results.unwrap_or_default() as u64,
            total,
        }
    };
    let work = || {
        loop {
            let next = queue.lock().ok().and_then(|mut q| q.next());
            let Some((i, job)) = next else { break };
            let found = job.result(&|| progress(done()));
            let failed = found.is_err();
            if let Ok(mut results) = results.lock() {
                results[i] = Some(found);
            }
            // What is left is not begun after an error.
            if failed && let Ok(mut queue) = queue.lock() {
                queue.by_ref().for_each(drop);
            }
        }
    };
    thread::scope(|scope| -> Result<(), Error> {
        for number in 0..plan.parallel.min(jobs.len()) {
            let name = format!("slam run {number}");
            let spawned = thread::Builder::new().name(name).spawn_scoped(scope, work);
            spawned.map_err(|source| Error::Io {
                path: out.to_owned(),
                source,
            })?;
        }
        Ok(())
    })?;
    let results = results.into_inner().unwrap_or_default();
    // A run that was stopped or could not be kept ends all: what was not begun has no result.
    results.into_iter().flatten().collect()
}

/// The folders and hashes that all runs of a sequence share.
#[derive(Clone)]
struct Prepared {
    inputs: BTreeMap<Layout, PathBuf>,
    made_of: String,
}

fn prepare(plan: &Plan, sequence: &Sequence, out: &Path) -> Result<Prepared, Error> {
    let is_file = sequence.input.is_file();
    let input = match is_file {
        true => sha256_of(&sequence.input)?,
        false => contents_of(&sequence.input, out)?,
    };
    let truth = sha256_of(&sequence.truth)?;
    let mut inputs = BTreeMap::new();
    for layout in plan.systems.iter().map(|system| system.layout) {
        let place = match layout {
            Layout::AsIs => sequence.input.clone(),
            _ if !is_file => {
                return Err(Error::NotExported {
                    path: sequence.input.clone(),
                    layout: layout.name(),
                });
            }
            layout => {
                let name = format!("input-{}-{}", layout.name(), &input[..12.min(input.len())]);
                let folder = out.join(&sequence.name).join(name);
                if !folder.exists() {
                    export(&Recording::open(&sequence.input)?, layout, &folder)?;
                }
                folder
            }
        };
        let place = place.canonicalize().map_err(|source| Error::Io {
            path: place.clone(),
            source,
        })?;
        inputs.insert(layout, place);
    }
    Ok(Prepared {
        inputs,
        made_of: format!("input {input}, truth {truth}"),
    })
}

/// A folder that systems read: another file, or another size or time of one, makes another run. What is below `out` is no input.
fn contents_of(folder: &Path, out: &Path) -> Result<String, Error> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| Error::Io { path, source }
    };
    let out = out.canonicalize().ok();
    let mut files = BTreeSet::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(io(&folder))? {
            let path = entry.map_err(io(&folder))?.path();
            let about = fs::symlink_metadata(&path).map_err(io(&path))?;
            if about.is_dir() {
                let is_out = out.is_some() && path.canonicalize().ok() == out;
                folders.extend((!is_out).then_some(path));
            } else {
                let changed = about.modified().map_err(io(&path))?;
                files.insert((path, about.len(), changed));
            }
        }
    }
    let mut hasher = DefaultHasher::new();
    files.hash(&mut hasher);
    let (place, count, hash) = (folder.display(), files.len(), hasher.finish());
    Ok(format!("{place} ({count} files, {hash:016x})"))
}

struct Job<'a> {
    plan: &'a Plan,
    sequence: &'a Sequence,
    system: &'a System,
    run: usize,
    folder: PathBuf,
    prepared: Prepared,
}

impl Job<'_> {
    /// What was found before, where it was made of the same, or what is found now.
    fn result(
        &self,
        check: &dyn Fn() -> Result<(), lsfb_types::Stopped>,
    ) -> Result<RunResult, Error> {
        let io = |source| Error::Io {
            path: self.folder.clone(),
            source,
        };
        let kept = self.folder.join("result.json");
        let made_of = self.made_of();
        let before = fs::read_to_string(&kept).ok();
        let before: Option<RunResult> = before.and_then(|text| serde_json::from_str(&text).ok());
        if let Some(before) = before.filter(|b| b.made_of == made_of) {
            return Ok(before);
        }
        // A trajectory of an earlier run would be judged as this one's.
        if self.folder.exists() {
            fs::remove_dir_all(&self.folder).map_err(io)?;
        }
        fs::create_dir_all(&self.folder).map_err(io)?;
        let folder = self.folder.canonicalize().map_err(io)?;
        let values = self.values(&folder);
        let bad = |what: String| Error::BadPlan {
            path: self.folder.clone(),
            what: format!("{}: {what}", self.system.name),
        };
        let words = words(&self.system.command).map_err(bad)?;
        let words = words
            .iter()
            .map(|word| filled(word, &values))
            .collect::<Result<Vec<_>, _>>();
        // A folder of runs may be moved.
        let within = |template: &String| {
            let path = PathBuf::from(filled(template, &values)?);
            Ok(match path.strip_prefix(&folder) {
                Ok(within) => within.to_owned(),
                Err(_) => path,
            })
        };
        let trajectory = within(&self.system.trajectory).map_err(bad)?;
        let times = self.system.times.as_ref().map(within).transpose();
        let limits = Limits {
            time_secs: self.plan.time_limit_secs,
            memory_mb: self.plan.memory_limit_mb,
        };
        let ended = process::run(&words.map_err(bad)?, &folder, limits, check).map_err(io)??;
        let empty = RunResult {
            sequence: self.sequence.name.clone(),
            system: self.system.name.clone(),
            run: self.run,
            made_of,
            wall_secs: ended.wall_secs,
            peak_mb: ended.peak_mb,
            covered: None,
            se3_m: None,
            scale_percent: None,
            sim3_m: None,
            cause: ended.cause,
            remark: None,
            trajectory,
            times: times.map_err(bad)?,
        };
        let result = match empty.cause {
            Some(_) => empty,
            None => self.judged(empty)?,
        };
        let text = serde_json::to_string_pretty(&result).map_err(|error| io(error.into()))?;
        let half = self.folder.join("result.part");
        fs::write(&half, text).map_err(io)?;
        fs::rename(&half, &kept).map_err(io)?;
        Ok(result)
    }

    fn made_of(&self) -> String {
        let (plan, system) = (self.plan, self.system);
        format!(
            "{}; {} → {} {:?} ({}, {:?}); {} s, {} MB, {} covered, stamps within {} s; lsfb {}",
            self.prepared.made_of,
            system.command,
            system.trajectory,
            system.times,
            system.layout.name(),
            system.scale,
            plan.time_limit_secs,
            plan.memory_limit_mb,
            plan.least_covered,
            plan.max_difference_secs,
            env!("CARGO_PKG_VERSION")
        )
    }

    fn values(&self, folder: &Path) -> BTreeMap<&'static str, String> {
        let shown = |path: &Path| path.display().to_string();
        let input = self.prepared.inputs.get(&self.system.layout);
        BTreeMap::from([
            ("input", input.map(|p| shown(p)).unwrap_or_default()),
            ("out", shown(folder)),
            ("trajectory", shown(&folder.join("trajectory.tum"))),
            ("sequence", self.sequence.name.clone()),
            ("run", self.run.to_string()),
        ])
    }

    fn judged(&self, run: RunResult) -> Result<RunResult, Error> {
        let failed = |cause| RunResult {
            cause: Some(cause),
            ..run.clone()
        };
        if !self.folder.join(&run.trajectory).exists() {
            return Ok(failed(Cause::NeverInitialised));
        }
        let estimate = match read_estimate(&self.folder, &run) {
            Ok(estimate) => estimate,
            Err(Error::NotATrajectory { .. }) => return Ok(failed(Cause::NeverInitialised)),
            Err(why) => {
                return Ok(failed(Cause::NotJudged {
                    why: why.to_string(),
                }));
            }
        };
        // A truth that cannot be read is the plan's fault, not the system's.
        let truth = read_trajectory(&self.sequence.truth, &ReadOptions::default())?;
        let judge = |alignment| judge(self.plan, &truth, &estimate, alignment);
        let metric = match self.system.scale {
            Scale::Metric => Some(judge(AlignmentMode::Se3)),
            Scale::Free => None,
        };
        let sim3 = match judge(AlignmentMode::Sim3) {
            Ok(sim3) => sim3,
            Err(why) => {
                return Ok(failed(Cause::NotJudged {
                    why: why.to_string(),
                }));
            }
        };
        if let Some(why) = sim3.no_result() {
            return Ok(failed(Cause::NotJudged { why }));
        }
        let covered = sim3.coverage.fraction;
        if covered < self.plan.least_covered {
            return Ok(RunResult {
                covered: Some(covered),
                ..failed(Cause::Lost { covered })
            });
        }
        let metric = metric.transpose()?;
        let odd = |f: &&Finding| f.verdict >= Verdict::Warn && ODD.contains(&f.code.as_ref());
        Ok(RunResult {
            remark: sim3.findings.iter().find(odd).map(|f| f.what.clone()),
            covered: Some(covered),
            se3_m: metric.as_ref().map(|m| m.ate_translation_m.rmse),
            scale_percent: metric.and_then(|m| m.scale_error_abs_percent),
            sim3_m: Some(sim3.ate_translation_m.rmse),
            ..run
        })
    }
}

#[cfg(test)]
pub(super) mod tests;
