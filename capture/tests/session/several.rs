//! Several LiDARs and IMUs in one recording: all of them are recorded, and none takes another's place.

use std::net::{IpAddr, Ipv4Addr, UdpSocket};

use lsfb_capture::{Incoming, record_incoming};

use super::live::run_until;
use super::*;

const PACKETS: u64 = 300;

fn packets(recording: &Recording, lidar: &str) -> Vec<Vec<u8>> {
    let packets = recording.packets(&format!("{lidar}/packets")).unwrap();
    packets.map(|p| p.unwrap().packet.bytes).collect()
}

/// Both sensors of a rig send to the factory ports: they are told apart by address, as the list of devices says.
#[test]
fn two_lidars_on_one_port_are_told_apart_by_address() {
    let folder = tempfile::tempdir().unwrap();
    // A free port, given back for the session to take.
    let free = || {
        UdpSocket::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
    };
    let (data, position) = (free(), free());
    let address = |last: u8| Ipv4Addr::new(127, 0, 0, last);
    let lidar = |name: &str, last: u8| LidarNetConfig {
        name: name.to_owned(),
        data,
        position,
        sensor: Some(IpAddr::V4(address(last))),
        ..LidarNetConfig::default()
    };
    let config = DevicesConfig {
        lidars: vec![lidar("lidar", 1), lidar("lidar_rear", 2)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    assert_eq!(session.lidar_addresses(), [data, position, data, position]);
    let snapshots = session.health().subscribe();
    let received = session.counts().lidar_packets;
    let sockets = [1, 2, 3].map(|last| UdpSocket::bind((address(last), 0)).unwrap());
    let mut shown = Vec::new();
    let mut sent = 0;
    let out = folder.path().join("scan.mcap");
    let report = run_until(session, &out, || {
        let until = (sent + 20).min(PACKETS);
        for n in sent..until {
            for (socket, offset) in sockets.iter().zip([0, 1_000, 2_000]) {
                let bytes = mock::lidar_packet(n + offset);
                socket.send_to(&bytes, data).unwrap();
            }
        }
        sent = until;
        shown.extend(snapshots.try_iter());
        received.load(Ordering::Relaxed) == 3 * PACKETS
    });
    shown.extend(snapshots.try_iter());
    for (name, offset) in [("lidar", 0), ("lidar_rear", 1_000)] {
        let found = stream(&report, name);
        assert_eq!((found.received, found.kept_out), (PACKETS, 0), "{found:?}");
        let recording = Recording::open(&out).unwrap();
        let expected: Vec<_> = (0..PACKETS)
            .map(|n| mock::lidar_packet(n + offset))
            .collect();
        assert!(packets(&recording, name) == expected, "{name}");
        assert!(recording.scans_of(name).unwrap().count() >= 2, "{name}");
    }
    // Whoever chose two of three has lost nothing by the third.
    let notes = stream(&report, "lidar").notes.join("\n");
    assert!(
        notes.contains("300 packets of 127.0.0.3 were rejected"),
        "{notes}"
    );
    let last = shown.last().expect("a snapshot");
    let names: Vec<_> = last.devices.iter().map(|d| d.name.as_str()).collect();
    assert_eq!(names, ["lidar", "lidar_rear"]);
}

/// Naively the first of each kind was recorded, and the others passed over without a word.
#[test]
fn what_several_devices_sent_is_recorded_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scan.mcap");
    let lidar = |name: &str| LidarNetConfig {
        name: name.to_owned(),
        ..LidarNetConfig::default()
    };
    let config = DevicesConfig {
        lidars: vec![
            lidar("lidar"),
            LidarNetConfig {
                data: LOOPBACK,
                position: LOOPBACK,
                ..lidar("lidar_rear")
            },
        ],
        ..anywhere()
    };
    let incoming = (0..PACKETS).flat_map(|n| {
        let arrival = Timestamp::from_nanos(START_NS + (n * 663_552).cast_signed());
        [0, 1].map(|lidar| Incoming::Lidar {
            lidar,
            packet: Packet {
                arrival,
                bytes: mock::lidar_packet(n + 1_000 * lidar as u64),
            },
        })
    });
    let report = record_incoming(incoming, &config, &out, &no_progress).unwrap();
    assert_eq!(report.lost, 0, "{report:?}");
    let recording = Recording::open(&out).unwrap();
    assert_eq!(packets(&recording, "lidar")[0], mock::lidar_packet(0));
    assert_eq!(
        packets(&recording, "lidar_rear")[0],
        mock::lidar_packet(1_000)
    );
}
