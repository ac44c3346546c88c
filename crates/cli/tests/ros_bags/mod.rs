//! Bags of both ROS with clouds, inertial samples and static transforms, as their recorders write them.

use std::io::Write as _;
use std::path::Path;

use lsfb_recording::message::{
    ImuVariance, StaticTransform, encode_imu, encode_points, encode_static_transforms,
};
use lsfb_types::{ImuSample, LidarScan, Stamped, Timestamp};
use rusqlite::Connection;

const CLOUD: &str = "sensor_msgs/PointCloud2";
const IMU: &str = "sensor_msgs/Imu";
const TF: &str = "tf2_msgs/TFMessage";

/// What a bag holds: on `/points` in the frame `lidar`, on `/imu` in the frame `imu`, and on `/tf_static`.
pub struct Walk {
    pub scans: Vec<Stamped<LidarScan>>,
    pub samples: Vec<Stamped<ImuSample>>,
    pub edges: Vec<StaticTransform>,
}

impl Walk {
    /// A bag of ROS 1, its chunk packed by LZ4.
    pub fn ros1(&self, path: &Path) {
        let tf = (TF, "/tf_static", vec![self.ros1_edges()]);
        let samples = self.samples.iter().map(ros1_imu).collect();
        let scans = self.scans.iter().map(ros1_cloud).collect();
        let topics = [tf, (IMU, "/imu", samples), (CLOUD, "/points", scans)];
        let mut chunk = Vec::new();
        for (id, (kind, topic, messages)) in (0_u32..).zip(topics) {
            let id = id.to_le_bytes();
            let topic = topic.as_bytes();
            let connection: [(&str, &[u8]); 3] = [("op", &[7]), ("conn", &id), ("topic", topic)];
            let of = header(&[("topic", topic), ("type", kind.as_bytes())]);
            chunk.extend(record(&connection, &of));
            for message in messages {
                let fields: [(&str, &[u8]); 3] = [("op", &[2]), ("conn", &id), ("time", &[0; 8])];
                chunk.extend(record(&fields, &message));
            }
        }
        let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).expect("lz4");
        encoder.write_all(&chunk).expect("lz4");
        let size = (chunk.len() as u32).to_le_bytes();
        let fields: [(&str, &[u8]); 3] = [("op", &[5]), ("compression", b"lz4"), ("size", &size)];
        let bag = [
            b"#ROSBAG V2.0\n".to_vec(),
            record(&[("op", &[3])], &[b' '; 16]),
            record(&fields, &encoder.finish().0),
        ];
        std::fs::write(path, bag.concat()).expect("a bag");
    }

    /// A folder of rosbag2 with a database in it.
    pub fn rosbag2(&self, folder: &Path) {
        std::fs::create_dir(folder).expect("folder");
        let about = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - walk_0.db3\n";
        std::fs::write(folder.join("metadata.yaml"), about).expect("metadata");
        let database = Connection::open(folder.join("walk_0.db3")).expect("sqlite");
        let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT);
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
             BEGIN;";
        database.execute_batch(tables).expect("tables");
        let edges = encode_static_transforms(Timestamp::from_nanos(0), &self.edges);
        let samples = self
            .samples
            .iter()
            .map(|s| encode_imu(s.time, "imu", &s.sample, ImuVariance::UNKNOWN));
        let scans = self.scans.iter();
        let scans = scans.map(|s| encode_points(s.time, "lidar", &s.sample));
        let topics = [
            (TF, "/tf_static", vec![edges]),
            (IMU, "/imu", samples.collect()),
            (CLOUD, "/points", scans.collect()),
        ];
        for (id, (kind, topic, messages)) in (1_i64..).zip(topics) {
            let insert = "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '')";
            let kind = kind.replace('/', "/msg/");
            database
                .execute(insert, (id, topic, kind))
                .expect("a topic");
            for message in messages {
                let insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, 7, ?2)";
                database.execute(insert, (id, message)).expect("a message");
            }
        }
        database.execute_batch("COMMIT;").expect("written");
    }

    fn ros1_edges(&self) -> Vec<u8> {
        let mut bytes = (self.edges.len() as u32).to_le_bytes().to_vec();
        for edge in &self.edges {
            bytes.extend(ros1_header(Timestamp::from_nanos(0), &edge.parent));
            bytes.extend(text(&edge.child));
            let pose = &edge.parent_from_child;
            let numbers = pose.translation.iter().chain(pose.rotation.coords.iter());
            bytes.extend(numbers.flat_map(|v| v.to_le_bytes()));
        }
        bytes
    }
}

fn header(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let fields = fields.iter().flat_map(|(name, value)| {
        let field = [name.as_bytes(), b"=", value].concat();
        [(field.len() as u32).to_le_bytes().to_vec(), field].concat()
    });
    fields.collect()
}

fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    [sized(&header(fields)), sized(data)].concat()
}

fn sized(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes(), bytes].concat()
}

fn text(text: &str) -> Vec<u8> {
    sized(text.as_bytes())
}

fn ros1_header(stamp: Timestamp, frame: &str) -> Vec<u8> {
    let (secs, nanos) = (stamp.nanos() / 1_000_000_000, stamp.nanos() % 1_000_000_000);
    let numbers = [9, secs as u32, nanos as u32];
    let numbers: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
    [numbers, text(frame)].concat()
}

fn ros1_imu(sample: &Stamped<ImuSample>) -> Vec<u8> {
    let mut bytes = ros1_header(sample.time, "imu");
    let turn = sample.sample.angular_velocity_rad_s;
    let force = sample.sample.specific_force_m_s2;
    let numbers = [&[0.0; 13][..], &turn, &[0.0; 9], &force, &[0.0; 9]].concat();
    bytes.extend(numbers.iter().flat_map(|v: &f64| v.to_le_bytes()));
    bytes
}

fn ros1_cloud(scan: &Stamped<LidarScan>) -> Vec<u8> {
    const POINT_BYTES: u32 = 18;
    let points = &scan.sample.points;
    let mut bytes = ros1_header(scan.time, "lidar");
    let u32s = |numbers: &[u32], bytes: &mut Vec<u8>| {
        bytes.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
    };
    u32s(&[1, points.len() as u32, 5], &mut bytes);
    let (f32_kind, u16_kind, u32_kind) = (7, 4, 6);
    for (name, offset, kind) in [
        ("x", 0, f32_kind),
        ("y", 4, f32_kind),
        ("z", 8, f32_kind),
        ("ring", 12, u16_kind),
        ("t", 14, u32_kind),
    ] {
        bytes.extend(text(name));
        u32s(&[offset], &mut bytes);
        bytes.push(kind);
        u32s(&[1], &mut bytes);
    }
    // Little-endian.
    bytes.push(0);
    u32s(
        &[POINT_BYTES, POINT_BYTES * points.len() as u32],
        &mut bytes,
    );
    let data: Vec<u8> = points
        .iter()
        .flat_map(|p| {
            let place = p.position_m.map(f32::to_le_bytes).concat();
            [
                &place[..],
                &p.ring.to_le_bytes(),
                &p.time_offset_ns.to_le_bytes(),
            ]
            .concat()
        })
        .collect();
    bytes.extend(sized(&data));
    // Dense.
    bytes.push(1);
    bytes
}
