//! Devices that go on sending and say nothing new: naively every one of them is healthy, as nothing is missing.

use lsfb_capture::{Incoming, record_incoming};
use lsfb_drivers::mynt_s::wire::{TimeSource, Trailer, emit_frame};
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_drivers::velodyne::wire::DataPacket;
use lsfb_drivers::xsens::model::message;
use lsfb_drivers::xsens::wire::{Item, Message, Vector};

use super::*;

/// How long each of them is recorded.
const SECS: u64 = 4;

fn packet(at_ns: u64, bytes: Vec<u8>) -> Packet {
    Packet {
        arrival: Timestamp::from_nanos(START_NS + at_ns.cast_signed()),
        bytes,
    }
}

fn record(incoming: impl Iterator<Item = Incoming>, devices: DevicesConfig) -> CaptureReport {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    record_incoming(incoming, &devices, &out, &no_progress).unwrap()
}

/// Four seconds of a LiDAR.
fn lidar(bytes: impl Fn(u64) -> Vec<u8>) -> CaptureReport {
    lidar_of(SECS * 1_000, bytes)
}

fn lidar_of(millis: u64, bytes: impl Fn(u64) -> Vec<u8>) -> CaptureReport {
    const PERIOD_NS: u64 = 663_552;
    let packets = (0..millis * 1_000_000 / PERIOD_NS).map(|n| Incoming::Lidar {
        lidar: 0,
        packet: packet(n * PERIOD_NS, bytes(n)),
    });
    let devices = DevicesConfig {
        lidars: vec![LidarNetConfig::default()],
        ..anywhere()
    };
    record(packets, devices)
}

fn assert_stale(report: &CaptureReport, name: &str, word: &str) {
    let found = stream(report, name);
    assert_eq!((found.stale, report.lost), (1, 1), "{found:?}");
    let notes = found.notes.join("\n");
    assert!(notes.contains(word), "{notes}");
}

#[test]
fn a_lidar_that_sees_nothing_is_not_healthy() {
    let blind = lidar(|n| {
        let mut packet = DataPacket::new(mock::lidar_packet(n)).unwrap();
        for block in 0..12 {
            (0..32).for_each(|channel| packet.set_return(block, channel, 0, 0));
        }
        packet.into_inner()
    });
    assert!(stream(&blind, "lidar").decoded > 30);
    assert_stale(&blind, "lidar", "without returns");
    assert_eq!(lidar(mock::lidar_packet).lost, 0);
}

/// Four seconds of a LiDAR of which some returns never come: by azimuth, 0.01°, and laser.
fn partly_blind(is_seen: impl Fn(u16, usize) -> bool) -> CaptureReport {
    partly_blind_of(SECS * 1_000, is_seen)
}

fn partly_blind_of(millis: u64, is_seen: impl Fn(u16, usize) -> bool) -> CaptureReport {
    lidar_of(millis, |n| {
        let mut packet = DataPacket::new(mock::lidar_packet(n)).unwrap();
        for block in 0..12 {
            let azimuth_centideg = packet.azimuth_centideg(block);
            let blind = (0..32).filter(|laser| !is_seen(azimuth_centideg, *laser));
            blind.for_each(|laser| packet.set_return(block, laser, 0, 0));
        }
        packet.into_inner()
    })
}

/// Once a scan like any other.
#[test]
fn a_lidar_of_which_most_lasers_are_dead_is_not_healthy() {
    let one_left = partly_blind(|_, laser| laser == 7);
    assert_stale(&one_left, "lidar", "31 of its 32 lasers have no returns");
    // What is left is of use: it is said, and nothing is lost.
    let one_dead = partly_blind(|_, laser| laser != 7);
    let notes = stream(&one_dead, "lidar").notes.join("\n");
    assert!(
        notes.contains("of 32, counted from below, has no returns"),
        "{notes}"
    );
    assert_eq!(one_dead.lost, 0);
    let covered = partly_blind(|azimuth, _| !(4_000..7_000).contains(&azimuth));
    let notes = stream(&covered, "lidar").notes.join("\n");
    assert!(notes.contains("no returns between 40° and 70°"), "{notes}");
    assert_eq!(covered.lost, 0);
}

/// A capture of three turns has neither twenty scans nor a second: each of these was recorded with nothing lost.
#[test]
fn a_short_recording_of_a_lidar_that_is_dead_is_not_healthy() {
    const MILLIS: u64 = 300;
    let one_left = partly_blind_of(MILLIS, |_, laser| laser == 7);
    assert_stale(&one_left, "lidar", "31 of its 32 lasers have no returns");
    let blind = partly_blind_of(MILLIS, |_, _| false);
    assert_stale(&blind, "lidar", "none with any returns");
    let stands = lidar_of(MILLIS, |n| mock::lidar_packet(n.min(5)));
    assert_stale(&stands, "lidar", "the sensor's clock is stuck");
    let still = lidar_of(400, |n| with_azimuths(n, |_| 10_000));
    assert_stale(&still, "lidar", "1 scans longer than a turn of the rotor");
    let good = lidar_of(MILLIS, mock::lidar_packet);
    assert_eq!(good.lost, 0, "{good:?}");
}

/// A packet whose rotor trembles about where packet `last` was sent: its blocks turn forward, and the next packet's do so again.
fn trembling_after(last: u64, n: u64) -> Vec<u8> {
    with_azimuths(n, |block| block_azimuth(last.min(n), block))
}

fn block_azimuth(n: u64, block: usize) -> u16 {
    DataPacket::new(mock::lidar_packet(n))
        .unwrap()
        .azimuth_centideg(block)
}

/// Packet `n`, its time as it was, with other azimuths.
fn with_azimuths(n: u64, azimuth_centideg: impl Fn(usize) -> u16) -> Vec<u8> {
    let mut packet = DataPacket::new(mock::lidar_packet(n)).unwrap();
    (0..12).for_each(|block| packet.set_azimuth_centideg(block, azimuth_centideg(block)));
    packet.into_inner()
}

/// Two halves of a capture in the wrong order, and one in which the host's clock was set.
#[test]
fn arrivals_that_go_back_are_told() {
    const PERIOD_NS: u64 = 663_552;
    for at_ns in [
        |n: u64| (n + 600) % 1_200 * PERIOD_NS,
        |n: u64| n * PERIOD_NS + if n < 600 { 3_600_000_000_000 } else { 0 },
    ] {
        let packets = (0..1_200).map(|n| Incoming::Lidar {
            lidar: 0,
            packet: packet(at_ns(n), mock::lidar_packet(n)),
        });
        let devices = DevicesConfig {
            lidars: vec![LidarNetConfig::default()],
            ..anywhere()
        };
        let report = record(packets, devices);
        let notes = stream(&report, "lidar").notes.join("\n");
        assert!(
            notes.contains("arrivals of its packets go back once"),
            "{notes}"
        );
    }
}

/// Packets of two models, one after the other: each pair of them looked like scans, fifteen hundred a second, and nothing was lost.
#[test]
fn packets_of_two_models_from_one_address_are_of_two_sensors() {
    let mixed = lidar(|n| {
        let mut bytes = mock::lidar_packet(n);
        if n % 2 == 1 {
            // A VLP-16's factory byte.
            *bytes.last_mut().unwrap() = 0x22;
        }
        bytes
    });
    let found = stream(&mixed, "lidar");
    assert!(
        matches!(&found.ending, Ending::Lost(why) if why.contains("two sensors")),
        "{found:?}"
    );
    assert!(mixed.lost > 0);
}

/// The same packet again and again is a repetition to be left out, and nothing else comes.
#[test]
fn a_lidar_whose_packets_make_no_scan_is_not_healthy() {
    let stuck = lidar(|n| mock::lidar_packet(n.min(300)));
    assert_stale(&stuck, "lidar", "without a complete scan");
    let all_zeros = lidar(|_| vec![0; 1206]);
    assert!(all_zeros.lost > 5_000, "{all_zeros:?}");
}

/// Once healthy: packets come at their rate with new times, and the azimuths that jump back make each of them look like a scan.
#[test]
fn a_lidar_whose_rotor_stands_is_not_healthy() {
    let stands = lidar(|n| trembling_after(300, n));
    assert_stale(&stands, "lidar", "without a complete scan");
    // At one angle: what is cut for its length comes three times a second, and looked like turns.
    let still = lidar(|n| {
        with_azimuths(n, |block| {
            if n < 1_500 {
                block_azimuth(n, block)
            } else {
                10_000
            }
        })
    });
    assert_stale(&still, "lidar", "without a complete scan");
}

/// Frames of a unit at 20 Hz, whose number and stamps go on while its pixels are those of `image`.
fn camera(image: impl Fn(u64) -> u8) -> CaptureReport {
    pair(|n| [image(n); 2])
}

/// The same, each camera with its own.
fn pair(grey: impl Fn(u64) -> [u8; 2]) -> CaptureReport {
    const PERIOD_NS: u64 = 50_000_000;
    let frames = (0..SECS * 20).map(|n| {
        let trailer = Trailer {
            time_source: TimeSource::External,
            frame_id: n as u16,
            timestamp_us: (START_NS.cast_unsigned() + n * PERIOD_NS) / 1_000,
            exposure_steps: 10,
            checksum: 0,
        };
        let format = FrameFormat {
            width: 64,
            height: 4,
        };
        let (mut bytes, [left, right]) = (Vec::new(), grey(n));
        let images: [&[u8]; 2] = [&[left; 128], &[right; 128]];
        emit_frame(format, &images, &trailer.with_checksum(), &mut bytes).unwrap();
        Incoming::Frame {
            unit: 0,
            packet: packet(n * PERIOD_NS, bytes),
        }
    });
    let devices = DevicesConfig {
        cameras: vec![CameraUnitConfig {
            frame_px: [64, 4],
            rate_hz: 20,
            ..unit(Path::new(""), ["cam0", "cam1"])
        }],
        ..anywhere()
    };
    record(frames, devices)
}

#[test]
fn a_camera_that_repeats_an_image_is_not_healthy() {
    assert_eq!(camera(|n| n as u8).lost, 0);
    assert_stale(&camera(|n| n.min(30) as u8), "cam0+cam1", "the same image");
    // A few repetitions are a dropped frame somewhere in the unit.
    assert_eq!(camera(|n| (n / 4) as u8).lost, 0);
}

/// The other camera of its unit went on, and hid it.
#[test]
fn one_camera_of_a_pair_that_is_frozen_or_capped_is_not_healthy() {
    let frozen = pair(|n| [20 + n as u8, 20 + n.min(30) as u8]);
    assert_stale(&frozen, "cam0+cam1", "the same image");
    let capped = pair(|n| [20 + n as u8, n as u8 % 3]);
    let notes = stream(&capped, "cam0+cam1").notes.join("\n");
    assert!(notes.contains("80 images of cam1 are black"), "{notes}");
    assert!(!notes.contains("cam0 are black"), "{notes}");
}

/// Samples at 200 Hz whose counters go on while what they measure is that of `measured`.
fn imu(measured: impl Fn(u64) -> f64) -> CaptureReport {
    const PERIOD_NS: u64 = 5_000_000;
    let packets = (0..SECS * 200).map(|n| {
        let items = [
            Item::PacketCounter(n as u16),
            Item::SampleTimeFine(50 * n as u32),
            Item::Acceleration(Vector::single([0.0, 0.0, 9.8125])),
            Item::RateOfTurn(Vector::single([0.0, 0.5, measured(n)])),
        ];
        let (mut data, mut bytes) = (Vec::new(), Vec::new());
        items.iter().for_each(|item| item.emit(&mut data).unwrap());
        let message = Message {
            id: message::MT_DATA2,
            data: &data,
        };
        message.emit(&mut bytes).unwrap();
        Incoming::Imu {
            imu: 0,
            packet: packet(n * PERIOD_NS, bytes),
        }
    });
    let devices = DevicesConfig {
        imus: vec![line(Path::new(""))],
        ..anywhere()
    };
    record(packets, devices)
}

#[test]
fn an_imu_whose_values_are_frozen_is_not_healthy() {
    assert_eq!(imu(|n| n as f64).lost, 0);
    assert_stale(&imu(|n| n.min(300) as f64), "imu0", "the same sample");
}
