//! Write speed beside the crate `mcap`, on the same bytes: 200 images of 1 MiB and 22 600 LiDAR packets, chunk checksums on.
//!
//! ```sh
//! cargo run --release -p lsfb-recording --example mcap_write -- FOLDER [RUNS]
//! ```
//!
//! Writes `FOLDER/images.bin` and `FOLDER/packets.bin` first, for writers in other languages (`benches/mcap_write`). Figures are
//! megabytes of payload per second of CPU time, medians of alternating runs.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a program to be run by hand"
)]

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::time::Instant;

use lsfb_recording::{Channel, Compression, Writer, WriterConfig};
use lsfb_types::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const IMAGES: usize = 200;
const DIFFERENT_IMAGES: usize = 6;
const IMAGE_BYTES: usize = 1 << 20;
const PACKETS: usize = 22_600;
const PACKET_BYTES: usize = 1206;
const CHUNK_BYTES: u64 = 4 << 20;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().map_or(".", String::as_str)).to_owned();
    let runs: usize = arguments.get(1).map_or(5, |n| n.parse().unwrap());
    let (images, packets) = payload();
    std::fs::write(folder.join("images.bin"), images.concat()).unwrap();
    std::fs::write(folder.join("packets.bin"), packets.concat()).unwrap();
    let bytes = (IMAGES * IMAGE_BYTES + PACKETS * PACKET_BYTES) as f64;
    for (name, ours, theirs, level) in [
        ("none", Compression::None, None, 0),
        ("lz4", Compression::Lz4, Some(mcap::Compression::Lz4), 0),
        // The default of the C++ library and of this one, and that of the crate and the PyPI package.
        (
            "zstd level 1",
            Compression::Zstd,
            Some(mcap::Compression::Zstd),
            1,
        ),
        (
            "zstd level 3",
            Compression::Zstd,
            Some(mcap::Compression::Zstd),
            3,
        ),
    ] {
        let (mut own, mut peer) = (Vec::new(), Vec::new());
        for _ in 0..runs {
            let path = folder.join("ours.mcap");
            own.push(timed(|| write_ours(&path, ours, level, &images, &packets)));
            let path = folder.join("crate.mcap");
            peer.push(timed(|| {
                write_crate(&path, theirs, level, &images, &packets)
            }));
        }
        let (mut own_alone, mut peer_alone) = (Vec::new(), Vec::new());
        for _ in 0..runs {
            // Without what the operating system does with the bytes.
            let nowhere = Path::new("/dev/null");
            own_alone.push(timed(|| {
                write_ours(nowhere, ours, level, &images, &packets)
            }));
            peer_alone.push(timed(|| {
                write_crate(nowhere, theirs, level, &images, &packets)
            }));
        }
        let size = |file: &str| std::fs::metadata(folder.join(file)).unwrap().len() as f64 / 1e6;
        let (own, peer) = (median(own), median(peer));
        println!(
            "{name}: lsfb-recording {:.0} MB/s of CPU ({:.2} s wall, {:.0} MB), crate mcap {:.0} MB/s ({:.2} s wall, {:.0} MB)",
            bytes / own.cpu_secs / 1e6,
            own.wall_secs,
            size("ours.mcap"),
            bytes / peer.cpu_secs / 1e6,
            peer.wall_secs,
            size("crate.mcap")
        );
        println!(
            "{name}, to /dev/null: lsfb-recording {:.0} MB/s of CPU, crate mcap {:.0} MB/s",
            bytes / median(own_alone).cpu_secs / 1e6,
            bytes / median(peer_alone).cpu_secs / 1e6,
        );
    }
    for file in ["ours.mcap", "crate.mcap"] {
        std::fs::remove_file(folder.join(file)).unwrap();
    }
}

/// Structure with noise in its lowest bits; packets like those of a LiDAR.
fn payload() -> (Vec<Vec<u8>>, Vec<Vec<u8>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let images = (0..DIFFERENT_IMAGES)
        .map(|n| {
            (0..IMAGE_BYTES)
                .map(|i| {
                    let (x, y) = (i % 1024, i / 1024);
                    let checks = 60 * ((x / 40 + y / 30 + n) % 2);
                    (60 + checks + x / 16 + y / 32) as u8 + rng.random_range(0..4_u8)
                })
                .collect()
        })
        .collect();
    let packets = (0..PACKETS)
        .map(|n| {
            (0..PACKET_BYTES)
                .map(|i| match i % 3 {
                    0 => rng.random::<u8>(),
                    1 => ((i + n) / 40) as u8,
                    _ => rng.random_range(0..60),
                })
                .collect()
        })
        .collect();
    (images, packets)
}

/// In the order of recording: an image, and the packets of 50 ms.
fn interleaved() -> impl Iterator<Item = (usize, std::ops::Range<usize>)> {
    let per_image = PACKETS / IMAGES;
    (0..IMAGES).map(move |n| (n, n * per_image..(n + 1) * per_image))
}

fn write_ours(
    path: &Path,
    compression: Compression,
    level: u32,
    images: &[Vec<u8>],
    packets: &[Vec<u8>],
) {
    let config = WriterConfig {
        compression,
        zstd_level: level as i32,
        chunk_bytes: CHUNK_BYTES,
        chunk_secs: 1e9,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(path, &config).unwrap();
    let channel = |topic| Channel {
        topic,
        schema_name: "x/msg/X",
        schema_text: "uint8[] data",
    };
    let (image, velodyne) = (channel("/image"), channel("/velodyne"));
    for (n, range) in interleaved() {
        let time = Timestamp::from_nanos(n as i64 * 50_000_000);
        let pixels = &images[n % images.len()];
        writer.write_cdr(&image, time, time, pixels).unwrap();
        for packet in &packets[range] {
            writer.write_cdr(&velodyne, time, time, packet).unwrap();
        }
    }
    writer.finish().unwrap();
}

fn write_crate(
    path: &Path,
    compression: Option<mcap::Compression>,
    level: u32,
    images: &[Vec<u8>],
    packets: &[Vec<u8>],
) {
    let file = BufWriter::with_capacity(1 << 20, File::create(path).unwrap());
    let mut writer = mcap::WriteOptions::new()
        .compression(compression)
        .compression_level(level)
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        .create(file)
        .unwrap();
    let mut channel = |topic: &str| {
        let schema = writer
            .add_schema("x/msg/X", "ros2msg", b"uint8[] data")
            .unwrap();
        writer
            .add_channel(schema, topic, "cdr", &BTreeMap::new())
            .unwrap()
    };
    let (image, velodyne) = (channel("/image"), channel("/velodyne"));
    let mut put = |channel_id, n: usize, data: &[u8]| {
        let time = n as u64 * 50_000_000;
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: n as u32,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    };
    for (n, range) in interleaved() {
        put(image, n, &images[n % images.len()]);
        packets[range]
            .iter()
            .for_each(|packet| put(velodyne, n, packet));
    }
    writer.finish().unwrap();
}

#[derive(Clone, Copy)]
struct Took {
    cpu_secs: f64,
    wall_secs: f64,
}

fn timed(work: impl FnOnce()) -> Took {
    let (cpu, wall) = (cpu_secs(), Instant::now());
    work();
    Took {
        cpu_secs: cpu_secs() - cpu,
        wall_secs: wall.elapsed().as_secs_f64(),
    }
}

fn median(mut runs: Vec<Took>) -> Took {
    runs.sort_by(|a, b| a.cpu_secs.total_cmp(&b.cpu_secs));
    runs[runs.len() / 2]
}

/// Time on the processor of this program's only thread.
fn cpu_secs() -> f64 {
    let times = std::fs::read_to_string("/proc/self/schedstat").unwrap();
    let nanos: f64 = times.split_whitespace().next().unwrap().parse().unwrap();
    nanos / 1e9
}
