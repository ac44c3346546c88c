//! A recorder that is killed at a random instant: the file opens, at most one second is missing, the doctor says which, and
//! what is there can be made whole.
//!
//! ```sh
//! LSFB_KILLS=200 cargo test --release -p lsfb-recording -p lsfb-capture --test killed
//! ```
//!
//! With `LSFB_FOREIGN_PYTHON` naming a Python that has the PyPI package `mcap`, every file is read by it too.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use lsfb_capture::doctor::{DoctorConfig, examine};
use lsfb_capture::{Feed, Overflow, RecorderConfig};
use lsfb_recording::{Recording, recover};
use lsfb_tests::foreign_python;
use lsfb_types::{Image, ImuSample, Stamped, Timestamp, Verdict, no_progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Where the recorder writes, in the process that is going to be killed.
const KILLED_OUT: &str = "LSFB_TEST_KILLED_OUT";
/// The test below, which runs itself as the process that is killed.
const NAME: &str = "a_recorder_that_is_killed_loses_less_than_a_second";
/// How many recorders are killed.
const KILLS: &str = "LSFB_KILLS";
/// What a kill may cost.
const SECOND_NS: i64 = 1_000_000_000;

fn now() -> Timestamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    Timestamp::from_nanos(since.as_nanos() as i64)
}

fn stamped<T>(n: u32, sample: T) -> Stamped<T> {
    let time = now();
    Stamped {
        time,
        arrival: time,
        device_ticks: u64::from(n) + 1,
        sample,
    }
}

/// Two cameras at 20 Hz and an IMU at 200 Hz, until somebody kills it.
fn record_until_killed(out: &Path) {
    let units = [vec!["cam0".to_owned(), "cam1".to_owned()]];
    let config = RecorderConfig::default();
    let feed = Feed::start(out, None, &units, &config, Overflow::Drop).unwrap();
    let mut feeder = feed.feeder("rig");
    let began = Instant::now();
    for n in 0..100_000_u32 {
        std::thread::sleep((Duration::from_millis(5) * n).saturating_sub(began.elapsed()));
        let sample = ImuSample {
            angular_velocity_rad_s: [f64::from(n), 0.0, 0.0],
            specific_force_m_s2: [0.0, 0.0, 9.81],
        };
        feeder.imu("imu0", stamped(n, sample));
        if n % 10 == 0 {
            for camera in ["cam0", "cam1"] {
                let image = Image {
                    width: 160,
                    height: 120,
                    pixels: (0..160 * 120).map(|i: u32| (i * 7 + n) as u8).collect(),
                    exposure_ns: 1,
                    frame_id: n / 10,
                };
                feeder.image(camera, stamped(n, image));
            }
        }
    }
}

#[test]
fn a_recorder_that_is_killed_loses_less_than_a_second() {
    if let Some(out) = std::env::var_os(KILLED_OUT) {
        return record_until_killed(Path::new(&out));
    }
    let kills: u64 = std::env::var(KILLS).map_or(3, |n| n.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut worst_ns = 0;
    let mut files = Vec::new();
    let seeds: Vec<u64> = (0..kills).collect();
    // A few at a time: each sleeps most of the time.
    for batch in seeds.chunks(4) {
        let results: Vec<Killed> = std::thread::scope(|scope| {
            let threads: Vec<_> = batch
                .iter()
                .map(|seed| {
                    let out = folder.path().join(format!("killed-{seed:03}.mcap"));
                    std::thread::Builder::new()
                        .name(format!("kill-{seed}"))
                        .spawn_scoped(scope, move || kill_one(*seed, &out))
                        .unwrap()
                })
                .collect();
            threads.into_iter().map(|t| t.join().unwrap()).collect()
        });
        for killed in results {
            worst_ns = worst_ns.max(killed.missing_ns);
            check(&killed);
            files.push(killed.out);
        }
    }
    println!(
        "{kills} kills: at most {:.0} ms missing",
        worst_ns as f64 / 1e6
    );
    read_elsewhere(&files);
    assert!(worst_ns <= SECOND_NS, "{worst_ns} ns");
}

struct Killed {
    out: PathBuf,
    missing_ns: i64,
}

fn kill_one(seed: u64, out: &Path) -> Killed {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", NAME])
        .env(KILLED_OUT, out)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while !out.exists() {
        assert!(
            began.elapsed() < Duration::from_secs(20),
            "nothing is recorded"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(Duration::from_micros(rng.random_range(700_000..2_500_000)));
    let killed = now();
    child.kill().unwrap();
    child.wait().unwrap();
    let last = Recording::open(out).unwrap().arrival_range().unwrap().end;
    Killed {
        out: out.to_owned(),
        missing_ns: killed - last,
    }
}

/// Nothing is missing before the end, the doctor names the place, and the recovered file is whole.
fn check(killed: &Killed) {
    let recording = Recording::open(&killed.out).unwrap();
    let samples = numbers(&recording);
    assert_eq!(samples, (0..samples.len() as u32).collect::<Vec<_>>());
    assert!(!recording.damage().is_empty());
    let diagnosis = examine(&recording, &DoctorConfig::default(), &no_progress).unwrap();
    assert_eq!(diagnosis.judgement.verdict(), Verdict::Fail);
    let named = diagnosis
        .judgement
        .findings()
        .iter()
        .any(|f| f.subject == "file" && f.what.contains("last message arrived at"));
    assert!(named, "{diagnosis:?}");
    // A copy of two thirds of a recording was said to lack a second at most, and to hold all messages that were written.
    let findings = diagnosis.judgement.findings().iter();
    let file = findings.clone().find(|f| f.subject == "file").unwrap();
    assert!(
        file.what
            .contains("if a copy was truncated, any amount may be missing"),
        "{file:?}"
    );
    let counts = findings.clone().find(|f| f.code == "counts").unwrap();
    assert_eq!(counts.verdict, Verdict::Unknown, "{counts:?}");

    let whole = killed.out.with_extension("whole.mcap");
    let recovered = recover(&killed.out, &whole, &no_progress).unwrap();
    let again = Recording::open(&whole).unwrap();
    assert_eq!(again.damage(), []);
    assert_eq!(again.verify(&no_progress).unwrap(), []);
    let kept = numbers(&again);
    assert!(kept.len() >= samples.len() && kept[..samples.len()] == samples);
    assert!(recovered.messages >= kept.len() as u64);
}

fn numbers(recording: &Recording) -> Vec<u32> {
    let samples = recording.imu().unwrap().map(Result::unwrap);
    samples
        .map(|s| s.sample.angular_velocity_rad_s[0] as u32)
        .collect()
}

/// The torn files as a stream, the recovered ones by their index.
fn read_elsewhere(files: &[PathBuf]) {
    let Some(python) = foreign_python(NAME) else {
        return;
    };
    let output = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/killed/read.py"))
        .args(files)
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout);
    println!("foreign reader: {}", said.trim());
}
