//! `lsfb demo` interrupted and finished, and its stages once more on one thread, on a walk short enough for a test.

use std::collections::BTreeMap;
use std::path::Path;

use crate::answer::json;
use crate::pages;
use crate::process::lsfb;
use crate::running::Running;
use crate::sidecar_rig::SidecarRig;
use lsfb_recording::sha256_of;
use nix::sys::signal::Signal;

/// The demo but for its length, with half of its images.
const SHORT: &str = "[scan]\nduration_s = 14.0\n[scan_cameras]\nrate_hz = 5\n[glasses]\nduration_s = 6.0\nheight_m = 1.62\n[glasses_cameras]\nrate_hz = 5\n";

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

/// The demo as it runs to its end, looked at.
fn finished(root: &Path, arguments: &[&str]) {
    let run = json(root, arguments, 0);
    let figure = |name: &str| run[name].as_f64().expect("figure");
    assert!(figure("ate_glasses_rms_m") <= 0.03, "{run}");
    assert!(figure("ate_scanner_rms_m") <= 0.03, "{run}");
    assert!(figure("map_reprojection_px") <= 1.5, "{run}");
    assert_eq!(run["lost"], 0, "{run}");
    assert_eq!(run["left_out"], 0, "{run}");
}

/// Refused with these words; nothing was computed.
fn refused(root: &Path, arguments: &[&str], says: &str) {
    let run = lsfb(root, arguments);
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    assert!(
        String::from_utf8_lossy(&run.stderr).contains(says),
        "{run:?}"
    );
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
fn the_same_seed_gives_the_same_bytes_also_when_interrupted_and_no_stage_needs_the_truth() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(root.join("short.toml"), SHORT).expect("settings");
    let demo = |out, seed| {
        [
            "demo",
            "--config",
            "short.toml",
            "--out",
            out,
            "--seed",
            seed,
        ]
    };
    let hashes = |out: &str| {
        ["scan.mcap", "walk.mcap"].map(|name| {
            let path = root.join(out).join(name);
            sha256_of(&path).expect("recording")
        })
    };
    // Stopped where both recordings are there.
    let stopped = |arguments: &[&str]| {
        let mut running = Running::lsfb(root, arguments.iter().map(|&a| a.to_owned()));
        running.wait_for("lidar odometry");
        running.signal(Signal::SIGTERM);
        assert_eq!(running.wait().code(), Some(143), "{}", running.said());
        let said = running.said();
        assert!(said.contains("stopped by SIGTERM"), "{said}");
    };
    let many = demo("many", "1");
    stopped(&many);
    let before = hashes("many");
    // Another demo does not take the folder.
    refused(root, &demo("many", "4"), "--force");
    finished(root, &many);
    assert_eq!(hashes("many"), before, "recorded once");
    let expected = results(&root.join("many"));

    // Its figures are no proof, and its page says so.
    let page = std::fs::read_to_string(root.join("many/report.html")).expect("report");
    assert!(page.contains("The demo is easy") && page.contains("lsfb bench twin"));
    pages::are_whole(root);

    // What is finished stays as it is.
    let report = || {
        let report = std::fs::metadata(root.join("many/report.html")).expect("report");
        report.modified().expect("time")
    };
    let written = report();
    refused(root, &many, "this demo is finished");
    assert_eq!(report(), written);
    assert_eq!(hashes("many"), before);

    // The stages as subcommands, uninterrupted and on one thread, where there are recordings, of one thread as well, and nothing else.
    stopped(&[&demo("once", "1")[..], &["--threads", "1"]].concat());
    let alone = root.join("alone");
    std::fs::create_dir(&alone).expect("folder");
    for name in ["scan.mcap", "walk.mcap"] {
        std::fs::rename(root.join("once").join(name), alone.join(name)).expect("recording");
    }
    // For who judges, out of reach of who estimates.
    std::fs::rename(root.join("once/truth"), root.join("truth")).expect("truth");
    for folder in ["many", "once"] {
        std::fs::remove_dir_all(root.join(folder)).expect("folder");
    }
    let map = "map scan.mcap --out map --out-trajectory scan.tum --threads 1";
    json(&alone, &map.split(' ').collect::<Vec<_>>(), 0);
    somebody_heard_the_same(&alone, &expected["walk.tum"]);
    let truth = "groundtruth walk.mcap --map map --radio radio.csv --out walk.tum --threads 1";
    let found = json(&alone, &truth.split(' ').collect::<Vec<_>>(), 0);
    let findings = found["findings"].as_array().expect("findings");
    let radio = findings.iter().find(|f| f["code"] == "radio");
    assert_eq!(radio.expect("compared")["verdict"], "pass", "{found}");
    assert_same(&expected, &results(&alone));
    the_bag_of_a_walk_has_its_motion(&alone);
    what_is_left_out_is_said(&alone);
    a_walk_sent_by_a_phone_is_worth_as_much(&alone, &root.join("truth/truth_walk.tum"));
}

/// A table of what the walk heard on its trajectory, an hour later.
fn somebody_heard_the_same(folder: &Path, trajectory: &[u8]) {
    std::fs::write(folder.join("others.tum"), trajectory).expect("trajectory");
    let table = "dataset radio walk.mcap --trajectory others.tum --out radio.csv";
    json(folder, &table.split(' ').collect::<Vec<_>>(), 0);
    let path = folder.join("radio.csv");
    let table = std::fs::read_to_string(&path).expect("table");
    let later = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if let Ok(time_ns) = cells[1].parse::<i64>() {
            cells[1] = (time_ns + 3_600_000_000_000).to_string();
        }
        cells.join(",") + "\n"
    };
    let later: String = table.lines().map(later).collect();
    std::fs::write(path, later).expect("table");
}

/// From the phone to the ground truth: played through the protocol, with cut connections and damaged messages, recorded by a rig,
/// solved as one with the walk itself, which each must be right for alone, and judged.
fn a_walk_sent_by_a_phone_is_worth_as_much(folder: &Path, truth: &Path) {
    let rig = SidecarRig::new();
    let (mut recorder, recording) = rig.recorder(0);
    rig.wait_for(&mut recorder);
    let code = rig.invite(rig.address).to_text();
    let play = [
        "sidecar",
        "play",
        "walk.mcap",
        "--code",
        &code,
        "--fault-seed",
        "7",
        "--speed",
        "2",
    ];
    let played = lsfb(folder, &play);
    assert_eq!(played.status.code(), Some(0), "{played:?}");
    // It ends with its only phone.
    assert!(recorder.wait().success());
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let walks = ["sidecar", "walks", &text(&recording), "--out", "walks"];
    let walks = json(folder, &walks, 0);
    let walk = walks["walks"][0]["path"].as_str().expect("a walk");
    let judged = |estimate: &str| {
        let judged = json(folder, &["eval", estimate, "--truth", &text(truth)], 0);
        let rms_m = judged["ate_translation_m"]["rmse"].as_f64();
        assert!(rms_m.is_some_and(|rms_m| rms_m <= 0.03), "{judged}");
    };
    let line = format!("groundtruth {walk} --with walk.mcap --map map --out both.tum");
    let both = json(folder, &line.split(' ').collect::<Vec<_>>(), 0);
    let together = &both["together"];
    assert_eq!(together["others"], 1, "{both}");
    let common = |of: &str| together[of].as_u64();
    assert!(
        common("map_points") > Some(50) && common("common_points") > Some(20),
        "{both}"
    );
    judged("both.tum");
    // The other walk's trajectory, of the same solve.
    judged("both_with_walk.tum");
    let other = &both["with"]["both_with_walk.tum"];
    assert_eq!(
        other["together"]["map_points"], together["map_points"],
        "{both}"
    );
    for beside in [
        "covariance.txt",
        "cross_check.txt",
        "states.csv",
        "states.mcap",
    ] {
        let written = folder.join(format!("both_with_walk_{beside}"));
        assert!(written.is_file(), "{beside}");
    }
}

/// For who reads ROS: the same poses at the images, with covariances, and at the IMU's rate.
fn the_bag_of_a_walk_has_its_motion(folder: &Path) {
    for stream in ["/pose", "/imu_rate/pose"] {
        let line = format!(
            "eval walk_states.mcap --estimate-stream {stream} --truth walk.tum --align none"
        );
        let judged = json(folder, &line.split(' ').collect::<Vec<_>>(), 0);
        let rms_m = judged["ate_translation_m"]["rmse"].as_f64();
        assert!(rms_m.is_some_and(|rms_m| rms_m < 1e-6), "{judged}");
    }
    let states = std::fs::read_to_string(folder.join("walk_states.csv")).expect("states");
    let rows = states.lines().filter(|line| !line.starts_with('#'));
    let bag = lsfb_recording::Recording::open(&folder.join("walk_states.mcap")).expect("a bag");
    let topics = bag.topics().iter();
    let count = |topic: &str| {
        topics
            .clone()
            .find(|t| t.topic == topic)
            .map(|t| t.messages)
    };
    let of_imu = Some(rows.count() as u64);
    for topic in ["pose", "velocity", "turn_rate", "gyroscope_bias"] {
        assert_eq!(count(&format!("/imu_rate/{topic}")), of_imu, "{topic}");
    }
    assert_eq!(count("/gravity"), Some(1));
}

/// A trajectory with a gap is not a whole one, for a script as for a person.
fn what_is_left_out_is_said(folder: &Path) {
    let checked = std::fs::read_to_string(folder.join("walk_cross_check.txt")).expect("check");
    let lines = checked.lines().filter(|line| !line.starts_with('#'));
    let moved_m = lines.map(|line| {
        let column = line.split(' ').nth(1).expect("a distance");
        column.parse::<f64>().expect("metres")
    });
    let mut moved_m: Vec<f64> = moved_m.collect();
    moved_m.sort_by(f64::total_cmp);
    let middle_m = moved_m[moved_m.len() / 2];
    let settings = format!("max_disagreement_m = {middle_m}\n");
    std::fs::write(folder.join("strict.toml"), settings).expect("settings");
    let strict = "groundtruth walk.mcap --map map --out strict.tum --config strict.toml --out-report strict.html";
    let strict: Vec<&str> = strict.split(' ').collect();
    for run in [json(folder, &strict, 3), json(folder, &strict, 3)] {
        let findings = run["findings"].as_array().expect("findings");
        let of = |code: &str| findings.iter().find(|f| f["code"] == code);
        let left_out = of("map-parts-disagree").unwrap_or_else(|| panic!("{run}"));
        assert_eq!(left_out["verdict"], "warn", "{run}");
        assert!(left_out["remedy"].is_string(), "{run}");
        assert_eq!(of("coverage").expect("coverage")["verdict"], "warn");
        assert!(run["poses"].as_u64() < run["frames"].as_u64(), "{run}");
    }
    the_page_of_a_walk_shows_what_is_left_out(&folder.join("strict.html"));
}

/// One file that fetches nothing, with all that is said of a walk.
fn the_page_of_a_walk_shows_what_is_left_out(path: &Path) {
    let page = std::fs::read_to_string(path).expect("page");
    for part in [
        "From above",
        "3D view",
        "Localized, exported and left out",
        "Standard deviation of positions",
        "Standard deviation of attitudes",
        "Agreement between halves of the map",
        "Reprojection of map points",
        "Reprojection of local points",
        "Left out",
        "map parts disagree",
        "Cameras relative to the rig file",
        "IMU errors",
        "verdict warn",
    ] {
        assert!(page.contains(part), "no {part:?}");
    }
    pages::are_whole(path.parent().expect("a folder"));
    let path = path.with_extension("html.provenance.json");
    assert!(path.exists(), "{}", path.display());
}

#[test]
fn somebodys_recordings_are_no_demo() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::create_dir(root.join("mine")).expect("folder");
    std::fs::write(root.join("mine/scan.mcap"), "mine").expect("recording");
    refused(root, &["demo", "--out", "mine"], "mine");
    assert_eq!(
        std::fs::read(root.join("mine/scan.mcap")).expect("recording"),
        b"mine"
    );
}
