//! Rows of text. Numbers have as many digits as give the same number again.

use std::fmt::Write as _;

use lsfb_geometry::StampedPose;

use crate::Orientations;

const KAPTURE_HEAD: &str = "# kapture format: 1.1\n";
/// The device of kapture's rows.
const DEVICE: &str = "rig";

/// As EuRoC and TUM-VI have it: stamp in nanoseconds, position, quaternion with w first; neither velocities nor biases.
pub fn euroc_text(poses: &[StampedPose]) -> String {
    let mut text = String::from(
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n",
    );
    for pose in poses {
        let t = pose.world_from_rig.translation;
        let q = pose.world_from_rig.rotation.quaternion();
        row(
            &mut text,
            ",",
            pose.time.nanos(),
            &[t.x, t.y, t.z, q.w, q.i, q.j, q.k],
        );
    }
    text
}

/// A table with its columns' names.
pub(super) fn csv(poses: &[StampedPose], orientations: Orientations) -> String {
    let is_turned = orientations == Orientations::Known;
    let mut text = String::from("timestamp_s,x_m,y_m,z_m");
    text += if is_turned { ",qx,qy,qz,qw\n" } else { "\n" };
    for pose in poses {
        let t = pose.world_from_rig.translation;
        let q = pose.world_from_rig.rotation.quaternion();
        let values = [t.x, t.y, t.z, q.i, q.j, q.k, q.w];
        let count = if is_turned { values.len() } else { 3 };
        row(&mut text, ",", pose.time, &values[..count]);
    }
    text
}

/// The first three rows of each pose's matrix.
pub(super) fn kitti(poses: &[StampedPose]) -> String {
    let mut text = String::new();
    for pose in poses {
        let rotation = pose.world_from_rig.rotation_matrix();
        let t = pose.world_from_rig.translation;
        let values: [f64; 12] = std::array::from_fn(|i| match (i / 4, i % 4) {
            (line, 3) => t[line],
            (line, column) => rotation[(line, column)],
        });
        let [first, rest @ ..] = values;
        row(&mut text, " ", first, &rest);
    }
    text
}

/// The stamps of those rows, seconds.
pub(super) fn times(poses: &[StampedPose]) -> String {
    let mut text = String::new();
    for pose in poses {
        row(&mut text, "", pose.time, &[]);
    }
    text
}

/// The one device whose poses they are.
pub(super) fn kapture_sensors() -> String {
    format!(
        "{KAPTURE_HEAD}# sensor_id, name, sensor_type, [sensor_params]+\n{DEVICE}, {DEVICE}, unknown\n"
    )
}

/// Poses of the world in the device.
pub(super) fn kapture(poses: &[StampedPose]) -> String {
    let mut text = format!("{KAPTURE_HEAD}# timestamp, device_id, qw, qx, qy, qz, tx, ty, tz\n");
    for pose in poses {
        let device_from_world = pose.world_from_rig.inverse();
        let t = device_from_world.translation;
        let q = device_from_world.rotation.quaternion();
        let head = format!("{}, {DEVICE}", pose.time.nanos());
        row(&mut text, ", ", head, &[q.w, q.i, q.j, q.k, t.x, t.y, t.z]);
    }
    text
}

fn row(text: &mut String, separator: &str, first: impl std::fmt::Display, values: &[f64]) {
    // Writing into a string cannot fail.
    let _ = write!(text, "{first}");
    for value in values {
        let _ = write!(text, "{separator}{value}");
    }
    text.push('\n');
}
