//! `lsfb doctor`, `recover`, `clock`, and `scan` onto a recording that is there: exit codes and words.

use std::path::Path;

use crate::pages;
use crate::process::lsfb;
use lsfb_geometry::{ImuNoiseModel, Rig};
use lsfb_recording::{Writer, WriterConfig, rig_sha256, sha256_of};
use lsfb_types::{ImuSample, Stamped, Timestamp};

const START: i64 = 1_772_359_200_000_000_000;

/// Ten seconds of an IMU, with a silence of two seconds in the middle where that is asked for.
fn recording(path: &Path, silent: std::ops::Range<u32>) {
    let config = WriterConfig {
        chunk_secs: 0.5,
        ..WriterConfig::default()
    };
    fill(Writer::create(path, &config).expect("recording"), silent);
}

/// The same with a rig in it, as a part of a recording where `session` says so.
fn recording_with_rig(path: &Path, rig: &Rig, session: &[(&str, &str)]) -> Writer {
    let session = session.iter().map(|(k, v)| ((*k).into(), (*v).into()));
    let config = WriterConfig {
        session: session.collect(),
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(path, &config).expect("recording");
    writer.attach_rig(rig).expect("rig");
    writer
}

/// What an IMU on a table measures: gravity, and noise.
fn at_rest(n: u32) -> ImuSample {
    let noise = f64::from(n * 7919 % 101) * 1e-4;
    ImuSample {
        angular_velocity_rad_s: [noise, -noise, 0.5 * noise],
        specific_force_m_s2: [-noise, noise, 9.81 + noise],
    }
}

fn fill(mut writer: Writer, silent: std::ops::Range<u32>) {
    for n in (0..2_000).filter(|n| !silent.contains(n)) {
        let time = Timestamp::from_nanos(START + i64::from(n) * 5_000_000);
        let sample = Stamped {
            time,
            arrival: time + 700_000 + i64::from(n * 7919 % 3_000) * 1_000,
            device_ticks: u64::from(n) * 50 + 1,
            sample: at_rest(n),
        };
        writer.write_imu("imu0", &sample).expect("sample");
    }
    writer
        .attach("health.json", "application/json", br#"{"lost": 0}"#)
        .expect("report");
    writer.finish().expect("recording");
}

fn json(output: &std::process::Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {output:?}"))
}

#[test]
fn the_doctor_judges_and_recover_makes_whole() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name);
    recording(&path("good.mcap"), 0..0);
    let output = lsfb(folder.path(), &["doctor", "good.mcap", "--full", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let good = json(&output);
    // There is no rig in it.
    assert_eq!(good["verdict"], "warn", "{good}");

    recording(&path("silent.mcap"), 800..1_200);
    let output = lsfb(folder.path(), &["doctor", "silent.mcap"]);
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains("FAIL     /imu0/data_raw") && text.contains("10:00:0"),
        "{text}"
    );

    let whole = std::fs::read(path("good.mcap")).expect("recording");
    std::fs::write(path("torn.mcap"), &whole[..whole.len() / 2]).expect("file");
    let output = lsfb(folder.path(), &["doctor", "torn.mcap", "--json"]);
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let torn = json(&output);
    assert!(
        torn["findings"][0]["what"]
            .as_str()
            .is_some_and(|f| f.contains("last message arrived at")),
        "{torn}"
    );
    let recover = ["recover", "torn.mcap", "--out", "saved.mcap"];
    let output = lsfb(folder.path(), &recover);
    assert_eq!(output.status.code(), Some(3), "something is missing");
    let again = lsfb(folder.path(), &recover);
    assert_eq!(again.status.code(), Some(1), "{again:?}");
    assert!(String::from_utf8_lossy(&again.stderr).contains("exists already"));
    // What stands is replaced by what was recovered, and by nothing else.
    let saved = std::fs::read(path("saved.mcap")).expect("recording");
    std::fs::write(path("other.mcap"), "no recording").expect("file");
    for (from, code) in [("other.mcap", 1), ("absent.mcap", 1), ("torn.mcap", 3)] {
        let recover = ["recover", from, "--out", "saved.mcap", "--force"];
        let output = lsfb(folder.path(), &recover);
        assert_eq!(output.status.code(), Some(code), "{from}: {output:?}");
        let left = std::fs::read(path("saved.mcap")).expect("what was there");
        assert_eq!(left, saved, "{from}");
        assert!(!path("saved.mcap.new").exists(), "{from}");
    }
    let output = lsfb(folder.path(), &["doctor", "saved.mcap", "--full"]);
    // Whole, but its recorder never said what it lost.
    assert_eq!(output.status.code(), Some(0), "{output:?}");
}

/// What the doctor says of `subject`: verdict, and words with the remedy.
fn said(diagnosis: &serde_json::Value, subject: &str) -> Vec<(String, String)> {
    let findings = diagnosis["findings"].as_array().expect("findings");
    let word = |f: &serde_json::Value, key: &str| f[key].as_str().expect("text").to_owned();
    findings
        .iter()
        .filter(|f| f["where"] == subject)
        .map(|f| {
            let remedy = f["remedy"].as_str().unwrap_or_default();
            (word(f, "verdict"), format!("{}: {remedy}", word(f, "what")))
        })
        .collect()
}

#[test]
fn the_doctor_names_the_calibration_and_its_age() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name);
    let rig = |days_before: Option<i64>| Rig {
        imus: lsfb_geometry::RigImu::from(ImuNoiseModel {
            gyro_noise_density: 1e-3,
            accel_noise_density: 1e-2,
            gyro_bias_walk: 1e-5,
            accel_bias_walk: 1e-4,
        })
        .alone(),
        calibrated_unix_s: days_before.map(|days| START / 1_000_000_000 - days * 86_400),
        ..Rig::empty("backpack")
    };
    let doctor = |arguments: &[&str]| {
        let output = lsfb(folder.path(), &[&["doctor", "--json"], arguments].concat());
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        json(&output)
    };
    let age = |diagnosis: &serde_json::Value| {
        let said = said(diagnosis, "calibration");
        let [(verdict, found)] = &said[..] else {
            panic!("{said:?}")
        };
        (verdict.clone(), found.clone())
    };

    fill(
        recording_with_rig(&path("new.mcap"), &rig(Some(12)), &[]),
        0..0,
    );
    let new = doctor(&["new.mcap"]);
    let hash = rig_sha256(&rig(Some(12)));
    assert_eq!(new["verdict"], "pass", "{new}");
    let found = &new["calibration"];
    assert_eq!(
        (&found["name"], &found["sha256"]),
        (&"backpack".into(), &hash.clone().into())
    );
    assert!(
        found["age_days"]
            .as_f64()
            .is_some_and(|d| (d - 12.0).abs() < 0.01)
    );
    let (_, words) = age(&new);
    assert!(
        words.contains(&hash[..16]) && words.contains("12.0 days before"),
        "{words}"
    );
    // What is written to a file is what is hashed.
    std::fs::write(path("rig.toml"), rig(Some(12)).to_toml()).expect("file");
    assert_eq!(sha256_of(&path("rig.toml")).expect("hash"), hash);

    fill(
        recording_with_rig(&path("old.mcap"), &rig(Some(40)), &[]),
        0..0,
    );
    let (verdict, words) = age(&doctor(&["old.mcap"]));
    assert!(
        verdict == "warn" && words.contains("lsfb calib verify"),
        "{words}"
    );
    std::fs::write(path("doctor.toml"), "warn_calibration_days = 60.0").expect("file");
    let (verdict, _) = age(&doctor(&["old.mcap", "--config", "doctor.toml"]));
    assert_eq!(verdict, "pass");

    fill(
        recording_with_rig(&path("undated.mcap"), &rig(None), &[]),
        0..0,
    );
    let (verdict, words) = age(&doctor(&["undated.mcap"]));
    assert!(
        verdict == "warn" && words.contains("at an unknown time"),
        "{words}"
    );

    // Somebody put another rig into it.
    let mut writer = recording_with_rig(&path("changed.mcap"), &rig(Some(12)), &[]);
    let other = rig(Some(11)).to_toml();
    writer
        .attach("rig.toml", "application/toml", other.as_bytes())
        .expect("rig");
    fill(writer, 0..0);
    let changed = said(&doctor(&["changed.mcap"]), "calibration");
    assert!(
        changed
            .iter()
            .any(|(v, f)| v == "warn" && f.contains(&hash[..16])),
        "{changed:?}"
    );

    // Parts of one recording.
    let first = [("part", "1")];
    let second = [("part", "2"), ("previous", "walk.mcap")];
    let third = [("part", "3"), ("previous", "walk-0002.mcap")];
    fill(
        recording_with_rig(&path("walk.mcap"), &rig(Some(12)), &first),
        0..0,
    );
    fill(
        recording_with_rig(&path("walk-0002.mcap"), &rig(Some(12)), &second),
        0..0,
    );
    for part in ["walk.mcap", "walk-0002.mcap"] {
        let parts = said(&doctor(&[part]), "calibration of parts");
        assert_eq!(parts[0].0, "pass", "{parts:?}");
    }
    fill(
        recording_with_rig(&path("walk-0003.mcap"), &rig(Some(2)), &third),
        0..0,
    );
    for (part, named) in [
        ("walk.mcap", "walk-0003.mcap carries"),
        ("walk-0003.mcap", "walk.mcap carries"),
    ] {
        let parts = said(&doctor(&[part]), "calibration of parts");
        assert!(
            parts[0].0 == "warn" && parts[0].1.contains(named),
            "{parts:?}"
        );
    }
}

#[test]
fn clocks_are_printed_and_plotted() {
    let folder = tempfile::tempdir().expect("folder");
    recording(&folder.path().join("scan.mcap"), 0..0);
    let output = lsfb(
        folder.path(),
        &["clock", "scan.mcap", "--out", "clocks.html", "--json"],
    );
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = json(&output);
    assert_eq!(report["devices"][0]["device"], "imu0");
    let skew_ppm = report["devices"][0]["epochs"][0]["skew_ppm"].as_f64();
    assert!(skew_ppm.is_some_and(|s| s.abs() < 5.0), "{report}");
    let page = std::fs::read_to_string(folder.path().join("clocks.html")).expect("page");
    pages::are_whole(folder.path());
    assert_eq!(page.matches("<svg").count(), 2);
    assert!(page.contains("PASS: 1 clock") && !page.contains("http"));
}

#[test]
fn a_recording_that_is_there_stays_unless_it_may_be_replaced() {
    let folder = tempfile::tempdir().expect("folder");
    let pcap = crate::capture_file::pcap(0..400);
    std::fs::write(folder.path().join("drive.pcap"), pcap).expect("file");
    let out = folder.path().join("drive.mcap");
    std::fs::write(&out, b"yesterday").expect("file");
    let scan = ["scan", "--pcap", "drive.pcap", "--out", "drive.mcap"];
    let output = lsfb(folder.path(), &scan);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("exists already"));
    assert_eq!(std::fs::read(&out).expect("file"), b"yesterday");
    let output = lsfb(folder.path(), &[&scan[..], &["--force"]].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(std::fs::read(&out).expect("file").len() > 1_000);
}
