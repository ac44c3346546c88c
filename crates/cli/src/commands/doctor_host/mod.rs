//! `lsfb doctor --host`: whether this machine can record, and what to do where it cannot.

mod access;
mod devices;
mod disk;
mod kernel;
mod machine;
mod network;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

const INSTALL: &str = "sudo udev/install.sh --apply";

/// How a check went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Verdict {
    /// As it should be.
    Pass,
    /// It will do, and could be better.
    Warn,
    /// Data will be lost.
    Fail,
}

/// One thing looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// How it went.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do; empty where nothing is to be done.
    pub remedy: String,
}

/// Everything that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HostReport {
    /// The worst verdict.
    pub verdict: Verdict,
    /// One entry per check.
    pub checks: Vec<Check>,
}

impl HostReport {
    /// Looks at this machine. `folder`: where recordings are to be written.
    pub fn of_this_machine(folder: &Path) -> Self {
        let root = Path::new("/");
        let mut checks = kernel_checks(root);
        checks.push(network::clock(root, &network::time_services()));
        checks.push(network::lidar());
        checks.extend(disk::checks(folder));
        Self::new(checks)
    }

    fn new(checks: Vec<Check>) -> Self {
        let worst = checks.iter().map(|check| check.verdict).max();
        Self {
            verdict: worst.unwrap_or(Verdict::Pass),
            checks,
        }
    }

    /// The report for people.
    pub fn text(&self) -> String {
        let mut lines = Vec::new();
        for check in &self.checks {
            let word = match check.verdict {
                Verdict::Pass => "PASS",
                Verdict::Warn => "WARN",
                Verdict::Fail => "FAIL",
            };
            lines.push(format!("{word}  {:<22} {}", check.name, check.found));
            if !check.remedy.is_empty() {
                lines.push(format!("      {:<22} → {}", "", check.remedy));
            }
        }
        lines.join("\n")
    }
}

fn check(
    name: &'static str,
    verdict: Verdict,
    found: impl Into<String>,
    remedy: impl Into<String>,
) -> Check {
    let remedy = match verdict {
        Verdict::Pass => String::new(),
        Verdict::Warn | Verdict::Fail => remedy.into(),
    };
    Check {
        name,
        verdict,
        found: found.into(),
        remedy,
    }
}

/// Good from `good` on, poor below `poor`.
fn at_least(value: f64, good: f64, poor: f64) -> Verdict {
    match value {
        v if v >= good => Verdict::Pass,
        v if v >= poor => Verdict::Warn,
        _ => Verdict::Fail,
    }
}

fn read(root: &Path, path: &str) -> Option<String> {
    let text = fs::read_to_string(root.join(path)).ok()?;
    Some(text.trim().to_owned())
}

fn number(root: &Path, path: &str) -> Option<u64> {
    read(root, path)?.split_whitespace().next()?.parse().ok()
}

/// Folders below one, in order of name.
fn folders(root: &Path, path: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root.join(path))
        .into_iter()
        .flatten()
        .flatten();
    let mut found: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    found.sort();
    found
}

/// What can be read from files.
fn kernel_checks(root: &Path) -> Vec<Check> {
    vec![
        kernel::receive_buffer(root),
        kernel::backlog(root),
        kernel::dirty_pages(root),
        kernel::early_writing(root),
        kernel::usbfs(root),
        kernel::video_options(root),
        access::groups(root),
        access::device_rules(root),
        access::can_network(root),
        access::real_time(root),
        access::open_files(root),
        machine::governor(root),
        machine::memory(root),
        devices::cameras(root),
        devices::serial_latency(root),
    ]
}
