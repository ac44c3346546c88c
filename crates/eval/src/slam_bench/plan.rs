//! What is run on what: a TOML file.

use std::path::{Path, PathBuf};

use lsfb_types::{Bounds, Names, OutOfBounds};
use serde::{Deserialize, Serialize};

use super::command;
use super::export::Layout;
use crate::Error;

/// A plan is written by hand.
const MAX_BYTES: u64 = 1 << 20;

/// What is run on what.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Title of the table.
    #[serde(default = "title")]
    pub title: String,
    /// Runs of each system on each sequence; the median counts.
    #[serde(default = "runs")]
    pub runs: usize,
    /// Runs at the same time.
    #[serde(default = "parallel")]
    pub parallel: usize,
    /// Longest time of a run, seconds.
    #[serde(default = "time_limit_secs")]
    pub time_limit_secs: f64,
    /// Most memory of a run, MB.
    #[serde(default = "memory_limit_mb")]
    pub memory_limit_mb: u64,
    /// Share of the truth that a trajectory must cover, 0 to 1; with less the system was lost.
    #[serde(default = "least_covered")]
    pub least_covered: f64,
    /// Largest difference of matching stamps, seconds.
    #[serde(default = "max_difference_secs")]
    pub max_difference_secs: f64,
    /// The sequences.
    #[serde(rename = "sequence", default)]
    pub sequences: Vec<Sequence>,
    /// The systems.
    #[serde(rename = "system", default)]
    pub systems: Vec<System>,
}

/// One sequence.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sequence {
    /// As the table calls it.
    pub name: String,
    /// The recording, or a folder that systems read as it is.
    pub input: PathBuf,
    /// Its ground truth.
    pub truth: PathBuf,
    /// Longer side of the place, metres: what errors are small against.
    pub longer_side_m: f64,
}

/// One system.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct System {
    /// As the table calls it.
    pub name: String,
    /// The command, with `{input}`, `{out}`, `{trajectory}`, `{sequence}`, `{run}`; started without a shell.
    pub command: String,
    /// Files and folders that the result depends on beside those that the command names: settings, scripts, vocabularies, what a shell starts.
    #[serde(default)]
    pub files: Vec<PathBuf>,
    /// What `{input}` is.
    #[serde(default)]
    pub layout: Layout,
    /// Where its trajectory is found; `{trajectory}` where it can be told.
    #[serde(default = "trajectory")]
    pub trajectory: String,
    /// Stamps of the trajectory's rows, seconds, one a line, where it has none (KITTI): `{input}/stamps.txt`.
    pub times: Option<String>,
    /// Whether it knows the scale.
    #[serde(default)]
    pub scale: Scale,
}

/// Whether a system knows the scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// It does: SE(3), Sim(3) and the scale error are tabled.
    #[default]
    Metric,
    /// It does not: Sim(3) alone is.
    Free,
}

fn title() -> String {
    "SLAM benchmark".to_owned()
}

fn runs() -> usize {
    3
}

fn parallel() -> usize {
    1
}

fn time_limit_secs() -> f64 {
    3600.0
}

fn memory_limit_mb() -> u64 {
    16_000
}

fn least_covered() -> f64 {
    0.5
}

fn max_difference_secs() -> f64 {
    0.02
}

fn trajectory() -> String {
    "{trajectory}".to_owned()
}

/// Reads a plan; paths in it are relative to it.
pub fn read_plan(path: &Path) -> Result<Plan, Error> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    let bad = |what: String| Error::BadPlan {
        path: path.to_owned(),
        what,
    };
    if std::fs::metadata(path).map_err(io)?.len() > MAX_BYTES {
        return Err(bad("a plan is a small text file".to_owned()));
    }
    let text = std::fs::read_to_string(path).map_err(io)?;
    let mut plan: Plan =
        toml::from_str(&text).map_err(|e| bad(lsfb_geometry::toml_problem(&text, &e)))?;
    plan.check().map_err(bad)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    for sequence in &mut plan.sequences {
        sequence.input = folder.join(&sequence.input);
        sequence.truth = folder.join(&sequence.truth);
    }
    for file in plan.systems.iter_mut().flat_map(|s| &mut s.files) {
        *file = folder.join(&*file);
    }
    Ok(plan)
}

lsfb_types::bounds! {
    Plan {
        title: any,
        runs: number(Bounds::Within(1.0, 99.0)),
        parallel: number(Bounds::Within(1.0, 256.0)),
        time_limit_secs: number(Bounds::POSITIVE),
        memory_limit_mb: number(Bounds::AT_LEAST_ONE),
        least_covered: number(Bounds::Within(0.0, 1.0)),
        max_difference_secs: number(Bounds::POSITIVE),
        sequences as "sequence": sections,
        systems as "system": any,
    }
    also is_named
}

lsfb_types::bounds! {
    Sequence {
        name: any,
        input: any,
        truth: any,
        longer_side_m: number(Bounds::POSITIVE),
    }
}

/// Names become folders.
const NAMES: Names = Names {
    holds: |c| c.is_alphanumeric() || "-_.+ ".contains(c),
    letters: "letters, digits, - _ . + and spaces",
};

impl Plan {
    fn check(&self) -> Result<(), String> {
        if self.sequences.is_empty() || self.systems.is_empty() {
            return Err("needs at least one [[sequence]] and one [[system]]".to_owned());
        }
        self.check_bounds("").map_err(|e| e.to_string())?;
        for system in &self.systems {
            command::words(&system.command).map_err(|what| format!("{}: {what}", system.name))?;
        }
        Ok(())
    }

    fn is_named(&self, _section: &str) -> Result<(), OutOfBounds> {
        let sequences = self.sequences.iter().map(|s| ("sequence.name", &*s.name));
        let systems = self.systems.iter().map(|s| ("system.name", &*s.name));
        NAMES.check(sequences.chain(systems))
    }
}
