//! A small file as glasses write it, and what is left of it when it is cut or changed.

use std::path::Path;

use lsfb_recording::Recording;
use lsfb_recording::message::{decode_wifi, decode_wifi_scan};
use lsfb_types::no_progress;

use crate::import::{Format, ImportConfig, ImportReport, import};

const IMU: &str = r#"{"data_layout":[
    {"name":"accelerometer_valid","type":"DataPieceValue<Bool>","offset":0},
    {"name":"gyroscope_valid","type":"DataPieceValue<Bool>","offset":1},
    {"name":"capture_timestamp_ns","type":"DataPieceValue<int64_t>","offset":2},
    {"name":"accelerometer","type":"DataPieceArray<float>","offset":10,"size":3},
    {"name":"gyroscope","type":"DataPieceArray<float>","offset":22,"size":3}]}"#;
const WIFI: &str = r#"{"data_layout":[
    {"name":"system_timestamp_ns","type":"DataPieceValue<int64_t>","offset":0},
    {"name":"board_timestamp_ns","type":"DataPieceValue<int64_t>","offset":8},
    {"name":"board_request_start_timestamp_ns","type":"DataPieceValue<int64_t>","offset":16},
    {"name":"board_request_complete_timestamp_ns","type":"DataPieceValue<int64_t>","offset":24},
    {"name":"rssi","type":"DataPieceValue<float>","offset":32},
    {"name":"freq_mhz","type":"DataPieceValue<float>","offset":36},
    {"name":"ssid","type":"DataPieceString","index":0},
    {"name":"bssid_mac","type":"DataPieceString","index":1}]}"#;

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

fn tags(tags: &[(&str, &str)]) -> Vec<u8> {
    let pairs = tags.iter().flat_map(|(a, b)| [text(a), text(b)].concat());
    [(tags.len() as u32).to_le_bytes().to_vec(), pairs.collect()].concat()
}

/// A record of a stream: type 3 is data.
fn record(of: u32, kind: u8, packing: u8, unpacked: usize, bytes: &[u8]) -> Vec<u8> {
    let version: u32 = 2;
    let mut out = Vec::new();
    for word in [32 + bytes.len() as u32, 0, of, version] {
        out.extend(word.to_le_bytes());
    }
    out.extend(1.5_f64.to_le_bytes());
    out.extend(1_u16.to_le_bytes());
    out.extend([kind, packing]);
    out.extend((unpacked as u32).to_le_bytes());
    out.extend(bytes);
    out
}

fn head(first: u64) -> Vec<u8> {
    let mut out = b"VisionRe12345678".to_vec();
    out.extend(80_u32.to_le_bytes());
    out.extend(32_u32.to_le_bytes());
    for at in [0, 80, first] {
        out.extend(u64::to_le_bytes(at));
    }
    out.resize(80, 0);
    out
}

/// Forty samples of an IMU at 20 Hz, every second one packed, and two readings of one scan.
fn glasses() -> Vec<u8> {
    let streams = [
        (1202_u32, IMU, "data_layout/size=34"),
        (282, WIFI, "data_layout+custom"),
    ];
    let mut description = (streams.len() as u32).to_le_bytes().to_vec();
    for (of, layout, format) in streams {
        description.extend(of.to_le_bytes());
        description.extend(1_u16.to_le_bytes());
        description.extend(tags(&[("device_type", "Aria")]));
        description.extend(tags(&[("DL:Data:2:0", layout), ("RF:Data:2", format)]));
    }
    description.extend(tags(&[("capture_time_epoch", "1649265055")]));
    let description = record(2, 3, 0, 0, &description);
    let mut file = head(80 + description.len() as u64);
    file.extend(description);
    for n in 0..40_i64 {
        let mut sample = vec![1, 1];
        sample.extend((86_000_000_000 + n * 50_000_000).to_le_bytes());
        for value in [0.0_f32, 0.0, 9.81, 0.1, 0.2, 0.3] {
            sample.extend(value.to_le_bytes());
        }
        match n % 2 {
            0 => file.extend(record(1202, 3, 0, 0, &sample)),
            _ => {
                let packed = zstd::stream::encode_all(sample.as_slice(), 1).expect("packed");
                file.extend(record(1202, 3, 2, sample.len(), &packed));
            }
        }
    }
    for (name, rssi) in [("cafe", -50.0_f32), ("", -61.0)] {
        let mut reading = Vec::new();
        for ns in [
            87_000_000_000_i64,
            86_500_000_000,
            86_400_000_000,
            86_900_000_000,
        ] {
            reading.extend(ns.to_le_bytes());
        }
        reading.extend(rssi.to_le_bytes());
        reading.extend(2412.0_f32.to_le_bytes());
        for (offset, length) in [(0, name.len() as u32), (name.len() as u32, 17)] {
            reading.extend(u32::to_le_bytes(offset));
            reading.extend(u32::to_le_bytes(length));
        }
        reading.extend(name.as_bytes());
        reading.extend(b"0a:1b:2c:3d:4e:5f");
        file.extend(record(282, 3, 0, 0, &reading));
    }
    // Sound, of which a recording has none.
    file.extend(record(231, 3, 0, 0, &[0; 8]));
    file
}

fn imported(folder: &Path, bytes: &[u8]) -> Result<ImportReport, String> {
    let source = folder.join("glasses.vrs");
    std::fs::write(&source, bytes).expect("file");
    let config = ImportConfig {
        format: Some(Format::AriaVrs),
        ..ImportConfig::default()
    };
    import(&source, &folder.join("walk.mcap"), &config, &no_progress).map_err(|e| e.to_string())
}

fn written(report: &ImportReport, what: &str) -> [u64; 3] {
    let found = report.records.iter().find(|r| r.what == what);
    found.map_or([0; 3], |r| [r.read, r.written, r.unreadable])
}

#[test]
fn glasses_come_over_whole() {
    let folder = tempfile::tempdir().expect("folder");
    let report = imported(folder.path(), &glasses()).expect("an import");
    assert_eq!(written(&report, "IMU in 1202-1"), [40, 40, 0]);
    assert_eq!(written(&report, "Wi-Fi in 282-1"), [2, 2, 0]);
    assert_eq!(report.left_out[0].what, "sound in 231-1");
    let recording = Recording::open(&folder.path().join("walk.mcap")).expect("a recording");
    let samples = recording.imu().expect("imu");
    let last = samples.last().expect("some").expect("whole");
    assert_eq!(last.time.nanos(), 87_950_000_000);
    assert_eq!(
        last.sample.angular_velocity_rad_s.map(|v| v as f32),
        [0.1, 0.2, 0.3]
    );
    let messages = |kind: &str| {
        let topic = format!("/sidecar/phone/{kind}");
        let found = recording.messages(&topic).expect("a topic");
        found.map(|m| m.expect("whole")).collect::<Vec<_>>()
    };
    let first = decode_wifi(&messages("wifi")[0].bytes).expect("a reading");
    assert_eq!(
        (first.ssid.as_str(), first.bssid.as_str(), first.rssi_dbm),
        ("cafe", "0a:1b:2c:3d:4e:5f", -50)
    );
    let scan = decode_wifi_scan(&messages("wifi_scan")[0].bytes).expect("a scan");
    let times = [scan.started.nanos(), scan.ended.nanos()];
    assert_eq!(
        (scan.readings, times),
        (2, [86_400_000_000, 86_900_000_000])
    );
}

/// Wherever it is cut, and whatever byte is changed: an error or a count, never a panic, and never more than there was.
#[test]
fn what_is_cut_or_changed_is_told() {
    let folder = tempfile::tempdir().expect("folder");
    let whole = glasses();
    for cut in (0..whole.len()).step_by(13) {
        match imported(folder.path(), &whole[..cut]) {
            Ok(report) => assert!(written(&report, "IMU in 1202-1")[1] <= 40, "{cut}"),
            Err(why) => assert!(why.contains("glasses.vrs"), "{cut}: {why}"),
        }
    }
    let within = whole.len() - 60;
    let report = imported(folder.path(), &whole[..within]).expect("what is there");
    assert_eq!(report.unreadable(), 1);
    let problem = report.records.iter().find_map(|r| r.first_problem.clone());
    assert!(problem.expect("a problem").contains("breaks off at byte"));
    for at in (0..whole.len()).step_by(17) {
        let mut changed = whole.clone();
        changed[at] ^= 0xff;
        if let Ok(report) = imported(folder.path(), &changed) {
            assert!(written(&report, "IMU in 1202-1")[1] <= 40, "{at}");
        }
    }
}
