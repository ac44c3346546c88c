//! What should be recorded better, and what contradicts the result.

use lsfb_geometry::{Rig, Se3, Vector3};

use super::association::direction_name;
use super::solved::{Solved, patch};
use super::{LidarCameraCalibration, MountedBoard, Scene};

/// Apparent excess of half the plate that the width of the beam does not explain, metres.
const LARGE_EXCESS_M: f64 = 0.015;
/// Scale that differs from one by more than this, and by more than its own spread, is no accident.
const LARGE_SCALE: f64 = 0.01;
/// Standard deviations beyond which more poses are asked for.
const GOOD_ROTATION_DEG: f64 = 0.1;
const GOOD_TRANSLATION_M: f64 = 0.01;
/// Spread of planes and outlines beyond which the sensors contradict each other.
const LARGE_SPREAD: f64 = 3.0;
/// Plate's middle off by more than this, and by more than its own spread explains, is no accident, metres.
const LARGE_SHIFT_M: f64 = 0.005;
/// Difference between the clocks that moves boards by more than the noise of their planes, seconds.
const LATE_S: f64 = 0.003;
/// Standard deviations beyond which a finding is none of chance: with a dozen checks, one false alarm in a thousand sessions.
const DEVIATIONS: f64 = 4.0;
/// How well a pose on a rig is known that was measured by hand, radians and metres.
const BY_HAND_RAD: f64 = 0.26;
const BY_HAND_M: f64 = 0.1;

impl LidarCameraCalibration {
    /// Compares the result with the rig it started from, where that has a LiDAR: a camera that was exchanged for another, or
    /// moved since, is added to the warnings.
    pub fn compare_with(&mut self, rig: &Rig) {
        let Some(lidar) = rig.lidar() else {
            return;
        };
        let off = |name: &str| {
            let camera = rig.cameras.get(name)?;
            let expected = camera.rig_from_camera.inverse() * lidar.rig_from_lidar;
            let off = (expected.inverse() * self.camera_from_lidar).log();
            let turn_rad = off.fixed_rows::<3>(0).norm();
            let shift_m = Se3::exp(&off).translation.norm();
            Some((
                turn_rad,
                shift_m,
                turn_rad / BY_HAND_RAD + shift_m / BY_HAND_M,
            ))
        };
        let Some((turn_rad, shift_m, own)) = off(&self.camera) else {
            return;
        };
        if turn_rad < BY_HAND_RAD && shift_m < BY_HAND_M {
            return;
        }
        let others = rig.cameras.keys().filter(|name| **name != self.camera);
        let better = others
            .filter_map(|name| Some((name, off(name)?)))
            .filter(|(_, (turn_rad, _, all))| *turn_rad < BY_HAND_RAD && *all < 0.5 * own)
            .min_by(|a, b| a.1.2.total_cmp(&b.1.2));
        self.warnings.push(match better {
            Some((name, _)) => format!(
                "{} is found where the rig has {name}: their images are swapped, or their names",
                self.camera
            ),
            None => format!(
                "the rig has {} {:.1}° and {:.0} mm away from what was found: check which camera and which rig this is",
                self.camera,
                turn_rad.to_degrees(),
                shift_m * 1e3
            ),
        });
    }
}

/// The plate's middle, against where it was said to be.
fn shift_warning(c: &LidarCameraCalibration, board: &MountedBoard) -> Option<String> {
    let clear = |k: usize| {
        let limit = LARGE_SHIFT_M.max(DEVIATIONS * c.offset_error_sigma_m[k]);
        c.offset_error_m[k].abs() > limit
    };
    if !clear(0) && !clear(1) {
        return None;
    }
    let found: [f64; 2] = std::array::from_fn(|k| board.offset_m[k] + c.offset_error_m[k]);
    // Turned by half a turn, the plate's middle is on the other side of the pattern's.
    let opposite = (0..2).all(|k| {
        let limit = LARGE_SHIFT_M.max(DEVIATIONS * c.offset_error_sigma_m[k]);
        (found[k] + board.offset_m[k]).abs() < limit
    });
    let place = format!(
        "the plate's middle lies {:+.0}, {:+.0} mm from that of the corners, {:+.0}, {:+.0} mm was said",
        found[0] * 1e3,
        found[1] * 1e3,
        board.offset_m[0] * 1e3,
        board.offset_m[1] * 1e3
    );
    Some(if opposite {
        format!("the pattern is upside down on its plate: {place}; turn the sign of --offset")
    } else {
        format!("{place}: measure it")
    })
}

pub(super) fn warnings(
    c: &LidarCameraCalibration,
    board: &MountedBoard,
    scenes: &[Scene],
    solved: &Solved,
) -> Vec<String> {
    let mut out = Vec::new();
    let left_out = c.poses.iter().filter(|p| p.rejected.is_some()).count();
    if 4 * left_out > c.poses.len() {
        out.push(format!(
            "{left_out} of {} poses were left out: see the table for the reasons",
            c.poses.len()
        ));
    }
    if (c.scale - 1.0).abs() > (4.0 * c.scale_sigma).max(LARGE_SCALE) {
        out.push(format!(
            "{}. Measure it, and check the camera's focal length",
            size_words(board, c.scale, c.scale_sigma)
        ));
    }
    for (k, side) in ["x", "y"].iter().enumerate() {
        if c.edge_excess_m[k].abs() > LARGE_EXCESS_M.max(5.0 * c.edge_excess_sigma_m[k]) {
            out.push(format!(
                "the plate looks {:+.0} mm longer along the pattern's {side} axis than was said: measure it",
                2e3 * c.edge_excess_m[k]
            ));
        }
    }
    out.extend(shift_warning(c, board));
    if let (Some(late), Some(sigma)) = (c.lidar_late_s, c.lidar_late_sigma_s)
        && late.abs() > LATE_S.max(DEVIATIONS * sigma)
    {
        out.push(format!(
            "clocks: scans are stamped {:.0} ± {:.0} ms {} than images, by how boards moved: check with `lsfb clock`, or hold the board still",
            late.abs() * 1e3,
            sigma * 1e3,
            if late > 0.0 { "later" } else { "earlier" }
        ));
    }
    let worst = |from: usize| {
        (from..from + 3)
            .max_by(|a, b| c.sigma[*a].total_cmp(&c.sigma[*b]))
            .unwrap_or(from)
    };
    let axis = |k: usize| {
        let mut unit = Vector3::zeros();
        unit[k % 3] = 1.0;
        direction_name(&unit)
    };
    let turn = worst(0);
    if c.sigma[turn].to_degrees() > GOOD_ROTATION_DEG {
        out.push(format!(
            "rotation about the LiDAR's {} axis is known to {:.2}° only: record more poses, with the board near the border of the image",
            axis(turn),
            c.sigma[turn].to_degrees()
        ));
    }
    let shift = worst(3);
    if c.sigma[shift] > GOOD_TRANSLATION_M {
        out.push(format!(
            "translation along the LiDAR's {} axis is known to {:.0} mm only: tilt the board so that it faces along it more",
            axis(shift),
            c.sigma[shift] * 1e3
        ));
    }
    let causes = [
        (
            "corners",
            "the lens is not that of these images, or the board is bent",
        ),
        (
            "planes",
            "the LiDAR's beams differ from each other or measure black and white differently, the board is bent, or it did not stand still",
        ),
        (
            "outlines",
            "something stands close to the board, or it did not stand still",
        ),
    ];
    for ((name, cause), spread) in causes.iter().zip(c.spread) {
        if spread > LARGE_SPREAD {
            out.push(format!(
                "{name} miss by {spread:.1} times what their noise explains, which is in the standard deviations: {cause}"
            ));
        }
    }
    let few = solved
        .used
        .iter()
        .filter(|u| patch(scenes, u).points < 100)
        .count();
    if 2 * few > solved.used.len() {
        out.push(format!(
            "{few} of {} boards have fewer than 100 points: bring the board nearer",
            solved.used.len()
        ));
    }
    out
}

/// What the scale of the camera's scene says of the pattern, in words.
pub(super) fn size_words(board: &MountedBoard, scale: f64, scale_sigma: f64) -> String {
    let excess = 1.0 / scale - 1.0;
    format!(
        "the pattern is {:.1} ± {:.1} % {} than said, by the LiDAR: {}",
        excess.abs() * 100.0,
        scale_sigma / (scale * scale) * 100.0,
        if excess > 0.0 { "larger" } else { "smaller" },
        board.target.scaled_words(1.0 / scale)
    )
}
