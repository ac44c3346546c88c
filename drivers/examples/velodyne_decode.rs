//! Measures the Velodyne decoder: `make DATA OUT.pcap` writes the packets, `run FILE.pcap [PASSES]` decodes them.
//!
//! One thread. The best of the passes counts, in CPU time of this process, so that a busy machine changes little. The
//! peer's side and the recipe are in `benches/velodyne_decode/`.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use std::error::Error;
use std::path::Path;
use std::time::Duration;

use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_drivers::transport::rosbag2::Rosbag2Source;
use lsfb_drivers::transport::save::{Encapsulation, PcapWriter};
use lsfb_drivers::velodyne::wire::DataPacket;
use lsfb_drivers::velodyne::{Decoder, DecoderConfig, OpticalOffset};
use lsfb_types::{Packet, Timestamp};
use nix::time::{ClockId, clock_gettime};

/// As many as the peer was measured on before: 15 s of a VLP-32C.
const PACKETS: usize = 22_624;
/// 12 blocks of 55.296 µs.
const PERIOD_NS: i64 = 663_552;
const START_NS: i64 = 1_700_000_000_000_000_000;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["make", data, out] => make(Path::new(data), Path::new(out)),
        ["run", file] => run(Path::new(file), 5),
        ["run", file, passes] => run(Path::new(file), passes.parse()?),
        _ => Err("usage: velodyne_decode make DATA OUT.pcap | run FILE.pcap [PASSES]".into()),
    }
}

/// A revolution of the real VLP-32C bag, repeated with timestamps that go on.
fn make(data: &Path, out: &Path) -> Result<(), Box<dyn Error>> {
    let bag = data.join("lidar/nebula_velodyne/vlp32/1713492677464078412_0.db3");
    let mut bag = Rosbag2Source::open(&bag)?;
    let mut packets = Vec::new();
    loop {
        match bag.recv(Duration::ZERO) {
            Ok(packet) => packets.extend(packet),
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break,
            Err(error) => return Err(error.into()),
        }
    }
    let azimuths = packets
        .iter()
        .map(|packet| Ok(DataPacket::new(packet.bytes.as_slice())?.azimuth_centideg(0)))
        .collect::<Result<Vec<u16>, lsfb_drivers::WireError>>()?;
    let wraps: Vec<usize> = (1..azimuths.len())
        .filter(|&i| azimuths[i] < azimuths[i - 1])
        .collect();
    let [first, second, ..] = wraps[..] else {
        return Err("no whole revolution in the bag".into());
    };
    let revolution = &packets[first..second];
    let mut file = PcapWriter::create(out, Encapsulation::Udp { port_of: |_| 2368 })?;
    for (index, packet) in revolution.iter().cycle().take(PACKETS).enumerate() {
        let arrival = Timestamp::from_nanos(START_NS + index as i64 * PERIOD_NS);
        let mut data = DataPacket::new(packet.bytes.clone())?;
        data.set_timestamp_us((arrival.nanos() / 1000).rem_euclid(3_600_000_000) as u32);
        file.write(&Packet {
            arrival,
            bytes: data.into_inner(),
        })?;
    }
    file.finish()?;
    Ok(())
}

fn run(file: &Path, passes: usize) -> Result<(), Box<dyn Error>> {
    let packets = read(file)?;
    let from_memory = best(passes, || {
        let mut decoder = decoder();
        let mut points = 0;
        for packet in &packets {
            points += decoder
                .push(packet)?
                .map_or(0, |scan| scan.sample.points.len());
        }
        while let Some(scan) = decoder.finish() {
            points += scan.sample.points.len();
        }
        Ok(points)
    })?;
    let from_file = best(passes, || {
        let mut decoder = decoder();
        let mut source = PcapSource::open(file, &[2368])?;
        let mut points = 0;
        loop {
            match source.recv(Duration::ZERO) {
                Ok(Some(packet)) => {
                    points += decoder
                        .push(&packet)?
                        .map_or(0, |scan| scan.sample.points.len());
                }
                Ok(None) => {}
                Err(lsfb_drivers::Error::EndOfStream { .. }) => break,
                Err(error) => return Err(error.into()),
            }
        }
        while let Some(scan) = decoder.finish() {
            points += scan.sample.points.len();
        }
        Ok(points)
    })?;
    let real_secs = packets.len() as f64 * PERIOD_NS as f64 / 1e9;
    for (what, best) in [("memory", from_memory), ("pcap", from_file)] {
        println!(
            "ours from {what}: {} packets, {} points, cpu {:.4} s: {:.1} Mpoint/s, {:.0} packets/s, {:.0} x real time",
            packets.len(),
            best.points,
            best.cpu_secs,
            best.points as f64 / best.cpu_secs / 1e6,
            packets.len() as f64 / best.cpu_secs,
            real_secs / best.cpu_secs,
        );
    }
    Ok(())
}

/// The peer models the optical centre's offset; so does this run.
fn decoder() -> Decoder {
    Decoder::new(DecoderConfig {
        optical_offset: OpticalOffset::Applied,
        ..DecoderConfig::default()
    })
}

fn read(file: &Path) -> Result<Vec<Packet>, Box<dyn Error>> {
    let mut source = PcapSource::open(file, &[2368])?;
    let mut packets = Vec::new();
    loop {
        match source.recv(Duration::ZERO) {
            Ok(packet) => packets.extend(packet),
            Err(lsfb_drivers::Error::EndOfStream { .. }) => return Ok(packets),
            Err(error) => return Err(error.into()),
        }
    }
}

struct Best {
    points: usize,
    cpu_secs: f64,
}

fn best(
    passes: usize,
    mut pass: impl FnMut() -> Result<usize, Box<dyn Error>>,
) -> Result<Best, Box<dyn Error>> {
    let mut best = Best {
        points: 0,
        cpu_secs: f64::INFINITY,
    };
    for _ in 0..passes.max(1) {
        let before = cpu()?;
        let points = pass()?;
        let cpu_secs = (cpu()? - before).as_secs_f64();
        best = Best {
            points,
            cpu_secs: best.cpu_secs.min(cpu_secs),
        };
    }
    Ok(best)
}

fn cpu() -> Result<Duration, Box<dyn Error>> {
    Ok(clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID)?.into())
}
