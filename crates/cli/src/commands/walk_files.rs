//! The files that a walk's ground truth is written to.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_pipeline::ground_truth::GroundTruth;
use lsfb_recording::write_tum;

use super::{covariance_file, motion_file};
use crate::files;

/// A trajectory, and what lies beside it.
pub struct WalkFiles {
    trajectory: PathBuf,
    covariances: PathBuf,
    cross_check: PathBuf,
    states: PathBuf,
    motion: PathBuf,
}

impl WalkFiles {
    fn of(trajectory: PathBuf) -> Self {
        let states = files::beside(&trajectory, "states").with_extension("csv");
        Self {
            covariances: files::beside(&trajectory, "covariance"),
            cross_check: files::beside(&trajectory, "cross_check"),
            motion: states.with_extension("mcap"),
            states,
            trajectory,
        }
    }

    /// Of a walk, and of the recordings of others that are solved together with it: `walk.tum` and `glasses.mcap` →
    /// `walk_with_glasses.tum`, a second one of that name `walk_with_glasses_2.tum`.
    pub fn of_walks(trajectory: &Path, others: &[PathBuf]) -> Vec<Self> {
        let stem = |path: &Path| {
            path.file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        };
        let mut found = vec![Self::of(trajectory.to_owned())];
        for other in others {
            let first = format!("{}_with_{}", stem(trajectory), stem(other));
            let numbered = (2..).map(|n| format!("{first}_{n}"));
            let names = std::iter::once(first.clone()).chain(numbered);
            let mut paths = names.map(|name| {
                let path = trajectory.with_file_name(name);
                match trajectory.extension() {
                    // Not by `with_extension`, which takes what stands behind a dot in a recording's name for one.
                    Some(ending) => {
                        let mut path = path.into_os_string();
                        path.push(".");
                        path.push(ending);
                        PathBuf::from(path)
                    }
                    None => path,
                }
            });
            let is_free = |path: &PathBuf| found.iter().all(|f: &Self| f.trajectory != *path);
            found.extend(paths.find(is_free).map(Self::of));
        }
        found
    }

    /// The trajectory.
    pub fn trajectory(&self) -> &Path {
        &self.trajectory
    }

    /// What lies beside it.
    pub fn beside(&self) -> [PathBuf; 4] {
        let Self {
            covariances,
            cross_check,
            states,
            motion,
            ..
        } = self;
        [covariances, cross_check, states, motion].map(PathBuf::clone)
    }

    /// Writes all of them.
    pub fn write(&self, found: &GroundTruth) -> anyhow::Result<()> {
        write_tum(&self.trajectory, &found.trajectory)?;
        let poses = found.trajectory.poses().iter().zip(&found.covariances);
        files::write(&self.covariances, covariance_file::text(NOT_IN_IT, poses))?;
        files::write(&self.cross_check, disagreements(found))?;
        files::write(&self.states, states_text(found))?;
        motion_file::write(found, &self.motion)
    }
}

/// What the covariances leave out.
const NOT_IN_IT: &str = "Included: errors of images, of the IMU, of the cameras, of single map points and of \
     neighbouring ones together. Not included: errors\nshared by the whole map around, its scale and its position, which a walk cannot \
     reveal.";

/// EuRoC's columns of a state (position and velocity in the world, rotation, biases of the IMU), and the turn rate, at the IMU's rate.
fn states_text(found: &GroundTruth) -> String {
    let [x, y, z]: [f64; 3] = found.gravity_m_s2.into();
    let mut text = format!(
        "# gravity in the world of these states: {x:.6} {y:.6} {z:.6} m/s^2\n\
         #timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], \
         v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], \
         b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2], w_RS_S_x [rad s^-1], w_RS_S_y [rad s^-1], w_RS_S_z [rad s^-1]\n"
    );
    for state in &found.states {
        let pose = &state.nav.world_from_rig;
        let q = pose.rotation.quaternion();
        let vectors = [
            state.nav.velocity_m_s,
            state.bias.gyro_rad_s,
            state.bias.accel_m_s2,
            state.turn_rate_rad_s,
        ];
        let turned = [q.w, q.i, q.j, q.k];
        let cells = pose.translation.iter().chain(&turned);
        let _ = write!(text, "{}", state.time.nanos());
        for cell in cells.chain(vectors.iter().flatten()) {
            let _ = write!(text, ",{cell:.9}");
        }
        text.push('\n');
    }
    text
}

/// How far half of the map's points move each position.
fn disagreements(found: &GroundTruth) -> String {
    let mut text = String::from("# timestamp_s disagreement_m\n");
    for (pose, moved_m) in found.trajectory.poses().iter().zip(&found.disagreements_m) {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "{} {moved_m:.6}", pose.time);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walks_of_one_name_have_files_of_their_own() {
        let others = ["a/walk.v2.mcap", "b/walk.v2.mcap", "glasses.mcap"].map(PathBuf::from);
        let files = WalkFiles::of_walks(Path::new("out/phone.tum"), &others);
        let written: Vec<&Path> = files.iter().map(WalkFiles::trajectory).collect();
        let expected = [
            "out/phone.tum",
            "out/phone_with_walk.v2.tum",
            "out/phone_with_walk.v2_2.tum",
            "out/phone_with_glasses.tum",
        ];
        assert_eq!(written, expected.map(Path::new));
        let mut all: Vec<PathBuf> = files.iter().flat_map(WalkFiles::beside).collect();
        all.extend(written.into_iter().map(Path::to_owned));
        let count = all.len();
        all.sort();
        all.dedup();
        assert_eq!(all.len(), count, "{all:?}");
    }
}
