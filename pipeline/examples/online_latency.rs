//! How long the scans of a recording take online, from the arrival of a scan's last packet to its pose, and the memory that this needs.
//!
//! `cargo run --release -p lsfb-pipeline --example online_latency -- scan.mcap`
//!
//! Samples and scans are given as fast as they were taken; `--at-once` gives them as fast as they are worked off, which tells the computing
//! alone.

#![allow(clippy::print_stdout)] // a program, not a library

use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

use lsfb_pipeline::odometry::{OdometryConfig, OnlineOdometry};
use lsfb_recording::Recording;

fn main() -> Result<(), Box<dyn Error>> {
    let (options, files): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|a| a.starts_with("--"));
    let at_once = options.iter().any(|o| o == "--at-once");
    let recording = Recording::open(Path::new(files.first().ok_or("give a recording")?))?;
    let rig = recording.rig()?;
    let mut odometry = OnlineOdometry::new(&OdometryConfig::default(), &rig)?;
    let mut samples = recording.imu()?.collect::<Result<Vec<_>, _>>()?.into_iter();
    let mut waiting = samples.next();
    let mut begun: Option<(Instant, lsfb_types::Timestamp)> = None;
    let mut milliseconds = Vec::new();
    for scan in recording.scans()? {
        let scan = scan?;
        let last_offset_ns = scan.sample.points.iter().map(|p| p.time_offset_ns).max();
        let end = scan.time.plus_nanos(i64::from(last_offset_ns.unwrap_or(0)));
        // The sample behind the end of the scan is there a few milliseconds later.
        while let Some(sample) = waiting.take_if(|s| s.time <= end.plus_nanos(20_000_000)) {
            odometry.push_imu(&sample);
            waiting = samples.next();
        }
        let (start, first) = *begun.get_or_insert((Instant::now(), end));
        let due = start + Duration::from_secs_f64(end.secs_since(first).max(0.0));
        let now = Instant::now();
        if !at_once && due > now {
            std::thread::sleep(due - now);
        }
        let arrived = if at_once { Instant::now() } else { due };
        odometry.push_scan(scan);
        while let Some(step) = odometry.next_step() {
            step?;
            milliseconds.push(1e3 * arrived.elapsed().as_secs_f64());
        }
    }
    let last = milliseconds.last().copied().unwrap_or(0.0);
    milliseconds.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let k = (share * milliseconds.len() as f64) as usize;
        milliseconds.get(k).copied().unwrap_or(last)
    };
    println!(
        "{} scans: median {:.1} ms, p99 {:.1} ms, longest {:.1} ms; {} MB",
        milliseconds.len(),
        at(0.5),
        at(0.99),
        milliseconds.last().copied().unwrap_or(0.0),
        resident_mb()
    );
    Ok(())
}

/// Largest resident memory so far, MB; 0 where the system does not say.
fn resident_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kilobytes = peak.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kilobytes.unwrap_or(0) / 1000
}
