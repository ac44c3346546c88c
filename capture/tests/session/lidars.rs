//! LiDARs recorded by name, and datagrams that are lost or strange.

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
        notes.contains("300 packets of 127.0.0.2 were kept out: another LiDAR"),
        "{notes}"
    );
    // Nobody chose which of the two counts.
    let lidar = stream(&report, "lidar");
    assert_eq!((lidar.kept_out, lidar.lost()), (300, 300), "{report:?}");
    let notes = stream(&report, "lidar_rear").notes.join("\n");
    assert!(
        notes.contains("VLP-32C at 127.0.0.2") && !notes.contains("kept out"),
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
