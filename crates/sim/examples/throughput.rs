//! Measures rays per second: `throughput [SEED]`. The number of threads is set by `RAYON_NUM_THREADS`.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::time::Instant;

use lsfb_sim::{SimConfig, Simulation};
use lsfb_types::no_progress;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seed = std::env::args().nth(1).map_or(Ok(1), |a| a.parse())?;
    let config = SimConfig {
        seed,
        ..SimConfig::default()
    };
    let began = Instant::now();
    let simulation = Simulation::new(&config, &no_progress)?;
    println!("world: {:.2} s", began.elapsed().as_secs_f64());
    let world = simulation.world();
    for (name, rig) in [
        ("scan", simulation.scan()),
        ("glasses", simulation.glasses()),
    ] {
        let began = Instant::now();
        let mut rays = 0;
        for frame in (0..rig.frame_count()).step_by(20) {
            for camera in 0..rig.rig().cameras.len() {
                rays += rig
                    .image(world, camera, frame)
                    .map_or(0, |i| i.sample.pixels.len());
            }
        }
        let spent_s = began.elapsed().as_secs_f64();
        println!(
            "{name} cameras: {:.2} M rays/s",
            rays as f64 / spent_s / 1e6
        );
    }
    let began = Instant::now();
    let mut rays = 0;
    for turn in (0..simulation.scan().revolution_count()).step_by(36) {
        rays += 32 * simulation.scan().revolution(world, turn).len();
    }
    let spent_s = began.elapsed().as_secs_f64();
    println!("LiDAR: {:.2} M rays/s", rays as f64 / spent_s / 1e6);
    Ok(())
}
