//! Poses as ROS programs publish them.

use lsfb_geometry::{Se3, Vector3};
use lsfb_types::Timestamp;
use nalgebra::{Quaternion, UnitQuaternion};

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// A pose that a message says.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseReading {
    /// Stamp of its header.
    pub time: Timestamp,
    /// The frame in which the pose is given.
    pub frame: String,
    /// The frame that is placed; empty where the type does not say it.
    pub child_frame: String,
    /// `frame_from_child`.
    pub pose: Se3,
    /// Covariance of x y z and of rotations about the fixed axes x y z, row by row, m² and rad²; `None` where the type has none or all
    /// of it is zero.
    pub covariance: Option<[f64; 36]>,
}

/// `geometry_msgs/msg/PoseStamped`: where a device has itself, in a world of its own called `frame`.
pub fn encode_pose(time: Timestamp, frame: &str, frame_from_device: &Se3) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(96 + frame.len());
    w.header(time, frame);
    w.f64s(frame_from_device.translation.as_slice());
    // nalgebra stores quaternions as x y z w, the order of the message.
    w.f64s(frame_from_device.rotation.coords.as_slice());
    w.finish()
}

/// `geometry_msgs/msg/PoseWithCovarianceStamped`: the same, with the covariance of x y z and of rotations about the axes of `frame`, row by
/// row, m² and rad².
pub fn encode_pose_with_covariance(
    time: Timestamp,
    frame: &str,
    frame_from_device: &Se3,
    covariance: &[f64; 36],
) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(384 + frame.len());
    w.header(time, frame);
    w.f64s(frame_from_device.translation.as_slice());
    w.f64s(frame_from_device.rotation.coords.as_slice());
    w.f64s(covariance);
    w.finish()
}

/// A message type that says poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Pose,
    PoseWithCovariance,
    Odometry,
    Transform,
    Path,
    Transforms,
}

impl Kind {
    fn of(schema: &str) -> Option<Self> {
        match schema {
            "geometry_msgs/msg/PoseStamped" => Some(Self::Pose),
            "geometry_msgs/msg/PoseWithCovarianceStamped" => Some(Self::PoseWithCovariance),
            "nav_msgs/msg/Odometry" => Some(Self::Odometry),
            "geometry_msgs/msg/TransformStamped" => Some(Self::Transform),
            "nav_msgs/msg/Path" => Some(Self::Path),
            "tf2_msgs/msg/TFMessage" => Some(Self::Transforms),
            _ => None,
        }
    }
}

/// Whether [`decode_poses`] reads messages of a type.
pub fn holds_poses(schema: &str) -> bool {
    Kind::of(schema).is_some()
}

/// Whether each message of a type repeats the whole trajectory, as `nav_msgs/Path` does.
pub fn holds_path(schema: &str) -> bool {
    Kind::of(schema) == Some(Kind::Path)
}

/// Whether the poses of a type are edges between frames of many names, as those of `/tf` are.
pub fn holds_edges(schema: &str) -> bool {
    Kind::of(schema) == Some(Kind::Transforms)
}

/// The poses in a message of the type `schema`.
pub fn decode_poses(schema: &str, bytes: &[u8]) -> Result<Vec<PoseReading>, CdrError> {
    let kind = Kind::of(schema).ok_or(CdrError::Value { field: "type" })?;
    let mut r = CdrReader::new(bytes)?;
    let each = match kind {
        Kind::Path => {
            r.header()?;
            Kind::Pose
        }
        Kind::Transforms => Kind::Transform,
        one => return Ok(vec![pose(one, &mut r)?]),
    };
    let count = r.u32("poses")?;
    // The count is not believed: memory grows with what is there.
    let mut found = Vec::new();
    for _ in 0..count {
        found.push(pose(each, &mut r)?);
    }
    Ok(found)
}

fn pose(kind: Kind, r: &mut CdrReader<'_>) -> Result<PoseReading, CdrError> {
    let header = r.header()?;
    let child_frame = match kind {
        Kind::Odometry | Kind::Transform => r.string("child_frame_id")?,
        _ => "",
    };
    let translation = Vector3::from(r.f64_array("position")?);
    let [x, y, z, w] = r.f64_array("orientation")?;
    let quaternion = Quaternion::new(w, x, y, z);
    // Zero is what a message holds that nobody filled in.
    let is_rotation = (0.5..2.0).contains(&quaternion.norm());
    if !is_rotation || !translation.iter().all(|v| v.is_finite()) {
        return Err(CdrError::Value { field: "pose" });
    }
    let covariance = match kind {
        Kind::PoseWithCovariance | Kind::Odometry => {
            let values: [f64; 36] = r.f64_array("covariance")?;
            values.iter().any(|v| *v != 0.0).then_some(values)
        }
        _ => None,
    };
    Ok(PoseReading {
        time: header.stamp,
        frame: header.frame_id.to_owned(),
        child_frame: child_frame.to_owned(),
        pose: Se3::new(UnitQuaternion::new_normalize(quaternion), translation),
        covariance,
    })
}
