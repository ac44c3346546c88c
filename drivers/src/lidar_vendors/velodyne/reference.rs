//! The Velodyne driver against PyPI `velodyne-decoder` 3.1, point by point, on recordings made by others.
//!
//! The reference models the optical centre's offset, and so does this test. It turns the rotor at the mean pace of a packet
//! where we take that of each block; in a packet with the gap of a field-of-view window that pace is wrong, and azimuths are
//! not compared. Its offset of the HDL-32E is 0.12 mm smaller than ours.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::io::Read;
use std::path::Path;
use std::time::Duration;

use crate::Error;
use crate::lidar_vendors::velodyne::model::{Model, Product};
use crate::lidar_vendors::velodyne::wire::{DataPacket, Returns, returns_of_code};
use crate::lidar_vendors::velodyne::{
    Decoder, DecoderConfig, ModelChoice, OpticalOffset, PacketLayout, returns,
};
use crate::transport::PacketSource;
use crate::transport::pcap::PcapSource;
use crate::transport::rosbag2::Rosbag2Source;
use flate2::read::DeflateDecoder;
use lsfb_tests::recordings as data;
use lsfb_types::{Echo, LidarPoint, Packet};

fn u16_at(bytes: &[u8], at: usize) -> usize {
    u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()).into()
}

fn u32_at(bytes: &[u8], at: usize) -> usize {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
}

/// The numbers of one array of an `.npz` file: a zip archive of `.npy` files.
fn array(archive: &[u8], name: &str) -> Vec<u8> {
    let end = archive
        .windows(4)
        .rposition(|w| w == b"PK\x05\x06")
        .unwrap();
    let mut entry = u32_at(archive, end + 16);
    loop {
        assert_eq!(archive[entry..entry + 4], *b"PK\x01\x02", "{name}");
        let name_len = u16_at(archive, entry + 28);
        if archive[entry + 46..entry + 46 + name_len] == *format!("{name}.npy").as_bytes() {
            break;
        }
        entry += 46 + name_len + u16_at(archive, entry + 30) + u16_at(archive, entry + 32);
    }
    let (packed_len, local) = (u32_at(archive, entry + 20), u32_at(archive, entry + 42));
    let start = local + 30 + u16_at(archive, local + 26) + u16_at(archive, local + 28);
    let mut file = Vec::new();
    DeflateDecoder::new(&archive[start..start + packed_len])
        .read_to_end(&mut file)
        .unwrap();
    assert_eq!(file[..6], *b"\x93NUMPY");
    file[10 + u16_at(&file, 8)..].to_vec()
}

/// One point of the reference.
struct Expected {
    xyz: [f32; 3],
    intensity: u8,
    ring: u16,
    echo: Echo,
}

fn reference(path: &Path) -> Vec<Expected> {
    let archive = std::fs::read(path).unwrap();
    let floats = |name| -> Vec<f32> {
        let bytes = array(&archive, name);
        let (chunks, _) = bytes.as_chunks::<4>();
        chunks
            .iter()
            .map(|chunk| f32::from_le_bytes(*chunk))
            .collect()
    };
    let [x, y, z, intensity] = ["x", "y", "z", "intensity"].map(floats);
    let ring = array(&archive, "ring");
    let return_type = array(&archive, "return_type");
    (0..x.len())
        .map(|i| Expected {
            xyz: [x[i], y[i], z[i]],
            intensity: intensity[i] as u8,
            ring: ring[i].into(),
            echo: Echo::from_code(return_type[i]),
        })
        .collect()
}

fn decode(packets: &[Packet]) -> Vec<LidarPoint> {
    let mut decoder = Decoder::new(DecoderConfig {
        optical_offset: OpticalOffset::Applied,
        ..DecoderConfig::default()
    });
    let mut points = Vec::new();
    for packet in packets {
        if let Some(scan) = decoder.push(packet).unwrap() {
            points.extend(scan.sample.points);
        }
    }
    while let Some(scan) = decoder.finish() {
        points.extend(scan.sample.points);
    }
    points
}

/// How near a point of ours must be.
#[derive(Clone, Copy)]
struct Tolerance {
    height_m: f32,
    azimuth_deg: f64,
}

/// Which of the points lie in packets with a gap.
fn in_gap(packets: &[Packet]) -> Vec<bool> {
    let mut in_gap = Vec::new();
    for packet in packets {
        let packet = DataPacket::new(&packet.bytes).unwrap();
        let model = Product::from_code(packet.product_code()).model().unwrap();
        let mode = returns_of_code(packet.return_mode_code()).unwrap();
        let layout = PacketLayout::new(&packet, model, mode);
        let count = returns(&packet, &layout).count();
        in_gap.extend(vec![layout.gap().is_some(); count]);
    }
    in_gap
}

/// Every point of the reference is one of ours: same ring, same echo, same intensity, same height and range, near in azimuth.
fn assert_same(name: &str, packets: &[Packet], expected: &[Expected], tolerance: Tolerance) {
    const WINDOW: usize = 64;
    let (ours, in_gap) = (decode(packets), in_gap(packets));
    assert_eq!(ours.len(), expected.len(), "{name}");
    let mut used = vec![false; ours.len()];
    let mut worst_deg = 0f64;
    for (i, e) in expected.iter().enumerate() {
        let off_deg = |p: &LidarPoint| {
            let bearing = |x: f32, y: f32| f64::from(y).atan2(f64::from(x)).to_degrees();
            let off = bearing(p.position_m[0], p.position_m[1]) - bearing(e.xyz[0], e.xyz[1]);
            (off + 180.0).rem_euclid(360.0) - 180.0
        };
        let range = |x: f32, y: f32| x.hypot(y);
        let is_it = |j: usize| {
            let p = &ours[j];
            let [x, y, z] = p.position_m;
            p.ring == e.ring
                && p.intensity == e.intensity
                && p.echo == e.echo
                && (z - e.xyz[2]).abs() <= tolerance.height_m * (1.0 + z.abs())
                && (range(x, y) - range(e.xyz[0], e.xyz[1])).abs() < 1e-4
                && (in_gap[j] || off_deg(p).abs() <= tolerance.azimuth_deg)
        };
        let mut near = i.saturating_sub(WINDOW)..(i + WINDOW).min(ours.len());
        let found = near.find(|&j| !used[j] && is_it(j));
        let found = found.unwrap_or_else(|| {
            panic!(
                "{name}: point {i}: {:?} ring {} is none of ours",
                e.xyz, e.ring
            )
        });
        used[found] = true;
        if !in_gap[found] {
            worst_deg = worst_deg.max(off_deg(&ours[found]).abs());
        }
    }
    println!(
        "{name}: {} points, azimuth within {worst_deg:.4}°",
        expected.len()
    );
}

fn read(source: &mut dyn PacketSource) -> Vec<Packet> {
    let mut packets = Vec::new();
    loop {
        match source.recv(Duration::ZERO) {
            Ok(packet) => packets.extend(packet),
            Err(Error::EndOfStream { .. }) => return packets,
            Err(error) => panic!("{error}"),
        }
    }
}

#[test]
fn bags_decode_to_the_reference() {
    let test = "bags_decode_to_the_reference";
    let (Some(bags), Some(decodes)) = (
        data(test, "lidar/nebula_velodyne"),
        data(test, "lidar/reference_decodes"),
    ) else {
        return;
    };
    for (bag, scans, azimuth_deg) in [
        (
            "vlp32/1713492677464078412_0.db3",
            &[
                "vlp32c_msg0_1713492677464078412",
                "vlp32c_msg1_1713492677545368298",
                "vlp32c_msg2_1713492677630748420",
            ][..],
            0.03,
        ),
        (
            "vlp16/1673400471837873222_0.db3",
            &[
                "vlp16dual_msg0_1673400471837873222",
                "vlp16dual_msg1_1673400471937957440",
            ],
            0.03,
        ),
    ] {
        let mut bag = Rosbag2Source::open(&bags.join(bag)).unwrap();
        for name in scans {
            let message = bag.next_scan().unwrap().unwrap();
            let expected = reference(&decodes.join(format!("{name}.npz")));
            let tolerance = Tolerance {
                height_m: 2e-6,
                azimuth_deg,
            };
            assert_same(name, &message.packets, &expected, tolerance);
        }
    }
}

#[test]
fn captures_decode_to_the_reference() {
    let test = "captures_decode_to_the_reference";
    let (Some(captures), Some(decodes)) = (
        data(test, "lidar/mrpt"),
        data(test, "lidar/reference_decodes"),
    ) else {
        return;
    };
    for (name, scans, height_m) in [
        ("sample_velodyne_hdl32", 3, 1e-4),
        ("sample_velodyne_vlp16_gps", 4, 2e-6),
    ] {
        let path = captures.join(format!("{name}.pcap"));
        let packets = read(&mut PcapSource::open(&path, &[2368]).unwrap());
        // Its scans are cut elsewhere; together they are the whole file.
        let expected: Vec<Expected> = (0..scans)
            .flat_map(|scan| reference(&decodes.join(format!("{name}_scan{scan}.npz"))))
            .collect();
        let tolerance = Tolerance {
            height_m,
            azimuth_deg: 0.03,
        };
        assert_same(name, &packets, &expected, tolerance);
    }
}

#[test]
fn the_single_packet_of_an_old_sensor_is_read_where_the_model_is_forced() {
    let test = "the_single_packet_of_an_old_sensor_is_read_where_the_model_is_forced";
    let Some(path) = data(test, "lidar/gadomski_velodyne/single.pcap") else {
        return;
    };
    let packets = read(&mut PcapSource::open(&path, &[2368]).unwrap());
    assert_eq!(packets.len(), 1);
    let mut decoder = Decoder::new(DecoderConfig {
        model: ModelChoice::Force(Model::Vlp16, Returns::Strongest),
        ..DecoderConfig::default()
    });
    assert_eq!(decoder.push(&packets[0]), Ok(None));
    let scan = decoder.finish().unwrap();
    let bytes = &packets[0].bytes;
    let filled = (0..12 * 32)
        .filter(|i| u16_at(bytes, 4 + 100 * (i / 32) + 3 * (i % 32)) > 0)
        .count();
    assert_eq!(scan.sample.points.len(), filled);
}
