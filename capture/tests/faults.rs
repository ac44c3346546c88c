//! Disks that fill up, refuse, or are slow: what is written is whole, what is missing is counted.
#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lsfb_capture::{CaptureReport, Error, Feed, Overflow, RecorderConfig, Session};
use lsfb_capture::{DevicesConfig, LidarNetConfig};
use lsfb_geometry::{Rig, RigLidar, Se3};
use lsfb_recording::{Compression, Existing, Recording, rig_sha256};
use lsfb_types::{Image, ImuSample, Stamped, Timestamp, no_progress};

const START: i64 = 1_772_359_200_000_000_000;
const IMAGE_BYTES: usize = 320 * 200;

fn stamped<T>(n: u32, sample: T) -> Stamped<T> {
    let time = Timestamp::from_nanos(START + i64::from(n) * 5_000_000);
    Stamped {
        time,
        arrival: time + 1_000_000,
        device_ticks: u64::from(n) + 1,
        sample,
    }
}

fn image(n: u32) -> Stamped<Image> {
    let pixels = (0..IMAGE_BYTES)
        .map(|i| (i as u32 * 31 + n) as u8)
        .collect();
    stamped(
        n,
        Image {
            width: 320,
            height: 200,
            pixels,
            exposure_ns: 1_000,
            frame_id: n,
        },
    )
}

fn sample(n: u32) -> Stamped<ImuSample> {
    stamped(
        n,
        ImuSample {
            angular_velocity_rad_s: [f64::from(n), 0.0, 0.0],
            specific_force_m_s2: [0.0, 0.0, 9.81],
        },
    )
}

fn plain() -> RecorderConfig {
    RecorderConfig {
        compression: Compression::None,
        reserve_bytes: 0,
        ..RecorderConfig::default()
    }
}

fn rig() -> Rig {
    Rig {
        lidars: RigLidar {
            rig_from_lidar: Se3::identity(),
            range_noise_m: 0.03,
        }
        .alone(),
        ..Rig::empty("test")
    }
}

/// Feeds images and samples; the images and samples that went in.
fn record(out: &Path, config: &RecorderConfig, images: u32, pause: Duration) -> CaptureReport {
    let feed = Feed::start(
        out,
        Some(rig()),
        &[vec!["cam0".to_owned()]],
        config,
        Overflow::Wait,
    )
    .unwrap();
    let mut feeder = feed.feeder("rig");
    for n in 0..images {
        if !(feeder.image("cam0", image(n)) && feeder.imu("imu0", sample(n))) {
            break;
        }
        std::thread::sleep(pause);
    }
    let report = feeder.finish();
    feed.finish(vec![report]).unwrap()
}

/// All samples of a recording in parts, and that each part opens by itself.
fn samples_of(parts: &[PathBuf]) -> Vec<u32> {
    let mut all = Vec::new();
    for part in parts {
        let recording = Recording::open(part).unwrap();
        assert_eq!(recording.damage(), [], "{}", part.display());
        assert_eq!(recording.verify(&no_progress).unwrap(), []);
        assert_eq!(recording.rig().unwrap().name, "test");
        assert!(recording.messages("/tf_static").unwrap().next().is_some());
        let values = recording.imu().unwrap().map(Result::unwrap);
        all.extend(values.map(|s| s.sample.angular_velocity_rad_s[0] as u32));
    }
    all
}

#[test]
fn split_by_size_every_part_is_complete_in_itself() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    let config = RecorderConfig {
        split_bytes: 1 << 20,
        chunk_bytes: 200_000,
        ..plain()
    };
    let report = record(&out, &config, 100, Duration::ZERO);
    assert_eq!((report.lost, &report.failure), (0, &None), "{report:?}");
    assert!((5..9).contains(&report.parts.len()), "{:?}", report.parts);
    assert_eq!(report.parts[1], folder.path().join("scan-0002.mcap"));
    assert_eq!(samples_of(&report.parts), (0..100).collect::<Vec<_>>());
    let second = Recording::open(&report.parts[1]).unwrap();
    let session = second.metadata("lsfb.session").unwrap();
    assert_eq!(
        (&*session["part"], &*session["previous"]),
        ("2", "scan.mcap")
    );
    let groups = second.messages("/sync/groups").unwrap().count();
    assert!(groups > 5, "{groups}");
    // The calibration is in each of them, readable without this program too.
    let hash = rig_sha256(&rig());
    for part in &report.parts {
        let part = Recording::open(part).unwrap();
        assert_eq!(part.metadata("lsfb.rig").unwrap()["sha256"], hash);
        assert_eq!(part.calibration().unwrap().sha256, hash);
    }
}

#[test]
fn a_recording_that_is_there_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    std::fs::write(&out, b"yesterday's work").unwrap();
    let start = |config: &RecorderConfig| Feed::start(&out, None, &[], config, Overflow::Wait);
    let message = start(&plain()).err().unwrap().to_string();
    assert!(
        message.contains("scan.mcap") && message.contains("already"),
        "{message}"
    );
    assert_eq!(std::fs::read(&out).unwrap(), b"yesterday's work");
    let replacing = RecorderConfig {
        existing: Existing::Replace,
        ..plain()
    };
    start(&replacing).unwrap().finish(Vec::new()).unwrap();
    assert!(Recording::open(&out).is_ok());
}

#[test]
fn a_disk_with_too_little_room_is_refused_before_anything_is_opened() {
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        lidars: vec![LidarNetConfig {
            data: "127.0.0.1:0".parse().unwrap(),
            position: "127.0.0.1:0".parse().unwrap(),
            ..LidarNetConfig::default()
        }],
        recorder: RecorderConfig {
            expected_bytes_per_sec: 1e18,
            ..RecorderConfig::default()
        },
        ..DevicesConfig::default()
    };
    let out = folder.path().join("scan.mcap");
    let session = Session::open(&config).unwrap();
    let error = session.run(&out, &no_progress).unwrap_err();
    assert!(matches!(error, Error::NoSpace { .. }), "{error}");
    let message = error.to_string();
    assert!(
        message.contains("minutes") && message.contains("MB/s"),
        "{message}"
    );
    assert!(!out.exists());
}

#[test]
fn a_disk_that_is_nearly_full_gives_way_to_the_second_and_that_one_is_closed_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    let config = RecorderConfig {
        // No disk has so much room: both are full from the start.
        reserve_bytes: u64::MAX,
        second_folder: Some(folder.path().join("second")),
        chunk_bytes: 100_000,
        ..plain()
    };
    let report = record(&out, &config, 400, Duration::from_millis(5));
    assert_eq!(
        report.parts,
        [out, folder.path().join("second/scan-0002.mcap")]
    );
    let failure = report.failure.as_deref().unwrap();
    assert!(failure.contains("full"), "{failure}");
    assert!(report.lost > 0);
    // Without a gap up to the end.
    let samples = samples_of(&report.parts);
    assert!(samples.len() > 10, "{}", samples.len());
    assert_eq!(samples, (0..samples.len() as u32).collect::<Vec<_>>());
}

#[test]
fn a_disk_that_takes_nothing_more_leaves_whole_files_and_the_second_goes_on() {
    if let Some(folder) = lsfb_tests::limited_folder() {
        return write_until_both_are_full(&folder);
    }
    let folder = tempfile::tempdir().unwrap();
    let test = "a_disk_that_takes_nothing_more_leaves_whole_files_and_the_second_goes_on";
    lsfb_tests::run_with_limited_files(test, 2048, folder.path());
}

fn write_until_both_are_full(folder: &Path) {
    let config = RecorderConfig {
        second_folder: Some(folder.join("second")),
        chunk_bytes: 200_000,
        ..plain()
    };
    let report = record(&folder.join("scan.mcap"), &config, 200, Duration::ZERO);
    assert_eq!(report.parts.len(), 2, "{report:?}");
    assert!(report.failure.is_some() && report.lost > 0, "{report:?}");
    let samples = samples_of(&report.parts);
    // The chunk that failed is what is missing between the two.
    assert!(samples.len() > 40, "{}", samples.len());
    assert!(samples.is_sorted());
    let gaps = samples.windows(2).filter(|w| w[1] != w[0] + 1).count();
    assert!(gaps <= 1, "{samples:?}");
}

#[test]
fn a_place_that_cannot_be_written_is_an_error_in_one_sentence() {
    let out = Path::new("/proc/nowhere/scan.mcap");
    let error = Feed::start(out, None, &[], &plain(), Overflow::Wait)
        .err()
        .unwrap();
    let message = error.to_string();
    assert!(
        message.contains("/proc/nowhere") && !message.contains('\n'),
        "{message}"
    );
}

/// Runs this test again where `mounts` are carried out first, each on a folder of its own below the one that the test is told
/// of: by the user's own name space, which needs no rights. `false`: not allowed here, which is said in one line.
fn run_below_mounts(test: &str, mounts: &[(&str, &str)]) -> bool {
    let folder = tempfile::tempdir().unwrap();
    let mut script = String::new();
    for (name, options) in mounts {
        let place = folder.path().join(name);
        std::fs::create_dir(&place).unwrap();
        script += &format!("mount -t tmpfs -o {options} tmpfs {} && ", place.display());
    }
    let unshared = |script: &str| {
        let mut command = std::process::Command::new("unshare");
        command.args(["--user", "--map-root-user", "--mount", "sh", "-c", script]);
        command
    };
    let allowed = unshared(&format!("{script}true")).output();
    if !allowed.is_ok_and(|output| output.status.success()) {
        lsfb_tests::skip(
            test,
            lsfb_tests::Lacks::Program,
            "no file system may be mounted here",
        );
        return false;
    }
    let child = unshared(&format!("{script}exec \"$0\" \"$@\""))
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", test])
        .env(MOUNTED_FOLDER, folder.path())
        .output()
        .unwrap();
    let output = String::from_utf8_lossy(&child.stdout);
    assert!(
        child.status.success() && output.contains("1 passed"),
        "{output}"
    );
    true
}

/// The part that runs where file systems of its own are mounted.
const MOUNTED_FOLDER: &str = "LSFB_TEST_MOUNTED_CAPTURE";

#[test]
fn a_read_only_disk_is_refused_before_anything_is_opened() {
    let Some(folder) = std::env::var_os(MOUNTED_FOLDER) else {
        let test = "a_read_only_disk_is_refused_before_anything_is_opened";
        run_below_mounts(test, &[("disk", "ro,size=1m")]);
        return;
    };
    let out = Path::new(&folder).join("disk/scan.mcap");
    let started = Feed::start(&out, None, &[], &plain(), Overflow::Wait);
    let message = started.err().unwrap().to_string();
    assert!(
        message.contains("scan.mcap") && message.contains("Read-only"),
        "{message}"
    );
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(!out.exists());
}

#[test]
fn full_disks_leave_whole_files() {
    let Some(folder) = std::env::var_os(MOUNTED_FOLDER) else {
        let disks = [("first", "size=2m"), ("second", "size=3m")];
        run_below_mounts("full_disks_leave_whole_files", &disks);
        return;
    };
    let folder = Path::new(&folder);
    let config = RecorderConfig {
        second_folder: Some(folder.join("second")),
        chunk_bytes: 200_000,
        ..plain()
    };
    let report = record(
        &folder.join("first/scan.mcap"),
        &config,
        200,
        Duration::ZERO,
    );
    assert_eq!(report.parts.len(), 2, "{report:?}");
    let failure = report.failure.clone().unwrap();
    assert!(failure.contains("No space left"), "{failure}");
    assert!(report.lost > 0);
    // Up to the last whole chunk, although the disk had no room even for an index.
    let samples: Vec<u32> = report
        .parts
        .iter()
        .flat_map(|part| {
            let recording = Recording::open(part).unwrap();
            let samples = recording.imu().unwrap().map(Result::unwrap);
            let values = samples.map(|s| s.sample.angular_velocity_rad_s[0] as u32);
            values.collect::<Vec<_>>()
        })
        .collect();
    assert!(samples.len() > 60, "{}", samples.len());
    let gaps = samples.windows(2).filter(|w| w[1] != w[0] + 1).count();
    assert!(samples.is_sorted() && gaps <= 1, "{samples:?}");
}

/// A pipe whose reader is slow stands for the disk: devices never wait, what does not fit is counted, and the file is whole.
#[test]
fn a_slow_disk_costs_samples_that_are_counted_and_no_device_waits() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("slow.mcap");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let copy = folder.path().join("copy.mcap");
    let disk = {
        let (pipe, copy) = (pipe.clone(), copy.clone());
        std::thread::Builder::new()
            .name("disk".to_owned())
            .spawn(move || {
                let mut from = std::fs::File::open(pipe).unwrap();
                let mut all = Vec::new();
                let mut piece = vec![0; 64 << 10];
                loop {
                    match from.read(&mut piece).unwrap() {
                        0 => break,
                        count => all.extend_from_slice(&piece[..count]),
                    }
                    // 6 MB/s.
                    std::thread::sleep(Duration::from_millis(10));
                }
                std::fs::write(copy, all).unwrap();
            })
            .unwrap()
    };
    let config = RecorderConfig {
        existing: Existing::Replace,
        queue_bytes: 2 << 20,
        chunk_bytes: 500_000,
        ..plain()
    };
    let feed = Feed::start(&pipe, Some(rig()), &[], &config, Overflow::Drop).unwrap();
    let mut feeder = feed.feeder("cam0");
    let images = 300;
    let mut longest = Duration::ZERO;
    for n in 0..images {
        let began = Instant::now();
        assert!(feeder.image("cam0", image(n)));
        longest = longest.max(began.elapsed());
        // 32 MB/s.
        std::thread::sleep(Duration::from_millis(2));
    }
    let stream = feeder.finish();
    let dropped = stream.dropped;
    let report = feed.finish(vec![stream]).unwrap();
    disk.join().unwrap();
    assert!(
        // The queue alone holds thirty.
        dropped > 50 && dropped < u64::from(images) - 25,
        "{dropped}"
    );
    assert_eq!(report.lost, dropped);
    // The disk takes three seconds for all of them.
    assert!(longest < Duration::from_secs(1), "{longest:?}");
    let recording = Recording::open(&copy).unwrap();
    assert_eq!(recording.damage(), []);
    let recorded = recording
        .images("cam0")
        .unwrap()
        .map(Result::unwrap)
        .count() as u64;
    assert_eq!(recorded + dropped, u64::from(images));
}
