//! `lsfb dataset`: one sequence made, checked, measured and exported.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::answer::json;
use crate::pages;
use crate::process::lsfb;
use lsfb_geometry::{Quaternion, Rig, Se3, Trajectory, UnitQuaternion, Vector3};
use lsfb_recording::{Recording, read_tum};
use lsfb_tests::foreign_python;
use lsfb_types::Timestamp;
use serde_json::Value;

const MAKE: &str = "dataset make --out ds --sequence C3-glasses --scale-percent 0.1 --min-secs 5 --small-images --seed 4711";

fn run(root: &Path, line: &str, code: i32) -> Value {
    json(root, &line.split(' ').collect::<Vec<_>>(), code)
}

fn said(root: &Path, line: &str) -> String {
    let output = lsfb(root, &line.split(' ').collect::<Vec<_>>());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_sequence_is_made_packed_checked_and_measured() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let made = run(root, MAKE, 0);
    let at = |name: &str| root.join("ds").join(name);
    for name in [
        "dataset.toml",
        "LICENSE.txt",
        "README.txt",
        "SHA256SUMS",
        "calibration/backpack.toml",
        "calibration/glasses.toml",
        "map/narrow-corridor/scan.mcap",
        "query/C3-glasses/walk.mcap",
        "truth/SHA256SUMS",
        "truth/map/narrow-corridor.tum",
        "truth/query/C3-glasses.tum",
    ] {
        assert!(at(name).is_file(), "{name}");
    }
    // Outside of the truth nothing says from which seed it can be made again.
    let recording = Recording::open(&at("query/C3-glasses/walk.mcap")).expect("walk");
    let session = recording.last_message("/sidecar/glasses/session");
    let session = session.expect("readable").expect("a session");
    let session = String::from_utf8_lossy(&session.bytes).into_owned();
    assert!(
        session.contains("C3-glasses") && !session.contains("4711"),
        "{session}"
    );
    for name in ["dataset.toml", "README.txt", "calibration/glasses.toml"] {
        let text = fs::read_to_string(at(name)).expect(name);
        assert!(!text.contains("4711"), "{name}: {text}");
    }
    sealing(root, &made);
    // What is packed is not made again.
    let before = fs::metadata(at("query/C3-glasses/walk.mcap"))
        .expect("walk")
        .modified()
        .expect("time");
    assert_eq!(run(root, MAKE, 0), made);
    let after = fs::metadata(at("query/C3-glasses/walk.mcap"))
        .expect("walk")
        .modified()
        .expect("time");
    assert_eq!(before, after);
    let other = MAKE.replace("4711", "4712");
    assert!(said(root, &other).contains("with other settings"));

    let stats = run(root, "dataset stats ds", 0);
    let sequence = &stats["sequences"][0];
    assert_eq!(sequence["images"]["cameras"][0]["frames"], 150, "{stats}");
    assert_eq!(
        sequence["images"]["cameras"].as_array().map(Vec::len),
        Some(2)
    );
    assert!(
        sequence["motion"]["length_m"].as_f64().expect("length") > 1.0,
        "{stats}"
    );

    let checked = run(root, "dataset check ds", 0);
    assert_eq!(checked["sums_sha256"], made["sums_sha256"]);
    let verdict = |line: &str, code| run(root, line, code)["verdict"].clone();
    let rig = fs::read(at("calibration/glasses.toml")).expect("rig");
    fs::write(at("calibration/glasses.toml"), [&rig[..], b"\n"].concat()).expect("rig");
    assert_eq!(verdict("dataset check ds", 4), "fail");
    fs::write(at("calibration/glasses.toml"), &rig).expect("rig");
    // Another truth, with hashes of its own, is not the one that was promised.
    let (truth, sums) = (at("truth/query/C3-glasses.tum"), at("truth/SHA256SUMS"));
    let (poses, list) = (
        fs::read(&truth).expect("truth"),
        fs::read(&sums).expect("sums"),
    );
    fs::write(&truth, "0 0 0 0 0 0 0 1\n").expect("truth");
    assert_eq!(verdict("dataset check ds", 4), "fail");
    let forged = lsfb_recording::sha256_of(&truth).expect("hash");
    let text = String::from_utf8(list.clone()).expect("text");
    let forged: String = text
        .lines()
        .map(|l| {
            if l.ends_with("C3-glasses.tum") {
                format!("{forged}  query/C3-glasses.tum\n")
            } else {
                format!("{l}\n")
            }
        })
        .collect();
    fs::write(&sums, forged).expect("sums");
    let found = run(root, "dataset check ds", 4);
    assert!(
        found["findings"]
            .to_string()
            .contains("differs from the one named in dataset.toml"),
        "{found}"
    );
    fs::write(&truth, poses).expect("truth");
    fs::write(&sums, list).expect("sums");
    assert_eq!(verdict("dataset check ds", 0), checked["verdict"]);

    exports(root);
    exports_come_back(root);
    others_open_exports(root);
    reports(root);

    // Held back, it is said to be, and nothing is said of how anybody moved.
    fs::rename(at("truth"), root.join("kept-truth")).expect("held back");
    let checked = run(root, "dataset check ds", 0);
    assert!(
        checked["findings"].to_string().contains("held back"),
        "{checked}"
    );
    let stats = run(root, "dataset stats ds", 0);
    assert!(stats["sequences"][0]["motion"].is_null(), "{stats}");
    assert!(
        said(
            root,
            "dataset export ds C3-glasses --format colmap --out no"
        )
        .contains("truth")
    );
}

/// Its hashes, and the description that it reads, were replaced unasked.
fn sealing(root: &Path, made: &Value) {
    let read = |name: &str| fs::read(root.join("ds").join(name)).expect("file");
    let names = ["SHA256SUMS", "dataset.toml", "truth/SHA256SUMS"];
    let before = names.map(read);
    let sealed = run(root, "dataset seal ds", 0);
    assert_eq!(sealed["sums_sha256"], made["sums_sha256"]);
    fs::write(root.join("ds/NOTES.txt"), "one more file\n").expect("file");
    let refused = said(root, "dataset seal ds");
    assert!(refused.contains("--force"), "{refused}");
    assert!(names.map(read) == before);
    let anew = run(root, "dataset seal ds --force", 0);
    assert_ne!(anew["sums_sha256"], made["sums_sha256"]);
    fs::remove_file(root.join("ds/NOTES.txt")).expect("file");
    run(root, "dataset seal ds --force", 0);
    assert!(names.map(read) == before);
}

/// Maps with walks in them, and an estimate beside its truth.
fn reports(root: &Path) {
    fs::create_dir(root.join("found")).expect("folder");
    fs::copy(
        root.join("ds/truth/query/C3-glasses.tum"),
        root.join("found/C3-glasses.tum"),
    )
    .expect("estimate");
    run(
        root,
        "report ds --out page.html --estimates found --out-svg figures",
        0,
    );
    let page = fs::read_to_string(root.join("page.html")).expect("page");
    pages::are_whole(root);
    for shown in [
        "Corridor (narrow)",
        "C3-glasses vs. its truth",
        "Translation error over time",
        "480×300",
    ] {
        assert!(page.contains(shown), "{shown}");
    }
    let svg = fs::read_to_string(root.join("figures/corridor-narrow.svg")).expect("drawing");
    // The scanned walls, and the walk.
    assert!(
        svg.matches("<circle").count() > 500 && svg.contains("#2b8a3e"),
        "{}",
        svg.len()
    );
}

/// What is exported and imported again is what it was: images, samples, readings, rig, and poses where the format has them.
fn exports_come_back(root: &Path) {
    let rig = Rig::read(&root.join("ds/calibration/glasses.toml")).expect("rig");
    let truth = "ds/truth/query/C3-glasses.tum";
    let was = Recording::open(&root.join("ds/query/C3-glasses/walk.mcap")).expect("walk");
    let messages = |recording: &Recording, end: &str| -> u64 {
        let topics = recording.topics().iter();
        let own = topics.filter(|t| t.topic.ends_with(end));
        own.map(|t| t.messages).sum()
    };
    for (layout, source) in [
        ("euroc", "euroc/mav0"),
        ("lamar", "lamar"),
        ("kapture", "kapture-again"),
        ("indoor-location", "mall/C3-glasses.txt"),
    ] {
        let out = source.split('/').next().expect("a folder");
        if layout != "euroc" {
            let line = format!("dataset export ds C3-glasses --format {layout} --out {out}");
            run(root, &line, 0);
        }
        let line = format!("import {source} --out {layout}.mcap --device glasses");
        run(root, &line, 0);
        let back = Recording::open(&root.join(format!("{layout}.mcap"))).expect("recording");
        let (images, samples) = (messages(&was, "/image"), messages(&was, "/imu"));
        if layout == "indoor-location" {
            assert_eq!(messages(&back, "/imu"), samples, "{layout}");
            assert!(messages(&back, "/waypoint") >= 2, "{layout}");
            continue;
        }
        assert_eq!(messages(&back, "/image"), images, "{layout}");
        if layout == "euroc" {
            assert_eq!(messages(&back, "/imu"), samples, "{layout}");
        }
        let found = back.rig().expect("a rig");
        for (name, camera) in &rig.cameras {
            let own = &found.cameras[name];
            let pixel = camera.camera.principal_px()[0] - own.camera.principal_px()[0];
            assert!(pixel.abs() < 1e-9, "{layout}: {name}: {pixel}");
            let imu_from_rig = match layout {
                "euroc" => rig.imus["imu0"].rig_from_imu.inverse(),
                _ => Se3::identity(),
            };
            let was = imu_from_rig * camera.rig_from_camera;
            let off = (own.rig_from_camera.inverse() * was).log().norm();
            assert!(off < 1e-9, "{layout}: {name}: {off}");
        }
        if layout == "lamar" {
            let line = format!("eval lamar.rig.tum --truth {truth} --align none");
            let ate = &run(root, &line, 0)["ate_translation_m"]["max"];
            // Stamps are rounded to microseconds.
            assert!(ate.as_f64().expect("error") < 1e-4, "{ate}");
        }
    }
}

/// Whatever the Python of others has of evo, kapture, pycolmap and PyYAML finds in the exports what is there.
fn others_open_exports(root: &Path) {
    let Some(python) = foreign_python("a_sequence_is_made_packed_checked_and_measured") else {
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/dataset/open.py");
    let output = Command::new(python).arg(script).arg(root).output();
    let output = output.expect("python");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let poses = read_tum(&root.join("euroc/truth.tum"))
        .expect("truth")
        .len();
    let said = String::from_utf8_lossy(&output.stdout);
    for line in said.lines() {
        let (what, count) = line.rsplit_once(' ').expect("two words");
        let expected = match what {
            "evo euroc" | "evo tum" => poses,
            "kapture images" | "kapture poses" | "pycolmap images" => 300,
            "kapture cameras" | "pycolmap cameras" => 2,
            "yaml transform" => 16,
            "yaml intrinsics" => 4,
            other => panic!("{other}"),
        };
        assert_eq!(count.parse(), Ok(expected), "{line}");
    }
}

/// What is exported places and judges as the truth does.
fn exports(root: &Path) {
    run(
        root,
        "dataset export ds C3-glasses --format euroc --out euroc",
        0,
    );
    let line = "eval euroc/mav0/state_groundtruth_estimate0/data.csv --truth ds/truth/query/C3-glasses.tum --align none";
    let ate = &run(root, line, 0)["ate_translation_m"]["max"];
    assert!(ate.as_f64().expect("error") < 1e-8, "{ate}");
    let images = fs::read_dir(root.join("euroc/mav0/cam1/data")).expect("images");
    assert_eq!(images.count(), 150);
    let first = "dataset export ds C3-glasses --format euroc --out twice";
    run(root, first, 0);
    let again = "dataset export ds C3-glasses --format images --out twice";
    assert!(said(root, again).contains("--force"));
    run(root, &format!("{again} --force"), 0);
    assert!(!root.join("twice/mav0").exists(), "of the export before");
    // What is no export is not thrown away.
    let others = again.replace("--out twice", "--out ds/query --force");
    assert!(said(root, &others).contains("is not known to be written by"));
    assert!(root.join("ds/query/C3-glasses/walk.mcap").exists());

    run(
        root,
        "dataset export ds C3-glasses --format colmap --out model",
        0,
    );
    let truth = Trajectory::new(
        read_tum(&root.join("ds/truth/query/C3-glasses.tum"))
            .expect("truth")
            .poses()
            .to_vec(),
    );
    let rig = Rig::read(&root.join("ds/calibration/glasses.toml")).expect("rig");
    let text = fs::read_to_string(root.join("model/sparse/images.txt")).expect("model");
    let rows: Vec<&str> = text.lines().filter(|l| l.ends_with(".png")).collect();
    assert_eq!(rows.len(), 300, "two cameras");
    for row in rows {
        let words: Vec<&str> = row.split(' ').collect();
        let number = |i: usize| words[i].parse::<f64>().expect("number");
        let (camera, stamp) = words[9]
            .trim_end_matches(".png")
            .split_once('/')
            .expect("name");
        assert!(root.join("model/images").join(words[9]).is_file(), "{row}");
        let time = Timestamp::from_nanos(stamp.parse().expect("stamp"));
        let world_from_camera = truth.at(time).expect("pose") * rig.cameras[camera].rig_from_camera;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(
            number(1),
            number(2),
            number(3),
            number(4),
        ));
        let camera_from_world = Se3::new(rotation, Vector3::new(number(5), number(6), number(7)));
        let off = (camera_from_world * world_from_camera).log().norm();
        assert!(off < 1e-9, "{row}: {off}");
    }

    // What is hidden is grey; a region of no image is refused, and nothing is left.
    fs::write(root.join("faces.txt"), "cam0 - - 10 20 30 40\n").expect("regions");
    run(
        root,
        "dataset export ds C3-glasses --format kapture --out kapture --hidden-regions faces.txt",
        0,
    );
    let trajectories =
        fs::read_to_string(root.join("kapture/sensors/trajectories.txt")).expect("kapture");
    assert_eq!(
        trajectories.lines().filter(|l| !l.starts_with('#')).count(),
        300
    );
    let records = root.join("kapture/sensors/records_data/cam0");
    let picture = fs::read_dir(records)
        .expect("images")
        .next()
        .expect("one")
        .expect("one")
        .path();
    let mut reader = png::Decoder::new(std::io::BufReader::new(
        fs::File::open(picture).expect("image"),
    ))
    .read_info()
    .expect("PNG");
    let width = reader.info().width as usize;
    let mut grey = vec![0; reader.output_buffer_size().expect("size")];
    reader.next_frame(&mut grey).expect("pixels");
    assert!((20..60).all(|y| (10..40).all(|x| grey[y * width + x] == grey[20 * width + 10])));
    fs::write(root.join("faces.txt"), "cam7 - - 10 20 30 40\n").expect("regions");
    let refused = said(
        root,
        "dataset export ds C3-glasses --format images --out no --hidden-regions faces.txt",
    );
    assert!(
        refused.contains("is in no image") && !root.join("no").exists(),
        "{refused}"
    );
}
