//! True trajectories in the files that SLAM systems are judged by.

use std::fmt::Write as _;

use lsfb_geometry::StampedPose;

/// As EuRoC and TUM-VI have it: stamp in nanoseconds, position, quaternion with w first; neither velocities nor biases.
pub fn euroc_truth(poses: &[StampedPose]) -> String {
    let mut text = String::from(
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n",
    );
    for pose in poses {
        let t = pose.world_from_rig.translation;
        let q = pose.world_from_rig.rotation.quaternion();
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{}",
            pose.time.nanos(),
            t.x,
            t.y,
            t.z,
            q.w,
            q.i,
            q.j,
            q.k
        );
    }
    text
}
