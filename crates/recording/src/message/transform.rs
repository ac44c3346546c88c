use lsfb_geometry::Se3;
use lsfb_types::Timestamp;

use crate::cdr::CdrWriter;
use crate::topic;

/// One edge of `/tf_static`.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticTransform {
    /// Frame in which the pose is given.
    pub parent: String,
    /// The frame that is placed.
    pub child: String,
    /// Pose of the child in the parent frame.
    pub parent_from_child: Se3,
}

/// `tf2_msgs/msg/TFMessage` of one edge: where the live odometry has the rig.
pub fn encode_odometry(time: Timestamp, odom_from_rig: &Se3) -> Vec<u8> {
    let edge = StaticTransform {
        parent: topic::ODOM_FRAME.to_owned(),
        child: topic::RIG_FRAME.to_owned(),
        parent_from_child: *odom_from_rig,
    };
    encode_static_transforms(time, &[edge])
}

/// `tf2_msgs/msg/TFMessage`.
pub fn encode_static_transforms(time: Timestamp, transforms: &[StaticTransform]) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(128 * transforms.len());
    w.u32(transforms.len() as u32);
    for transform in transforms {
        w.header(time, &transform.parent);
        w.string(&transform.child);
        let pose = &transform.parent_from_child;
        w.f64s(pose.translation.as_slice());
        // nalgebra stores quaternions as x y z w, the order of the message.
        w.f64s(pose.rotation.coords.as_slice());
    }
    w.finish()
}
