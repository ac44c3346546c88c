//! `lsfb demo` twice and its stages once more, and a demo that is interrupted, on a walk short enough for a test.

mod answer;
mod process;
mod running;

use std::collections::BTreeMap;
use std::path::Path;

use answer::json;
use lsfb_recording::sha256_of;
use nix::sys::signal::Signal;
use process::lsfb;
use running::Running;

/// The demo but for its length.
const SHORT: &str = "[scan]\nduration_s = 14.0\n[glasses]\nduration_s = 6.0\nheight_m = 1.62\n";

/// What must not depend on the run: both trajectories and every file of the map.
fn results(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let map = std::fs::read_dir(folder.join("map")).expect("map");
    let mut names: Vec<String> = map
        .map(|entry| format!("map/{}", entry.expect("file").file_name().to_string_lossy()))
        .collect();
    assert!(names.len() >= 8, "{names:?}");
    names.extend(["scan.tum", "walk.tum"].map(str::to_owned));
    let read = |name: String| {
        let bytes = std::fs::read(folder.join(&name)).expect("result");
        (name, bytes)
    };
    names.into_iter().map(read).collect()
}

/// Like `assert_eq!`, without printing megabytes.
fn assert_same(left: &BTreeMap<String, Vec<u8>>, right: &BTreeMap<String, Vec<u8>>) {
    assert!(left.keys().eq(right.keys()));
    let differing: Vec<_> = left
        .iter()
        .filter(|(name, bytes)| right[*name] != **bytes)
        .map(|(name, _)| name)
        .collect();
    assert!(differing.is_empty(), "{differing:?} differ");
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_no_stage_needs_the_truth() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(root.join("short.toml"), SHORT).expect("settings");
    let demo = ["demo", "--seed", "1", "--sim-config", "short.toml", "--out"];
    let one = json(root, &[&demo[..], &["one", "--threads", "1"]].concat(), 0);
    let many = json(root, &[&demo[..], &["many"]].concat(), 0);
    for run in [&one, &many] {
        let figure = |name: &str| run[name].as_f64().expect("figure");
        assert!(figure("ate_glasses_rms_m") <= 0.03, "{run}");
        assert!(figure("ate_scanner_rms_m") <= 0.03, "{run}");
        assert!(figure("map_reprojection_px") <= 1.5, "{run}");
        assert_eq!(run["lost"], 0, "{run}");
    }
    let expected = results(&root.join("one"));
    assert_same(&expected, &results(&root.join("many")));

    // The stages as subcommands, where there are recordings and nothing else.
    let alone = root.join("alone");
    std::fs::create_dir(&alone).expect("folder");
    for name in ["scan.mcap", "walk.mcap"] {
        std::fs::rename(root.join("many").join(name), alone.join(name)).expect("recording");
    }
    std::fs::remove_dir_all(root.join("one")).expect("folder");
    std::fs::remove_dir_all(root.join("many")).expect("folder");
    json(
        &alone,
        &[
            "map",
            "scan.mcap",
            "--out",
            "map",
            "--out-trajectory",
            "scan.tum",
        ],
        0,
    );
    json(
        &alone,
        &[
            "groundtruth",
            "walk.mcap",
            "--map",
            "map",
            "--out",
            "walk.tum",
        ],
        0,
    );
    assert_same(&expected, &results(&alone));
}

#[test]
fn an_interrupted_demo_goes_on_and_a_finished_one_is_not_recorded_over() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(root.join("short.toml"), SHORT).expect("settings");
    let demo = [
        "demo",
        "--sim-config",
        "short.toml",
        "--out",
        "out",
        "--seed",
    ];
    let with_seed = |seed: &'static str| [&demo[..], &[seed]].concat();
    let mut running = Running::lsfb(root, with_seed("3").into_iter().map(str::to_owned));
    running.wait_for("lidar odometry");
    running.signal(Signal::SIGTERM);
    assert_eq!(running.wait().code(), Some(143), "{}", running.said());
    assert!(
        running.said().contains("stopped by SIGTERM"),
        "{}",
        running.said()
    );
    let recordings = ["scan.mcap", "walk.mcap"].map(|name| root.join("out").join(name));
    let hashes = || {
        recordings
            .clone()
            .map(|path| sha256_of(&path).expect("recording"))
    };
    let before = hashes();

    // Another demo does not take the folder.
    let refused = lsfb(root, &with_seed("4"));
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--force"));

    json(root, &with_seed("3"), 0);
    assert_eq!(hashes(), before, "recorded once");
    let report = std::fs::metadata(root.join("out/report.html")).expect("report");
    let refused = lsfb(root, &with_seed("3"));
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("this demo is finished"));
    let after = std::fs::metadata(root.join("out/report.html")).expect("report");
    assert_eq!(
        after.modified().expect("time"),
        report.modified().expect("time")
    );
    assert_eq!(hashes(), before);

    // Somebody's recordings are no demo.
    std::fs::create_dir(root.join("mine")).expect("folder");
    std::fs::write(root.join("mine/scan.mcap"), "mine").expect("recording");
    let refused = lsfb(root, &["demo", "--out", "mine"]);
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert_eq!(
        std::fs::read(root.join("mine/scan.mcap")).expect("recording"),
        b"mine"
    );
}
