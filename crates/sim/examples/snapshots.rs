//! Renders a few images of both walks as PNG files: `snapshots FOLDER [SEED]`.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::time::Instant;

use lsfb_sim::{RigSim, SimConfig, Simulation};
use lsfb_types::no_progress;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let folder = Path::new(arguments.get(1).map_or(".", |a| a));
    let seed = arguments.get(2).map_or(Ok(1), |a| a.parse())?;
    std::fs::create_dir_all(folder)?;
    let config = SimConfig {
        seed,
        ..SimConfig::default()
    };
    let began = Instant::now();
    let simulation = Simulation::new(&config, &no_progress)?;
    println!(
        "built in {:.2} s: {} facets, {:.1} MB of texture",
        began.elapsed().as_secs_f64(),
        simulation.world().facets().len(),
        simulation.world().texture_bytes() as f64 / 1e6
    );
    let began = Instant::now();
    let mut rays = 0;
    for (name, rig, cameras) in [
        ("scan", simulation.scan(), 4),
        ("walk", simulation.glasses(), 2),
    ] {
        for frame in (0..rig.frame_count()).step_by(40) {
            for camera in 0..cameras {
                rays += save(
                    &simulation,
                    rig,
                    camera,
                    frame,
                    &folder.join(format!("{name}-{frame:03}-cam{camera}.png")),
                )?;
            }
        }
    }
    println!(
        "{rays} rays with PNG in {:.2} s",
        began.elapsed().as_secs_f64()
    );
    Ok(())
}

fn save(
    simulation: &Simulation,
    rig: &RigSim,
    camera: usize,
    frame: u32,
    path: &Path,
) -> Result<usize, Box<dyn std::error::Error>> {
    let Some(image) = rig.image(simulation.world(), camera, frame) else {
        return Ok(0);
    };
    let image = image.sample;
    let mut encoder = png::Encoder::new(
        BufWriter::new(File::create(path)?),
        image.width,
        image.height,
    );
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header()?.write_image_data(&image.pixels)?;
    Ok(image.pixels.len())
}
