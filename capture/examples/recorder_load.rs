//! The whole rig's data rate into real files: four cameras of 1280×800 at 20 Hz, a VLP-32C, an IMU at 400 Hz.
//!
//! ```sh
//! cargo run --release -p lsfb-capture --example recorder_load -- FOLDER [SECS] [SPEED] [grey|yuyv] [none|lz4|zstd] [KEEP]
//! ```
//!
//! Prints one line. Files are split every 2 GB; with `KEEP` only that many are kept while it runs, for disks that are smaller
//! than the stream.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a program to be run by hand"
)]

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use lsfb_capture::{Feed, Overflow, RecorderConfig, StreamReport};
use lsfb_recording::{Compression, Existing};
use lsfb_types::{Image, ImuSample, LidarPoint, LidarScan, Packet, Stamped, Timestamp};

const SPLIT_BYTES: u64 = 2_000_000_000;
const WIDTH: u32 = 1280;
const HEIGHT: u32 = 800;
/// Images that are sent again and again; together larger than any cache.
const IMAGES: u32 = 16;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let text = |n: usize, or: &str| arguments.get(n).cloned().unwrap_or_else(|| or.to_owned());
    let folder = PathBuf::from(text(0, "."));
    let secs: f64 = text(1, "60").parse().unwrap();
    let speed: f64 = text(2, "1").parse().unwrap();
    let bytes_per_pixel = if text(3, "grey") == "yuyv" { 2 } else { 1 };
    let compression = match text(4, "none").as_str() {
        "lz4" => Compression::Lz4,
        "zstd" => Compression::Zstd,
        _ => Compression::None,
    };
    let keep: usize = text(5, "0").parse().unwrap();

    let out = folder.join("load.mcap");
    remove_parts(&folder, 0);
    let config = RecorderConfig {
        compression,
        split_bytes: SPLIT_BYTES,
        existing: Existing::Replace,
        ..RecorderConfig::default()
    };
    let units = [
        vec!["cam0".to_owned(), "cam1".to_owned()],
        vec!["cam2".to_owned(), "cam3".to_owned()],
    ];
    let images: Vec<Vec<u8>> = (0..IMAGES)
        .map(|n| textured(WIDTH * bytes_per_pixel, n))
        .collect();
    let feed = Feed::start(&out, None, &units, &config, Overflow::Drop).unwrap();
    let began = Instant::now();
    let done = AtomicBool::new(false);
    let running = |period: f64, n: u64| -> bool {
        let due = Duration::try_from_secs_f64(n as f64 * period / speed).unwrap();
        std::thread::sleep(due.saturating_sub(began.elapsed()));
        began.elapsed().as_secs_f64() < secs
    };
    let reports: Vec<StreamReport> = std::thread::scope(|scope| {
        let mut threads = Vec::new();
        for names in &units {
            let mut feeder = feed.feeder(&names.join("+"));
            let (images, running) = (&images, &running);
            threads.push(spawn(scope, "unit", move || {
                let mut n = 0;
                while running(0.05, n) {
                    for (k, name) in names.iter().enumerate() {
                        let pixels = &images[(n as usize * 2 + k) % images.len()];
                        let image = Image {
                            width: WIDTH * bytes_per_pixel,
                            height: HEIGHT,
                            pixels: pixels.clone(),
                            exposure_ns: 5_000_000,
                            frame_id: n as u32,
                        };
                        feeder.image(name, stamped(n, image, began, 0.05 / speed));
                    }
                    n += 1;
                }
                feeder.finish()
            }));
        }
        let mut feeder = feed.feeder("lidar");
        let turn = &running;
        threads.push(spawn(scope, "lidar", move || {
            let (points, packets) = revolution();
            let mut n = 0;
            while turn(0.1, n) {
                let scan = LidarScan {
                    points: points.clone(),
                };
                feeder.scan(
                    "lidar",
                    stamped(n, scan, began, 0.1 / speed),
                    packets.clone(),
                );
                n += 1;
            }
            feeder.finish()
        }));
        let mut feeder = feed.feeder("imu0");
        threads.push(spawn(scope, "imu", move || {
            let mut n = 0;
            while turn(0.0025, n) {
                let sample = ImuSample {
                    angular_velocity_rad_s: [n as f64, 0.1, 0.2],
                    specific_force_m_s2: [0.0, 0.0, 9.81],
                };
                feeder.imu("imu0", stamped(n, sample, began, 0.0025 / speed));
                n += 1;
            }
            feeder.finish()
        }));
        let watched = spawn(scope, "rotate", || {
            while !done.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(200));
                if keep > 0 {
                    remove_parts(&folder, keep);
                }
            }
            StreamReport::default()
        });
        let reports = threads.into_iter().map(|t| t.join().unwrap()).collect();
        done.store(true, Ordering::Relaxed);
        watched.join().unwrap();
        reports
    });
    let took = began.elapsed().as_secs_f64();
    let sent: u64 = reports.iter().map(|r| r.received).sum();
    let report = feed.finish(reports).unwrap();
    let usage = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF).unwrap();
    let secs_of = |t: nix::sys::time::TimeVal| t.tv_sec() as f64 + t.tv_usec() as f64 / 1e6;
    let cpu = secs_of(usage.user_time()) + secs_of(usage.system_time());
    println!(
        "{took:.0} s at {speed}x: {:.1} MB/s, {:.1} GB in {} files, {sent} samples, {} lost, enqueue to write p99 {:.1} ms, longest {:.0} ms, RSS {:.0} MB, {:.0} % of a core{}",
        report.bytes as f64 / took / 1e6,
        report.bytes as f64 / 1e9,
        report.parts.len(),
        report.lost,
        report.write_p99_ms,
        report.write_longest_ms,
        usage.max_rss() as f64 / 1e3,
        100.0 * cpu / took,
        report.failure.map_or(String::new(), |f| format!("; {f}"))
    );
    if keep > 0 {
        remove_parts(&folder, 1);
    }
}

fn spawn<'scope>(
    scope: &'scope std::thread::Scope<'scope, '_>,
    name: &str,
    work: impl FnOnce() -> StreamReport + Send + 'scope,
) -> std::thread::ScopedJoinHandle<'scope, StreamReport> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn_scoped(scope, work)
        .unwrap()
}

fn stamped<T>(n: u64, sample: T, began: Instant, period: f64) -> Stamped<T> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    let start_ns = now.as_nanos() as i64 - began.elapsed().as_nanos() as i64;
    Stamped {
        time: Timestamp::from_nanos(start_ns).plus_secs(n as f64 * period),
        arrival: Timestamp::from_nanos(now.as_nanos() as i64),
        // Microseconds, as cameras count; nobody looks at those of the others.
        device_ticks: (n as f64 * period * 1e6) as u64 + 1,
        sample,
    }
}

/// Structure with noise in its lowest bits, as a camera sees it.
fn textured(width: u32, seed: u32) -> Vec<u8> {
    let mut state = u64::from(seed) * 0x9E37_79B9_7F4A_7C15 + 1;
    let mut noise = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 60) as u32
    };
    (0..width * HEIGHT)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let checks = 60 * ((x / 40 + y / 30 + seed) % 2);
            (60 + checks + x / 16 + y / 32 + noise()) as u8
        })
        .collect()
}

fn revolution() -> (Vec<LidarPoint>, Vec<Packet>) {
    let points = (0..58_000_u32)
        .map(|i| LidarPoint {
            position_m: [
                (i as f32 * 0.001).sin() * 8.0,
                (i as f32 * 0.001).cos() * 8.0,
                0.1 * (i % 32) as f32,
            ],
            intensity: i as u8,
            ring: (i % 32) as u16,
            time_offset_ns: i * 1_720,
            ..LidarPoint::default()
        })
        .collect();
    let packets = (0..151_u32)
        .map(|n| Packet {
            arrival: Timestamp::from_nanos(1_772_359_200_000_000_000),
            bytes: (0..1206_u32).map(|i| (i * 7 + n) as u8).collect(),
        })
        .collect();
    (points, packets)
}

/// Removes all parts but the last `keep`.
fn remove_parts(folder: &Path, keep: usize) {
    let mut parts: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with("load") && name.ends_with(".mcap")
        })
        .collect();
    parts.sort_by_key(|path| std::fs::metadata(path).and_then(|m| m.modified()).ok());
    for path in parts.iter().take(parts.len().saturating_sub(keep)) {
        let _ = std::fs::remove_file(path);
    }
}
