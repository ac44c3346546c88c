//! Measures rays per second of CPU time: `throughput [PLACE] [--baked] [--export FOLDER]`. Time that other programs take does not
//! count; the number of threads is set by `RAYON_NUM_THREADS`.
//!
//! With a folder it also writes the triangles and the rays of one image, for another ray caster: see
//! `benches/ray_cast/README.md`.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::Path;

use lsfb_geometry::Vector2;
use lsfb_sim::world::{LANES, NO_FACET, RayPacket};
use lsfb_sim::{Device, Place, SimConfig, Simulation};
use lsfb_types::no_progress;
use wide::f32x8;

/// Times each rate is measured; the best is printed.
const RUNS: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let place = arguments
        .first()
        .and_then(|a| Place::named(a))
        .unwrap_or(Place::Demo);
    let mut config = SimConfig::for_place(place, Device::Glasses);
    // One ray per pixel, and four where surfaces meet: blur would only make more of the same.
    config.scan_cameras.motion_blur = false;
    config.scan.duration_s = 20.0;
    config.glasses.duration_s = 5.0;
    config.light.baked = arguments.iter().any(|a| a == "--baked");
    let simulation = Simulation::new(&config, &no_progress)?;
    let world = simulation.world();
    println!("{}: {} facets", place.name(), world.facets().len());
    let scan = simulation.scan();
    let frames = [40, 120, 200, 280, 360];
    let best = |run: &mut dyn FnMut() -> usize| {
        let rate = (0..RUNS).map(|_| {
            let began = cpu_s();
            let rays = run();
            rays as f64 / (cpu_s() - began).max(1e-3) / 1e6
        });
        rate.fold(0.0, f64::max)
    };
    let mut images = || {
        let taken = frames.iter().flat_map(|&f| (0..4).map(move |c| (c, f)));
        taken
            .filter_map(|(camera, frame)| scan.image(world, camera, frame))
            .map(|image| image.sample.pixels.len())
            .sum()
    };
    println!(
        "images 1280 × 800, textured, distorted: {:.2} M rays/s",
        best(&mut images)
    );

    let rays = rays_of_image(&simulation)?;
    let mut hits = Vec::new();
    let mut cast = || {
        // Often enough for a clock that ticks a hundred times a second.
        for _ in 0..6 {
            hits.clear();
            for (origin, group) in &rays {
                hits.push(world.cast_packet(&RayPacket::from_point(*origin, *group)));
            }
        }
        6 * rays.len() * LANES
    };
    println!(
        "casting alone: {:.2} M rays per CPU second",
        best(&mut cast)
    );

    let mut revolutions = || {
        let turns = (20..40).map(|turn| 32 * scan.revolution(world, turn).len());
        turns.sum()
    };
    let rate = best(&mut revolutions);
    // A VLP-32C fires 32 lasers every 55.296 µs.
    println!(
        "LiDAR: {rate:.2} M rays per CPU second, {:.1} × real time on one core",
        rate / (32.0 / 55.296)
    );

    if let Some(at) = arguments.iter().position(|a| a == "--export") {
        let folder = Path::new(arguments.get(at + 1).ok_or("--export needs a folder")?);
        std::fs::create_dir_all(folder)?;
        let mut corners = Vec::new();
        for facet in world.facets() {
            let v = facet.vertices();
            for k in 1..v.len() - 1 {
                corners.extend([v[0], v[k], v[k + 1]].into_iter().flatten());
            }
        }
        let (mut starts, mut directions, mut distances) = (Vec::new(), Vec::new(), Vec::new());
        for ((origin, group), hit) in rays.iter().zip(&hits) {
            let [x, y, z] = group.map(|d| d.to_array());
            let distance = hit.distance.to_array();
            for lane in 0..LANES {
                starts.extend(origin);
                directions.extend([x[lane], y[lane], z[lane]]);
                let none = hit.facet[lane] == NO_FACET;
                distances.push(if none { -1.0 } else { distance[lane] });
            }
        }
        for (name, values) in [
            ("triangles.f32", corners),
            ("origins.f32", starts),
            ("directions.f32", directions),
            ("distances.f32", distances),
        ] {
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            std::fs::write(folder.join(name), bytes)?;
        }
    }
    Ok(())
}

/// CPU time of all threads so far, seconds (`man 5 proc_pid_stat`: fields 14 and 15, in hundredths).
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = after_name.split_whitespace().skip(11).take(2);
    ticks.filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
}

type Rays = Vec<([f32; 3], [f32x8; 3])>;

/// The rays of one image of the forward camera, row by row.
fn rays_of_image(simulation: &Simulation) -> Result<Rays, Box<dyn std::error::Error>> {
    let scan = simulation.scan();
    let camera = &scan.rig().cameras["cam0"];
    let at = scan.frame_offset_ns(200) as f64 * 1e-9;
    let world_from_camera = scan.walk().at(at).world_from_rig * camera.rig_from_camera;
    let origin = world_from_camera.translation.map(|v| v as f32).into();
    let mut rays = Vec::new();
    for y in 0..camera.camera.height {
        for x in (0..camera.camera.width).step_by(LANES) {
            let mut lanes = [[0.0_f32; 3]; LANES];
            for (lane, ray) in lanes.iter_mut().enumerate() {
                let pixel = Vector2::new(f64::from(x) + lane as f64, f64::from(y));
                let in_camera = camera.camera.unproject(&pixel).ok_or("no ray")?;
                *ray = (world_from_camera.rotation * in_camera)
                    .map(|v| v as f32)
                    .into();
            }
            let axis = |i: usize| f32x8::new(lanes.map(|ray| ray[i]));
            rays.push((origin, [axis(0), axis(1), axis(2)]));
        }
    }
    Ok(rays)
}
