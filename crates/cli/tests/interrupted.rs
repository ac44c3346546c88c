//! Stages that are told to stop: they end at once, and leave nothing half-written.

use std::fs::DirEntry;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::session::with;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

#[test]
fn mapping_ends_at_once() {
    // Exit codes as shells have them: 128 and the number of the signal.
    ends_at_once(Signal::SIGINT, 130, "stopped by Ctrl-C");
    ends_at_once(Signal::SIGTERM, 143, "stopped by SIGTERM");
}

fn ends_at_once(signal: Signal, code: i32, words: &str) {
    let folder = with(&["scan.mcap"]);
    let process = Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(["map", "scan.mcap", "--out", "map"])
        .current_dir(folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the built binary");
    // Long enough to be at work, far too short to be done.
    std::thread::sleep(Duration::from_millis(500));
    let asked = Instant::now();
    let id = i32::try_from(process.id()).expect("process id");
    kill(Pid::from_raw(id), signal).expect("signal");
    let output = process.wait_with_output().expect("an end");
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(asked.elapsed() < Duration::from_secs(3), "{text}");
    assert!(text.contains(words), "{text}");
    // A fast machine has finished the first stage by then, and keeps it for the next try.
    let kept = names_in(&folder.path().join("map.unfinished"));
    let is_whole = |name: &String| name == "made_from" || name.ends_with(".stage");
    assert!(kept.iter().all(is_whole), "half a stage: {kept:?}");
    let mut left = names_in(folder.path());
    left.retain(|name| name != "map.unfinished");
    assert_eq!(left, ["scan.mcap"], "the recording and nothing else");
}

/// Names of what is in a folder; none where it is not there.
fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let name = |entry: std::io::Result<DirEntry>| entry.expect("entry").file_name();
    let names = entries.map(|entry| name(entry).into_string().expect("UTF-8"));
    names.collect()
}
