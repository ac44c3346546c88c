//! Every command of `docs/from/` does what is said there, on files as other programs write them.

use std::fmt::Write as _;
use std::path::Path;

use crate::process::lsfb;
use lsfb_geometry::{Se3, UnitQuaternion, Vector3, Vector6, so3};
use lsfb_recording::{Channel, Writer, WriterConfig};
use lsfb_types::{ImuSample, Stamped, Timestamp};

const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/from");
const EPOCH_S: f64 = 1_403_636_579.0;
/// By how much the clock of a phone is behind that of a scanner.
const PHONE_BEHIND_S: f64 = 3.25;

/// A walk of a minute with turns about all axes.
fn motion(t: f64) -> Se3 {
    let turn = Vector3::new(
        0.5 * (0.9 * t).sin() + 0.1 * (3.1 * t).sin(),
        0.4 * (0.7 * t + 1.0).sin(),
        0.6 * (0.4 * t).sin() + 0.2 * t,
    );
    let place = Vector3::new(
        2.0 * (0.5 * t).sin(),
        1.5 * (0.3 * t).cos() + 0.1 * t,
        0.2 * (1.7 * t).sin(),
    );
    Se3::new(so3::exp(&turn), place)
}

/// The reference's body beside the device.
fn body() -> Se3 {
    Se3::exp(&Vector6::new(0.4, -0.6, 0.3, 0.05, -0.08, 0.1))
}

/// One row per pose: what the format makes of seconds and pose.
fn rows(rate_hz: f64, row: impl Fn(f64, &Se3) -> String) -> String {
    (0..(60.0 * rate_hz) as usize)
        .map(|i| {
            let t = i as f64 / rate_hz;
            row(t, &motion(t)) + "\n"
        })
        .collect()
}

fn tum(secs: f64, pose: &Se3) -> String {
    let (p, q) = (pose.translation, pose.rotation);
    format!(
        "{secs:.6} {} {} {} {} {} {} {}",
        p.x, p.y, p.z, q.i, q.j, q.k, q.w
    )
}

fn euroc(secs: f64, pose: &Se3) -> String {
    let (p, q) = (pose.translation, pose.rotation);
    format!(
        "{:.0},{},{},{},{},{},{},{}",
        secs * 1e9,
        p.x,
        p.y,
        p.z,
        q.w,
        q.i,
        q.j,
        q.k
    )
}

fn write(root: &Path, name: &str, text: &str) {
    let path = root.join(name);
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    std::fs::write(path, text).expect(name);
}

/// What the pages' readers have.
fn files(root: &Path) {
    write(
        root,
        "trajectory.tum",
        &rows(30.0, |t, pose| tum(EPOCH_S + t, pose)),
    );
    write(
        root,
        "stamped_trajectory.txt",
        &rows(20.0, |t, pose| tum(EPOCH_S + t, pose)),
    );
    write(
        root,
        "truth.tum",
        &rows(100.0, |t, pose| tum(EPOCH_S + t, pose)),
    );
    write(
        root,
        "office/found.tum",
        &rows(30.0, |t, pose| tum(EPOCH_S + t, pose)),
    );
    let positions = rows(30.0, |t, pose| {
        let p = pose.translation;
        format!("{:.6},{},{},{}", EPOCH_S + t, p.x, p.y, p.z)
    });
    write(root, "positions.csv", &format!("time,x,y,z\n{positions}"));
    let header = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n";
    let state = rows(200.0, |t, pose| euroc(EPOCH_S + t, pose));
    write(
        root,
        "mav0/state_groundtruth_estimate0/data.csv",
        &format!("{header}{state}"),
    );
    // Markers beside the IMU, on a clock that is 0.4 s ahead.
    let mocap = rows(120.0, |t, pose| {
        euroc(EPOCH_S + t + 0.4, &(*pose * body().inverse()))
    });
    write(root, "mav0/mocap0/data.csv", &format!("{header}{mocap}"));
    let sampled = |own: UnitQuaternion<f64>, clock_s: f64| {
        rows(200.0, |t, _| {
            let h = 1e-4;
            let [before, now, after] = [-h, 0.0, h].map(|step| motion(t + step));
            let rate = so3::local(&before.rotation, &after.rotation) / (2.0 * h);
            let moved = after.translation - 2.0 * now.translation + before.translation;
            let force = now.rotation.inverse() * (moved / (h * h) + Vector3::new(0.0, 0.0, 9.81));
            let (rate, force) = (own * rate, own * force);
            let values = [rate.x, rate.y, rate.z, force.x, force.y, force.z];
            values
                .iter()
                .fold(format!("{:.0}", (EPOCH_S + clock_s + t) * 1e9), |row, v| {
                    format!("{row},{v:.9}")
                })
        })
    };
    let samples = sampled(UnitQuaternion::identity(), 0.0);
    write(root, "mav0/imu0/data.csv", &samples);
    write(root, "scanner.csv", &samples);
    // A phone on the same board, lying on its side, with a clock that is behind.
    let phone = sampled(body().rotation, -PHONE_BEHIND_S);
    write(root, "phone.csv", &phone);
    phones(root);
    // The phone has been on for an hour; the motion capture is 997 s ahead of it.
    let phone = rows(60.0, |t, pose| {
        let (p, q) = (pose.translation, pose.rotation);
        format!(
            "{:.6}, {:06.0}, {}, {}, {}, {}, {}, {}, {}",
            3600.0 + t,
            60.0 * t,
            p.x,
            p.y,
            p.z,
            q.i,
            q.j,
            q.k,
            q.w
        )
    });
    write(
        root,
        "odometry.csv",
        &format!("timestamp, frame, x, y, z, qx, qy, qz, qw\n{phone}"),
    );
    let mocap = rows(120.0, |t, pose| {
        tum(4597.0 + t, &(*pose * body().inverse()))
    });
    write(root, "mocap.csv", &mocap);
    let mut images = "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n".to_owned();
    for i in 0..300 {
        let t = 0.2 * f64::from(i);
        let scaled = Se3::new(motion(t).rotation, motion(t).translation * 0.37).inverse();
        let (p, q) = (scaled.translation, scaled.rotation);
        let _ = writeln!(
            images,
            "{} {} {} {} {} {} {} {} 1 cam0/{:.3}.png\n1.5 2.5 -1",
            i + 1,
            q.w,
            q.i,
            q.j,
            q.k,
            p.x,
            p.y,
            p.z,
            EPOCH_S + t
        );
    }
    write(root, "sparse/0/images.txt", &images);
    bag(&root.join("robot.mcap"));
    // Two seconds on each mark, as the page's survey visits them.
    let marks = [(0.0, 0.0), (1.8, 0.0), (4.2, 0.0), (1.8, 2.6), (0.0, 2.6)];
    let mut rests = String::new();
    for (k, (x, y)) in marks.into_iter().enumerate() {
        for i in 0..60 {
            // Carried for a second, then at rest for two.
            let lift = 0.5 * (1.0 - f64::from(i) / 20.0).max(0.0);
            let pose = Se3::new(UnitQuaternion::identity(), Vector3::new(x + lift, y, lift));
            let _ = writeln!(
                rests,
                "{}",
                tum(EPOCH_S + 3.0 * k as f64 + 0.05 * f64::from(i), &pose)
            );
        }
    }
    write(root, "rests.tum", &rests);
    inertial(&root.join("rests.mcap"), marks.len());
}

/// The inertial samples of that walk over the marks.
fn inertial(path: &Path, marks: usize) {
    let mut writer = Writer::create(path, &WriterConfig::default()).expect("a file");
    for i in 0..300 * marks as i64 {
        let shake = if i % 300 < 100 { (i as f64).sin() } else { 0.0 };
        let time = Timestamp::from_secs_f64(EPOCH_S + 0.01 * i as f64);
        let sample = Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: ImuSample {
                angular_velocity_rad_s: [shake, 0.01, 0.0],
                specific_force_m_s2: [0.1, 3.0 * shake, 9.8],
            },
        };
        writer.write_imu("imu0", &sample).expect("written");
    }
    writer.finish().expect("finished");
}

/// A robot's bag: odometry and motion capture as `geometry_msgs/PoseStamped`.
fn bag(path: &Path) {
    let mut writer = Writer::create(path, &WriterConfig::default()).expect("a file");
    for i in 0..1800 {
        let t = f64::from(i) / 30.0;
        let time = Timestamp::from_secs_f64(EPOCH_S + t);
        let pose = motion(t);
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend((time.nanos().div_euclid(1_000_000_000) as u32).to_le_bytes());
        bytes.extend((time.nanos().rem_euclid(1_000_000_000) as u32).to_le_bytes());
        bytes.extend([4, 0, 0, 0]);
        bytes.extend(*b"map\0");
        let values = pose.translation.iter().chain(pose.rotation.coords.iter());
        bytes.extend(values.flat_map(|v| v.to_le_bytes()));
        for topic in ["/odom", "/mocap/pose"] {
            let channel = Channel {
                topic,
                schema_name: "geometry_msgs/msg/PoseStamped",
                schema_text: "std_msgs/Header header",
            };
            writer
                .write_cdr(&channel, time, time, &bytes)
                .expect("written");
        }
    }
    writer.finish().expect("finished");
}

/// What recorders on phones write: StrayScanner's folder without its video, and a walk of Indoor Location 2.0.
fn phones(root: &Path) {
    let mut imu = "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n".to_owned();
    let mut walk = "#\tstartTime:1574560118902\n#\tFloorName:F1\n".to_owned();
    for n in 0..100 {
        let noise = 1e-3 * f64::from(n * 37 % 11);
        let _ = writeln!(
            imu,
            "{}, {noise}, 0.0, -1.0, 0.1, {noise}, 0.3",
            7.0 + 0.01 * f64::from(n)
        );
        let ms = 1_574_560_118_910_i64 + 20 * i64::from(n);
        for (kind, values) in [
            ("ACCELEROMETER", format!("{noise}\t0.0\t9.81")),
            ("GYROSCOPE", format!("0.1\t{noise}\t0.3")),
        ] {
            let _ = writeln!(walk, "{ms}\tTYPE_{kind}\t{values}\t3");
        }
    }
    walk += "1574560119021\tTYPE_WIFI\tnet\t06:74:9c:2b:1a:27\t-41\t5200\t1574560118940\n#\tendTime:1574560121000\n";
    write(root, "mall.txt", &walk);
    write(root, "stray/imu.csv", &imu);
    write(
        root,
        "stray/camera_matrix.csv",
        "1596.0, 0.0, 955.0\n0.0, 1596.0, 717.0\n0.0, 0.0, 1.0\n",
    );
    let header = "timestamp, frame, x, y, z, qx, qy, qz, qw\n";
    write(
        root,
        "stray/odometry.csv",
        &format!("{header}7.0, 000000, 0, 0, 0, 0, 0, 0, 1\n"),
    );
}

/// Blocks of a page that begin with a fence of this kind.
fn blocks<'a>(page: &'a str, kind: &str) -> Vec<&'a str> {
    let fence = format!("```{kind}\n");
    let rest = page.split(&fence).skip(1).collect::<Vec<_>>();
    rest.into_iter()
        .filter_map(|rest| rest.split("```").next())
        .collect()
}

#[test]
fn every_command_of_every_page_works() {
    let mut pages = 0;
    for entry in std::fs::read_dir(DOCS).expect("docs/from") {
        let path = entry.expect("a page").path();
        let page = std::fs::read_to_string(&path).expect("a page");
        let folder = tempfile::tempdir().expect("folder");
        let root = folder.path();
        files(root);
        for (name, kind) in [("plan.toml", "toml"), ("floor.survey", "text")] {
            if let Some(text) = blocks(&page, kind).first() {
                write(root, name, text);
            }
        }
        let mut commands = 0;
        for line in blocks(&page, "sh").into_iter().flat_map(str::lines) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let Some((&"lsfb", arguments)) = words.split_first() else {
                panic!("{}: {line}", path.display());
            };
            // A file that the page makes replaces the one that other pages begin with.
            let arguments: Vec<&str> = arguments.iter().copied().chain(["--force"]).collect();
            let output = lsfb(root, &arguments);
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!(
                output.status.code(),
                Some(0),
                "{}: {line}: {said}",
                path.display()
            );
            commands += 1;
        }
        assert!(commands > 0, "{}", path.display());
        pages += 1;
    }
    assert_eq!(pages, 5);
}

/// What the page of phones claims: a phone and a scanner that were turned together have one clock.
#[test]
fn two_devices_that_were_turned_together_have_one_clock() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    files(root);
    let line = "align --imu phone.csv --reference-imu scanner.csv --json";
    let output = lsfb(root, &line.split(' ').collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found["verdict"], "pass", "{found}");
    let offset_secs = found["offset_secs"].as_f64().expect("seconds");
    assert!((offset_secs - PHONE_BEHIND_S).abs() < 1e-4, "{found}");
    // A device that was elsewhere is refused, and so is a table for the other kind of alignment.
    for line in [
        "align --imu phone.csv --reference-imu scanner.csv --offset-secs 100",
        "align trajectory.tum --reference-imu scanner.csv",
        "align --imu phone.csv --reference-imu scanner.csv --out truth.tum",
    ] {
        let output = lsfb(root, &line.split(' ').collect::<Vec<_>>());
        assert!(!output.status.success(), "{line}");
    }
}

/// What the pages claim: after `align` nothing is left of the other body and clock.
#[test]
fn alignment_makes_truth_of_the_own_body() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    files(root);
    let json = |arguments: &[&str]| -> serde_json::Value {
        let output = lsfb(root, arguments);
        serde_json::from_slice(&output.stdout).expect("JSON")
    };
    let reference = "mav0/mocap0/data.csv";
    let rmse_m = |truth: &str| {
        let judged = json(&["eval", "stamped_trajectory.txt", "--truth", truth, "--json"]);
        judged["ate_translation_m"]["rmse"]
            .as_f64()
            .expect("a figure")
    };
    let before_m = rmse_m(reference);
    let found = json(&[
        "align",
        "stamped_trajectory.txt",
        "--reference",
        reference,
        "--out",
        "own.tum",
        "--json",
    ]);
    // One was made of the other, to the last digit, and that is said.
    for finding in found["findings"].as_array().expect("findings") {
        let expected = match finding["code"] == "same" {
            true => "warn",
            false => "pass",
        };
        assert_eq!(finding["verdict"], expected, "{found}");
    }
    assert!(
        (found["offset_secs"].as_f64().expect("seconds") - 0.4).abs() < 1e-4,
        "{found}"
    );
    let after_m = rmse_m("own.tum");
    assert!(before_m > 0.03 && after_m < 0.005, "{before_m} {after_m}");
}

/// Units and orders that a folder may have, before the built binary: each is read or named.
#[test]
fn a_researchers_folder_is_read_or_refused_by_name() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    files(root);
    let nanos = rows(20.0, |t, pose| {
        tum((EPOCH_S + t) * 1e9, pose).replacen(".000000", "", 1)
    });
    write(root, "nanos.txt", &nanos);
    let mut shuffled: Vec<&str> = nanos.lines().collect();
    shuffled.swap(3, 900);
    shuffled.push(shuffled[17]);
    write(root, "shuffled.txt", &shuffled.join("\n"));
    let commas = rows(20.0, |t, pose| tum(EPOCH_S + t, pose).replace(' ', ","));
    write(root, "commas.csv", &commas);
    for (name, code) in [
        ("nanos.txt", None),
        ("shuffled.txt", Some("unsorted-stamps")),
        ("commas.csv", Some("columns")),
    ] {
        let output = lsfb(root, &["eval", name, "--truth", "truth.tum", "--json"]);
        assert_eq!(
            output.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let judged: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert!(
            judged["ate_translation_m"]["rmse"]
                .as_f64()
                .expect("a figure")
                < 1e-4,
            "{name}"
        );
        let findings = judged["findings"].as_array().expect("findings");
        let codes: Vec<&str> = findings.iter().filter_map(|f| f["code"].as_str()).collect();
        assert!(
            code.is_none_or(|code| codes.contains(&code)),
            "{name}: {codes:?}"
        );
    }
    let nowhere = |pose: &Se3| Se3::new(pose.rotation, Vector3::repeat(f64::NAN));
    let nan = rows(20.0, |t, pose| match t > 30.0 {
        true => tum(EPOCH_S + t, &nowhere(pose)),
        false => tum(EPOCH_S + t, pose),
    });
    write(root, "nan.txt", &nan);
    let coarse = rows(20.0, |_, pose| {
        tum(0.0, pose).replacen("0.000000", "1.40364e+09", 1)
    });
    write(root, "coarse.txt", &coarse);
    // No trajectory, and one that stands still in time.
    for (name, code) in [("nan.txt", 1), ("coarse.txt", 4)] {
        let output = lsfb(root, &["eval", name, "--truth", "truth.tum"]);
        assert_eq!(output.status.code(), Some(code), "{name}");
        assert!(String::from_utf8_lossy(&output.stderr).contains(name));
    }
}

/// Two recordings that share seven stamps: the error after alignment is small, and no result.
#[test]
fn few_shared_stamps_fail() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let late = |first: f64| rows(10.0, |t, pose| tum(EPOCH_S + first + t, pose));
    write(root, "truth.tum", &late(0.0));
    write(root, "later.tum", &late(59.3));
    let output = lsfb(root, &["eval", "later.tum", "--truth", "truth.tum"]);
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(4), "{said}");
    assert!(
        said.contains("only 7 poses match: too few for a result"),
        "{said}"
    );
}

/// What is damaged in a recording was passed over without a word, and the exit code was 0.
#[test]
fn inertial_samples_that_cannot_be_read_are_told() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    files(root);
    let page = Path::new(DOCS).join("slam.md");
    let page = std::fs::read_to_string(page).expect("the page");
    let survey = blocks(&page, "text");
    write(root, "floor.survey", survey.first().expect("a survey"));
    let recording = root.join("rests.mcap");
    let mut bytes = std::fs::read(&recording).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle..middle + 100].fill(0);
    std::fs::write(&recording, bytes).expect("written");
    let arguments = "survey check floor.survey --trajectory rests.tum --recording rests.mcap";
    let output = lsfb(root, &arguments.split(' ').collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("cannot be read"), "{said}");
    assert_eq!(output.status.code(), Some(3), "{said}");
}
