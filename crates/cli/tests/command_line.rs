//! What every command shares: refusals in one sentence, exit codes, stdout that is full or closed, results that stay.

use std::fs::File;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::answer::json;
use crate::inlier_lines::hold_against_poses;
use crate::pages;
use crate::process::lsfb;
use crate::refusal::found_unfit;
use crate::session::with;
use serde_json::Value;

fn here() -> &'static Path {
    Path::new(env!("CARGO_TARGET_TMPDIR"))
}

fn said(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    text
}

/// A command with bad arguments, and the sentence it must say.
fn bad_arguments(arguments: &[&str], words: &str) {
    let output = lsfb(here(), arguments);
    let text = said(&output);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
    assert!(text.contains(words), "{arguments:?}: {text}");
}

#[test]
fn numbers_out_of_range_are_refused_with_a_sentence() {
    bad_arguments(
        &["--threads", "100000", "doctor", "x.mcap"],
        "expected a whole number from 0 (all cores) to 1024",
    );
    for command in ["demo", "sim", "mock"] {
        bad_arguments(
            &[command, "--out", "never", "--seed", "-5"],
            "expected a whole number from 0 to",
        );
    }
    bad_arguments(
        &["sim", "preview", "--out", "never", "--seed", "-5"],
        "expected a whole number from 0 to",
    );
    assert!(!here().join("never").exists());
}

#[test]
#[cfg(feature = "view")]
fn a_view_of_nothing_is_refused() {
    bad_arguments(&["view", "--out", "never.rrd"], "MCAP");
    assert!(!here().join("never.rrd").exists());
}

#[test]
fn exit_codes_are_in_the_help() {
    let output = lsfb(here(), &["--help"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    for (code, meaning) in [
        ("0", "done"),
        ("1", "failed"),
        ("2", "bad"),
        ("3", "finished"),
        ("4", "a check of the data failed"),
        ("129, 130, 143", "stopped"),
    ] {
        let mut lines = text
            .lines()
            .filter_map(|line| line.trim().strip_prefix(code));
        let is_said = lines.any(|rest| rest.starts_with("  ") && rest.trim().starts_with(meaning));
        assert!(is_said, "{code}: {text}");
    }
}

#[test]
fn a_full_disk_under_stdout_is_an_error_and_no_panic() {
    let full = File::options()
        .write(true)
        .open("/dev/full")
        .expect("/dev/full");
    let output = Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(["completions", "bash"])
        .stdout(full)
        .stderr(Stdio::piped())
        .output()
        .expect("the built binary");
    let text = said(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("standard output"), "{text}");
    assert!(text.contains("disk") && text.contains("full"), "{text}");
}

#[test]
fn the_name_of_a_file_cannot_command_the_terminal() {
    let output = lsfb(here(), &["doctor", "no-such\u{1b}]0;owned\u{7}.mcap"]);
    let text = said(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("no-such\u{fffd}]0;owned\u{fffd}.mcap"),
        "{text:?}"
    );
    assert!(!text.contains('\u{1b}'), "{text:?}");
}

#[test]
fn a_full_disk_under_stderr_is_no_panic() {
    let full = File::options()
        .write(true)
        .open("/dev/full")
        .expect("/dev/full");
    let status = Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(["doctor", "no-such.mcap"])
        .stdout(Stdio::null())
        .stderr(full)
        .status()
        .expect("the built binary");
    assert_eq!(status.code(), Some(1));
}

#[test]
fn who_closes_stdout_has_read_enough() {
    let mut process = Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(["completions", "zsh"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the built binary");
    drop(process.stdout.take());
    let output = process.wait_with_output().expect("an end");
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    assert!(output.stderr.is_empty());
}

#[test]
fn results_stay_unless_they_may_be_replaced() {
    let folder = with(&["scan.mcap"]);
    let path = folder.path();
    for (arguments, result) in [
        (
            &["odometry", "scan.mcap", "--out", "new.tum"][..],
            "new.tum",
        ),
        (&["recover", "scan.mcap", "--out", "new.mcap"], "new.mcap"),
    ] {
        std::fs::write(path.join(result), "yesterday").expect("file");
        let output = lsfb(path, arguments);
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        assert!(said(&output).contains("--force"), "{}", said(&output));
        let left = std::fs::read(path.join(result)).expect("file");
        assert_eq!(left, b"yesterday", "{arguments:?}");
        let output = lsfb(path, &[arguments, &["--force", "--quiet"]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        assert_eq!(said(&output), "", "quiet");
        let left = std::fs::read(path.join(result)).expect("file");
        assert_ne!(left, b"yesterday", "{arguments:?}");
    }
    let plan = "runs = 1\n[[sequence]]\nname = \"a\"\ninput = \"scan.mcap\"\ntruth = \"new.tum\"\nlonger_side_m = 10.0\n\
                [[system]]\nname = \"none\"\ncommand = \"false\"\n";
    std::fs::write(path.join("plan.toml"), plan).expect("plan");
    std::fs::create_dir(path.join("bench")).expect("folder");
    std::fs::write(path.join("bench/table.tex"), "yesterday").expect("file");
    let output = lsfb(path, &["bench", "slam", "plan.toml", "--out", "bench"]);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("--force"), "{}", said(&output));
    let left = std::fs::read(path.join("bench/table.tex")).expect("file");
    assert_eq!(left, b"yesterday");
    // Nothing takes the place of what it was made from.
    let before = std::fs::read(path.join("scan.mcap")).expect("recording");
    for command in [
        "recover scan.mcap --out scan.mcap",
        "odometry scan.mcap --out ./scan.mcap",
        "clock scan.mcap --out scan.mcap",
        "map scan.mcap --out map --out-trajectory scan.mcap",
        "view scan.mcap --out scan.mcap",
        "calib verify scan.mcap --out scan.mcap",
        "eval new.tum --truth scan.mcap --out scan.mcap",
        "calib import kalibr scan.mcap --out scan.mcap",
    ] {
        let arguments: Vec<&str> = command.split(' ').chain(["--force"]).collect();
        let output = lsfb(path, &arguments);
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        let left = std::fs::read(path.join("scan.mcap")).expect("recording");
        assert!(left == before, "{command}");
    }
}

#[test]
fn a_map_that_stands_is_not_built_again_and_another_is_not_replaced() {
    let folder = with(&["scan.mcap"]);
    let path = folder.path();
    let map = [
        "map",
        "scan.mcap",
        "--out",
        "map",
        "--out-trajectory",
        "scan.tum",
        "--json",
    ];
    let first = lsfb(path, &map);
    assert_eq!(first.status.code(), Some(0), "{}", said(&first));
    let written = |name: &str| {
        let meta = std::fs::metadata(path.join(name)).expect("result");
        meta.modified().expect("time")
    };
    let names = ["map/map.toml", "scan.tum", "map.finished.json"];
    let before = names.map(written);
    let again = lsfb(path, &map);
    assert_eq!(again.status.code(), Some(0), "{}", said(&again));
    assert!(said(&again).contains("up to date"), "{}", said(&again));
    let points = |output: &Output| {
        let said: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        said["points"].as_u64().expect("points")
    };
    assert_eq!(points(&again), points(&first));
    assert_eq!(names.map(written), before);

    // Other settings are another map.
    std::fs::write(path.join("other.toml"), "keyframe_distance_m = 0.5\n").expect("settings");
    let other = [&map[..], &["--config", "other.toml"]].concat();
    let refused = lsfb(path, &other);
    assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
    assert_eq!(names.map(written), before);

    // Half a trajectory is none: it is made again, as soon as it may be.
    std::fs::write(path.join("scan.tum"), "# half").expect("trajectory");
    let refused = lsfb(path, &map);
    assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
    let forced = lsfb(path, &[&map[..], &["--force"]].concat());
    assert_eq!(forced.status.code(), Some(0), "{}", said(&forced));
    assert_eq!(forced.stdout, first.stdout);
}

/// Every command that judges answers programs alike: one verdict, the worst of its findings, and each finding with all of its fields.
#[test]
fn every_judgement_has_one_shape() {
    const FIELDS: [&str; 9] = [
        "code", "limit", "remedy", "sigma", "unit", "value", "verdict", "what", "where",
    ];
    let folder = with(&["scan.mcap", "map"]);
    let path = folder.path();
    let walk: String = (0..200)
        .map(|n| {
            let t = f64::from(n) * 0.1;
            format!(
                "{t:.1} {:.4} {:.4} {:.4} 0 0 0 1\n",
                t.sin(),
                t.cos(),
                0.1 * t
            )
        })
        .collect();
    std::fs::write(path.join("walk.tum"), walk).expect("trajectory");
    for command in [
        "doctor scan.mcap",
        "clock scan.mcap --out clock.html",
        "calib verify scan.mcap --out verify.html",
        "calib verify scan.mcap --out clocks.html --out-rig clocks.toml",
        "eval walk.tum --truth walk.tum --out eval.html",
        "localize map scan.mcap --out-report localize.html",
        "map crop map --min-m=-99,-99,-99 --max-m 99,99,99 --out part",
        "map export keyframes map --out poses",
    ] {
        let arguments: Vec<&str> = command.split(' ').chain(["--json"]).collect();
        let output = lsfb(path, &arguments);
        let answer: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{command}: {error}: {}", said(&output)));
        let verdict = answer["verdict"].as_str().expect("a verdict");
        assert!(answer["summary"].is_string(), "{command}: {answer}");
        let findings = answer["findings"].as_array().expect("findings");
        assert!(!findings.is_empty(), "{command}: {answer}");
        for finding in findings {
            let fields: Vec<&String> = finding.as_object().expect("an object").keys().collect();
            assert_eq!(fields, FIELDS, "{command}: {finding}");
        }
        let worst = ["fail", "warn", "pass", "unknown"];
        let worst = worst
            .into_iter()
            .find(|word| findings.iter().any(|f| f["verdict"] == *word));
        assert_eq!(Some(verdict), worst, "{command}: {answer}");
        let failed = output.status.code() == Some(4);
        assert_eq!(failed, verdict == "fail", "{command}: {answer}");
        // A page that is written before all is judged says another thing than the exit code.
        if let Some(page) = arguments.iter().find(|a| a.ends_with(".html")) {
            let page = std::fs::read_to_string(path.join(page)).expect("a page");
            let drawn = format!("verdict {verdict}");
            assert!(page.contains(&drawn), "{command}: {verdict}");
        }
    }
    pages::are_whole(path);
}

#[test]
fn maps_that_stand_are_shown_exported_and_cut_and_joined_with_no_part_of_themselves() {
    let folder = with(&["map"]);
    let path = folder.path();
    let info = json(path, &["map", "info", "map"], 0);
    let count = |value: &Value, name: &str| value[name].as_u64().expect("a count");
    let points = count(&info, "points");
    assert_eq!(info["cameras"].as_array().map(Vec::len), Some(4));
    let median_sigma_m = info["point_sigma_m"][0].as_f64().expect("metres");
    assert!((1e-4..0.2).contains(&median_sigma_m), "{median_sigma_m} m");

    let formats = [
        ("colmap", "points3D.txt"),
        ("colmap-binary", "rig_config.json"),
        ("kapture", "sensors/sensors.txt"),
        ("ply", "points.ply"),
        ("laz", "points.laz"),
    ];
    for (format, file) in formats {
        let said = json(path, &["map", "export", format, "map", "--out", format], 0);
        assert_eq!(count(&said, "points"), points);
        assert!(path.join(format).join(file).exists(), "{file}");
    }
    let again = lsfb(path, &["map", "export", "ply", "map", "--out", "ply"]);
    assert_eq!(again.status.code(), Some(1), "{}", said(&again));

    let half = [
        "map",
        "crop",
        "map",
        "--min-m=-99,-99,-99",
        "--max-m",
        "99,99,1",
        "--out",
        "half",
    ];
    let cropped = count(&json(path, &half, 0), "points");
    assert!(cropped > 0 && cropped < points, "{cropped} of {points}");
    let turned = [
        "map", "crop", "map", "--min-m", "1,1,1", "--max-m", "0,0,0", "--out", "none",
    ];
    assert!(said(&lsfb(path, &turned)).contains("the smallest coordinates or more"));
    // Naively each observation of that half stood twice in the result.
    let joined = ["map", "merge", "map", "half", "--out", "both"];
    found_unfit(
        path,
        &joined,
        &["same images", "part of the other", "whole one"],
    );
    assert!(!path.join("both").exists());
}

#[test]
fn how_well_keyframes_are_known_is_judged_by_a_truth() {
    let folder = with(&["map", "scan.tum"]);
    let path = folder.path();
    let info = json(path, &["map", "info", "map"], 0);
    let sigma_m = info["keyframe_sigma"]["position_m"][0]
        .as_f64()
        .expect("metres");
    assert!((1e-5..0.01).contains(&sigma_m), "{sigma_m} m");
    let export = ["map", "export", "keyframes", "map", "--out", "poses"];
    let said = json(path, &export, 0);
    assert_eq!(said["keyframes"], info["keyframes"]);
    assert_eq!(said["with_covariance"], info["keyframes"]);
    let judged = json(
        path,
        &[
            "eval",
            "poses/keyframes_covariance.txt",
            "--truth",
            "scan.tum",
            "--align",
            "origin",
        ],
        // The trajectory was bent through these keyframes, and there are few of them: no result, but it is read.
        4,
    );
    let text = judged.to_string();
    assert!(text.contains("nees_mean"), "{text}");
}

#[test]
fn maps_are_pruned_and_looked_at() {
    let folder = with(&["map", "scan.mcap", "scan.tum"]);
    let path = folder.path();
    let whole = json(path, &["map", "info", "map"], 0);
    let mb = whole["bytes"].as_f64().expect("bytes") / 1e6;
    let size = format!("{:.3}", 0.7 * mb);
    let prune = ["map", "prune", "map", "--size-mb", &size, "--out", "small"];
    let said = json(path, &prune, 0);
    let left_mb = said["size_mb"][1].as_f64().expect("a size");
    assert!(
        left_mb <= 0.7 * mb && left_mb > 0.4 * mb,
        "{left_mb} of {mb}"
    );
    let small = json(path, &["map", "info", "small"], 0);
    assert!(small["points"].as_u64() <= whole["points"].as_u64());
    assert!(small["descriptors"].as_u64() < whole["descriptors"].as_u64());
    assert!(small["keyframe_sigma"].is_object(), "{small}");
    let none = ["map", "prune", "map", "--size-mb", "0.01", "--out", "none"];
    let refused = lsfb(path, &none);
    assert_eq!(refused.status.code(), Some(4));
    assert!(
        self::said(&refused).contains("MB or more"),
        "{}",
        self::said(&refused)
    );
    assert!(!path.join("none").exists());

    let view = [
        "map",
        "view",
        "map",
        "--recording",
        "scan.mcap",
        "--trajectory",
        "scan.tum",
        "--out",
        "map.rrd",
        "--out-report",
        "map.html",
    ];
    let said = json(path, &view, 0);
    assert_eq!(said["points"], whole["points"]);
    assert!(said["surface_points"].as_u64() > Some(1_000), "{said}");
    assert!(said["images"].as_u64() >= whole["keyframes"].as_u64());
    assert!(
        std::fs::metadata(path.join("map.rrd"))
            .expect("a file")
            .len()
            > 10_000
    );
    let page = std::fs::read_to_string(path.join("map.html")).expect("a page");
    pages::are_whole(path);
    assert!(page.contains("3D view") && page.contains("keyframes"));
    let alone = [
        "map",
        "view",
        "map",
        "--recording",
        "scan.mcap",
        "--out",
        "b.rrd",
    ];
    assert_eq!(lsfb(path, &alone).status.code(), Some(2));
}

#[test]
fn depth_is_given_where_the_scanner_saw_something() {
    let folder = with(&["scan.mcap", "scan.tum"]);
    let path = folder.path();
    let poses = std::fs::read_to_string(path.join("scan.tum")).expect("poses");
    let stamped: Vec<&str> = poses.lines().filter(|l| !l.starts_with('#')).collect();
    let chosen = [stamped[stamped.len() / 3], stamped[stamped.len() / 2]];
    std::fs::write(path.join("two.tum"), chosen.join("\n")).expect("poses");
    let far = chosen.map(|line| {
        let (stamp, rest) = line.split_once(' ').expect("a stamp");
        let rest = rest.split_once(' ').expect("x").1;
        format!("{stamp} 500 {rest}")
    });
    std::fs::write(path.join("far.tum"), far.join("\n")).expect("poses");
    let depth = |poses: &str, out: &str| {
        let words = format!(
            "--json map depth scan.mcap --trajectory scan.tum --poses {poses} --camera cam0 --out {out}"
        );
        lsfb(path, &words.split(' ').collect::<Vec<_>>())
    };
    let given = depth("two.tum", "depths");
    assert_eq!(given.status.code(), Some(0), "{}", said(&given));
    // Images of other poses stood among those of these.
    let again = depth("scan.tum", "depths");
    assert_eq!(again.status.code(), Some(1));
    assert!(said(&again).contains("--force"), "{}", said(&again));
    let folder = path.join("depths/depth/cam0");
    let files: Vec<_> = folder.read_dir().expect("a folder").collect();
    assert_eq!(files.len(), 2);
    let file = files[0].as_ref().expect("a file").path();
    let normals = path
        .join("depths/normals/cam0")
        .join(file.file_name().expect("a name"));
    assert!(normals.exists());
    let file = std::io::BufReader::new(File::open(file).expect("a file"));
    let mut reader = png::Decoder::new(file).read_info().expect("PNG");
    assert_eq!(reader.info().bit_depth, png::BitDepth::Sixteen);
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    reader.next_frame(&mut bytes).expect("pixels");
    let depths_mm = bytes.chunks(2).map(|b| u16::from_be_bytes([b[0], b[1]]));
    let known: Vec<u16> = depths_mm.filter(|d| *d > 0).collect();
    assert!(known.len() * 20 > bytes.len() / 2, "{} known", known.len());
    assert!(known.iter().all(|d| (300..20_000).contains(d)), "{known:?}");

    // Poses of another place show nothing, and that is no result.
    let refused = depth("far.tum", "none");
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        said(&refused).contains("give poses in the world frame of"),
        "{}",
        said(&refused)
    );
}

/// An EuRoC folder of a walk and the walk itself are the same images and samples: so are their poses.
#[test]
fn a_walk_that_was_imported_is_localized_as_it_was_recorded() {
    let folder = with(&["walk.mcap", "map"]);
    let path = folder.path();
    let walk = lsfb_recording::Recording::open(&path.join("walk.mcap")).expect("a walk");
    let rig = walk.rig().expect("a rig");
    std::fs::write(path.join("rig.toml"), rig.to_toml()).expect("rig");
    let write = |name: &str, text: String| {
        let file = path.join("mav0").join(name);
        std::fs::create_dir_all(file.parent().expect("a folder")).expect("folder");
        std::fs::write(file, text).expect("file");
    };
    let samples = walk.imu().expect("imu").map(|s| s.expect("a sample"));
    let rows = samples.map(|s| {
        let ([wx, wy, wz], [ax, ay, az]) = (
            s.sample.angular_velocity_rad_s,
            s.sample.specific_force_m_s2,
        );
        format!("{},{wx},{wy},{wz},{ax},{ay},{az}\n", s.time.nanos())
    });
    write("imu0/data.csv", rows.collect());
    for camera in rig.cameras.keys() {
        std::fs::create_dir_all(path.join(format!("mav0/{camera}/data"))).expect("folder");
        let mut list = String::new();
        for image in walk.images(camera).expect("images") {
            let image = image.expect("an image");
            let name = format!("{}.png", image.time.nanos());
            let file = path.join(format!("mav0/{camera}/data/{name}"));
            let file = File::create(file).expect("file");
            let mut encoder = png::Encoder::new(file, image.sample.width, image.sample.height);
            encoder.set_color(png::ColorType::Grayscale);
            let mut writer = encoder.write_header().expect("PNG");
            writer.write_image_data(&image.sample.pixels).expect("PNG");
            list += &format!("{},{name}\n", image.time.nanos());
        }
        write(&format!("{camera}/data.csv"), list);
    }
    let run = |words: &str, code: i32| {
        let output = lsfb(path, &words.split(' ').collect::<Vec<_>>());
        let exit = output.status.code();
        assert_eq!(exit, Some(code), "{words}: {}", said(&output));
    };
    run(
        "import mav0 --out imported.mcap --device glasses --rig rig.toml",
        0,
    );
    // None of these few small images is found, which is no success; what was matched is written.
    run(
        "localize map walk.mcap --out walk.tum --out-matches walk.csv",
        4,
    );
    run("localize map imported.mcap --out imported.tum", 4);
    let found = |name: &str| std::fs::read_to_string(path.join(name)).expect("a table");
    assert_eq!(found("walk.tum"), found("imported.tum"));
    // A line per instant: what was matched, whether or not it was enough here.
    assert!(found("walk.tum").lines().count() > 10);
    let [poses, matches] = ["walk.tum", "walk.csv"].map(|name| path.join(name));
    assert!(hold_against_poses(&poses, &matches, &rig) > 10);

    // The same folder as images, each for itself: its cameras are those of the rig by their names.
    run(
        "localize map mav0 --rig rig.toml --every 5 --out images.csv",
        4,
    );
    let lines = found("images.csv");
    let of = |camera: &str| lines.lines().filter(|l| l.starts_with(camera)).count();
    for camera in rig.cameras.keys() {
        assert!(of(&format!("{camera}/data/")) > 1, "{camera}: {lines}");
    }
    // What is not said, or twice, is asked for.
    let refused = |words: &str, expected: &str| {
        let output = lsfb(path, &words.split(' ').collect::<Vec<_>>());
        assert_eq!(output.status.code(), Some(1), "{words}");
        assert!(said(&output).contains(expected), "{}", said(&output));
    };
    refused("localize map mav0", "sensor.yaml");
    write(
        "cameras.txt",
        "1 PINHOLE 640 480 500 500 320 240\n".to_owned(),
    );
    refused(
        "localize map mav0 --rig rig.toml",
        "COLMAP (cameras.txt or cameras.bin) or EuRoC (cam0/data.csv)",
    );
    refused("localize map map", "transforms.json");
    refused("localize map mav0/cam0/data", "--rig, or K.txt");
}
