use std::io::Write as _;

use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_types::{Image, Stamped, Timestamp};
use rusqlite::Connection;

use super::*;

const STAMP_NS: i64 = 1_403_636_579_763_555_584;

/// Writes fields as either layout has them.
struct Fields {
    layout: Layout,
    bytes: Vec<u8>,
}

impl Fields {
    fn new(layout: Layout) -> Self {
        Self {
            layout,
            bytes: Vec::new(),
        }
    }

    fn put(mut self, number: &[u8]) -> Self {
        if self.layout == Layout::Cdr {
            self.bytes
                .resize(self.bytes.len().next_multiple_of(number.len()), 0);
        }
        self.bytes.extend(number);
        self
    }

    fn u32(self, value: u32) -> Self {
        self.put(&value.to_le_bytes())
    }

    fn f64s(self, values: &[f64]) -> Self {
        values.iter().fold(self, |s, v| s.put(&v.to_le_bytes()))
    }

    fn sequence(self, bytes: &[u8]) -> Self {
        let mut s = self.u32(bytes.len() as u32);
        s.bytes.extend(bytes);
        s
    }

    fn text(self, text: &str) -> Self {
        match self.layout {
            Layout::Ros1 => self.sequence(text.as_bytes()),
            Layout::Cdr => self.sequence(format!("{text}\0").as_bytes()),
        }
    }

    fn header(self, stamp_ns: i64) -> Self {
        let s = match self.layout {
            Layout::Ros1 => self.u32(9),
            Layout::Cdr => self,
        };
        s.u32((stamp_ns / 1_000_000_000) as u32)
            .u32((stamp_ns % 1_000_000_000) as u32)
            .text("cam0")
    }

    fn finish(self) -> Vec<u8> {
        match self.layout {
            Layout::Ros1 => self.bytes,
            Layout::Cdr => [&[0, 1, 0, 0], self.bytes.as_slice()].concat(),
        }
    }
}

fn image(layout: Layout, stamp_ns: i64, encoding: &str, step: u32, data: &[u8]) -> Vec<u8> {
    Fields::new(layout)
        .header(stamp_ns)
        .u32(2)
        .u32(2)
        .text(encoding)
        .put(&[0])
        .u32(step)
        .sequence(data)
        .finish()
}

fn imu(layout: Layout, stamp_ns: i64) -> Vec<u8> {
    Fields::new(layout)
        .header(stamp_ns)
        .f64s(&[0.0; 13])
        .f64s(&[0.1, 0.2, 0.3])
        .f64s(&[0.0; 9])
        .f64s(&[1.0, 2.0, 9.8])
        .f64s(&[0.0; 9])
        .finish()
}

fn png() -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 2, 2);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().expect("PNG");
    writer.write_image_data(&[1, 2, 3, 4]).expect("PNG");
    drop(writer);
    file
}

/// A cloud of two points 80 ms apart, times as Velodyne's driver of ROS 1 has them: seconds before the stamp.
fn cloud(layout: Layout, stamp_ns: i64) -> Vec<u8> {
    let mut fields = Fields::new(layout).header(stamp_ns).u32(1).u32(2).u32(4);
    for (name, offset) in [("x", 0), ("y", 4), ("z", 8), ("time", 12)] {
        fields = fields.text(name).u32(offset).put(&[7]).u32(1);
    }
    let points = [[1.0_f32, 2.0, 3.0, -0.08], [4.0, 5.0, 6.0, 0.0]];
    let data: Vec<u8> = points
        .as_flattened()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    fields
        .put(&[0])
        .u32(16)
        .u32(32)
        .sequence(&data)
        .put(&[1])
        .finish()
}

/// The LiDAR on the camera, half a metre to the left and turned about z by half a turn.
fn transform(layout: Layout) -> Vec<u8> {
    Fields::new(layout)
        .u32(1)
        .header(0)
        .text("lidar")
        .f64s(&[0.0, 0.5, 0.0])
        .f64s(&[0.0, 0.0, 1.0, 0.0])
        .finish()
}

/// Topic, type, message.
fn messages(layout: Layout) -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let compressed = Fields::new(layout)
        .header(STAMP_NS + 1)
        .text("png")
        .sequence(&png())
        .finish();
    vec![
        (
            "/cam0/image_raw",
            IMAGE,
            image(layout, STAMP_NS, "mono8", 3, &[1, 2, 0, 3, 4, 0]),
        ),
        ("/cam1/compressed", COMPRESSED_IMAGE, compressed),
        ("/imu0", IMU, imu(layout, STAMP_NS + 2)),
        ("/imu0", IMU, imu(layout, STAMP_NS + 3)),
        ("/velodyne_points", CLOUD, cloud(layout, STAMP_NS)),
        (TF_STATIC, TF, transform(layout)),
    ]
}

fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut header = Vec::new();
    for (name, value) in fields {
        let field = [name.as_bytes(), b"=", value].concat();
        header.extend((field.len() as u32).to_le_bytes());
        header.extend(field);
    }
    let lengths = [header.len(), data.len()].map(|n| (n as u32).to_le_bytes());
    [&lengths[0], header.as_slice(), &lengths[1], data].concat()
}

/// A bag of ROS 1 with all messages in one chunk.
fn ros1(compression: &str) -> Vec<u8> {
    let mut chunk = Vec::new();
    let mut connections: Vec<&str> = Vec::new();
    let all = messages(Layout::Ros1);
    for (topic, kind, message) in &all {
        let id = connections
            .iter()
            .position(|c| c == topic)
            .unwrap_or_else(|| {
                connections.push(topic);
                let id = connections.len() - 1;
                let data = record(
                    &[("topic", topic.as_bytes()), ("type", kind.as_bytes())],
                    &[],
                );
                // The data of a connection is a header: without its length.
                let data = &data[4..data.len() - 4];
                let fields: [(&str, &[u8]); 3] = [
                    ("op", &[7]),
                    ("conn", &(id as u32).to_le_bytes()),
                    ("topic", topic.as_bytes()),
                ];
                chunk.extend(record(&fields, data));
                id
            });
        let fields: [(&str, &[u8]); 3] = [
            ("op", &[2]),
            ("conn", &(id as u32).to_le_bytes()),
            ("time", &[0; 8]),
        ];
        chunk.extend(record(&fields, message));
    }
    let packed = match compression {
        "lz4" => {
            let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).expect("lz4");
            encoder.write_all(&chunk).expect("lz4");
            encoder.finish().0
        }
        "bz2" => {
            let level = bzip2::Compression::default();
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), level);
            encoder.write_all(&chunk).expect("bz2");
            encoder.finish().expect("bz2")
        }
        _ => chunk.clone(),
    };
    let fields: [(&str, &[u8]); 3] = [
        ("op", &[5]),
        ("compression", compression.as_bytes()),
        ("size", &(chunk.len() as u32).to_le_bytes()),
    ];
    let start = record(&[("op", &[3])], &[b' '; 16]);
    [
        b"#ROSBAG V2.0\n",
        start.as_slice(),
        &record(&fields, &packed),
    ]
    .concat()
}

fn images_of(bag: &RosBag, topic: &str) -> Vec<(i64, Image)> {
    let mut all = Vec::new();
    bag.images(topic, &mut |stamp, image| {
        all.push((stamp, image));
        Ok::<(), Error>(())
    })
    .expect("images");
    all
}

fn assert_messages(bag: &RosBag) {
    for (topic, stamp_ns) in [
        ("/cam0/image_raw", STAMP_NS),
        ("/cam1/compressed", STAMP_NS + 1),
    ] {
        let [(stamp, image)] = &images_of(bag, topic)[..] else {
            panic!("one image on {topic}")
        };
        assert_eq!((*stamp, image.width, image.height), (stamp_ns, 2, 2));
        assert_eq!(image.pixels, [1, 2, 3, 4]);
    }
    let samples = bag.imu(None).expect("samples").samples;
    assert_eq!(samples.len(), 2);
    assert_eq!(samples[0].0.nanos(), STAMP_NS + 2);
    assert_eq!(samples[1].1.angular_velocity_rad_s, [0.1, 0.2, 0.3]);
    assert_eq!(samples[1].1.specific_force_m_s2, [1.0, 2.0, 9.8]);
    let lidar = bag.lidar(None).expect("one LiDAR");
    assert_eq!(
        (lidar.topic.as_str(), lidar.messages),
        ("/velodyne_points", LidarMessages::Clouds)
    );
    let mut clouds = Vec::new();
    bag.clouds(&lidar.topic, &mut |cloud| {
        clouds.push(cloud);
        Ok::<(), Error>(())
    })
    .expect("clouds");
    let [found] = &clouds[..] else {
        panic!("one cloud")
    };
    assert!((found.begins().nanos() - (STAMP_NS - 80_000_000)).abs() < 100);
    let points = &found.cloud.scan.points;
    assert_eq!(points[1].position_m, [4.0, 5.0, 6.0]);
    assert!(points[0].time_offset_ns == 0 && points[1].time_offset_ns.abs_diff(80_000_000) < 100);
    let frame = bag.frame(&lidar.topic).expect("a frame");
    let pose =
        pose_in(&frame, "lidar", &bag.static_transforms().expect("edges")).expect("connected");
    assert!((pose.translation.y - 0.5).abs() < 1e-12);
    let error = bag.lidar(Some("/imu0")).expect_err("no LiDAR").to_string();
    assert!(error.contains("these have: /velodyne_points"), "{error}");
    let wrong = bag
        .images("/gone", &mut |_, _| Ok::<(), Error>(()))
        .expect_err("no such topic");
    assert!(
        wrong.to_string().contains(
            "images are on /cam0/image_raw, /cam1/compressed, IMUs on /imu0, clouds on /velodyne_points"
        ),
        "{wrong}"
    );
    assert!(
        bag.images("/imu0", &mut |_, _| Ok::<(), Error>(()))
            .is_err()
    );
    assert!(bag.imu(Some("/cam0/image_raw")).is_err());
}

/// Naively one bad message in an hour of recording ends the run, or it is left out and nobody hears of it.
#[test]
fn a_damaged_message_and_a_damaged_chunk_cost_no_other_message_and_are_counted() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.bag");
    let whole = ros1("none");
    // A second chunk as the first, its size wrong, and a third that is whole.
    let start = 13 + record(&[("op", &[3])], &[b' '; 16]).len();
    let chunk = &whole[start..];
    let mut damaged = chunk.to_vec();
    let size = damaged
        .windows(5)
        .position(|w| w == b"size=")
        .expect("size")
        + 5;
    damaged[size] ^= 1;
    std::fs::write(&path, [&whole, damaged.as_slice(), chunk].concat()).expect("bag");
    let bag = RosBag::open(&path).expect("a bag");
    let imu = bag.imu(None).expect("samples");
    assert_eq!((imu.samples.len(), imu.unread.count), (4, 1));
    let first = imu.unread.first.expect("what is wrong");
    assert!(
        first.contains("message 3 of /imu0") && first.contains("announced"),
        "{first}"
    );

    // A message that ends before its fields do: its samples are no numbers.
    let mut holed = whole.clone();
    let force = 9.8_f64.to_le_bytes();
    let at = holed.windows(8).position(|w| w == force).expect("force");
    holed[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    std::fs::write(&path, &holed).expect("bag");
    let imu = RosBag::open(&path)
        .expect("a bag")
        .imu(None)
        .expect("samples");
    assert_eq!((imu.samples.len(), imu.unread.count), (1, 1));
    assert_eq!(imu.frame, "cam0");

    let mut clouds = 0;
    let unread = RosBag::open(&path)
        .expect("a bag")
        .clouds("/velodyne_points", &mut |_| {
            clouds += 1;
            Ok::<(), Error>(())
        });
    assert_eq!((unread.expect("read"), clouds), (Unread::default(), 1));
}

/// A bag as `rosbag record` closes it, but for the connections of its index; `index_pos` as its first record has it.
fn closed_ros1(mut index_pos: impl FnMut(u64) -> u64) -> Vec<u8> {
    let of_one = ros1("lz4");
    let start = 13 + record(&[("op", &[3])], &[b' '; 16]).len();
    let chunk = &of_one[start..];
    let head = |index_pos: u64| {
        let fields: [(&str, &[u8]); 4] = [
            ("op", &[3]),
            ("index_pos", &index_pos.to_le_bytes()),
            ("conn_count", &5_u32.to_le_bytes()),
            ("chunk_count", &2_u32.to_le_bytes()),
        ];
        [b"#ROSBAG V2.0\n", record(&fields, &[b' '; 16]).as_slice()].concat()
    };
    let at = (head(0).len() + 2 * chunk.len()) as u64;
    let index = record(&[("op", &[6]), ("ver", &1_u32.to_le_bytes())], &[0; 8]);
    [&head(index_pos(at)), chunk, chunk, &index].concat()
}

/// Naively what can be read is all there was.
#[test]
fn a_bag_of_ros_1_that_is_cut_or_was_not_closed_lacks_something() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.bag");
    let whole = closed_ros1(|at| at);
    let damage = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("bag");
        let bag = RosBag::open(&path).expect("a bag");
        let samples = bag.imu(None).expect("samples").samples.len();
        (bag.damage().join("; "), samples)
    };
    assert_eq!(damage(&whole), (String::new(), 4));
    // Between the chunks, within the second one, and behind it.
    let chunk = (ros1("lz4").len() - 13 - record(&[("op", &[3])], &[b' '; 16]).len()) as u64;
    let mut end_of_chunks = 0;
    _ = closed_ros1(|at| {
        end_of_chunks = at as usize;
        at
    });
    for (length, chunks) in [
        (end_of_chunks - chunk as usize, 1),
        (end_of_chunks - 10, 1),
        (end_of_chunks + 5, 2),
    ] {
        let (said, samples) = damage(&whole[..length]);
        let expected = format!("is truncated: {chunks} of 2 chunks");
        assert!(said.contains(&expected), "{length}: {said}");
        assert_eq!(samples, 2 * chunks);
    }
    let (said, samples) = damage(&closed_ros1(|_| 0));
    assert!(said.contains("was not closed"), "{said}");
    assert_eq!(samples, 4);
}

#[test]
fn bags_of_ros_1_are_read() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.bag");
    for compression in ["none", "lz4", "bz2"] {
        std::fs::write(&path, ros1(compression)).expect("file");
        assert_messages(&RosBag::open(&path).expect(compression));
    }
    // Cut or damaged anywhere: an error or less, never a panic.
    let whole = ros1("none");
    for length in (0..whole.len()).step_by(3) {
        std::fs::write(&path, &whole[..length]).expect("file");
        if let Ok(bag) = RosBag::open(&path) {
            let _ = bag.imu(None);
        }
    }
    for at in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[at] = 0xff;
        std::fs::write(&path, damaged).expect("file");
        if let Ok(bag) = RosBag::open(&path) {
            let _ = bag.imu(None);
            let _ = bag.images("/cam0/image_raw", &mut |_, _| Ok::<(), Error>(()));
        }
    }
}

fn database(path: &Path, format: &str) {
    let database = Connection::open(path).expect("sqlite");
    database
        .execute_batch(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT);
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);",
        )
        .expect("tables");
    let mut names: Vec<&str> = Vec::new();
    for (topic, kind, message) in messages(Layout::Cdr) {
        let id = names.iter().position(|n| *n == topic).unwrap_or_else(|| {
            names.push(topic);
            let kind = kind.replace('/', "/msg/");
            database
                .execute(
                    "INSERT INTO topics VALUES (?1, ?2, ?3, ?4, '')",
                    (names.len() as i64, topic, kind, format),
                )
                .expect("a topic");
            names.len() - 1
        });
        database
            .execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, 7, ?2)",
                (id as i64 + 1, message),
            )
            .expect("a message");
    }
}

#[test]
fn databases_of_rosbag2_are_read_alone_and_in_their_folder() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk_0.db3");
    database(&path, "cdr");
    assert_messages(&RosBag::open(&path).expect("a database"));
    assert_messages(&RosBag::open(folder.path()).expect("a folder"));
    database(&folder.path().join("walk_10.db3"), "cdr");
    database(&folder.path().join("walk_2.db3"), "cdr");
    let bag = RosBag::open(folder.path()).expect("three parts");
    assert_eq!(bag.imu(None).expect("samples").samples.len(), 6);

    assert_eq!(bag.damage(), [""; 0]);
    // One of them was not copied along.
    let metadata = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - walk_0.db3\n    - walk/walk_1.db3\n    \
        - walk_2.db3.zstd\n    - walk_10.db3\n  duration:\n    nanoseconds: 5\n";
    std::fs::write(folder.path().join("metadata.yaml"), metadata).expect("metadata");
    let damage = RosBag::open(folder.path()).expect("a folder").damage();
    let [missing] = damage.as_slice() else {
        panic!("{damage:?}");
    };
    assert!(
        missing.contains("names walk_1.db3, which is missing"),
        "{missing}"
    );

    let other = folder.path().join("other.db3");
    database(&other, "protobuf");
    let error = RosBag::open(&other)
        .err()
        .expect("another format")
        .to_string();
    assert!(error.contains("serialized as protobuf"), "{error}");
}

#[test]
fn an_mcap_is_read_by_the_stamps_of_its_headers() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).expect("a file");
    let gray = Image {
        width: 2,
        height: 2,
        pixels: vec![1, 2, 3, 4],
        exposure_ns: 0,
        frame_id: 0,
    };
    let time = Timestamp::from_nanos(STAMP_NS);
    let stamped = Stamped {
        time,
        arrival: time.plus_secs(0.1),
        device_ticks: 0,
        sample: gray.clone(),
    };
    writer.write_image("cam0", &stamped).expect("written");
    writer.finish().expect("a file");
    let bag = RosBag::open(&path).expect("a bag");
    let topic = Recording::open(&path)
        .expect("a recording")
        .topics()
        .iter()
        .find(|t| t.schema.ends_with("Image"))
        .map(|t| t.topic.clone())
        .expect("images");
    assert_eq!(images_of(&bag, &topic), [(STAMP_NS, gray)]);
}

#[test]
fn colors_and_depths_become_grey() {
    let gray = |encoding: &str, step: u32, data: &[u8]| {
        message::image(Layout::Ros1, &image(Layout::Ros1, 0, encoding, step, data))
            .map(|(_, image)| image.pixels)
    };
    let red_green_blue_white = [255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255];
    let expected = vec![76, 150, 29, 255];
    assert_eq!(gray("rgb8", 6, &red_green_blue_white), Ok(expected.clone()));
    let swapped: Vec<u8> = red_green_blue_white
        .chunks(3)
        .flat_map(|p| [p[2], p[1], p[0]])
        .collect();
    assert_eq!(gray("bgr8", 6, &swapped), Ok(expected));
    assert_eq!(
        gray("mono16", 4, &[255, 15, 0, 8, 0, 0, 0, 4]),
        Ok(vec![255, 128, 0, 64])
    );
    assert_eq!(
        gray("yuv422", 4, &[0, 1, 0, 2, 0, 3, 0, 4]),
        Ok(vec![1, 2, 3, 4])
    );
    // A wall of one color: red 200, green 100, blue 40.
    assert_eq!(
        gray("bayer_rggb8", 2, &[200, 100, 100, 40]),
        Ok(vec![110; 4])
    );
    let error = gray("32FC1", 8, &[0; 16]).expect_err("unknown");
    assert!(
        error.contains("image encoding 32FC1 is not supported"),
        "{error}"
    );
    let error = gray("mono8", 1, &[0; 2]).expect_err("short rows");
    assert!(error.contains("2 × 2 pixels mono8 in 2 bytes"), "{error}");
}
