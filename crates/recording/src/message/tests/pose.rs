//! Against bytes serialised by rosbags 0.11 (ROS 2 Jazzy type store), as `surroundings.rs` says; covariances are 0, 1, … 35.

use super::STAMP;
use super::surroundings::unhex;
use crate::cdr::CdrError;
use crate::message::*;

const POSE: &str = "0001000007e5926915cd5b07040000006d617000000000000000f83f00000000000002c0000000000000c03f00000000000000003333\
    33333333e33f00000000000000009a9999999999e93f";
const POSE_WITH_COVARIANCE: &str = "0001000007e5926915cd5b07040000006d617000000000000000f83f00000000000002c0000000000000c03f00000000000000003333\
    33333333e33f00000000000000009a9999999999e93f0000000000000000000000000000f03f00000000000000400000000000000840\
    0000000000001040000000000000144000000000000018400000000000001c4000000000000020400000000000002240000000000000\
    2440000000000000264000000000000028400000000000002a400000000000002c400000000000002e40000000000000304000000000\
    000031400000000000003240000000000000334000000000000034400000000000003540000000000000364000000000000037400000\
    00000000384000000000000039400000000000003a400000000000003b400000000000003c400000000000003d400000000000003e40\
    0000000000003f400000000000004040000000000080404000000000000041400000000000804140";
const ODOMETRY: &str = "0001000007e5926915cd5b07050000006f646f6d000000000a000000626173655f6c696e6b00000000000000000000000000f83f0000\
    0000000002c0000000000000c03f0000000000000000333333333333e33f00000000000000009a9999999999e93f0000000000000000\
    000000000000f03f00000000000000400000000000000840000000000000104000000000000014400000000000001840000000000000\
    1c40000000000000204000000000000022400000000000002440000000000000264000000000000028400000000000002a4000000000\
    00002c400000000000002e40000000000000304000000000000031400000000000003240000000000000334000000000000034400000\
    00000000354000000000000036400000000000003740000000000000384000000000000039400000000000003a400000000000003b40\
    0000000000003c400000000000003d400000000000003e400000000000003f4000000000000040400000000000804040000000000000\
    41400000000000804140000000000000f83f00000000000002c0000000000000c03f000000000000f83f00000000000002c000000000\
    0000c03f0000000000000000000000000000f03f00000000000000400000000000000840000000000000104000000000000014400000\
    0000000018400000000000001c4000000000000020400000000000002240000000000000244000000000000026400000000000002840\
    0000000000002a400000000000002c400000000000002e40000000000000304000000000000031400000000000003240000000000000\
    334000000000000034400000000000003540000000000000364000000000000037400000000000003840000000000000394000000000\
    00003a400000000000003b400000000000003c400000000000003d400000000000003e400000000000003f4000000000000040400000\
    00000080404000000000000041400000000000804140";
const TRANSFORM: &str = "0001000007e5926915cd5b0706000000776f726c6400000005000000626f647900000000000000000000f83f00000000000002c00000\
    00000000c03f0000000000000000333333333333e33f00000000000000009a9999999999e93f";
/// Two poses, a second apart.
const PATH: &str = "000100000ce5926915cd5b07040000006d6170000200000007e5926915cd5b07040000006d61700000000000000000000000f83f0000\
    0000000002c0000000000000c03f0000000000000000333333333333e33f00000000000000009a9999999999e93f08e5926915cd5b07\
    040000006d617000000000000000044000000000000002c0000000000000c03f0000000000000000333333333333e33f000000000000\
    00009a9999999999e93f";
/// `world.body` twice, a second apart, and `world.camera_0` between them.
const TRANSFORMS: &str = "000100000300000007e5926915cd5b0706000000776f726c6400000005000000626f64790000000000000000000000000000f83f0000\
    0000000002c0000000000000c03f0000000000000000333333333333e33f00000000000000009a9999999999e93f07e5926915cd5b07\
    06000000776f726c640000000900000063616d6572615f300000000000000000000000000000f83f00000000000002c0000000000000\
    c03f0000000000000000333333333333e33f00000000000000009a9999999999e93f08e5926915cd5b0706000000776f726c64000000\
    05000000626f647900000000000000000000044000000000000002c0000000000000c03f0000000000000000333333333333e33f0000\
    0000000000009a9999999999e93f";

#[test]
fn a_pose_is_written_as_ros_has_it() {
    let poses = decode_poses("geometry_msgs/msg/PoseStamped", &unhex(POSE)).unwrap();
    let bytes = encode_pose(STAMP, "map", &poses[0].pose);
    assert_eq!(super::hex(&bytes), POSE);
}

#[test]
fn a_pose_with_its_covariance_is_written_as_ros_has_it() {
    let schema = "geometry_msgs/msg/PoseWithCovarianceStamped";
    let poses = decode_poses(schema, &unhex(POSE_WITH_COVARIANCE)).unwrap();
    let covariance = std::array::from_fn(|i| i as f64);
    let bytes = encode_pose_with_covariance(STAMP, "map", &poses[0].pose, &covariance);
    assert_eq!(bytes, unhex(POSE_WITH_COVARIANCE));
}

#[test]
fn every_type_says_the_same_pose() {
    let counted: [f64; 36] = std::array::from_fn(|i| i as f64);
    for (schema, text, frame, child_frame, covariance) in [
        ("geometry_msgs/msg/PoseStamped", POSE, "map", "", None),
        (
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            POSE_WITH_COVARIANCE,
            "map",
            "",
            Some(counted),
        ),
        (
            "nav_msgs/msg/Odometry",
            ODOMETRY,
            "odom",
            "base_link",
            Some(counted),
        ),
        (
            "geometry_msgs/msg/TransformStamped",
            TRANSFORM,
            "world",
            "body",
            None,
        ),
    ] {
        assert!(holds_poses(schema));
        let bytes = unhex(text);
        let [read] = &decode_poses(schema, &bytes).expect(schema)[..] else {
            panic!("{schema}: not one pose");
        };
        assert_eq!(read.time, STAMP);
        assert_eq!(
            (read.frame.as_str(), read.child_frame.as_str()),
            (frame, child_frame)
        );
        assert_eq!(read.pose.translation.as_slice(), [1.5, -2.25, 0.125]);
        let q = read.pose.rotation;
        assert!((q.j - 0.6).abs() < 1e-15 && (q.w - 0.8).abs() < 1e-15 && q.i == 0.0 && q.k == 0.0);
        assert_eq!(read.covariance, covariance);
        for length in 0..bytes.len() {
            let cut = decode_poses(schema, &bytes[..length]);
            // What follows the pose's covariance in an odometry message is not read.
            assert!(
                cut.is_err() || cut == Ok(vec![read.clone()]),
                "{schema} {length}"
            );
        }
    }
    assert!(!holds_poses("sensor_msgs/msg/Imu"));
}

/// A pose that nobody filled in would be read as the origin, and look like an estimate.
#[test]
fn a_pose_that_is_none_is_refused() {
    let mut bytes = unhex(POSE);
    let quaternion = bytes.len() - 32;
    bytes[quaternion..].fill(0);
    let refused = decode_poses("geometry_msgs/msg/PoseStamped", &bytes);
    assert_eq!(refused, Err(CdrError::Value { field: "pose" }));
}

#[test]
fn messages_of_several_poses_say_each() {
    for (schema, text, frames) in [
        ("nav_msgs/msg/Path", PATH, vec!["", ""]),
        (
            "tf2_msgs/msg/TFMessage",
            TRANSFORMS,
            vec!["body", "camera_0", "body"],
        ),
    ] {
        let bytes = unhex(text);
        let read = decode_poses(schema, &bytes).expect(schema);
        let children: Vec<&str> = read.iter().map(|p| p.child_frame.as_str()).collect();
        assert_eq!(children, frames);
        let last = read.last().expect("poses");
        assert_eq!(last.time, STAMP.plus_secs(1.0));
        assert_eq!(last.pose.translation.as_slice(), [2.5, -2.25, 0.125]);
        for length in 0..bytes.len() {
            assert!(decode_poses(schema, &bytes[..length]).is_err(), "{length}");
        }
        // A count that no message has is no reason to take memory.
        let mut many = bytes.clone();
        let at = if schema.starts_with("nav") { 20 } else { 4 };
        many[at..at + 4].fill(0xff);
        assert!(decode_poses(schema, &many).is_err(), "{schema}");
    }
    assert!(holds_path("nav_msgs/msg/Path") && holds_edges("tf2_msgs/msg/TFMessage"));
}
