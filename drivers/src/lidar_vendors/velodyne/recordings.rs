//! The Velodyne driver on recordings made by others.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::time::Duration;

use crate::Error;
use crate::lidar::Counters;
use crate::lidar_vendors::velodyne::model::{Model, Product};
use crate::lidar_vendors::velodyne::nmea::Rmc;
use crate::lidar_vendors::velodyne::wire::{
    DataPacket, PositionPacket, PpsStatus, Returns, identify, returns_of_code,
};
use crate::lidar_vendors::velodyne::{
    DecodeError, Decoder, DecoderConfig, ModelChoice, OpticalOffset, PacketLayout, returns,
};
use crate::transport::PacketSource;
use crate::transport::pcap::PcapSource;
use crate::transport::rosbag2::Rosbag2Source;
use lsfb_tests::recordings;
use lsfb_types::{LidarPoint, LidarScan, Packet};

struct DecodedAll {
    scans: Vec<LidarScan>,
    counters: Counters,
}

fn decode(config: DecoderConfig, packets: &[Packet]) -> DecodedAll {
    let mut decoder = Decoder::new(config);
    let mut scans = Vec::new();
    for packet in packets {
        scans.extend(decoder.push(packet).unwrap().map(|scan| scan.sample));
    }
    while let Some(scan) = decoder.finish() {
        scans.push(scan.sample);
    }
    DecodedAll {
        scans,
        counters: *decoder.counters(),
    }
}

fn read(source: &mut dyn PacketSource) -> Vec<Packet> {
    let mut packets = Vec::new();
    loop {
        match source.recv(Duration::ZERO) {
            Ok(Some(packet)) => packets.push(packet),
            Ok(None) => panic!("a file never has to wait"),
            Err(Error::EndOfStream { .. }) => return packets,
            Err(error) => panic!("{error}"),
        }
    }
}

fn messages(path: &std::path::Path) -> Vec<Vec<Packet>> {
    let mut bag = Rosbag2Source::open(path).unwrap();
    std::iter::from_fn(|| bag.next_scan().unwrap())
        .map(|scan| scan.packets)
        .collect()
}

/// The records of a binary PCD file, each `stride` bytes.
fn pcd_records(path: &std::path::Path, stride: usize) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(path).unwrap();
    let marker = b"DATA binary\n";
    let start = bytes
        .windows(marker.len())
        .position(|w| w == marker)
        .unwrap()
        + marker.len();
    bytes[start..]
        .chunks_exact(stride)
        .map(<[u8]>::to_vec)
        .collect()
}

fn f32_at(record: &[u8], offset: usize) -> f32 {
    f32::from_le_bytes(record[offset..offset + 4].try_into().unwrap())
}

fn range_m(p: [f32; 3]) -> f64 {
    p.map(|v| f64::from(v).powi(2)).iter().sum::<f64>().sqrt()
}

fn ring_of(model: Model, p: [f32; 3]) -> u16 {
    let elevation = (f64::from(p[2]) / range_m(p)).asin().to_degrees();
    let off = |e: f64| (e - elevation).abs();
    let channels = model.table().channels;
    let nearest = channels
        .iter()
        .min_by(|a, b| off(a.elevation_deg).total_cmp(&off(b.elevation_deg)))
        .unwrap();
    assert!(off(nearest.elevation_deg) < 0.01, "no beam at {elevation}°");
    nearest.ring
}

/// Degrees counter-clockwise from x.
fn bearing_deg(p: [f32; 3]) -> f64 {
    f64::from(p[1]).atan2(f64::from(p[0])).to_degrees()
}

fn angle_between_deg(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(360.0);
    d.min(360.0 - d)
}

/// Pairs every expected position with one point of ours: same ring, same raw range, near azimuth.
///
/// Both lists are in the order of firing, but for the two echoes of a firing.
fn assert_same_points(model: Model, ours: &[LidarPoint], expected: &[[f32; 3]], azimuth_deg: f64) {
    const WINDOW: usize = 64;
    let unit_m = f64::from(model.table().distance_unit_mm) / 1000.0;
    assert_eq!(ours.len(), expected.len());
    let key = |p: [f32; 3]| {
        let raw = range_m(p) / unit_m;
        assert!((raw - raw.round()).abs() < 0.02, "{raw} is off the grid");
        (ring_of(model, p), raw.round() as u32)
    };
    let keys: Vec<(u16, u32)> = ours.iter().map(|p| key(p.position_m)).collect();
    assert!(ours.iter().zip(&keys).all(|(p, key)| p.ring == key.0));
    let mut used = vec![false; ours.len()];
    let mut worst_deg = 0f64;
    for (i, e) in expected.iter().enumerate() {
        let off_deg =
            |j: usize| angle_between_deg(bearing_deg(ours[j].position_m), bearing_deg(*e));
        let found = (i.saturating_sub(WINDOW)..(i + WINDOW).min(ours.len()))
            .find(|j| !used[*j] && keys[*j] == key(*e) && off_deg(*j) < azimuth_deg)
            .unwrap_or_else(|| panic!("no point of ours is the expected {e:?}"));
        used[found] = true;
        worst_deg = worst_deg.max(off_deg(found));
    }
    println!(
        "{} points, worst azimuth difference {worst_deg:.4}°",
        expected.len()
    );
}

/// Decoded points whose block has an encoder angle that `keep` accepts.
fn points_by_encoder(
    config: DecoderConfig,
    model: Model,
    packets: &[Packet],
    keep: impl Fn(usize, u16) -> bool,
) -> Vec<LidarPoint> {
    let mut encoder = Vec::new();
    let mut raw = Vec::new();
    for (index, packet) in packets.iter().enumerate() {
        let packet = DataPacket::new(&packet.bytes).unwrap();
        let mode = returns_of_code(packet.return_mode_code()).unwrap();
        let layout = PacketLayout::new(&packet, model, mode);
        encoder.extend(
            returns(&packet, &layout).map(|hit| (index, packet.azimuth_centideg(hit.block))),
        );
        raw.extend(returns(&packet, &layout));
    }
    let points: Vec<LidarPoint> = decode(config, packets)
        .scans
        .into_iter()
        .flat_map(|scan| scan.points)
        .collect();
    assert_eq!(points.len(), encoder.len());
    let unit_m = f64::from(model.table().distance_unit_mm) / 1000.0;
    for (point, hit) in points.iter().zip(&raw) {
        assert_eq!((point.ring, point.intensity), (hit.ring, hit.reflectivity));
        assert!((range_m(point.position_m) - f64::from(hit.range_raw) * unit_m).abs() < 1e-5);
        let bearing = -f64::from(hit.azimuth_centideg) / 100.0;
        assert!(angle_between_deg(bearing_deg(point.position_m), bearing) < 1e-3);
    }
    points
        .into_iter()
        .zip(encoder)
        .filter(|(_, (packet, azimuth))| keep(*packet, *azimuth))
        .map(|(point, _)| point)
        .collect()
}

/// Points in the first 1, 2, … packets.
fn running_counts(model: Model, packets: &[Packet]) -> Vec<usize> {
    let mut total = 0;
    let count = |packet: &Packet| {
        let packet = DataPacket::new(&packet.bytes).unwrap();
        total += returns(
            &packet,
            &PacketLayout::new(&packet, model, Returns::Strongest),
        )
        .count();
        total
    };
    packets.iter().map(count).collect()
}

#[test]
fn vlp32c_bag_equals_its_cloud_and_the_reference_counts() {
    let name = "vlp32c_bag_equals_its_cloud_and_the_reference_counts";
    let Some(folder) = recordings(name, "lidar/nebula_velodyne/vlp32") else {
        return;
    };
    let messages = messages(&folder.join("1713492677464078412_0.db3"));
    let config = DecoderConfig {
        model: ModelChoice::Expect(Model::Vlp32c),
        cut_azimuth_centideg: 18_000,
        ..DecoderConfig::default()
    };
    let expected: Vec<[f32; 3]> = pcd_records(&folder.join("1713492677464078412.pcd"), 12)
        .iter()
        .map(|r| [f32_at(r, 0), f32_at(r, 4), f32_at(r, 8)])
        .collect();
    assert_eq!(expected.len(), 26_216);
    // The cloud was made with the window 270°–90°; the sensor fired a little beyond it.
    let in_window = |_, azimuth: u16| azimuth <= 9_000 || azimuth >= 27_000;
    let ours = points_by_encoder(config, Model::Vlp32c, &messages[0], in_window);
    assert_same_points(Model::Vlp32c, &ours, &expected, 0.15);

    // reference_decodes/vlp32c_msg{0,1,2}, and all of the five messages in one stream.
    for (message, count) in messages.iter().zip([26_330, 26_331, 26_317]) {
        let decoded = decode(config, message);
        assert_eq!(
            decoded
                .scans
                .iter()
                .map(|scan| scan.points.len())
                .sum::<usize>(),
            count
        );
        assert_eq!(decoded.counters.points, count as u64);
    }
    let all = decode(config, &messages.concat());
    let expected = Counters {
        packets: 379,
        points: 131_305,
        scans: 6,
        azimuths: all.counters.azimuths,
        ..Counters::default()
    };
    assert_eq!(all.counters, expected);
    // Twelve blocks a packet.
    let fired = all.counters.azimuths.fired;
    assert_eq!(fired.iter().sum::<u64>(), 12 * 379);
    // A turn at 600 rpm, half of it dark: the last firing is 50 ms after the first, the window's end included.
    for scan in &all.scans[1..5] {
        let last = scan.points.last().unwrap().time_offset_ns;
        assert!((49_000_000..51_500_000).contains(&last), "{last}");
        assert!(
            scan.points
                .windows(2)
                .all(|w| w[0].time_offset_ns <= w[1].time_offset_ns)
        );
    }
}

#[test]
fn vlp16_dual_bag_equals_its_cloud_and_the_reference_counts() {
    let name = "vlp16_dual_bag_equals_its_cloud_and_the_reference_counts";
    let Some(folder) = recordings(name, "lidar/nebula_velodyne/vlp16") else {
        return;
    };
    let messages = messages(&folder.join("1673400471837873222_0.db3"));
    let config = DecoderConfig::default();
    for (message, count) in messages.iter().zip([14_885, 14_845]) {
        assert_eq!(decode(config, message).counters.points, count);
    }
    let all = decode(config, &messages.concat());
    assert_eq!(
        (
            all.counters.packets,
            all.counters.lost,
            all.counters.malformed
        ),
        (603, 0, 0)
    );
    // The other decoder's revolution: from the wrap in the last packet of message 2 to 358.7° in message 3.
    let records = pcd_records(&folder.join("1673400472138016708.pcd"), 32);
    let expected: Vec<[f32; 3]> = records
        .iter()
        .map(|r| [f32_at(r, 0), f32_at(r, 4), f32_at(r, 8)])
        .collect();
    assert_eq!(expected.len(), 14_831);
    let mut revolution = vec![messages[2].last().unwrap().clone()];
    revolution.extend_from_slice(&messages[3][..150]);
    let ours = points_by_encoder(config, Model::Vlp16, &revolution, |packet, azimuth| {
        packet < 150 || azimuth == 35_865
    });
    // The other decoder leaves the rotor's motion out in the last blocks of a packet: up to 0.4° for the second firing.
    assert_same_points(Model::Vlp16, &ours, &expected, 0.45);
}

#[test]
fn hdl32e_pcap_counts_equal_the_reference() {
    let Some(path) = recordings(
        "hdl32e_pcap_counts_equal_the_reference",
        "lidar/mrpt/sample_velodyne_hdl32.pcap",
    ) else {
        return;
    };
    let packets = read(&mut PcapSource::open(&path, &[2368]).unwrap());
    assert_eq!(packets.len(), 500);
    assert_eq!(packets[0].arrival.nanos(), 1_319_768_048_284_089_000);
    let decoded = decode(
        DecoderConfig {
            cut_azimuth_centideg: 22_251,
            ..DecoderConfig::default()
        },
        &packets,
    );
    let running = running_counts(Model::Hdl32e, &packets);
    for end in [58_169, 58_169 + 58_078, 146_705] {
        assert!(running.contains(&end), "{end}");
    }
    // reference_decodes/sample_velodyne_hdl32_scan{0,1,2}: 58169 + 58078 + 30458, cut at whole packets.
    let expected = Counters {
        packets: 500,
        points: 146_705,
        scans: 3,
        azimuths: decoded.counters.azimuths,
        ..Counters::default()
    };
    assert_eq!(decoded.counters, expected);
    // Twelve blocks a packet.
    let fired = decoded.counters.azimuths.fired;
    assert_eq!(fired.iter().sum::<u64>(), 12 * 500);
}

#[test]
fn vlp16_pcap_with_gps_is_read_whole() {
    let Some(path) = recordings(
        "vlp16_pcap_with_gps_is_read_whole",
        "lidar/mrpt/sample_velodyne_vlp16_gps.pcap",
    ) else {
        return;
    };
    let packets = read(&mut PcapSource::open(&path, &[2368]).unwrap());
    assert_eq!(packets.len(), 293);
    let decoded = decode(
        DecoderConfig {
            cut_azimuth_centideg: 11_888,
            ..DecoderConfig::default()
        },
        &packets,
    );
    let running = running_counts(Model::Vlp16, &packets);
    for end in [18_790, 18_790 + 18_701, 18_790 + 18_701 + 18_678, 73_486] {
        assert!(running.contains(&end), "{end}");
    }
    // reference_decodes/sample_velodyne_vlp16_gps_scan{0..3}: 18790 + 18701 + 18678 + 17317, cut at whole packets.
    let expected = Counters {
        packets: 293,
        points: 73_486,
        scans: 4,
        azimuths: decoded.counters.azimuths,
        ..Counters::default()
    };
    assert_eq!(decoded.counters, expected);
    // Twelve blocks a packet.
    let fired = decoded.counters.azimuths.fired;
    assert_eq!(fired.iter().sum::<u64>(), 12 * 293);

    let positions = read(&mut PcapSource::open(&path, &[8308]).unwrap());
    assert_eq!(positions.len(), 57);
    let mut previous = 0;
    for packet in &positions {
        let position = PositionPacket::new(&packet.bytes).unwrap();
        assert_eq!(position.pps_status(), PpsStatus::Locked);
        assert!(position.timestamp_us() > previous);
        previous = position.timestamp_us();
        let rmc = Rmc::parse(position.nmea()).unwrap();
        assert!(rmc.valid);
        assert_eq!(
            (rmc.year, rmc.month, rmc.day, rmc.hour, rmc.minute),
            (2016, 1, 21, 8, 18)
        );
        // The sentence belongs to this second or the one before.
        let second = position.timestamp_us() / 1_000_000 % 60;
        assert!(
            (0..=1).contains(&(second as i32 - i32::from(rmc.second))),
            "{second} {}",
            rmc.second
        );
    }
    // Every frame of the file is one or the other.
    assert_eq!(read(&mut PcapSource::open(&path, &[]).unwrap()).len(), 350);
}

#[test]
fn position_packets_with_a_wrong_ip_length_are_read() {
    let Some(path) = recordings(
        "position_packets_with_a_wrong_ip_length_are_read",
        "lidar/gadomski_velodyne/position.pcap",
    ) else {
        return;
    };
    let packets = read(&mut PcapSource::open(&path, &[8308]).unwrap());
    assert_eq!(packets.len(), 1);
    let position = PositionPacket::new(&packets[0].bytes).unwrap();
    assert_eq!(position.timestamp_us(), 2_467_110_195);
    assert_eq!(position.pps_status(), PpsStatus::Locked);
    let rmc = Rmc::parse(position.nmea()).unwrap();
    assert_eq!(
        (rmc.hour, rmc.minute, rmc.second, rmc.mode),
        (21, 41, 6, Some('D'))
    );
}

#[test]
fn a_vlp16_that_claims_to_be_an_hdl32e_is_named() {
    let Some(path) = recordings(
        "a_vlp16_that_claims_to_be_an_hdl32e_is_named",
        "lidar/rust_lidar_utils/velodyne/velodyne_vlp16.pcap",
    ) else {
        return;
    };
    let packets = read(&mut PcapSource::open(&path, &[2368]).unwrap());
    assert_eq!(packets.len(), 84);
    let mut decoder = Decoder::new(DecoderConfig::default());
    let mut refused = 0;
    for packet in &packets {
        match decoder.push(packet) {
            Ok(scan) => assert_eq!(scan, None),
            Err(error) => {
                assert_eq!(
                    error,
                    DecodeError::WrongBytes {
                        declared: Model::Hdl32e,
                        looks_like: Model::Vlp16
                    }
                );
                refused += 1;
            }
        }
    }
    assert_eq!(
        (refused, decoder.counters().refused, decoder.counters().lost),
        (76, 76, 0)
    );
    assert_eq!(decoder.finish(), None);

    let model = ModelChoice::Force(Model::Vlp16, Returns::Strongest);
    let forced = decode(
        DecoderConfig {
            model,
            ..DecoderConfig::default()
        },
        &packets,
    );
    assert_eq!((forced.counters.packets, forced.counters.lost), (84, 0));
}

fn vector(test: &str, name: &str) -> Option<Vec<u8>> {
    let path = recordings(test, &format!("../protocols/vectors/real/{name}"))?;
    Some(std::fs::read(path).unwrap())
}

fn azimuths(packet: &DataPacket<Vec<u8>>) -> [u16; 12] {
    std::array::from_fn(|block| packet.azimuth_centideg(block))
}

fn count(packet: &DataPacket<Vec<u8>>, model: Model, mode: Returns) -> usize {
    returns(packet, &PacketLayout::new(packet, model, mode)).count()
}

#[test]
fn single_real_packets_hold_what_was_read_by_hand() {
    let name = "single_real_packets_hold_what_was_read_by_hand";
    let Some(bytes) = vector(name, "nebula_vlp32c_strongest_pkt0.bin") else {
        return;
    };
    let packet = DataPacket::new(bytes).unwrap();
    assert_eq!(packet.timestamp_us(), 625_659_068);
    assert_eq!(
        (packet.return_mode_code(), packet.product_code()),
        (0x37, 0x28)
    );
    let expected = [
        27039, 27059, 27080, 27100, 27118, 27140, 27158, 27179, 27198, 27218, 27239, 27258,
    ];
    assert_eq!(azimuths(&packet), expected);
    assert_eq!(
        (packet.distance_raw(0, 0), packet.reflectivity(0, 0)),
        (189, 11)
    );
    assert_eq!(count(&packet, Model::Vlp32c, Returns::Strongest), 380);

    let Some(bytes) = vector(name, "nebula_vlp32c_fovgap_pkt75.bin") else {
        return;
    };
    let packet = DataPacket::new(bytes).unwrap();
    assert_eq!(packet.timestamp_us(), 625_708_834);
    let azimuth = azimuths(&packet);
    assert_eq!(
        (azimuth[0], &azimuth[7..]),
        (8956, &[9095, 27017, 27037, 27057, 27078][..])
    );
    let mut layout = PacketLayout::new(&packet, Model::Vlp32c, Returns::Strongest);
    assert_eq!(layout.gap(), Some((9095, 27017)));
    assert_eq!(returns(&packet, &layout).count(), 315);
    // The next packet of the recording starts 50 375 µs later: what follows the gap is timed back from it.
    let guess = layout.group_time_ns(8);
    layout.time_gap_from_next(50_375_000);
    assert_eq!(layout.group_time_ns(8), 50_375_000 - 4 * 55_296);
    assert_eq!(layout.group_time_ns(7), 7 * 55_296);
    assert!((guess - layout.group_time_ns(8)).abs() < 600_000, "{guess}");

    let Some(bytes) = vector(name, "nebula_vlp32c_wrap_pkt37.bin") else {
        return;
    };
    let packet = DataPacket::new(bytes).unwrap();
    assert_eq!(packet.timestamp_us(), 625_683_619);
    assert_eq!(
        (azimuths(&packet)[0], &azimuths(&packet)[6..9]),
        (35871, &[35991, 11, 31][..])
    );
    assert_eq!(count(&packet, Model::Vlp32c, Returns::Strongest), 350);
    assert_eq!(
        PacketLayout::new(&packet, Model::Vlp32c, Returns::Strongest).gap(),
        None
    );

    let Some(bytes) = vector(name, "nebula_vlp16_dual_pkt0.bin") else {
        return;
    };
    let packet = DataPacket::new(bytes).unwrap();
    assert_eq!(packet.timestamp_us(), 140_554_572);
    assert_eq!(
        (packet.return_mode_code(), packet.product_code()),
        (0x39, 0x22)
    );
    assert_eq!(
        azimuths(&packet),
        [66, 66, 105, 105, 145, 145, 185, 185, 225, 225, 265, 265]
    );
    let filled = (0..12)
        .flat_map(|b| (0..32).map(move |k| (b, k)))
        .filter(|(b, k)| packet.distance_raw(*b, *k) > 0);
    assert_eq!(filled.count(), 194);

    let Some(bytes) = vector(name, "nebula_vls128_pkt0.bin") else {
        return;
    };
    assert_eq!(identify(&bytes).unwrap(), Product::Vls128);
    let packet = Packet {
        arrival: lsfb_types::Timestamp::default(),
        bytes,
    };
    let error = Decoder::new(DecoderConfig::default())
        .push(&packet)
        .unwrap_err();
    assert_eq!(
        error,
        DecodeError::Unsupported {
            product: Product::Vls128
        }
    );
    assert!(error.to_string().contains("VLS-128"));

    let Some(bytes) = vector(name, "foxglove_hdl32e_pkt1.bin") else {
        return;
    };
    let packet = DataPacket::new(bytes.clone()).unwrap();
    assert_eq!(
        (packet.timestamp_us(), packet.azimuth_centideg(0)),
        (757_034_951, 22288)
    );
    assert_eq!(
        (packet.distance_raw(0, 0), packet.reflectivity(0, 0)),
        (1230, 9)
    );
    assert_eq!(
        (packet.distance_raw(0, 1), packet.reflectivity(0, 1)),
        (2537, 4)
    );
    assert_eq!(count(&packet, Model::Hdl32e, Returns::Strongest), 382);
    // Its repository expects point 0 at (-1.55048573, 1.43979204, -1.25482786) m.
    let config = DecoderConfig {
        optical_offset: OpticalOffset::Ignored,
        ..DecoderConfig::default()
    };
    let decoded = decode(
        config,
        &[Packet {
            arrival: lsfb_types::Timestamp::default(),
            bytes,
        }],
    );
    let p = decoded.scans[0].points[0].position_m;
    let expected = [-1.550_485_7, 1.439_792, -1.254_827_9];
    assert!(
        (0..3).all(|axis| (p[axis] - expected[axis]).abs() < 1e-4),
        "{p:?}"
    );
}
