use super::*;

fn message(count: u32, packets: &[(i32, u32, u8)]) -> Vec<u8> {
    let mut body = Vec::new();
    body.extend(17i32.to_le_bytes());
    body.extend(5u32.to_le_bytes());
    body.extend(6u32.to_le_bytes());
    body.extend(b"lidar\0");
    body.resize(body.len().next_multiple_of(4), 0);
    body.extend(count.to_le_bytes());
    for (secs, nanos, fill) in packets {
        body.resize(body.len().next_multiple_of(4), 0);
        body.extend(secs.to_le_bytes());
        body.extend(nanos.to_le_bytes());
        body.extend([*fill; 1206]);
    }
    [&CDR_LITTLE_ENDIAN[..], &body].concat()
}

fn bag(messages: &[Vec<u8>]) -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().unwrap();
    let database = Connection::open(file.path()).unwrap();
    database
        .execute_batch(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,
                 serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);
             CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,
                 timestamp INTEGER NOT NULL, data BLOB NOT NULL);
             INSERT INTO topics VALUES (1,'/imu','sensor_msgs/msg/Imu','cdr','');
             INSERT INTO topics VALUES (2,'/packets','velodyne_msgs/msg/VelodyneScan','cdr','');
             INSERT INTO messages VALUES (1,1,50,x'00010000');",
        )
        .unwrap();
    for (n, data) in messages.iter().enumerate() {
        database
            .execute(
                "INSERT INTO messages VALUES (?1,2,?2,?3)",
                (n as i64 + 2, 1000 - n as i64, data),
            )
            .unwrap();
    }
    file
}

#[test]
fn scans_come_in_the_order_of_recording() {
    let file = bag(&[
        message(1, &[(3, 4, 0xAB)]),
        message(2, &[(1, 2, 1), (1, 9, 2)]),
    ]);
    let mut source = Rosbag2Source::open(file.path()).unwrap();
    let scan = source.next_scan().unwrap().unwrap();
    assert_eq!(
        (
            scan.recorded.nanos(),
            scan.stamp.nanos(),
            scan.frame_id.as_str()
        ),
        (999, 17_000_000_005, "lidar")
    );
    assert_eq!(
        scan.packets[0],
        Packet {
            arrival: Timestamp::from_nanos(1_000_000_002),
            bytes: vec![1; 1206]
        }
    );
    assert_eq!(
        scan.packets[1],
        Packet {
            arrival: Timestamp::from_nanos(1_000_000_009),
            bytes: vec![2; 1206]
        }
    );
    assert_eq!(
        source.recv(Duration::ZERO).unwrap().unwrap().bytes,
        vec![0xAB; 1206]
    );
    assert!(matches!(
        source.recv(Duration::ZERO),
        Err(Error::EndOfStream { .. })
    ));
    assert!(matches!(
        source.recv(Duration::ZERO),
        Err(Error::EndOfStream { .. })
    ));
}

#[test]
fn damaged_messages_and_files_say_where() {
    let whole = message(2, &[(1, 2, 1), (1, 9, 2)]);
    let mut huge = whole.clone();
    huge[24..28].copy_from_slice(&u32::MAX.to_le_bytes());
    let file = bag(&[whole[..2000].to_vec(), huge]);
    let mut source = Rosbag2Source::open(file.path()).unwrap();
    for message in ["message 3", "message 2"] {
        let error = source.next_scan().unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    assert_eq!(source.next_scan().unwrap(), None);
    let velodyne = RosPackets::named("velodyne_msgs/msg/VelodyneScan").unwrap();
    for cut in 0..whole.len() {
        assert!(parse_scan(velodyne, Timestamp::default(), &whole[..cut]).is_none());
    }

    let text = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(
        text.path(),
        "no database, and long enough to be told from an empty one",
    )
    .unwrap();
    let error = Rosbag2Source::open(text.path()).unwrap_err().to_string();
    assert!(error.contains("not a rosbag2 database"), "{error}");
    let error = Rosbag2Source::open(Path::new("/no/such.db3"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("/no/such.db3") && error.contains("open"),
        "{error}"
    );
    let empty = bag(&[]);
    Connection::open(empty.path())
        .unwrap()
        .execute("DELETE FROM topics WHERE id = 2", [])
        .unwrap();
    let error = Rosbag2Source::open(empty.path()).unwrap_err().to_string();
    assert!(error.contains("no topic of velodyne_msgs"), "{error}");
}

/// As some writers leave it: the column empty, or not there at all.
#[test]
fn a_bag_that_does_not_say_how_it_is_serialized_is_read() {
    for change in [
        "UPDATE topics SET serialization_format = ''",
        "ALTER TABLE topics DROP COLUMN serialization_format",
    ] {
        let file = bag(&[message(1, &[(3, 4, 0xAB)])]);
        Connection::open(file.path())
            .unwrap()
            .execute_batch(change)
            .unwrap();
        let mut source = Rosbag2Source::open(file.path()).unwrap();
        let packet = source.recv(Duration::ZERO).unwrap().unwrap();
        assert_eq!(packet.bytes, vec![0xAB; 1206], "{change}");
    }
}

#[test]
fn what_is_wrong_with_a_bag_is_said() {
    for (change, reason) in [
        (
            "UPDATE topics SET serialization_format = 'protobuf'",
            "/packets is serialized as `protobuf`, but only `cdr` is supported",
        ),
        (
            "UPDATE topics SET type = 'sensor_msgs/msg/PointCloud2' WHERE id = 2",
            "it has /imu (sensor_msgs/msg/Imu), /packets (sensor_msgs/msg/PointCloud2)",
        ),
        (
            "INSERT INTO topics VALUES (3,'/back','velodyne_msgs/msg/VelodyneScan','cdr','')",
            "several topics of scans, expected one: /packets, /back",
        ),
    ] {
        let file = bag(&[message(1, &[(3, 4, 0xAB)])]);
        Connection::open(file.path())
            .unwrap()
            .execute_batch(change)
            .unwrap();
        let refused = Rosbag2Source::open(file.path()).unwrap_err().to_string();
        assert!(refused.contains(reason), "{refused}");
    }
}
