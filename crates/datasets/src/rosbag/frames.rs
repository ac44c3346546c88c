//! Poses of frames in each other along the edges of `/tf_static`.

use std::collections::BTreeMap;

use lsfb_geometry::Se3;
use lsfb_recording::message::StaticTransform;

/// Pose of the frame `source` in the frame `target`, along however many edges in either direction; `None` where they are not
/// connected. Names are compared without the slash that ROS 1 once put before them.
pub fn pose_in(target: &str, source: &str, edges: &[StaticTransform]) -> Option<Se3> {
    let plain = |name: &str| name.trim_start_matches('/').to_owned();
    let mut reached = BTreeMap::from([(plain(target), Se3::identity())]);
    // Each round reaches the frames one edge farther.
    for _ in 0..=edges.len() {
        for edge in edges {
            let (parent, child) = (plain(&edge.parent), plain(&edge.child));
            match (reached.get(&parent).copied(), reached.get(&child).copied()) {
                (Some(of_parent), None) => {
                    reached.insert(child, of_parent * edge.parent_from_child);
                }
                (None, Some(of_child)) => {
                    reached.insert(parent, of_child * edge.parent_from_child.inverse());
                }
                (Some(_), Some(_)) | (None, None) => {}
            }
        }
        if let Some(found) = reached.get(&plain(source)) {
            return Some(*found);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn frames_are_found_against_and_along_the_edges() {
        let edge = |parent: &str, child: &str, x: f64, turn: f64| StaticTransform {
            parent: parent.to_owned(),
            child: child.to_owned(),
            parent_from_child: Se3::new(
                UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, turn)),
                Vector3::new(x, 0.0, 0.0),
            ),
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        let edges = [
            edge("mount", "/lidar", 1.0, 0.0),
            edge("base", "mount", 2.0, quarter),
            edge("base", "imu", 0.5, 0.0),
        ];
        let found = pose_in("imu", "lidar", &edges).expect("connected");
        let expected = Vector3::new(1.5, 1.0, 0.0);
        assert!((found.translation - expected).norm() < 1e-12, "{found:?}");
        assert!(pose_in("imu", "gnss", &edges).is_none());
        assert_eq!(pose_in("imu", "imu", &[]), Some(Se3::identity()));
    }
}
