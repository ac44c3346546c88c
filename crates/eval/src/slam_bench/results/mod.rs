//! Runs of a plan: started, limited, judged, remembered.

mod judging;
mod made_of;
mod medians;
mod prepared;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::thread;

use lsfb_recording::sha256_of;
use lsfb_types::{Finding, Progress, ProgressFn, Verdict};
use serde::{Deserialize, Serialize};

use super::cause::Cause;
use super::command::{filled, words};
use super::export::Layout;
use super::plan::{Plan, Scale, Sequence, System};
use super::process::{self, Limits};
use crate::alignment::AlignmentMode;
use crate::{Error, ReadOptions, read_trajectory};
pub(super) use judging::{judge, read_estimate};
use made_of::{Files, contents_of};
pub(super) use medians::median;
pub use medians::table_of;
use prepared::{Prepared, prepare};

/// Findings that make figures doubtful however good they are, the gravest first.
const ODD: [&str; 11] = [
    "same",
    "mirrored",
    "inverse",
    "follows",
    "held",
    "stamp-unit",
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
    /// What it was made of: another command, program, file that is named, input or limit makes another run.
    pub made_of: String,
    /// SHA-256 of its trajectory, in hexadecimal; absent where it wrote none.
    pub trajectory_sha256: Option<String>,
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

/// What becomes of runs that are finished.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Finished {
    /// They stand where they were made of the same.
    #[default]
    Keep,
    /// They are run again.
    Repeat,
}

/// How a plan is run.
#[derive(Clone, Copy, Debug)]
pub struct RunConfig<'a> {
    /// SHA-256 of this program, in hexadecimal: inputs exported by another one are exported again.
    pub program_sha256: &'a str,
    /// Runs that are finished.
    pub finished: Finished,
}

/// Runs what has not been run before, and judges all; results lie in `out` by sequence, system and run.
pub fn run_plan(
    plan: &Plan,
    out: &Path,
    config: RunConfig<'_>,
    progress: ProgressFn<'_>,
) -> Result<Vec<RunResult>, Error> {
    let mut jobs = Vec::new();
    let mut files = Files::default();
    for sequence in &plan.sequences {
        let prepared = prepare(plan, sequence, out, config.program_sha256)?;
        for system in &plan.systems {
            for run in 1..=plan.runs {
                let mut job = Job {
                    plan,
                    sequence,
                    system,
                    run,
                    finished: config.finished,
                    folder: folder_of(out, &sequence.name, &system.name, run),
                    prepared: prepared.clone(),
                    made_of: String::new(),
                };
                job.made_of = job.made_of(&mut files, config.program_sha256)?;
                jobs.push(job);
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

struct Job<'a> {
    plan: &'a Plan,
    sequence: &'a Sequence,
    system: &'a System,
    run: usize,
    finished: Finished,
    folder: PathBuf,
    prepared: Prepared,
    made_of: String,
}

impl Job<'_> {
    /// What was run before, where it was made of the same, or what is run now, judged: judging is done anew, as truth and judge may be others.
    fn result(
        &self,
        check: &dyn Fn() -> Result<(), lsfb_types::Stopped>,
    ) -> Result<RunResult, Error> {
        let io = |source| self.io(source);
        let kept = self.folder.join("result.json");
        let ended = match self.finished_before(&kept) {
            Some(before) => before,
            None => self.run_now(check)?,
        };
        let result = match ended.cause {
            Some(_) => ended,
            None => self.judged(ended)?,
        };
        let text = serde_json::to_string_pretty(&result).map_err(|error| io(error.into()))?;
        let half = self.folder.join("result.part");
        fs::write(&half, text).map_err(io)?;
        fs::rename(&half, &kept).map_err(io)?;
        Ok(result)
    }

    fn io(&self, source: std::io::Error) -> Error {
        Error::Io {
            path: self.folder.clone(),
            source,
        }
    }

    fn bad(&self, what: String) -> Error {
        Error::BadPlan {
            path: self.folder.clone(),
            what: format!("{}: {what}", self.system.name),
        }
    }

    /// A run that stands, as it was before it was judged.
    fn finished_before(&self, kept: &Path) -> Option<RunResult> {
        let text = match self.finished {
            Finished::Keep => fs::read_to_string(kept).ok()?,
            Finished::Repeat => return None,
        };
        let before: RunResult = serde_json::from_str(&text).ok()?;
        let trajectory_sha256 = hash_of(&self.folder.join(&before.trajectory)).ok()?;
        let stands =
            before.made_of == self.made_of && before.trajectory_sha256 == trajectory_sha256;
        stands.then_some(RunResult {
            covered: None,
            se3_m: None,
            scale_percent: None,
            sim3_m: None,
            cause: before.cause.filter(|cause| !cause.is_of_judge()),
            remark: None,
            ..before
        })
    }

    fn run_now(
        &self,
        check: &dyn Fn() -> Result<(), lsfb_types::Stopped>,
    ) -> Result<RunResult, Error> {
        let io = |source| self.io(source);
        let bad = |what| self.bad(what);
        // A trajectory of an earlier run would be judged as this one's.
        if self.folder.exists() {
            fs::remove_dir_all(&self.folder).map_err(io)?;
        }
        fs::create_dir_all(&self.folder).map_err(io)?;
        let folder = self.folder.canonicalize().map_err(io)?;
        let values = self.values(&folder);
        let words = self.words(&values)?;
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
        let ended = process::run(&words, &folder, limits, check).map_err(io)??;
        Ok(RunResult {
            sequence: self.sequence.name.clone(),
            system: self.system.name.clone(),
            run: self.run,
            made_of: self.made_of.clone(),
            trajectory_sha256: hash_of(&folder.join(&trajectory))?,
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
        })
    }

    fn words(&self, values: &BTreeMap<&str, String>) -> Result<Vec<String>, Error> {
        let words = words(&self.system.command).map_err(|what| self.bad(what))?;
        let words = words.iter().map(|word| filled(word, values));
        words
            .collect::<Result<Vec<_>, _>>()
            .map_err(|what| self.bad(what))
    }

    fn made_of(&self, files: &mut Files, program_sha256: &str) -> Result<String, Error> {
        let (plan, system) = (self.plan, self.system);
        let folder = std::path::absolute(&self.folder).map_err(|source| self.io(source))?;
        let folder = made_of::plain(&folder);
        let words = self.words(&self.values(&folder))?;
        let input = self.prepared.inputs.get(&system.layout);
        let named = files.of_words(&words, &folder, input)?;
        let listed = files.listed(&system.files)?;
        let exported = match system.layout {
            Layout::AsIs => String::new(),
            _ => format!(" exported by lsfb {}", made_of::short(program_sha256)),
        };
        Ok(format!(
            "{}{exported}; {} → {} {:?} ({}); {} s, {} MB; files {named}{listed}",
            self.prepared.made_of,
            system.command,
            system.trajectory,
            system.times,
            system.layout.name(),
            plan.time_limit_secs,
            plan.memory_limit_mb,
        ))
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
        let is_odd = |f: &Finding, code: &str| f.verdict >= Verdict::Warn && f.code == code;
        let odd = |code: &&str| sim3.findings.iter().find(|f| is_odd(f, code));
        Ok(RunResult {
            remark: ODD.iter().find_map(odd).map(|f| f.what.clone()),
            covered: Some(covered),
            se3_m: metric.as_ref().map(|m| m.ate_translation_m.rmse),
            scale_percent: metric.and_then(|m| m.scale_error_abs_percent),
            sim3_m: Some(sim3.ate_translation_m.rmse),
            ..run
        })
    }
}

/// SHA-256 of a trajectory, or of the files of a folder; `None` where there is none.
fn hash_of(trajectory: &Path) -> Result<Option<String>, Error> {
    if trajectory.is_dir() {
        return contents_of(trajectory, None).map(Some);
    }
    match trajectory.exists() {
        true => Ok(Some(sha256_of(trajectory)?)),
        false => Ok(None),
    }
}

#[cfg(test)]
pub(super) mod tests;
