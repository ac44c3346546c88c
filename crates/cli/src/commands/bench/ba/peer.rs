//! A peer that is run beside ours, on the same problem.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::Context as _;

use super::runs::{Run, read_run};
use crate::context::Context;

/// How often is looked whether it has ended.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A program that solves the problem keyframe by keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    name: String,
    words: Vec<String>,
}

/// `NAME=COMMAND`; the name becomes part of that of a file.
pub fn program(text: &str) -> Result<Program, String> {
    let expected =
        || "expected a name of letters and digits, and a command: PEER=command".to_owned();
    let (name, command) = text.split_once('=').ok_or_else(expected)?;
    let words: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.is_empty() || !name.chars().all(is_plain) || words.is_empty() {
        return Err(expected());
    }
    Ok(Program {
        name: name.to_owned(),
        words,
    })
}

impl Program {
    /// Where it writes its result in a folder.
    pub fn result(&self, folder: &Path) -> PathBuf {
        folder.join(format!("peer-{}.csv", self.name))
    }

    /// Where what it says goes.
    pub fn log(&self, folder: &Path) -> PathBuf {
        folder.join(format!("peer-{}.log", self.name))
    }

    /// Runs it with the names of the problem and of its result behind its other arguments.
    pub fn run(
        &self,
        problem: &Path,
        folder: &Path,
        keyframes: u32,
        context: &Context,
    ) -> anyhow::Result<Run> {
        let (result, log) = (self.result(folder), self.log(folder));
        let said = File::create(&log).with_context(|| log.display().to_string())?;
        let (program, arguments) = self.words.split_first().context("a command has a word")?;
        let mut child = Command::new(program)
            .args(arguments)
            .args([problem, &result])
            .stdin(Stdio::null())
            .stdout(said.try_clone()?)
            .stderr(said)
            .spawn()
            .with_context(|| format!("{}: {program}", self.name))?;
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            if let Err(stopped) = context.check_stop() {
                // Gone already is as good as ended.
                let _ = child.kill();
                child.wait()?;
                return Err(stopped.into());
            }
            std::thread::sleep(LOOK_EVERY);
        };
        anyhow::ensure!(
            status.success(),
            "{}: {program} ended with {status}: see {}",
            self.name,
            log.display()
        );
        read_run(&self.name, &result, keyframes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_has_a_name_that_files_can_have_and_a_command() {
        let found = program("ISAM2=python isam2_walk.py --fast=1").expect("a program");
        assert_eq!(found.name, "ISAM2");
        assert_eq!(found.words, ["python", "isam2_walk.py", "--fast=1"]);
        assert_eq!(
            found.result(Path::new("ba")),
            Path::new("ba/peer-ISAM2.csv")
        );
        for text in ["ISAM2", "=python", "a/b=python", "ISAM2= "] {
            assert!(program(text).is_err(), "{text}");
        }
    }
}
