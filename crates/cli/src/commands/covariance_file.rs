//! The file of poses with their covariance that stands beside a trajectory, as `lsfb eval` reads it.

use std::fmt::Write as _;

use lsfb_eval::covariance_in_world;
use lsfb_geometry::{Matrix6, StampedPose};

/// TUM's columns, then the covariance of x, y, z and of rotations about the world's axes, row by row. The covariances are of
/// `[rotation, translation]` in the tangents of the poses; `says` stands in the head: what is in them and what is not.
pub fn text<'a>(
    says: &str,
    poses: impl IntoIterator<Item = (&'a StampedPose, &'a Matrix6<f64>)>,
) -> String {
    let mut text = String::from(
        "# timestamp_s tx_m ty_m tz_m qx qy qz qw, covariance of x y z (m) and rotations about the world's axes (rad), 36 columns\n",
    );
    for line in says.lines() {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "# {line}");
    }
    for (pose, covariance) in poses {
        let t = &pose.world_from_rig.translation;
        let q = pose.world_from_rig.rotation.quaternion();
        // Writing into a string cannot fail.
        let _ = write!(
            text,
            "{} {} {} {} {} {} {} {}",
            pose.time, t.x, t.y, t.z, q.i, q.j, q.k, q.w
        );
        let in_world = covariance_in_world(covariance, &pose.world_from_rig);
        for value in in_world.iter() {
            let _ = write!(text, " {value:e}");
        }
        text.push('\n');
    }
    text
}
