//! How long the live odometry takes for each scan of a recording, from the moment its last packet is there: median, 99th percentile, longest.
//!
//! `cargo run --release -p lsfb-pipeline --example scan_latency -- scan.mcap`
//!
//! Scans come one after the other, as fast as they are taken: what they wait for each other while the odometry is behind is not in it.

#![allow(clippy::print_stdout)] // a program, not a library

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use lsfb_pipeline::odometry::{OdometryConfig, OnlineOdometry};
use lsfb_recording::Recording;

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args().nth(1).ok_or("give a recording")?;
    let recording = Recording::open(Path::new(&file))?;
    let rig = recording.rig()?;
    let mut odometry = OnlineOdometry::new(&OdometryConfig::default(), &rig)?;
    let mut samples = recording.imu()?;
    let mut taken_ms = Vec::new();
    for scan in recording.scans()? {
        let scan = scan?;
        let last_ns = scan.sample.points.iter().map(|p| p.time_offset_ns).max();
        let end = scan.time.plus_nanos(last_ns.map_or(0, i64::from));
        for sample in samples.by_ref() {
            let sample = sample?;
            let reaches = sample.time >= end;
            odometry.push_imu(&sample);
            if reaches {
                break;
            }
        }
        let begun = Instant::now();
        odometry.push_scan(scan);
        while let Some(step) = odometry.next_step() {
            step?;
        }
        taken_ms.push(1e3 * begun.elapsed().as_secs_f64());
    }
    taken_ms.sort_by(f64::total_cmp);
    let last = taken_ms
        .len()
        .checked_sub(1)
        .ok_or("there is no scan in it")?;
    let at = |share: f64| taken_ms[(share * last as f64).round() as usize];
    println!(
        "{} scans: median {:.1} ms, 99 % within {:.1} ms, longest {:.1} ms",
        taken_ms.len(),
        at(0.5),
        at(0.99),
        at(1.0)
    );
    Ok(())
}
