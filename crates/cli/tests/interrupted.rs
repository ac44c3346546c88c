//! Stages that are told to stop: they end at once, and leave nothing half-written.

use std::fs::{DirEntry, File};
use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::running::{Running, wait_until};
use crate::session::with;
use lsfb_geometry::{Se3, StampedPose, Trajectory, UnitQuaternion, Vector3};
use lsfb_recording::write_tum;
use lsfb_types::Timestamp;
use nix::fcntl::OFlag;
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::Mode;
use nix::unistd::Pid;

#[test]
fn mapping_ends_at_once() {
    // Exit codes as shells have them: 128 and the number of the signal.
    ends_at_once(Signal::SIGINT, 130, "stopped by Ctrl-C");
    ends_at_once(Signal::SIGTERM, 143, "stopped by SIGTERM");
}

fn ends_at_once(signal: Signal, code: i32, words: &str) {
    let folder = with(&["scan.mcap"]);
    let (output, took) =
        stopped_at_work(folder.path(), &["map", "scan.mcap", "--out", "map"], signal);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(took < Duration::from_secs(3), "{text}");
    assert!(text.contains(words), "{text}");
    // A fast machine has finished the first stage by then, and keeps it for the next try.
    let kept = names_in(&folder.path().join("map.unfinished"));
    let is_whole = |name: &String| name == "made_from" || name.ends_with(".stage");
    assert!(kept.iter().all(is_whole), "half a stage: {kept:?}");
    let mut left = names_in(folder.path());
    left.retain(|name| name != "map.unfinished");
    assert_eq!(left, ["scan.mcap"], "the recording and nothing else");
}

/// Runs a command until it has computed for a third of a second, however busy the machine is, and sends it a signal. What it said, and how
/// long it took to end.
fn stopped_at_work(folder: &Path, arguments: &[&str], signal: Signal) -> (Output, Duration) {
    let mut process = Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(arguments)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the built binary");
    let id = process.id();
    wait_until("it is at work, or ended", || {
        worked_secs(id).is_none_or(|secs| secs > 0.3)
            || process.try_wait().is_ok_and(|end| end.is_some())
    });
    let asked = Instant::now();
    let id = i32::try_from(id).expect("process id");
    kill(Pid::from_raw(id), signal).expect("signal");
    let output = process.wait_with_output().expect("an end");
    (output, asked.elapsed())
}

/// User and system time of a process, in hundredths of a second behind its name in brackets (proc_pid_stat(5)).
fn worked_secs(id: u32) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    let (_, fields) = text.rsplit_once(')')?;
    let times = fields.split_whitespace().skip(11).take(2);
    Some(
        times
            .filter_map(|ticks| ticks.parse::<f64>().ok())
            .sum::<f64>()
            / 100.0,
    )
}

/// Short commands read on, wrote and ended with 0.
#[test]
fn what_is_asked_for_while_a_file_is_read_is_not_written() {
    for page in [&["--out", "floor.html"][..], &[]] {
        let folder = tempfile::tempdir().expect("folder");
        let survey = folder.path().join("floor.survey");
        nix::unistd::mkfifo(&survey, Mode::S_IRWXU).expect("a pipe");
        let solve = ["survey", "solve", "floor.survey"];
        let arguments = [&solve[..], page].concat();
        let mut running = Running::lsfb(folder.path(), arguments.iter().map(|a| (*a).to_owned()));
        // It is open for writing as soon as somebody reads.
        let mut pipe = None;
        running.wait_until("the survey is opened", || {
            let mut options = File::options();
            options.write(true).custom_flags(OFlag::O_NONBLOCK.bits());
            pipe = options.open(&survey).ok();
            pipe.is_some()
        });
        running.signal(Signal::SIGINT);
        let mut pipe = pipe.expect("a pipe");
        pipe.write_all(SURVEY.as_bytes()).expect("the survey");
        drop(pipe);
        assert_eq!(running.wait().code(), Some(130), "{}", running.said());
        assert!(running.said().contains("stopped by Ctrl-C"));
        assert_eq!(names_in(folder.path()), ["floor.survey"]);
    }
}

/// Three marks of a triangle.
const SURVEY: &str =
    "horizontal A B 3\nvertical A C 4\ndistance B C 5\ndistance A B 3\ndistance A C 4\n";

/// An IMU at rest for longer than its noise is read in a moment, and two trajectories that are long to align.
#[test]
fn calibrations_and_alignments_end_at_once() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    std::fs::write(path.join("imu.csv"), at_rest()).expect("samples");
    for name in ["a.tum", "b.tum"] {
        write_tum(&path.join(name), &turning()).expect("poses");
    }
    for line in [
        "calib imu-noise --imu imu.csv --out noise.html",
        "align a.tum --reference b.tum --search-secs 3600 --out truth.tum",
    ] {
        let arguments: Vec<&str> = line.split(' ').collect();
        let (output, _) = stopped_at_work(path, &arguments, Signal::SIGINT);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(130), "{line}: {said}");
        let mut left = names_in(path);
        left.sort();
        assert_eq!(left, ["a.tum", "b.tum", "imu.csv"], "{line}");
    }
}

/// An hour at 200 Hz, as EuRoC has it.
fn at_rest() -> String {
    let mut state = 1_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 16) / 65_536.0 - 0.5
    };
    let row = |k: i64| {
        let [a, b, c, d, e, f] = [(); 6].map(|()| 1e-3 * noise());
        let stamp = 1_772_359_200_000_000_000 + k * 5_000_000;
        format!(
            "{stamp},{a:.6},{b:.6},{c:.6},{d:.6},{e:.6},{:.6}\n",
            9.81 + f
        )
    };
    (0..720_000).map(row).collect()
}

/// Ten minutes of turns about all axes.
fn turning() -> Trajectory {
    let pose = |k: i64| {
        let t = 0.05 * k as f64;
        let [a, b, c] =
            [0.7, 1.1, 0.37].map(|rate| (rate * t).sin() + 0.3 * (rate * rate * t).cos());
        let rotation = UnitQuaternion::from_euler_angles(a, 0.5 * b, c);
        StampedPose {
            time: Timestamp::from_nanos(k * 50_000_000),
            world_from_rig: Se3::new(rotation, Vector3::new(a, c, b)),
        }
    };
    Trajectory::new((0..12_000).map(pose).collect())
}

/// Names of what is in a folder; none where it is not there.
fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let name = |entry: std::io::Result<DirEntry>| entry.expect("entry").file_name();
    let names = entries.map(|entry| name(entry).into_string().expect("UTF-8"));
    names.collect()
}
