//! LiDARs recorded by name, datagrams that are lost or strange, and what an operator is told of sensors that are not as they seem.

use lsfb_capture::health::{DeviceHealth, Level};
use lsfb_capture::{Incoming, record_incoming};
use lsfb_drivers::hesai;
use lsfb_drivers::velodyne::nmea::Rmc;
use lsfb_drivers::velodyne::wire::PositionPacket;
use lsfb_recording::HEALTH;
use lsfb_recording::message::decode_health_value;

use super::live::run_until;
use super::*;

/// Two LiDARs and two IMUs have topics of their own, and nobody else's packets come into a cloud.
#[test]
fn lidars_and_imus_are_recorded_by_name_and_strangers_kept_out() {
    let folder = tempfile::tempdir().unwrap();
    let imus = [mock::imu(Some(600), &[]), mock::imu(Some(300), &[])];
    let lidar = |name: &str| LidarNetConfig {
        name: name.to_owned(),
        data: LOOPBACK,
        position: LOOPBACK,
        ..LidarNetConfig::default()
    };
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        lidars: vec![lidar("lidar"), lidar("lidar_rear")],
        imus: vec![
            line(&imus[0].path),
            ImuLineConfig {
                name: "imu1".to_owned(),
                ..line(&imus[1].path)
            },
        ],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let addresses = session.lidar_addresses();
    let sensor = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let stranger = std::net::UdpSocket::bind("127.0.0.2:0").unwrap();
    for n in 0..300 {
        sensor
            .send_to(&mock::lidar_packet(n), addresses[0])
            .unwrap();
        // The same model, a third of a turn apart.
        stranger
            .send_to(&mock::lidar_packet(n + 50), addresses[0])
            .unwrap();
        stranger
            .send_to(&mock::lidar_packet(n + 20), addresses[2])
            .unwrap();
    }
    let out = folder.path().join("scan.mcap");
    let report = run(session, &out);
    imus.into_iter().for_each(|imu| imu.thread.join().unwrap());
    let notes = stream(&report, "lidar").notes.join("\n");
    assert!(
        notes.contains("VLP-32C at 127.0.0.1, returns: strongest"),
        "{notes}"
    );
    assert!(
        notes.contains("300 packets of 127.0.0.2 were rejected: another LiDAR"),
        "{notes}"
    );
    // Nobody chose which of the two counts.
    let lidar = stream(&report, "lidar");
    assert_eq!((lidar.kept_out, lidar.lost()), (300, 300), "{report:?}");
    let notes = stream(&report, "lidar_rear").notes.join("\n");
    assert!(
        notes.contains("VLP-32C at 127.0.0.2") && !notes.contains("rejected"),
        "{notes}"
    );
    assert_eq!(stream(&report, "imu1").decoded, 300);
    let recording = Recording::open(&out).unwrap();
    for (name, first) in [("lidar", 0), ("lidar_rear", 20)] {
        let packets = recording.packets(&format!("{name}/packets")).unwrap();
        let packets: Vec<_> = packets.map(|p| p.unwrap().packet.bytes).collect();
        assert_eq!(
            (packets.len(), &packets[0]),
            (300, &mock::lidar_packet(first)),
            "{name}"
        );
        assert!(recording.scans_of(name).unwrap().count() >= 2, "{name}");
    }
    assert_eq!(recording.main_lidar(), "lidar");
    assert_eq!(recording.imu().unwrap().count(), 600);
}

/// What a Hesai sensor sends about its GPS input was counted among what could not be read.
#[test]
fn packets_about_the_gps_input_of_a_hesai_are_recorded_and_no_loss() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    let model = hesai::Model::Xt32;
    let layout = model.layout();
    let data = |n: u32| {
        let mode = hesai::wire::ReturnMode::Strongest;
        let mut packet =
            hesai::wire::DataPacket::init(vec![0; layout.len + 4], model, mode).unwrap();
        for block in 0..layout.blocks {
            packet.set_azimuth_centideg(block, ((n as usize * 144 + block * 18) % 36_000) as u16);
            packet.set_return(block, 0, 1_000, 20);
        }
        packet.set_clock(&hesai::wire::Clock {
            date: [126, 3, 1],
            time: [10, 0, (n / 2_500) as u8],
            micros: n % 2_500 * 400,
        });
        packet.set_sequence(n);
        packet.into_inner()
    };
    let mut beside = vec![0; 512];
    beside[..2].copy_from_slice(&[0xFF, 0xEE]);
    let packets = (0..5_000).flat_map(|n| {
        let arrival = Timestamp::from_nanos(START_NS + i64::from(n) * 400_000);
        let position = (n % 2_500 == 0).then(|| beside.clone());
        let bytes = position.into_iter().chain([data(n)]);
        bytes.map(move |bytes| Incoming::Lidar {
            lidar: 0,
            packet: Packet { arrival, bytes },
        })
    });
    let config = DevicesConfig {
        lidars: vec![LidarNetConfig::default()],
        ..anywhere()
    };
    let report = record_incoming(packets, &config, &out, &no_progress).unwrap();
    let lidar = stream(&report, "lidar");
    assert_eq!((lidar.bad, lidar.missing), (0, 0), "{lidar:?}");
    assert!(lidar.decoded >= 19, "{lidar:?}");
    let recording = Recording::open(&out).unwrap();
    let kept = recording.packets(LIDAR_POSITION).unwrap();
    let kept: Vec<_> = kept.map(|p| p.unwrap().packet.bytes).collect();
    assert_eq!(kept, [beside.clone(), beside]);
}

#[test]
fn lost_and_strange_datagrams_are_counted_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(Some(600), &[]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        lidars: vec![lidar()],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let addresses = session.lidar_addresses();
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    socket
        .send_to(&mock::position_packet(0), addresses[1])
        .unwrap();
    for n in (0..400).filter(|n| !(100..103).contains(n)) {
        socket
            .send_to(&mock::lidar_packet(n), addresses[0])
            .unwrap();
    }
    socket.send_to(b"hello", addresses[0]).unwrap();
    let out = folder.path().join("scan.mcap");
    let report = run(session, &out);
    let lidar = stream(&report, "lidar");
    assert_eq!(
        (lidar.received, lidar.missing, lidar.bad),
        (399, 3, 1),
        "{report:?}"
    );
    assert!(
        lidar.first_bad.as_ref().unwrap().contains("5 bytes"),
        "{lidar:?}"
    );
    let recording = Recording::open(&out).unwrap();
    assert_eq!(recording.packets("lidar/packets").unwrap().count(), 397);
    let strange: Vec<_> = recording
        .packets("lidar")
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(strange[0].packet.bytes, b"hello");
}

/// Runs a session with one LiDAR, whose `packets` are sent in their own time, until something is said of it that `is_enough`; the report
/// and all that was said, on the screen and in the recording.
fn said_of_lidar(
    mut packets: impl FnMut(u64) -> Vec<(Port, Vec<u8>)> + Send + 'static,
    is_enough: impl Fn(&DeviceHealth) -> bool,
) -> (CaptureReport, DeviceHealth, Vec<(u8, String)>) {
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        lidars: vec![LidarNetConfig {
            data: LOOPBACK,
            position: LOOPBACK,
            ..LidarNetConfig::default()
        }],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let addresses = session.lidar_addresses();
    let feed = session.health();
    let snapshots = feed.subscribe();
    let done = std::sync::Arc::new(AtomicBool::new(false));
    let sender = mock::spawn("mock-lidar", {
        let done = done.clone();
        move || {
            let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
            let (began, mut n) = (Instant::now(), 0_u64);
            while !done.load(Ordering::Acquire) {
                let due_ns = began.elapsed().as_nanos() as u64;
                while n * PACKET_PERIOD_NS < due_ns {
                    for (port, bytes) in packets(n) {
                        socket.send_to(&bytes, addresses[port as usize]).unwrap();
                    }
                    n += 1;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    });
    let out = folder.path().join("scan.mcap");
    let mut enough = None;
    let report = run_until(session, &out, || {
        let devices = snapshots.try_iter().flat_map(|s| s.devices);
        enough = enough.take().or(devices.into_iter().find(|d| is_enough(d)));
        enough.is_some()
    });
    done.store(true, Ordering::Release);
    sender.join().unwrap();
    let recording = Recording::open(&out).unwrap();
    let recorded = recording.messages(&format!("{HEALTH}rate")).unwrap();
    let recorded = recorded.map(|m| decode_health_value(&m.unwrap().bytes).unwrap());
    let recorded = recorded
        .filter(|value| value.device == "lidar")
        .map(|value| (value.level, value.text));
    (report, enough.unwrap(), recorded.collect())
}

#[derive(Clone, Copy)]
enum Port {
    Data,
    Position,
}

/// Of a VLP-32C's data packets.
const PACKET_PERIOD_NS: u64 = 663_552;

/// Two sensors at their factory address: twice the packets of one, each of them sound. Naively "✓ lidar", and one cloud of both rooms.
#[test]
fn two_sensors_behind_one_address_are_an_alarm_while_they_are_recorded() {
    let (report, said, recorded) = said_of_lidar(
        |n| {
            [n, n + 50]
                .map(|n| (Port::Data, mock::lidar_packet(n)))
                .to_vec()
        },
        |lidar| lidar.problem.contains("two sensors"),
    );
    assert_eq!(said.level, Level::Error, "{said:?}");
    let is_recorded = |(level, text): &(u8, String)| {
        *level == Level::Error as u8 && text.contains("give each its own address")
    };
    assert!(recorded.iter().any(is_recorded), "{recorded:?}");
    let lidar = stream(&report, "lidar");
    assert!(
        matches!(&lidar.ending, Ending::Lost(why) if why.contains("two sensors")),
        "{lidar:?}"
    );
    assert!(report.lost > 0);
}

/// A receiver indoors: its sentences go on, without a fix. Naively "✓ lidar", its time by whatever the host's clock says.
#[test]
fn a_receiver_without_a_fix_is_said_on_the_screen_and_in_the_recording() {
    let without_fix = |n: u64| {
        let mut packet = PositionPacket::new(mock::position_packet((n * 664) as u32)).unwrap();
        let rmc = Rmc {
            hour: 10,
            valid: false,
            day: 1,
            month: 3,
            year: 2026,
            ..Rmc::default()
        };
        packet.set_nmea(rmc.emit().as_bytes()).unwrap();
        packet.into_inner()
    };
    let (report, said, recorded) = said_of_lidar(
        move |n| {
            let mut packets = vec![(Port::Data, mock::lidar_packet(n))];
            if n % 14 == 0 {
                packets.push((Port::Position, without_fix(n)));
            }
            packets
        },
        |lidar| lidar.problem.contains("GNSS"),
    );
    assert_eq!(said.level, Level::Warn, "{said:?}");
    assert!(
        said.problem.contains("UTC is not backed by GNSS"),
        "{said:?}"
    );
    let is_recorded =
        |(level, text): &(u8, String)| *level == Level::Warn as u8 && text.contains("GNSS");
    assert!(recorded.iter().any(is_recorded), "{recorded:?}");
    let notes = stream(&report, "lidar").notes.join("\n");
    assert!(
        notes.contains("1 times UTC was not backed by GNSS"),
        "{notes}"
    );
}
