//! Writes a place in traced light for another path tracer to judge: `light PLACE FOLDER [--points N] [--paths N]`.
//!
//! Triangles with albedo and luminance, the sun, points that a camera sees with their illuminance by our path tracer and in the baked
//! maps, and pictures with their cameras: see `benches/light/README.md`. Prints what the baking cost.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::Path;
use std::time::Instant;

use lsfb_geometry::Vector2;
use lsfb_sim::preview::Picture;
use lsfb_sim::{Device, LitPlace, Place, SimConfig, Simulation};
use lsfb_types::no_progress;
use rayon::prelude::*;
use serde_json::json;

type Failure = Box<dyn std::error::Error>;

/// Images of the backpack's cameras that points are taken from.
const IMAGES: u32 = 25;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let usage = "usage: light PLACE FOLDER [--points N] [--paths N]";
    let place = arguments
        .first()
        .and_then(|a| Place::named(a))
        .ok_or(usage)?;
    let folder = Path::new(arguments.get(1).ok_or(usage)?);
    let number = |name: &str, default: u32| match arguments.iter().position(|a| a == name) {
        Some(at) => arguments
            .get(at + 1)
            .and_then(|a| a.parse().ok())
            .ok_or(usage),
        None => Ok(default),
    };
    let (points, paths) = (number("--points", 1000)?, number("--paths", 4096)?);
    std::fs::create_dir_all(folder)?;

    let mut config = SimConfig::for_place(place, Device::Glasses);
    config.people = false;
    config.light.baked = true;
    config.scan.duration_s = 40.0;
    config.glasses.duration_s = 5.0;
    let mut dim = config.clone();
    dim.light.baked = false;
    let (began, cpu) = (Instant::now(), cpu_s());
    drop(Simulation::new(&dim, &no_progress)?);
    let (without_s, without_cpu_s) = (began.elapsed().as_secs_f64(), cpu_s() - cpu);
    let (began, cpu) = (Instant::now(), cpu_s());
    let simulation = Simulation::new(&config, &no_progress)?;
    let report = simulation.world().light_report().ok_or("no light")?;
    println!(
        "{}: {} facets, light at {} points: {:.0} s, {:.0} s of CPU time more than without",
        place.name(),
        simulation.world().facets().len(),
        report.points,
        began.elapsed().as_secs_f64() - without_s,
        cpu_s() - cpu - without_cpu_s,
    );

    let lit = LitPlace::of(&config);
    let (mut corners, mut optics) = (Vec::new(), Vec::new());
    for surface in lit.surfaces() {
        let v = &surface.vertices;
        for k in 1..v.len() - 1 {
            corners.extend([v[0], v[k], v[k + 1]].into_iter().flatten());
            let glass = f32::from(u8::from(surface.glass));
            optics.extend([surface.albedo, surface.luminance_cd_m2, glass]);
        }
    }
    write(folder, "triangles.f32", &corners)?;
    write(folder, "optics.f32", &optics)?;

    let seen = points_in_sight(&simulation, points)?;
    let compared: Vec<[f32; 8]> = seen
        .par_iter()
        .enumerate()
        .map(|(k, &(facet, place, point, normal))| {
            let traced = lit.illuminance_lx(point, normal, paths, k as u64);
            let baked = simulation.world().illuminance_lx(facet, place);
            let [px, py, pz] = point;
            let [nx, ny, nz] = normal;
            [px, py, pz, nx, ny, nz, traced, baked.unwrap_or_default()]
        })
        .collect();
    write(folder, "points.f32", compared.as_flattened())?;

    let scan = simulation.scan();
    let (name, camera) = scan.rig().cameras.first_key_value().ok_or("no camera")?;
    let mut views = Vec::new();
    for k in 0..3 {
        let frame = scan.frame_count() * (2 * k + 1) / 6;
        let image = scan.image(simulation.world(), 0, frame).ok_or("no image")?;
        let at = scan.frame_offset_ns(frame) as f64 * 1e-9;
        let world_from_camera = scan.walk().at(at).world_from_rig * camera.rig_from_camera;
        let picture = Picture {
            width: image.sample.width as usize,
            height: image.sample.height as usize,
            pixels: image.sample.pixels,
        };
        picture.write_png(&folder.join(format!("ours-{k}.png")))?;
        let m = world_from_camera.rotation_matrix();
        let t = world_from_camera.translation;
        views.push(json!({
            "right": [m[(0, 0)], m[(1, 0)], m[(2, 0)]],
            "down": [m[(0, 1)], m[(1, 1)], m[(2, 1)]],
            "forward": [m[(0, 2)], m[(1, 2)], m[(2, 2)]],
            "eye": [t.x, t.y, t.z],
        }));
    }
    let sun = lit
        .sun()
        .map(|(direction, lux)| json!({ "direction": direction, "lux": lux }));
    let about = json!({ "place": place.name(), "camera": name, "sun": sun, "views": views });
    std::fs::write(
        folder.join("place.json"),
        serde_json::to_string_pretty(&about)?,
    )?;
    Ok(())
}

/// A facet, where on it, the point and its normal, metres.
type RayHit = (usize, [f32; 2], [f32; 3], [f32; 3]);

/// Points spread over images of the walk, on opaque surfaces that are lit.
fn points_in_sight(simulation: &Simulation, count: u32) -> Result<Vec<RayHit>, Failure> {
    let (scan, world) = (simulation.scan(), simulation.world());
    let cameras: Vec<_> = scan.rig().cameras.values().collect();
    let mut found = Vec::new();
    let each = count.div_ceil(IMAGES);
    for image in 0..IMAGES {
        let frame = scan.frame_count() * (2 * image + 1) / (2 * IMAGES);
        let camera = cameras[image as usize % cameras.len()];
        let at = scan.frame_offset_ns(frame) as f64 * 1e-9;
        let world_from_camera = scan.walk().at(at).world_from_rig * camera.rig_from_camera;
        let origin: [f32; 3] = world_from_camera.translation.map(|v| v as f32).into();
        let mut kept = 0;
        // A sequence of low discrepancy over the image.
        for k in 1..100 * each {
            let (u, v) = (
                f64::from(k) * 0.754_877_666_2,
                f64::from(k) * 0.569_840_290_9,
            );
            let size = [camera.camera.width, camera.camera.height].map(f64::from);
            let pixel = Vector2::new(u.fract() * (size[0] - 1.0), v.fract() * (size[1] - 1.0));
            let ray = camera.camera.unproject(&pixel).ok_or("no ray")?;
            let ray: [f32; 3] = (world_from_camera.rotation * ray).map(|v| v as f32).into();
            let Some(hit) = world.cast(origin, ray) else {
                continue;
            };
            let facet = &world.facets()[hit.facet];
            let point = std::array::from_fn(|i| origin[i] + hit.distance * ray[i]);
            // What shines is no question of what lights it.
            let glass = world.substance(hit.facet) == lsfb_sim::world::Substance::Glass;
            if hit.distance > 60.0 || glass || world.illuminance_lx(hit.facet, [0.5; 2]).is_none() {
                continue;
            }
            found.push((hit.facet, facet.coordinates(point), point, facet.normal));
            kept += 1;
            if kept == each || found.len() == count as usize {
                break;
            }
        }
    }
    Ok(found)
}

fn write(folder: &Path, name: &str, values: &[f32]) -> Result<(), Failure> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    Ok(std::fs::write(folder.join(name), bytes)?)
}

/// CPU time of all threads so far, seconds (`man 5 proc_pid_stat`: fields 14 and 15, in hundredths).
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = after_name.split_whitespace().skip(11).take(2);
    ticks.filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
}
