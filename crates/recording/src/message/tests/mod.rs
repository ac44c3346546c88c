//! Against bytes serialised by rosbags 0.11.9 (ROS 2 Jazzy type store), stamp 1771234567.123456789.

use super::*;
use lsfb_geometry::{Camera, Se3, UnitQuaternion, Vector3};
use lsfb_types::{Echo, Image, ImuSample, LidarPoint, LidarScan, Packet, Timestamp};

mod pose;
mod surroundings;

const STAMP: Timestamp = Timestamp::from_nanos(1_771_234_567_123_456_789);

#[rustfmt::skip]
const IMAGE_BYTES: [u8; 60] = [
    0x00, 0x01, 0x00, 0x00, 0x07, 0xe5, 0x92, 0x69, 0x15, 0xcd, 0x5b, 0x07, 0x05, 0x00, 0x00, 0x00, 0x63, 0x61, 0x6d, 0x30,
    0x00, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x04, 0x00, 0x00, 0x00, 0x06, 0x00, 0x00, 0x00, 0x6d, 0x6f, 0x6e, 0x6f,
    0x38, 0x00, 0x00, 0x00, 0x04, 0x00, 0x00, 0x00, 0x08, 0x00, 0x00, 0x00, 0x00, 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07,
];

#[rustfmt::skip]
const IMU_BYTES: [u8; 324] = [
    0x00, 0x01, 0x00, 0x00, 0x07, 0xe5, 0x92, 0x69, 0x15, 0xcd, 0x5b, 0x07, 0x05, 0x00, 0x00, 0x00, 0x69, 0x6d, 0x75, 0x30,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xf0, 0x3f,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xf0, 0xbf, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xc0, 0x3f,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xe0, 0xbf, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xf0, 0x3f, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xe0, 0x3f, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0xd0, 0xbf, 0x00, 0x00, 0x00, 0x00, 0x00, 0xa0, 0x23, 0x40, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00,
];

#[rustfmt::skip]
const TIME_REFERENCE_BYTES: [u8; 57] = [
    0x00, 0x01, 0x00, 0x00, 0x07, 0xe5, 0x92, 0x69, 0x15, 0xcd, 0x5b, 0x07, 0x05, 0x00, 0x00, 0x00, 0x69, 0x6d, 0x75, 0x30,
    0x00, 0x00, 0x00, 0x00, 0x7b, 0x00, 0x00, 0x00, 0x08, 0x0c, 0x3a, 0x1b, 0x15, 0x00, 0x00, 0x00, 0x78, 0x73, 0x65, 0x6e,
    0x73, 0x2e, 0x73, 0x61, 0x6d, 0x70, 0x6c, 0x65, 0x74, 0x69, 0x6d, 0x65, 0x66, 0x69, 0x6e, 0x65, 0x00,
];

#[rustfmt::skip]
const TF_BYTES: [u8; 100] = [
    0x00, 0x01, 0x00, 0x00, 0x01, 0x00, 0x00, 0x00, 0x07, 0xe5, 0x92, 0x69, 0x15, 0xcd, 0x5b, 0x07, 0x05, 0x00, 0x00, 0x00,
    0x62, 0x61, 0x73, 0x65, 0x00, 0x00, 0x00, 0x00, 0x06, 0x00, 0x00, 0x00, 0x6c, 0x69, 0x64, 0x61, 0x72, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xe0, 0x3f, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xf0, 0x3f,
];

#[rustfmt::skip]
const VELODYNE_SCAN_START: [u8; 40] = [
    0x00, 0x01, 0x00, 0x00, 0x07, 0xe5, 0x92, 0x69, 0x15, 0xcd, 0x5b, 0x07, 0x06, 0x00, 0x00, 0x00, 0x6c, 0x69, 0x64, 0x61,
    0x72, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x07, 0xe5, 0x92, 0x69, 0x01, 0x00, 0x00, 0x00, 0xff, 0xee, 0x3c, 0x8c,
];
/// Size of the scan of two packets whose start is above.
const VELODYNE_SCAN_BYTES: usize = 2458;

#[test]
fn image() {
    let image = Image {
        width: 4,
        height: 2,
        pixels: (0..8).collect(),
        exposure_ns: 0,
        frame_id: 0,
    };
    assert_eq!(encode_image(STAMP, "cam0", &image), IMAGE_BYTES);
    assert_eq!(decode_image(&IMAGE_BYTES), Ok(image));
}

#[test]
fn image_as_the_camera_sends_it_gives_its_luma() {
    let mut bytes = crate::cdr::CdrWriter::with_capacity(64);
    bytes.header(STAMP, "cam0");
    bytes.u32(2);
    bytes.u32(2);
    bytes.string("yuv422_yuy2");
    bytes.u8(0);
    bytes.u32(6); // two bytes of padding in each row
    bytes.byte_sequence(&[1, 128, 2, 128, 0, 0, 3, 128, 4, 128, 0, 0]);
    let image = decode_image(&bytes.finish()).unwrap();
    assert_eq!(
        (image.width, image.height, image.pixels),
        (2, 2, vec![1, 2, 3, 4])
    );
}

#[test]
fn imu_values_and_layout() {
    let sample = ImuSample {
        angular_velocity_rad_s: [0.125, -0.5, 1.0],
        specific_force_m_s2: [0.5, -0.25, 9.8125],
    };
    assert_eq!(decode_imu(&IMU_BYTES), Ok(sample));
    assert_eq!(
        encode_imu(STAMP, "imu0", &sample, ImuVariance::UNKNOWN),
        IMU_BYTES
    );
}

#[test]
fn time_reference() {
    let reference = TimeReference {
        device_ticks: 123_456_789_000,
        source: "xsens.sampletimefine".into(),
    };
    assert_eq!(
        decode_time_reference(&TIME_REFERENCE_BYTES),
        Ok(reference.clone())
    );
    assert_eq!(
        encode_time_reference(STAMP, "imu0", &reference).unwrap(),
        TIME_REFERENCE_BYTES
    );
    let too_large = TimeReference {
        device_ticks: u64::MAX,
        source: String::new(),
    };
    assert_eq!(encode_time_reference(STAMP, "imu0", &too_large), None);
}

#[test]
fn static_transform() {
    let transform = StaticTransform {
        parent: "base".into(),
        child: "lidar".into(),
        parent_from_child: Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 0.5)),
    };
    let bytes = encode_static_transforms(STAMP, &[transform]);
    assert_eq!(hex(&bytes), hex(&TF_BYTES));
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn lidar_packets(sizes: &[usize]) -> Vec<Packet> {
    let numbered = (0_i64..).zip(sizes);
    numbered
        .map(|(k, size)| {
            let mut bytes = vec![7 + k as u8; *size];
            bytes[..4].copy_from_slice(&[0xff, 0xee, 0x3c, 0x8c]);
            Packet {
                arrival: Timestamp::from_nanos(
                    (STAMP.nanos() / 1_000_000_000 + k) * 1_000_000_000 + 1,
                ),
                bytes,
            }
        })
        .collect()
}

#[test]
fn lidar_packets_of_any_size_come_back() {
    let packets = lidar_packets(&[1206, 1080, 5, 1198]);
    let bytes = encode_lidar_packets(STAMP, "lidar", &packets);
    assert_eq!(
        decode_lidar_packets(LIDAR_PACKETS.name, &bytes).unwrap(),
        packets
    );
}

#[test]
fn velodyne_scan_pads_before_the_second_packet() {
    let packets = lidar_packets(&[1206, 1206]);
    let mut w = crate::cdr::CdrWriter::with_capacity(4096);
    w.header(STAMP, "lidar");
    w.u32(2);
    for packet in &packets {
        w.time(packet.arrival);
        w.raw(&packet.bytes);
    }
    let bytes = w.finish();
    assert_eq!(bytes[..40], VELODYNE_SCAN_START);
    assert_eq!(bytes.len(), VELODYNE_SCAN_BYTES);
    assert_eq!(
        decode_lidar_packets("velodyne_msgs/msg/VelodyneScan", &bytes).unwrap(),
        packets
    );
}

#[test]
fn a_pandar_scan_has_packets_as_long_as_it_says() {
    let packets = lidar_packets(&[1080, 1198]);
    let message = |sizes: [u32; 2]| {
        let mut w = crate::cdr::CdrWriter::with_capacity(4096);
        w.header(STAMP, "hesai");
        w.u32(2);
        for (packet, size) in packets.iter().zip(sizes) {
            let mut data = packet.bytes.clone();
            data.resize(1500, 0);
            w.time(packet.arrival);
            w.raw(&data);
            w.u32(size);
        }
        w.finish()
    };
    assert_eq!(
        decode_lidar_packets("pandar_msgs/msg/PandarScan", &message([1080, 1198])).unwrap(),
        packets
    );
    let field = "packets.size";
    assert_eq!(
        decode_lidar_packets("pandar_msgs/msg/PandarScan", &message([1080, 1501])),
        Err(CdrError::Value { field })
    );
}

fn scan_of(bytes: &[u8]) -> LidarScan {
    let message = decode_cloud(Layout::Cdr, bytes).expect("a cloud");
    assert_eq!((message.stamp, message.frame.as_str()), (STAMP, "lidar"));
    message.cloud.scan
}

#[test]
fn points_round_trip_field_by_field() {
    let scan = LidarScan {
        points: (0..5)
            .map(|i| LidarPoint {
                position_m: [i as f32 + 0.25, -1.5, 1e-3],
                intensity: 50 * i as u8,
                ring: 31 - i,
                echo: Echo::ALL[usize::from(i)],
                time_offset_ns: 55_296 * u32::from(i),
            })
            .collect(),
    };
    let bytes = encode_points(STAMP, "lidar", &scan);
    assert_eq!(scan_of(&bytes), scan);
    assert_eq!(
        scan_of(&encode_points(STAMP, "lidar", &LidarScan::default())),
        LidarScan::default()
    );
}

#[test]
fn own_messages_round_trip() {
    let raw = RawPacket {
        source: "imu0".into(),
        kind: 513,
        sequence: 1 << 40,
        bytes: vec![1, 2, 3],
    };
    assert_eq!(
        decode_raw_packet(&encode_raw_packet(STAMP, "imu0", &raw)),
        Ok(raw)
    );
    let meta = FrameMeta {
        frame_id: 7,
        device_ticks: 1 << 50,
        exposure_ns: 5_000_000,
        trailer: vec![0x3b, 0xc],
    };
    assert_eq!(
        decode_frame_meta(&encode_frame_meta(STAMP, "cam0", &meta)),
        Ok(meta)
    );
}

#[test]
fn every_cut_message_is_refused() {
    type Decode = fn(&[u8]) -> Option<CdrError>;
    let packets = encode_lidar_packets(STAMP, "", &lidar_packets(&[4, 5]));
    let points = encode_points(
        STAMP,
        "lidar",
        &LidarScan {
            points: vec![LidarPoint::default(); 2],
        },
    );
    let raw = RawPacket {
        source: "s".into(),
        kind: 0,
        sequence: 0,
        bytes: vec![1],
    };
    let cases: [(Vec<u8>, Decode); 8] = [
        (IMAGE_BYTES.to_vec(), |b| decode_image(b).err()),
        (IMU_BYTES.to_vec(), |b| decode_imu(b).err()),
        (TIME_REFERENCE_BYTES.to_vec(), |b| {
            decode_time_reference(b).err()
        }),
        (packets, |b| {
            decode_lidar_packets(LIDAR_PACKETS.name, b).err()
        }),
        (points, |b| decode_cloud(Layout::Cdr, b).err()),
        (encode_raw_packet(STAMP, "", &raw), |b| {
            decode_raw_packet(b).err()
        }),
        (encode_frame_meta(STAMP, "", &FrameMeta::default()), |b| {
            decode_frame_meta(b).err()
        }),
        (encode_remark(STAMP, &Remark::default()), |b| {
            decode_remark(b).err()
        }),
    ];
    for (index, (bytes, error)) in cases.iter().enumerate() {
        assert_eq!(error(bytes), None);
        for length in 0..bytes.len() {
            assert!(
                error(&bytes[..length]).is_some(),
                "case {index} cut to {length}"
            );
        }
    }
    let big_endian = [0, 0, 0, 0];
    assert_eq!(
        decode_imu(&big_endian),
        Err(CdrError::Encapsulation { found: [0, 0] })
    );
}

#[test]
fn camera_info_has_the_intrinsics_where_viewers_look() {
    let camera = Camera::pinhole(640, 400, [350.0, 351.0], [319.5, 199.5]);
    let bytes = encode_camera_info(STAMP, "cam0", &camera);
    let mut r = CdrReader::new(&bytes).unwrap();
    r.header().unwrap();
    assert_eq!((r.u32("height"), r.u32("width")), (Ok(400), Ok(640)));
    assert_eq!(r.string("distortion_model"), Ok("plumb_bob"));
    assert_eq!(r.u32("d"), Ok(5));
    assert_eq!(r.f64_array::<5>("d"), Ok([0.0; 5]));
    assert_eq!(
        r.f64_array::<9>("k"),
        Ok([350.0, 0.0, 319.5, 0.0, 351.0, 199.5, 0.0, 0.0, 1.0])
    );
}

#[test]
fn remarks_keep_their_words_and_their_place() {
    for position_in_world_m in [Some([1.5, -2.0, 0.25]), None] {
        let remark = Remark {
            kind: "control-point".to_owned(),
            text: "Pfeiler Süd 3".to_owned(),
            position_in_world_m,
        };
        let bytes = encode_remark(STAMP, &remark);
        assert_eq!(decode_remark(&bytes), Ok(remark));
    }
}
