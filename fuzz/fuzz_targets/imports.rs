//! Recordings of other programs: the first byte says whose, the rest is each of the files that `lsfb import` reads of it.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_datasets::import::{Format, ImportConfig, import};
use lsfb_recording::Recording;
use lsfb_types::no_progress;

fn files(format: Format) -> &'static [&'static str] {
    match format {
        Format::Euroc => &["imu0/data.csv", "cam0/data.csv", "cam0/sensor.yaml"],
        Format::IosLogger => &["Accel.txt", "Gyro.txt", "Magnet.txt", "GPS.txt", "ARposes.txt"],
        Format::StrayScanner => &["imu.csv", "odometry.csv"],
        Format::MarsLogger => &["gyro_accel.csv", "frame_timestamps.txt", "movie_metadata.csv"],
        Format::VideoImuCapture => &["video_meta.pb3"],
        Format::SpectacularRec => &["data.jsonl", "calibration.json"],
        Format::Kapture => &[
            "sensors/sensors.txt",
            "sensors/records_wifi.txt",
            "sensors/records_bluetooth.txt",
            "sensors/trajectories.txt",
        ],
        Format::Lamar => &["sensors.txt", "images.txt", "wifi.txt", "bt.txt", "trajectories.txt"],
        // One file, not a folder.
        Format::IndoorLocation | Format::AriaVrs => &[],
    }
}

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let format = Format::ALL[usize::from(*which) % Format::ALL.len()];
    let root = std::env::temp_dir().join(format!("lsfb-fuzz-imports-{}", std::process::id()));
    let source = root.join("source");
    let _ = std::fs::remove_dir_all(&root);
    std::fs::create_dir_all(&root).expect("a scratch folder");
    match files(format) {
        [] => std::fs::write(&source, data).expect("a scratch file"),
        names => names.iter().for_each(|name| {
            let path = source.join(name);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("a scratch folder");
            std::fs::write(path, data).expect("a scratch file");
        }),
    }
    let config = ImportConfig {
        format: Some(format),
        ..ImportConfig::default()
    };
    let out = root.join("walk.mcap");
    if let Ok(report) = import(&source, &out, &config, &no_progress) {
        let read: u64 = report.records.iter().map(|r| r.written).sum();
        let recording = Recording::open(&out).expect("it was written");
        assert!(read == 0 || !recording.topics().is_empty());
    }
});
