//! `lsfb convert`: a trajectory goes through the files of every program and comes back, and programs of others read it on the way.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::answer::json;
use crate::process::lsfb;
use lsfb_geometry::{Se3, StampedPose, Trajectory, Vector6};
use lsfb_recording::{read_tum, write_tum};
use lsfb_tests::foreign_python;
use lsfb_types::Timestamp;
use serde_json::Value;

/// Formats, the files that they are written to, and the options to read them again.
const FORMATS: [(&str, &str, &str); 5] = [
    ("euroc", "walk_euroc.csv", ""),
    ("kitti", "walk_kitti.txt", " --times walk_kitti_times.txt"),
    ("csv", "walk.csv", ""),
    ("kapture", "walk_kapture", ""),
    ("mcap", "walk.mcap", ""),
];

fn walk() -> Trajectory {
    let poses = (0..300).map(|i| {
        let t = 0.05 * f64::from(i);
        StampedPose {
            time: Timestamp::from_nanos(1_772_359_200_123_456_789 + i64::from(i) * 50_000_001),
            world_from_rig: Se3::exp(&Vector6::new(
                0.3 * t.sin(),
                0.2 * t.cos(),
                0.4 * t,
                5.0 * t.cos(),
                2.0 * t,
                0.1,
            )),
        }
    });
    Trajectory::new(poses.collect())
}

fn run(root: &Path, line: &str, code: i32) -> Value {
    json(root, &line.split(' ').collect::<Vec<_>>(), code)
}

fn refused(root: &Path, line: &str, words: &str) {
    let output = lsfb(root, &line.split(' ').collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success(), "{line}");
    assert!(said.contains(words) && !said.contains("panicked"), "{said}");
}

#[test]
fn a_trajectory_goes_through_every_format_and_comes_back() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let walk = walk();
    write_tum(&root.join("walk.tum"), &walk).expect("written");
    for (format, out, times) in FORMATS {
        let written = run(
            root,
            &format!("convert walk.tum --format {format} --out {out}"),
            0,
        );
        assert_eq!(written["poses"], 300, "{written}");
        assert_eq!(written["verdict"], "pass", "{written}");
        let line = format!("convert {out}{times} --format tum --out back_{format}.tum");
        run(root, &line, 0);
        let back = read_tum(&root.join(format!("back_{format}.tum"))).expect("read");
        assert_eq!(back.len(), walk.len(), "{format}");
        for (was, is) in walk.poses().iter().zip(back.poses()) {
            assert_eq!(was.time, is.time, "{format}");
            let off = (was.world_from_rig.inverse() * is.world_from_rig).log();
            assert!(off.amax() < 1e-12, "{format}: {off}");
        }
    }
    // KITTI's rows are judged with their times on either side.
    let line = "eval walk_kitti.txt --estimate-times walk_kitti_times.txt --truth walk_kitti.txt --truth-times walk_kitti_times.txt";
    assert_eq!(run(root, line, 0)["matched_poses"], 300);
    read_by_others(root, &walk);

    // What is there stays, what is read is not replaced, and a failure leaves nothing.
    refused(
        root,
        "convert walk.tum --format csv --out walk.csv",
        "exists already",
    );
    refused(
        root,
        "convert walk.tum --format kapture --out walk_kapture",
        "exists already",
    );
    refused(
        root,
        "convert walk_kitti.txt --times walk_kitti_times.txt --format kitti --out walk_kitti.txt",
        "would replace an input file",
    );
    fs::write(root.join("positions.txt"), "1 2 3 4\n2 3 4 5\n").expect("written");
    refused(
        root,
        "convert positions.txt --format mcap --out no.mcap",
        "only positions",
    );
    refused(root, "convert . --format tum --out no.tum", "name the file");
    refused(
        root,
        "convert walk.tum --times walk_kitti_times.txt --format csv --out no.csv",
        "its own stamps",
    );
    for nothing in ["no.mcap", "no.tum", "no.csv"] {
        assert!(!root.join(nothing).exists(), "{nothing}");
    }
    let warned = run(
        root,
        "convert walk_kitti.txt --format tum --out rows.tum",
        0,
    );
    assert!(warned.to_string().contains("without stamps"), "{warned}");
}

/// Whatever the Python of others has of evo, kapture, pandas and mcap-ros2-support finds every pose, and the last one where it is.
fn read_by_others(root: &Path, walk: &Trajectory) {
    let Some(python) = foreign_python("a_trajectory_goes_through_every_format_and_comes_back")
    else {
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/convert/open.py");
    let output = Command::new(python).arg(script).arg(root).output();
    let output = output.expect("python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let last = walk.poses().last().expect("a pose");
    let (t, q) = (
        last.world_from_rig.translation,
        last.world_from_rig.rotation.quaternion(),
    );
    let sign = q.w.signum();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    for line in said.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        assert_eq!(words[1], "300", "{line}");
        let number = |i: usize| words[2 + i].parse::<f64>().expect("a number");
        // Doubles of seconds are exact to a fifth of a microsecond.
        let off_secs = number(0) - last.time.nanos() as f64 * 1e-9;
        assert!(off_secs.abs() < 1e-6, "{line}");
        let expected = [
            t.x,
            t.y,
            t.z,
            sign * q.i,
            sign * q.j,
            sign * q.k,
            sign * q.w,
        ];
        for (i, value) in expected.into_iter().enumerate() {
            assert!((number(1 + i) - value).abs() < 2e-9, "{line}: {value}");
        }
    }
}
