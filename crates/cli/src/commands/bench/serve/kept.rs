//! Scores, kept line by line in a file.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::Context as _;
use lsfb_eval::leaderboard::{Ranked, Submission, ranking};

/// More are not kept.
const MOST: usize = 100_000;

/// Scores in memory and in their file.
pub struct Kept {
    path: PathBuf,
    state: Mutex<Submissions>,
}

struct Submissions {
    file: File,
    submissions: Vec<Submission>,
}

impl Kept {
    /// Reads what is there. A line that no score can be read from is an error: a leaderboard that forgets is worse than none.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let named = || path.display().to_string();
        let text = match path.exists() {
            true => std::fs::read_to_string(path).with_context(named)?,
            false => String::new(),
        };
        let submissions = text
            .lines()
            .enumerate()
            .map(|(i, line)| {
                serde_json::from_str(line)
                    .with_context(|| format!("{}, line {}: not a score", path.display(), i + 1))
            })
            .collect::<anyhow::Result<_>>()?;
        let mut file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(path)
            .with_context(named)?;
        if !text.is_empty() && !text.ends_with('\n') {
            file.write_all(b"\n").with_context(named)?;
        }
        Ok(Self {
            path: path.to_owned(),
            state: Mutex::new(Submissions { file, submissions }),
        })
    }

    /// Keeps one; an error where it cannot be.
    pub fn add(&self, submission: Submission) -> anyhow::Result<()> {
        let line = serde_json::to_string(&submission)? + "\n";
        let mut state = self
            .state
            .lock()
            .map_err(|_| anyhow::anyhow!("a thread panicked"))?;
        anyhow::ensure!(state.submissions.len() < MOST, "the leaderboard is full");
        // In one piece: a line is there or not.
        let written = state.file.write_all(line.as_bytes());
        written.with_context(|| self.path.display().to_string())?;
        state.submissions.push(submission);
        Ok(())
    }

    /// The leaderboard of a sequence.
    pub fn ranking(&self, sequence: &str) -> Vec<Ranked> {
        let state = self.state.lock();
        state.map_or_else(
            |_| Vec::new(),
            |state| ranking(&state.submissions, sequence),
        )
    }
}
