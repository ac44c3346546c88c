//! What should be recorded better, and what contradicts the result.

use lsfb_geometry::{Rig, Se3, Vector3};
use lsfb_types::{Finding, Limit, Verdict};

use super::association::direction_name;
use super::solved::{Solved, patch};
use super::{LidarCameraCalibration, MountedBoard, PoseFit, Scene};
use crate::PatternExcess;
use crate::findings::unseen_corners;

/// Apparent excess of half the plate that the width of the beam does not explain, metres.
const LARGE_EXCESS_M: f64 = 0.015;
/// Scale that differs from one by more than this, and by more than its own spread, is no accident.
const LARGE_SCALE: f64 = 0.01;
/// Standard deviations beyond which more poses are asked for.
const GOOD_ROTATION_DEG: f64 = 0.1;
const GOOD_TRANSLATION_M: f64 = 0.01;
/// Points on a board below which it is too far away.
const FEW_POINTS: usize = 100;
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
    /// moved since, is added to the findings.
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
        let finding = |what| Finding::new("place", Verdict::Warn, &*self.camera, what);
        self.findings.push(match better {
            Some((name, _)) => finding(format!(
                "was found where the rig has {name}: their images or their names are swapped"
            ))
            .remedy("check which images belong to which camera"),
            None => finding(format!(
                "its pose differs by {:.1}° and {:.0} mm from the rig's",
                turn_rad.to_degrees(),
                shift_m * 1e3
            ))
            .remedy("check which camera and which rig this is"),
        });
    }
}

/// A measure of the board beside what was said of it: millimetres.
fn board_finding(code: &'static str, what: String, value_mm: f64, limit_mm: f64) -> Finding {
    Finding::new(code, Verdict::Warn, "board", what)
        .value(value_mm, "mm")
        .limit(Limit::AtMost(limit_mm))
}

/// The plate's middle, against where it was said to be.
fn shift(c: &LidarCameraCalibration, board: &MountedBoard) -> Option<Finding> {
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
        "the plate's centre is at {:+.0}, {:+.0} mm from the centre of the corners, but {:+.0}, {:+.0} mm was given",
        found[0] * 1e3,
        found[1] * 1e3,
        board.offset_m[0] * 1e3,
        board.offset_m[1] * 1e3
    );
    let off_mm = c.offset_error_m[0].hypot(c.offset_error_m[1]) * 1e3;
    let limit_mm = LARGE_SHIFT_M * 1e3;
    Some(if opposite {
        let what = format!("the pattern is upside down on its plate: {place}");
        board_finding("plate-offset", what, off_mm, limit_mm)
            .remedy("change the sign of --plate-offset-m")
    } else {
        board_finding("plate-offset", place, off_mm, limit_mm).remedy("measure it")
    })
}

/// What is to be said of a result.
pub(super) fn findings(
    c: &LidarCameraCalibration,
    board: &MountedBoard,
    scenes: &[Scene],
    solved: &Solved,
) -> Vec<Finding> {
    let mut out = vec![poses_left_out(c)];
    out.extend(unseen_corners(&c.camera, &c.cells));
    let limit = (4.0 * c.scale_sigma).max(LARGE_SCALE);
    let off = c.scale - 1.0;
    let what = if off.abs() > limit {
        pattern_excess(board, c.scale, c.scale_sigma).to_string()
    } else {
        format!(
            "according to the LiDAR, the pattern size is as specified (± {:.1} %)",
            100.0 * c.scale_sigma
        )
    };
    out.push(
        Finding::new(
            "board-size",
            Verdict::Warn.unless(off.abs() <= limit),
            "board",
            what,
        )
        .value(100.0 * off, "%")
        .sigma(100.0 * c.scale_sigma)
        .limit(Limit::AtMost((1e3 * limit).ceil() / 10.0))
        .remedy("measure it, and check the camera's focal length"),
    );
    for (k, side) in ["x", "y"].iter().enumerate() {
        let limit_m = LARGE_EXCESS_M.max(5.0 * c.edge_excess_sigma_m[k]);
        if c.edge_excess_m[k].abs() > limit_m {
            let longer_mm = 2e3 * c.edge_excess_m[k];
            let what = format!(
                "the plate looks {longer_mm:+.0} mm longer along the pattern's {side} axis than given"
            );
            let finding = board_finding("plate-size", what, longer_mm, 2e3 * limit_m);
            out.push(finding.remedy("measure it"));
        }
    }
    out.extend(shift(c, board));
    out.extend(clocks(c));
    out.extend(precision(c));
    out.extend(spreads(c));
    let few = solved
        .used
        .iter()
        .filter(|u| patch(scenes, u).points < FEW_POINTS)
        .count();
    let of = solved.used.len();
    let what = format!("{few} of {of} boards have fewer than {FEW_POINTS} points");
    out.push(
        Finding::new("points", Verdict::Warn.unless(2 * few <= of), "lidar", what)
            .value(few as f64, "boards")
            .limit(Limit::AtMost((of / 2) as f64))
            .remedy("bring the board closer"),
    );
    out
}

impl PoseFit {
    /// Of a pose that was left out nothing is known; one that does not fit is left out.
    pub fn verdict(&self) -> Verdict {
        match self.rejected {
            Some(_) => Verdict::Unknown,
            None => Verdict::Pass,
        }
    }
}

fn poses_left_out(c: &LidarCameraCalibration) -> Finding {
    let left_out = c.poses.iter().filter(|p| p.rejected.is_some()).count();
    let is_good = 4 * left_out <= c.poses.len();
    let what = format!("{left_out} of {} poses were left out", c.poses.len());
    Finding::new("poses", Verdict::Warn.unless(is_good), "poses", what)
        .value(left_out as f64, "poses")
        .limit(Limit::AtMost((c.poses.len() / 4) as f64))
        .remedy("see the table of poses for the reasons")
}

/// Times of scans against those of images, where boards moved.
fn clocks(c: &LidarCameraCalibration) -> Option<Finding> {
    let (late_s, sigma_s) = c.lidar_late_s.zip(c.lidar_late_sigma_s)?;
    let limit_s = LATE_S.max(DEVIATIONS * sigma_s);
    let is_good = late_s.abs() <= limit_s;
    let (late_ms, sigma_ms) = (late_s * 1e3, sigma_s * 1e3);
    let what = if is_good {
        format!("scans and images of moving boards agree in time (± {sigma_ms:.0} ms)")
    } else {
        format!(
            "according to moving boards, scans are stamped {:.0} ± {sigma_ms:.0} ms {} than images",
            late_ms.abs(),
            if late_s > 0.0 { "later" } else { "earlier" }
        )
    };
    let finding = Finding::new("clocks", Verdict::Warn.unless(is_good), "clocks", what)
        .value(late_ms, "ms")
        .sigma(sigma_ms)
        .limit(Limit::AtMost(limit_s * 1e3));
    Some(finding.remedy("check with `lsfb clock`, or hold the board still"))
}

/// How well the worst rotation and the worst translation are known.
fn precision(c: &LidarCameraCalibration) -> [Finding; 2] {
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
    let (turn, shift) = (worst(0), worst(3));
    let (turn_deg, shift_mm) = (c.sigma[turn].to_degrees(), c.sigma[shift] * 1e3);
    let limit = Limit::AtMost(GOOD_ROTATION_DEG);
    let what = format!(
        "rotation about the LiDAR's {} axis: standard deviation {turn_deg:.2}°",
        axis(turn)
    );
    let rotation = Finding::new("rotation-sigma", Verdict::Warn, &*c.camera, what)
        .judged(turn_deg, "°", limit)
        .remedy("record more poses, with the board near the border of the image");
    let limit = Limit::AtMost(GOOD_TRANSLATION_M * 1e3);
    let what = format!(
        "translation along the LiDAR's {} axis: standard deviation {shift_mm:.0} mm",
        axis(shift)
    );
    let translation = Finding::new("translation-sigma", Verdict::Warn, &*c.camera, what)
        .judged(shift_mm, "mm", limit)
        .remedy("tilt the board so that it faces more in that direction");
    [rotation, translation]
}

/// Corners, planes and outlines that miss by more than their noise explains.
fn spreads(c: &LidarCameraCalibration) -> impl Iterator<Item = Finding> {
    let causes = [
        (
            "corners",
            "check that the lens belongs to these images, and that the board is flat",
        ),
        (
            "planes",
            "check that the board is flat and stood still; otherwise the LiDAR's beams have different offsets, or measure black and white differently",
        ),
        (
            "outlines",
            "check that nothing stands close to the board, and that it stood still",
        ),
    ];
    causes.into_iter().zip(c.spread).map(|((name, remedy), spread)| {
        let limit = Limit::AtMost(LARGE_SPREAD);
        let what = format!(
            "residuals of {name} are {spread:.1} times their expected noise; the standard deviations account for that"
        );
        Finding::new("spread", Verdict::Warn, name, what)
            .judged(spread, "", limit)
            .remedy(remedy)
    })
}

/// What the scale of the camera's scene says of the pattern.
pub(super) fn pattern_excess(board: &MountedBoard, scale: f64, scale_sigma: f64) -> PatternExcess {
    PatternExcess {
        share: 1.0 / scale - 1.0,
        sigma: scale_sigma / (scale * scale),
        edges: board.target.scaled_words(1.0 / scale),
    }
}
