//! Writes a session straight to files, without devices: `record FOLDER [--seed N] [--duration S] [--small]
//! [--place NAME | --motion NAME [--device NAME]]`.
//!
//! `--small` is the least that the pipeline can use: 320 pixels across, coarse surfaces, ten images a second. The folder receives `scan.mcap`, `walk.mcap`, `backpack.toml`, `glasses.toml`, and the truth beside them.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::{Path, PathBuf};
use std::time::Instant;

use lsfb_recording::{Writer, WriterConfig};
use lsfb_sim::{Device, PaperMotion, Place, RigSim, SimConfig, Simulation};
use lsfb_types::{Stamped, no_progress};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (folder, config) = arguments()?;
    std::fs::create_dir_all(&folder)?;
    let began = Instant::now();
    let simulation = Simulation::new(&config, &no_progress)?;
    println!("world built in {:.2} s", began.elapsed().as_secs_f64());
    for (rig, recording, name) in [
        (simulation.scan(), "scan.mcap", "backpack.toml"),
        (simulation.glasses(), "walk.mcap", "glasses.toml"),
    ] {
        let began = Instant::now();
        std::fs::write(folder.join(name), rig.rig().to_toml())?;
        record(&simulation, rig, &folder.join(recording))?;
        println!(
            "{recording} written in {:.2} s",
            began.elapsed().as_secs_f64()
        );
    }
    simulation.write_truth(&folder)?;
    Ok(())
}

fn arguments() -> Result<(PathBuf, SimConfig), Box<dyn std::error::Error>> {
    let mut folder = None;
    let mut config = SimConfig::default();
    let (mut seed, mut duration_s, mut small) = (1, None, false);
    let (mut place, mut motion, mut device) = (None, None, Device::Glasses);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--seed" => seed = value()?.parse()?,
            "--duration" => duration_s = Some(value()?.parse()?),
            "--small" => small = true,
            "--place" => place = Some(Place::named(&value()?).ok_or("no such place")?),
            "--motion" => motion = Some(PaperMotion::named(&value()?).ok_or("not in Table VII")?),
            "--device" => {
                let name = value()?;
                let found = Device::ALL.into_iter().find(|d| d.name() == name);
                device = found.ok_or("no such device")?;
            }
            _ => folder = Some(PathBuf::from(argument)),
        }
    }
    if let Some(motion) = motion {
        config = SimConfig::for_motion(motion, device);
    } else if let Some(place) = place {
        config = SimConfig::for_place(place, device);
    }
    config.seed = seed;
    if let Some(duration_s) = duration_s {
        config.motion.clear();
        config.scan.duration_s = duration_s;
        config.glasses.duration_s = duration_s;
        if config.place == Place::Demo {
            config.glasses.duration_s = duration_s.min(24.0);
        }
    }
    if small {
        config.texel_m = 0.008;
        for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
            (cameras.height, cameras.width) = (320 * cameras.height / cameras.width / 8 * 8, 320);
            cameras.rate_hz = 10;
        }
    }
    Ok((
        folder.ok_or("usage: record FOLDER [--seed N] [--duration S] [--small] [--place NAME]")?,
        config,
    ))
}

/// Everything a rig measures, in order of time.
fn record(
    simulation: &Simulation,
    rig: &RigSim,
    path: &Path,
) -> Result<(), Box<dyn std::error::Error>> {
    let world = simulation.world();
    let mut writer = Writer::create(path, &WriterConfig::default())?;
    writer.attach_rig(rig.rig())?;
    let mut imu = rig.imu().iter().peekable();
    let mut frame = 0;
    let mut revolution = 0;
    // One tenth of a second after another; all rates are multiples of it.
    for tenth in 1..=(rig.walk().duration_s() * 10.0).round() as i64 {
        let end_ns = tenth * 100_000_000;
        while let Some(s) = imu.next_if(|s| s.offset_ns <= end_ns) {
            let time = rig.time(s.offset_ns);
            writer.write_imu(
                "imu0",
                &Stamped {
                    time,
                    arrival: time,
                    device_ticks: (s.offset_ns / 100_000) as u64,
                    sample: s.sample,
                },
            )?;
        }
        while frame < rig.frame_count() && rig.frame_offset_ns(frame) <= end_ns {
            for (camera, name) in rig.rig().cameras.keys().enumerate() {
                if let Some(image) = rig.image(world, camera, frame) {
                    writer.write_image(name, &image)?;
                }
            }
            frame += 1;
        }
        if rig.rig().lidar().is_some() && revolution < rig.revolution_count() {
            if let Some(scan) = rig.scan(world, revolution) {
                writer.write_scan(lsfb_geometry::MAIN_LIDAR, &scan)?;
            }
            revolution += 1;
        }
    }
    writer.finish()?;
    Ok(())
}
