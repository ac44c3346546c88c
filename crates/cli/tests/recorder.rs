//! `lsfb doctor`, `recover`, `clock`, and `scan` onto a recording that is there: exit codes and words.

mod capture_file;
mod process;
mod velodyne_packets;

use std::path::Path;

use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{ImuSample, Stamped, Timestamp};
use process::lsfb;

const START: i64 = 1_772_359_200_000_000_000;

/// Ten seconds of an IMU, with a silence of two seconds in the middle where that is asked for.
fn recording(path: &Path, silent: std::ops::Range<u32>) {
    let config = WriterConfig {
        chunk_secs: 0.5,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(path, &config).expect("recording");
    for n in (0..2_000).filter(|n| !silent.contains(n)) {
        let time = Timestamp::from_nanos(START + i64::from(n) * 5_000_000);
        let sample = Stamped {
            time,
            arrival: time + 700_000 + i64::from(n * 7919 % 3_000) * 1_000,
            device_ticks: u64::from(n) * 50 + 1,
            sample: ImuSample::default(),
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
    assert_eq!(good["verdict"], "WARN", "{good}");

    recording(&path("silent.mcap"), 800..1_200);
    let output = lsfb(folder.path(), &["doctor", "silent.mcap"]);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains("FAIL  /imu0/data_raw") && text.contains("10:00:0"),
        "{text}"
    );

    let whole = std::fs::read(path("good.mcap")).expect("recording");
    std::fs::write(path("torn.mcap"), &whole[..whole.len() / 2]).expect("file");
    let output = lsfb(folder.path(), &["doctor", "torn.mcap", "--json"]);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    let torn = json(&output);
    assert!(
        torn["findings"][0]["found"]
            .as_str()
            .is_some_and(|f| f.contains("last message arrived at")),
        "{torn}"
    );
    let recover = ["recover", "torn.mcap", "--out", "saved.mcap"];
    let output = lsfb(folder.path(), &recover);
    assert_eq!(output.status.code(), Some(3), "something is missing");
    let again = lsfb(folder.path(), &recover);
    assert_eq!(again.status.code(), Some(1), "{again:?}");
    assert!(String::from_utf8_lossy(&again.stderr).contains("there already"));
    let output = lsfb(folder.path(), &["doctor", "saved.mcap", "--full"]);
    // Whole, but its recorder never said what it lost.
    assert_eq!(output.status.code(), Some(0), "{output:?}");
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
    assert_eq!(page.matches("<svg").count(), 2);
    assert!(!page.contains("<script") && !page.contains("http"));
}

#[test]
fn a_recording_that_is_there_stays_unless_it_may_be_replaced() {
    let folder = tempfile::tempdir().expect("folder");
    let pcap = capture_file::pcap(400);
    std::fs::write(folder.path().join("drive.pcap"), pcap).expect("file");
    let out = folder.path().join("drive.mcap");
    std::fs::write(&out, b"yesterday").expect("file");
    let scan = ["scan", "--pcap", "drive.pcap", "--out", "drive.mcap"];
    let output = lsfb(folder.path(), &scan);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("there already"));
    assert_eq!(std::fs::read(&out).expect("file"), b"yesterday");
    let output = lsfb(folder.path(), &[&scan[..], &["--force"]].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(std::fs::read(&out).expect("file").len() > 1_000);
}
