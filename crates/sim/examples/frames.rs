//! Writes images with what is true about them, for foreign programs to judge:
//! `frames FOLDER [--baked] [--detailed] [--gap=N] [--device=NAME] [--jpeg=QUALITY] NAME ...`;
//! with `--baked` in traced light, which is kept in the folder, with `--detailed` in the detailed look.
//!
//! A name is a place, a sequence of Table VII, or `calibration`. For a place or a sequence: pairs of images N frames apart (3, a tenth of a
//! second, unless another gap is asked for) through the first camera of the glasses or of another device, with the true motion between them; of
//! the device's JPEG quality or another (0 for none). For `calibration`: images of
//! the AprilGrid through the backpack's first camera, through a phone with a rolling shutter, and through the same phone
//! on the same walk as if its shutter were global, with the true corners.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::Path;

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_sim::{
    CalibrationBoard, CameraConfig, Device, Look, PaperMotion, Place, RigSim, SimConfig,
    Simulation, preview::Picture,
};
use lsfb_types::no_progress;
use serde_json::{Value, json};

type Failure = Box<dyn std::error::Error>;

/// Pairs of images of one walk.
const PAIRS: u32 = 16;
/// Images of the board by one camera.
const BOARDS: u32 = 60;

fn main() -> Result<(), Failure> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let baked = arguments.iter().any(|a| a == "--baked");
    let look = match arguments.iter().any(|a| a == "--detailed") {
        true => Look::Detailed,
        false => Look::Plain,
    };
    let gap = match arguments.iter().find_map(|a| a.strip_prefix("--gap=")) {
        Some(frames) => frames.parse()?,
        None => 3,
    };
    let option = |name: &str| arguments.iter().find_map(|a| a.strip_prefix(name));
    let device = match option("--device=") {
        Some(name) => Device::ALL
            .into_iter()
            .find(|device| device.name() == name)
            .ok_or_else(|| format!("{name}: no device"))?,
        None => Device::Glasses,
    };
    let jpeg_quality: Option<u8> = option("--jpeg=").map(str::parse).transpose()?;
    arguments.retain(|a| !a.starts_with("--"));
    let folder = Path::new(
        arguments
            .first()
            .ok_or("usage: frames FOLDER [--baked] [--detailed] [--gap=N] [--device=NAME] [--jpeg=QUALITY] NAME ...")?,
    );
    std::fs::create_dir_all(folder)?;
    for name in &arguments[1..] {
        let truth = if name == Place::Calibration.name() {
            boards(folder, baked)?
        } else {
            let mut config = match (Place::named(name), PaperMotion::named(name)) {
                (Some(place), _) => SimConfig::for_place(place, device),
                (None, Some(motion)) => SimConfig::for_motion(motion, device),
                (None, None) => return Err(format!("{name}: no place and no sequence").into()),
            };
            // The scanner does not walk here.
            config.scan.duration_s = 1.0;
            config.light.baked = baked;
            config.look = look;
            if let Some(quality) = jpeg_quality {
                config.glasses_cameras.jpeg_quality = quality;
            }
            config.light.cache = folder.join("light");
            pairs(folder, name, gap, &Simulation::new(&config, &no_progress)?)?
        };
        std::fs::write(
            folder.join(format!("{name}.json")),
            serde_json::to_string_pretty(&truth)?,
        )?;
        println!("{name}");
    }
    Ok(())
}

fn write(folder: &Path, name: &str, image: lsfb_types::Image) -> Result<(), Failure> {
    let picture = Picture {
        width: image.width as usize,
        height: image.height as usize,
        pixels: image.pixels,
    };
    Ok(picture.write_png(&folder.join(name))?)
}

fn pairs(folder: &Path, name: &str, gap: u32, simulation: &Simulation) -> Result<Value, Failure> {
    let rig = simulation.glasses();
    let camera = rig.rig().cameras.values().next().ok_or("no camera")?;
    let pose = |frame: u32| {
        let at = rig.frame_offset_ns(frame) as f64 * 1e-9;
        rig.walk().at(at).world_from_rig * camera.rig_from_camera
    };
    let mut list = Vec::new();
    for k in 0..PAIRS {
        let first = rig.frame_count().saturating_sub(gap + 1) * (2 * k + 1) / (2 * PAIRS);
        let mut files = Vec::new();
        for frame in [first, first + gap] {
            let image = rig.image(simulation.world(), 0, frame).ok_or("no image")?;
            let file = format!(
                "{name}-{k:02}-{}.png",
                if frame == first { 'a' } else { 'b' }
            );
            write(folder, &file, image.sample)?;
            files.push(file);
        }
        let b_from_a: Se3 = pose(first + gap).inverse() * pose(first);
        let rotation = b_from_a.rotation_matrix();
        let rows: Vec<Vec<f64>> = (0..3)
            .map(|r| {
                (0..3)
                    .map(|c| rotation[(r, c)])
                    .chain([b_from_a.translation[r]])
                    .collect()
            })
            .collect();
        list.push(json!({ "a": files[0], "b": files[1], "b_from_a": rows }));
    }
    Ok(json!({ "camera": camera.camera, "pairs": list }))
}

fn boards(folder: &Path, baked: bool) -> Result<Value, Failure> {
    let mut all = Vec::new();
    for (kind, device) in [
        ("global", Device::Glasses),
        ("rolling", Device::Android),
        ("frozen", Device::Android),
    ] {
        let mut config = SimConfig::for_place(Place::Calibration, device);
        // Sharp images in good light of a sharp print: what is measured is where corners are.
        config.texel_m = 0.001;
        config.light.baked = baked;
        config.light.cache = folder.join("light");
        for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
            *cameras = CameraConfig {
                motion_blur: false,
                jpeg_quality: 0,
                readout_ns: if kind == "frozen" {
                    0
                } else {
                    cameras.readout_ns
                },
                ..cameras.clone()
            };
        }
        let simulation = Simulation::new(&config, &no_progress)?;
        let rig = match device {
            Device::Glasses => simulation.scan(),
            _ => simulation.glasses(),
        };
        // The backpack's first camera faces the board in the first quarter.
        let usable = if device == Device::Glasses {
            rig.frame_count() / 4 - 60
        } else {
            rig.frame_count() - 60
        };
        for k in 0..BOARDS {
            let frame = 40 + usable * k / BOARDS;
            let image = rig.image(simulation.world(), 0, frame).ok_or("no image")?;
            let file = format!("board-{kind}-{k:02}.png");
            write(folder, &file, image.sample)?;
            all.push(json!({ "file": file, "kind": kind, "corners": corners(rig, frame)? }));
        }
    }
    Ok(json!({ "images": all }))
}

/// True places of all corners that lie in the image, by tag.
fn corners(rig: &RigSim, frame: u32) -> Result<Value, Failure> {
    let camera = rig.rig().cameras.values().next().ok_or("no camera")?;
    let sim = rig.camera(0).ok_or("no camera")?;
    let middle = rig.frame_offset_ns(frame) as f64 * 1e-9;
    let board = CalibrationBoard::of_room();
    let mut tags = serde_json::Map::new();
    for id in 0..36 {
        let mut seen = Vec::new();
        for corner in board.tag_corners_m(id) {
            // Where a row sees the corner decides when, and when decides where.
            let mut pixel = Some(Vector2::new(0.0, 0.5 * f64::from(camera.camera.height)));
            for _ in 0..8 {
                let Some(last) = pixel else { break };
                let at = middle + sim.row_offset_s(last.y);
                let world_from_camera = rig.walk().at(at).world_from_rig * camera.rig_from_camera;
                pixel = camera
                    .camera
                    .project(&(world_from_camera.inverse() * Vector3::from(corner)));
            }
            match pixel.filter(|p| camera.camera.contains(p, 6.0)) {
                Some(p) => seen.push(json!([p.x, p.y])),
                None => break,
            }
        }
        if seen.len() == 4 {
            tags.insert(id.to_string(), Value::Array(seen));
        }
    }
    Ok(Value::Object(tags))
}
