//! The part of the Android recorder that needs no phone, on a JVM: its own tests, and a phone that is killed in the middle of a walk past a
//! real rig. Skipped, and said so, where there is no `javac`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use crate::sidecar_rig::SidecarRig;
use lsfb_recording::Recording;
use lsfb_tests::{Lacks, skip};
use nix::sys::signal::Signal;

const MESSAGES: usize = 1500;

fn java_sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            java_sources(&path, found);
        } else if path.extension().is_some_and(|end| end == "java") {
            found.push(path);
        }
    }
}

fn ran(command: &mut Command) -> Output {
    let output = command.output().expect("it is there");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    output
}

/// Compiles the recorder's core; `None` where nobody can.
fn compiled(out: &Path) -> Option<()> {
    if Command::new("javac").arg("-version").output().is_err() {
        return None;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../capture/android/core");
    let mut sources = Vec::new();
    java_sources(&root, &mut sources);
    let mut javac = Command::new("javac");
    ran(javac
        .args(["-Xlint:all", "-Werror", "--release", "11", "-d"])
        .arg(out)
        .args(sources));
    Some(())
}

#[test]
fn the_android_recorder_resumes_where_it_was_killed() {
    let folder = tempfile::tempdir().expect("folder");
    let classes = folder.path().join("classes");
    if compiled(&classes).is_none() {
        let test = "the_android_recorder_resumes_where_it_was_killed";
        return skip(test, Lacks::Program, "no javac is installed");
    }
    let java = |class: &str| {
        let mut java = Command::new("java");
        java.arg("-cp").arg(&classes).arg(class);
        java
    };
    let document = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/sidecar.md");
    ran(java("lsfb.sidecar.CoreTest")
        .arg(document)
        .arg(folder.path()));

    let rig = SidecarRig::new();
    let (mut recorder, out) = rig.recorder(0);
    rig.wait_for(&mut recorder);
    let code = rig.invite(rig.address).to_text();
    let walk = || {
        let mut walk = java("lsfb.sidecar.Walk");
        walk.args([&code, "pixel8"])
            .arg(folder.path().join("walk"))
            .args([&MESSAGES.to_string(), "1"]);
        walk
    };
    // Killed twice: nothing is told, nothing is closed.
    for _ in 0..2 {
        let mut killed = walk().stderr(Stdio::null()).spawn().expect("java");
        std::thread::sleep(Duration::from_millis(1_300));
        killed.kill().expect("killed");
        killed.wait().expect("an end");
    }
    let whole = ran(&mut walk());
    let said = String::from_utf8_lossy(&whole.stdout).into_owned();
    assert!(said.contains(&format!("stored {MESSAGES}")), "{said}");
    recorder.signal(Signal::SIGINT);
    recorder.wait();

    let recording = Recording::open(&out).expect("a recording");
    let samples = recording.imu().expect("a topic");
    let numbers: Vec<f64> = samples
        .map(|sample| sample.expect("whole").sample.angular_velocity_rad_s[0])
        .collect();
    let expected: Vec<f64> = (0..MESSAGES).map(|n| n as f64).collect();
    assert_eq!(numbers, expected);
    let exchanges = recording.messages("/sidecar/pixel8/time_sync");
    assert!(exchanges.expect("a topic").count() >= 10);
}
