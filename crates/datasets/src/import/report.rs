//! What an import says about itself.

use std::path::PathBuf;

use serde::Serialize;

/// Whose clock the stamps are of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ClockOf {
    /// Time of day, as the device knew it.
    Utc,
    /// Time since something of the device's own, as its start.
    Device,
}

impl ClockOf {
    /// Its name in the recording's metadata.
    pub fn name(self) -> &'static str {
        match self {
            Self::Utc => "utc",
            Self::Device => "device",
        }
    }
}

/// What became of the records of one kind.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordCount {
    /// What they are called where they come from.
    pub what: String,
    /// The topic they are on.
    pub topic: String,
    /// Records there were.
    pub read: u64,
    /// Messages they became.
    pub written: u64,
    /// Records that could not be read, or contradict others: data that is lost.
    pub unreadable: u64,
    /// The first of these, and what is wrong with it.
    pub first_problem: Option<String>,
    /// Records that were there twice, word for word; one of each was written.
    pub repeated: u64,
    /// Records that stood before an earlier one; they were put in order.
    pub reordered: u64,
    /// Whether they are made of other records of the same import.
    pub derived: bool,
}

/// What has no place in a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeftOut {
    /// Files, or records of a type.
    pub what: String,
    /// How many.
    pub records: u64,
    /// Why, and where it is of use.
    pub why: String,
}

/// What an import did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImportReport {
    /// The recording.
    pub recording: PathBuf,
    /// What it was made of.
    pub format: &'static str,
    /// Name of the device.
    pub device: String,
    /// Whose clock the stamps are of.
    pub clock: ClockOf,
    /// First to last record, seconds.
    pub duration_secs: f64,
    /// Every kind of record.
    pub records: Vec<RecordCount>,
    /// What was not imported.
    pub left_out: Vec<LeftOut>,
    /// Whether a rig is attached.
    pub has_rig: bool,
    /// Poses that somebody had made, written beside the recording.
    pub trajectories: Vec<PathBuf>,
    /// What else one should know.
    pub notes: Vec<String>,
    /// Tables and videos that were read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
}

impl ImportReport {
    /// Records that could not be read.
    pub fn unreadable(&self) -> u64 {
        self.records.iter().map(|r| r.unreadable).sum()
    }
}
