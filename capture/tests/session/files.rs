//! What goes into a recording from elsewhere: remarks, and the files of others.

use super::*;

#[test]
fn remarks_go_into_the_recording_that_runs() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(Some(2_000), &[]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let mut session = Session::open(&config).unwrap();
    let remarks = session.remarks();
    let time = Timestamp::from_nanos(START_NS + 5);
    let made = Remark {
        kind: "note".to_owned(),
        text: "Tür war offen".to_owned(),
        position_in_world_m: Some([1.0, 2.0, 3.0]),
    };
    remarks.put(time, time + 7, made.clone()).unwrap();
    let out = folder.path().join("scan.mcap");
    run(session, &out);
    imu.thread.join().unwrap();
    let recording = Recording::open(&out).unwrap();
    let found: Vec<_> = recording
        .messages(REMARKS)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(found.len(), 1);
    assert_eq!((found[0].time, found[0].arrival), (time, time + 7));
    assert_eq!(decode_remark(&found[0].bytes), Ok(made.clone()));
    let late = remarks.put(time, time, made).unwrap_err().to_string();
    assert!(late.contains("has ended"), "{late}");
}

/// A `velodyne_msgs/msg/VelodyneScan` as ROS serialises it.
fn velodyne_scan(packets: &[&Packet]) -> Vec<u8> {
    let stamp = |bytes: &mut Vec<u8>, time: Timestamp| {
        let (secs, nanos) = (time.nanos() / 1_000_000_000, time.nanos() % 1_000_000_000);
        bytes.extend((secs as u32).to_le_bytes());
        bytes.extend((nanos as u32).to_le_bytes());
    };
    let mut bytes = vec![0, 1, 0, 0];
    stamp(&mut bytes, packets[0].arrival);
    bytes.extend(9_u32.to_le_bytes());
    bytes.extend(b"velodyne\0\0\0\0");
    bytes.extend((packets.len() as u32).to_le_bytes());
    for packet in packets {
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        stamp(&mut bytes, packet.arrival);
        bytes.extend(&packet.bytes);
    }
    bytes
}

/// The packets of a rosbag2 MCAP and of a recording of ours go through the functions used live.
#[test]
fn packets_in_mcap_files_become_the_same_recording() {
    const PACKETS: u64 = 1_000;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let small = WriterConfig {
        chunk_bytes: 100_000,
        ..WriterConfig::default()
    };
    let mut ours = Writer::create(&at("ours.mcap"), &small).unwrap();
    let mut theirs = Writer::create(&at("theirs.mcap"), &WriterConfig::default()).unwrap();
    // Recordings of ours before the packets' own type.
    let mut older = Writer::create(&at("older.mcap"), &WriterConfig::default()).unwrap();
    let arrived = |n: u64, bytes: Vec<u8>| Packet {
        arrival: Timestamp::from_nanos(START_NS + (n * 663_552) as i64 + 300_000),
        bytes,
    };
    let position = arrived(0, mock::position_packet(0));
    let time = position.arrival;
    ours.write_raw(LIDAR_POSITION, 0, 0, &position, time)
        .unwrap();
    for first in (0..PACKETS).step_by(100) {
        let packets: Vec<Packet> = (first..first + 100)
            .map(|n| arrived(n, mock::lidar_packet(n)))
            .collect();
        ours.write_lidar_packets("lidar", packets[0].arrival, &packets)
            .unwrap();
    }
    ours.finish().unwrap();
    let recording = Recording::open(&at("ours.mcap")).unwrap();
    for (topic, mcap) in [
        ("/velodyne_packets", &mut theirs),
        ("/lidar/packets", &mut older),
    ] {
        let channel = Channel {
            topic,
            schema_name: "velodyne_msgs/msg/VelodyneScan",
            schema_text: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
        };
        let packets: Vec<_> = recording
            .lidar_packets()
            .unwrap()
            .map(Result::unwrap)
            .collect();
        for packets in packets.chunks(100) {
            let (first, last) = (&packets[0], &packets[packets.len() - 1]);
            let packets: Vec<_> = packets.iter().map(|p| &p.packet).collect();
            mcap.write_cdr(
                &channel,
                first.time,
                last.packet.arrival,
                &velodyne_scan(&packets),
            )
            .unwrap();
        }
    }
    older
        .write_raw(LIDAR_POSITION, 0, 0, &position, position.arrival)
        .unwrap();
    older.finish().unwrap();
    theirs.finish().unwrap();
    for (name, positions) in [("ours.mcap", 1), ("older.mcap", 1), ("theirs.mcap", 0)] {
        let out = at(&format!("again-{name}"));
        let config = ReplayConfig::default();
        let report = replay_recording(&at(name), &config, &out, &no_progress).unwrap();
        assert_eq!(report.lost, 0, "{report:?}");
        assert_eq!(stream(&report, "lidar").received, PACKETS + positions);
        let again = Recording::open(&out).unwrap();
        let packets = again.packets("lidar/packets").unwrap().map(Result::unwrap);
        assert_eq!(packets.count() as u64, PACKETS);
        for (packet, n) in again.lidar_packets().unwrap().map(Result::unwrap).zip(0..) {
            assert_eq!(
                packet.packet,
                arrived(n, mock::lidar_packet(n)),
                "{name} {n}"
            );
        }
        let scans: Vec<_> = again.scans().unwrap().map(Result::unwrap).collect();
        assert_eq!(scans.len(), 7, "{name}");
        // By its pulse, or fitted to arrivals that are 0.3 ms late.
        let late_ns = scans[0].time.nanos() - START_NS;
        let expected = if positions > 0 {
            0..56_000
        } else {
            250_000..356_000
        };
        assert!(expected.contains(&late_ns), "{name}: {late_ns}");
    }
    // A damaged chunk in the middle, and a file that was cut off, lack something, and what lies behind it is there.
    let whole = std::fs::read(at("ours.mcap")).unwrap();
    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 50].fill(0x55);
    let cut = &whole[..whole.len() * 2 / 3];
    for (name, bytes) in [("damaged", &damaged[..]), ("cut", cut)] {
        let path = at(&format!("{name}.mcap"));
        std::fs::write(&path, bytes).unwrap();
        let out = at(&format!("again-{name}.mcap"));
        let report = replay_recording(&path, &ReplayConfig::default(), &out, &no_progress).unwrap();
        let lidar = stream(&report, "lidar");
        assert!(lidar.bad > 0 && report.lost > 0, "{name}: {report:?}");
        let told = lidar.notes.iter().any(|note| note.contains("damaged"));
        assert!(told, "{name}: {lidar:?}");
        let again = Recording::open(&out).unwrap();
        let packets = again.lidar_packets().unwrap().map(Result::unwrap);
        let arrivals: Vec<_> = packets.map(|p| p.packet.arrival).collect();
        let last = arrived(PACKETS - 1, Vec::new()).arrival;
        assert!(arrivals.len() > 300, "{name}: {}", arrivals.len());
        assert!(arrivals.len() < PACKETS as usize, "{name}");
        assert_eq!(arrivals.last() == Some(&last), name == "damaged", "{name}");
        if name == "damaged" {
            assert!(lidar.missing > 0, "{lidar:?}");
        }
    }
    let empty = at("empty.mcap");
    Writer::create(&empty, &WriterConfig::default())
        .unwrap()
        .finish()
        .unwrap();
    let config = ReplayConfig::default();
    let error = replay_recording(&empty, &config, &at("x"), &no_progress);
    let message = error.unwrap_err().to_string();
    assert!(message.contains("LiDAR packets"), "{message}");
}
