//! Writes LiDAR packets with what is true about them, for foreign programs to judge: `packets FOLDER`.
//!
//! For each model and return mode a pcap of two seconds in an office with rooms behind glass, and beside it when each
//! return was fired; for all together the surfaces, the poses, and where the LiDAR sits. Nobody walks about: people are
//! not among the surfaces.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::Path;

use lsfb_drivers::transport::save::{Encapsulation, PcapWriter};
use lsfb_sim::{Device, LidarModel, Place, Returns, RigSim, SimConfig, Simulation};
use lsfb_types::{Packet, no_progress};
use serde_json::json;

type Failure = Box<dyn std::error::Error>;

/// Start and length of what is written, nanoseconds.
const FROM_NS: i64 = 4_000_000_000;
const SPAN_NS: i64 = 2_000_000_000;

fn main() -> Result<(), Failure> {
    let folder = std::env::args().nth(1).ok_or("usage: packets FOLDER")?;
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder)?;
    let mut streams = Vec::new();
    for (name, model, returns) in [
        ("vlp32c-strongest", LidarModel::Vlp32c, Returns::Strongest),
        ("vlp32c-dual", LidarModel::Vlp32c, Returns::Dual),
        ("vlp16-strongest", LidarModel::Vlp16, Returns::Strongest),
        ("vlp16-dual", LidarModel::Vlp16, Returns::Dual),
    ] {
        let mut config = SimConfig::for_place(Place::MediumOffice, Device::Glasses);
        (config.texel_m, config.people) = (0.05, false);
        (config.scan.duration_s, config.glasses.duration_s) = (10.0, 1.0);
        (config.lidar.model, config.lidar.returns) = (model, returns);
        let simulation = Simulation::new(&config, &no_progress)?;
        write_stream(folder, name, &simulation)?;
        println!("{name}");
        if streams.is_empty() {
            write_world(folder, &simulation)?;
        }
        streams.push(json!({
            "name": name,
            "model": model,
            "dual": returns == Returns::Dual,
            "range_noise_m": config.lidar.range_noise_m,
            "divergence_rad": config.lidar.divergence_rad,
            "separation_m": config.lidar.separation_m,
        }));
    }
    let meta = json!({ "streams": streams });
    std::fs::write(
        folder.join("packets.json"),
        serde_json::to_string_pretty(&meta)?,
    )?;
    Ok(())
}

/// Surfaces as triangles with the way they face, which of them are glass, and the LiDAR's poses once a millisecond.
fn write_world(folder: &Path, simulation: &Simulation) -> Result<(), Failure> {
    let world = simulation.world();
    let (mut corners, mut normals, mut glass) = (Vec::new(), Vec::new(), Vec::new());
    for (number, facet) in world.facets().iter().enumerate() {
        let v = facet.vertices();
        for k in 1..v.len() - 1 {
            corners.extend([v[0], v[k], v[k + 1]].into_iter().flatten());
            normals.extend(facet.normal);
            glass.push(u8::from(world.is_glass(number)));
        }
    }
    let floats =
        |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    std::fs::write(folder.join("triangles.f32"), floats(&corners))?;
    std::fs::write(folder.join("normals.f32"), floats(&normals))?;
    std::fs::write(folder.join("glass.u8"), glass)?;
    let rig = simulation.scan();
    let mut poses = String::new();
    for k in 0..=(SPAN_NS / 1_000_000) + 4 {
        let offset_ns = FROM_NS - 2_000_000 + k * 1_000_000;
        let pose = rig.world_from_lidar(offset_ns as f64 * 1e-9);
        let (t, q) = (pose.translation, pose.rotation.quaternion());
        poses += &format!(
            "{} {:.9} {:.9} {:.9} {:.12} {:.12} {:.12} {:.12}\n",
            rig.time(offset_ns).nanos(),
            t.x,
            t.y,
            t.z,
            q.i,
            q.j,
            q.k,
            q.w
        );
    }
    std::fs::write(folder.join("world_from_lidar.txt"), poses)?;
    Ok(())
}

/// Packets, and time, ring and range of every return in them.
fn write_stream(folder: &Path, name: &str, simulation: &Simulation) -> Result<(), Failure> {
    let rig: &RigSim = simulation.scan();
    let lidar = rig.lidar().ok_or("no LiDAR")?;
    let packet_ns = lidar.packet_ns();
    let first = (FROM_NS / packet_ns) as u64;
    let count = (SPAN_NS / packet_ns) as usize;
    let path = folder.join(format!("{name}.pcap"));
    let mut capture = PcapWriter::create(&path, Encapsulation::Udp { port_of: |_| 2368 })?;
    for (k, bytes) in rig
        .lidar_packets(simulation.world(), first, count)?
        .into_iter()
        .enumerate()
    {
        // A packet leaves when its last laser has fired.
        let arrival = rig.time((first as i64 + k as i64 + 1) * packet_ns);
        let bytes = bytes.to_vec();
        capture.write(&Packet { arrival, bytes })?;
    }
    capture.finish()?;
    let mut fired = String::new();
    let cycles = lidar.cycles_per_packet();
    for cycle in rig.fire(simulation.world(), first * cycles as u64, count * cycles) {
        for channel in 0..cycle.returns.len() {
            let (one, two) = (&cycle.returns[channel], &cycle.second_returns[channel]);
            let time = rig.time(cycle.offset_ns + lidar.firing_delay_ns(channel));
            let other = two.range_count != one.range_count;
            for (echo, is_sent) in [(one, true), (two, other)] {
                if is_sent && echo.range_count > 0 {
                    let range_m = f64::from(echo.range_count) * lidar.range_unit_m();
                    fired += &format!("{} {} {range_m:.3}\n", time.nanos(), lidar.ring(channel));
                }
            }
        }
    }
    std::fs::write(folder.join(format!("{name}.txt")), fired)?;
    Ok(())
}
