//! Draws places: `preview FOLDER [PLACE-OR-SEQUENCE ...]`, all nine environments without names.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::Path;
use std::time::Instant;

use lsfb_sim::{Device, PaperMotion, Place, SimConfig, Simulation, preview};
use lsfb_types::no_progress;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().map_or(".", |a| a));
    std::fs::create_dir_all(folder)?;
    let mut names: Vec<String> = arguments.iter().skip(1).cloned().collect();
    if names.is_empty() {
        names = Place::ENVIRONMENTS.map(|p| p.name().to_owned()).to_vec();
    }
    for name in names {
        let config = match (Place::named(&name), PaperMotion::named(&name)) {
            (Some(place), _) => SimConfig::for_place(place, Device::Glasses),
            (None, Some(motion)) => SimConfig::for_motion(motion, Device::Android),
            (None, None) => return Err(format!("{name}: neither a place nor a sequence").into()),
        };
        let began = Instant::now();
        let simulation = Simulation::new(&config, &no_progress)?;
        let world = simulation.world();
        println!(
            "{name}: built in {:.2} s, {} facets, {:.0} MB of texture, scan of {:.0} s",
            began.elapsed().as_secs_f64(),
            world.facets().len(),
            world.texture_bytes() as f64 / 1e6,
            simulation.scan().walk().duration_s(),
        );
        let began = Instant::now();
        for (kind, rig) in [("scan", simulation.scan()), ("walk", simulation.glasses())] {
            preview::contact_sheet(&simulation, rig, &no_progress)?
                .write_png(&folder.join(format!("{name}-{kind}.png")))?;
        }
        preview::top_view(&simulation).write_png(&folder.join(format!("{name}-top.png")))?;
        println!("  drawn in {:.2} s", began.elapsed().as_secs_f64());
    }
    Ok(())
}
