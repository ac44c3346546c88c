//! Odometry and, with `--map`, mapping of a recording; with a true trajectory its errors as well.
//!
//! `cargo run --release -p lsfb-pipeline --example map_recording -- scan.mcap [truth.tum] [--map]`
//!
//! With `--ablation` the map is made without one of its parts after the other, and with the IMU among them, a line each.
//!
//! Writes `odometry.tum` and `mapping.tum` where it is run.

#![allow(clippy::print_stdout)] // a program, not a library

use std::error::Error;
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{Trajectory, Vector3};
use lsfb_pipeline::mapping::{MappingConfig, build_map};
use lsfb_pipeline::odometry::{OdometryConfig, run_odometry};
use lsfb_recording::{Recording, read_tum, write_tum};
use lsfb_types::{Progress, Stopped, no_progress};

fn main() -> Result<(), Box<dyn Error>> {
    let (options, files): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|a| a.starts_with("--"));
    let recording = Recording::open(Path::new(files.first().ok_or("give a recording")?))?;
    let truth = files.get(1).map(|f| read_tum(Path::new(f))).transpose()?;

    let begun = Instant::now();
    let result = run_odometry(&recording, &OdometryConfig::default(), &no_progress)?;
    println!("odometry: {:.1} s", begun.elapsed().as_secs_f64());
    println!("{:#?}", result.report);
    print_errors(&result.trajectory, truth.as_ref());
    write_tum(Path::new("odometry.tum"), &result.trajectory)?;

    if options.iter().any(|o| o == "--ablation") {
        for (name, config) in ablations() {
            let result = build_map(&recording, &config, &no_progress)?;
            let r = &result.report;
            println!(
                "{name}: reprojection {:.3} px rms, planes {:.2} mm, edges {:.2} mm, {} rounds",
                r.reprojection_rms_px,
                1e3 * r.lidar_after.plane_rms_m,
                1e3 * r.lidar_after.edge_rms_m,
                r.rounds.len()
            );
            print_errors(&result.trajectory, truth.as_ref());
        }
    }
    if options.iter().any(|o| o == "--map") {
        let begun = Instant::now();
        let result = build_map(&recording, &MappingConfig::default(), &stage_printer())?;
        println!(
            "mapping with odometry: {:.1} s",
            begun.elapsed().as_secs_f64()
        );
        println!("{:#?}", result.report);
        print_errors(&result.trajectory, truth.as_ref());
        write_tum(Path::new("mapping.tum"), &result.trajectory)?;
    }
    Ok(())
}

/// The map as it is, without each of its parts, and with the IMU's.
fn ablations() -> Vec<(&'static str, MappingConfig)> {
    let with = |change: &dyn Fn(&mut MappingConfig)| {
        let mut config = MappingConfig {
            close_loops: true,
            ..MappingConfig::default()
        };
        change(&mut config);
        config
    };
    vec![
        ("all", with(&|_| {})),
        ("no plane", with(&|c| c.terms.planes = false)),
        ("no edge", with(&|c| c.terms.edges = false)),
        ("no visual", with(&|c| c.terms.images = false)),
        ("with IMU", with(&|c| c.terms.imu = true)),
        (
            "no loops",
            with(&|c| {
                c.close_loops = false;
                c.scan_revisits = 0;
            }),
        ),
        ("one outer iteration", with(&|c| c.outer_iterations = 1)),
    ]
}

fn print_errors(trajectory: &Trajectory, truth: Option<&Trajectory>) {
    let pairs = |truth: &Trajectory| -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
        let both = trajectory
            .poses()
            .iter()
            .filter_map(|p| Some((p.world_from_rig.translation, truth.at(p.time)?.translation)));
        both.unzip()
    };
    let Some((found, truth)) = truth.map(pairs) else {
        return;
    };
    if let Some(alignment) = umeyama(&found, &truth, Scale::Fixed) {
        let errors = found
            .iter()
            .zip(&truth)
            .map(|(f, t)| (alignment.apply(f) - t).norm());
        let squares: f64 = errors.clone().map(|e| e * e).sum();
        println!(
            "ATE {:.2} cm RMS, {:.2} cm at most, {} poses",
            100.0 * (squares / found.len() as f64).sqrt(),
            100.0 * errors.fold(0.0, f64::max),
            found.len()
        );
        let tilt = alignment.target_from_source.rotation * Vector3::z();
        println!(
            "world tilted by {:.3} deg",
            tilt.angle(&Vector3::z()).to_degrees()
        );
    }
}

/// Prints when each stage begins.
fn stage_printer() -> impl Fn(Progress) -> Result<(), Stopped> + Sync {
    let begun = Instant::now();
    let last = Mutex::new("");
    move |progress| {
        if let Ok(mut last) = last.lock()
            && *last != progress.stage
        {
            *last = progress.stage;
            println!(
                "{:7.1} s  {}",
                begun.elapsed().as_secs_f64(),
                progress.stage
            );
        }
        Ok(())
    }
}
