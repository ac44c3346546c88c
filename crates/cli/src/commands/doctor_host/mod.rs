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

use lsfb_types::{Finding, Judgement, Verdict};

const INSTALL: &str = "sudo udev/install.sh --apply";

/// Looks at this machine. `folder`: where recordings are to be written.
pub fn judge_this_machine(folder: &Path) -> Judgement {
    let root = Path::new("/");
    let mut findings = kernel_checks(root);
    findings.push(network::clock(root, &network::time_services()));
    findings.push(network::lidar());
    findings.extend(disk::checks(folder));
    Judgement::new(findings)
}

/// How a check went; its code is its name as programs like it: `receive-buffer`.
fn check(
    name: &'static str,
    verdict: Verdict,
    found: impl Into<String>,
    remedy: impl Into<String>,
) -> Finding {
    let code = name.to_lowercase().replace(' ', "-");
    Finding::new(code, verdict, name, found).remedy(remedy)
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
fn kernel_checks(root: &Path) -> Vec<Finding> {
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
