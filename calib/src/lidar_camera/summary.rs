//! What a LiDAR–camera calibration leaves.

use lsfb_geometry::{Camera, Se3, Vector2, Vector3};
use lsfb_types::Verdict;

use super::adjustment::{PatternSize, PlateShift, adjust, pattern_size, plate_shift};
use super::association::Joined;
use super::outline::{Rectangle, fitted};
use super::problem::edge_errors_m;
use super::solved::{Solved, Used, patch};
use super::{
    BoardResiduals, LidarCameraCalibration, LidarCameraConfig, MountedBoard, PoseFit, Scene,
    checks, clocks, halves,
};
use crate::coverage::COVERAGE_CELLS;
use crate::detect::Corner;
use crate::residual_diagnosis::{AdjustedCorner, AdjustedView, Diagnosis};
use crate::{Error, JoinProblem, WrongSize};

/// Poses from which halves are compared, and poses held back.
const MIN_FOR_PARTS: usize = 8;
/// Parts of the poses that are held back in turn.
const PARTS: usize = 4;
/// Scale that differs from one by more than this, and by more than its own spread, is no accident.
const WRONG_SCALE: f64 = 0.03;
/// Corners that miss by more than this many times the rest of their view say nothing.
const CORNER_OUTLIER: f64 = 4.0;
/// Distance between the middles beyond which sensors have not seen the same boards, metres.
const STRANGERS_M: f64 = 0.06;

/// A board as each sensor alone has it, in the camera's frame.
struct Alone {
    lidar_center: Vector3<f64>,
    camera_center: Vector3<f64>,
    normal_error_rad: f64,
}

pub(super) fn summarize(
    board: &MountedBoard,
    camera: &str,
    lens: &Camera,
    scenes: &[Scene],
    joined: &Joined,
    solved: &Solved,
    config: &LidarCameraConfig,
) -> Result<LidarCameraCalibration, Error> {
    let alone: Vec<Alone> = solved
        .used
        .iter()
        .map(|u| alone(board, scenes, u, solved, &solved.camera_from_lidar))
        .collect();
    let mut poses: Vec<PoseFit> = scenes.iter().map(unused).collect();
    for (u, a) in solved.used.iter().zip(&alone) {
        let patch = patch(scenes, u);
        poses[u.scene] = PoseFit {
            name: scenes[u.scene].name.clone(),
            rejected: None,
            distance_m: u.fit.plane.origin.norm(),
            points: patch.points,
            edges: u.edges_used,
            center_error_m: (a.lidar_center - a.camera_center).norm(),
            normal_error_rad: a.normal_error_rad,
            corner_rms_px: scenes[u.scene].in_camera.rms_px,
        };
    }
    for (scene, why) in &solved.rejected {
        poses[*scene].rejected = Some(why.clone());
    }
    let n = alone.len().max(1) as f64;
    let center_rms_m = (alone
        .iter()
        .map(|a| (a.lidar_center - a.camera_center).norm_squared())
        .sum::<f64>()
        / n)
        .sqrt();
    let squares = solved
        .used
        .iter()
        .map(|u| scenes[u.scene].in_camera.rms_px.powi(2));
    let corner_rms_px = (squares.sum::<f64>() / n).sqrt();
    let diagnosis = diagnosis(board, lens, scenes, solved);
    let fit = diagnosis.finding(camera, corner_rms_px);
    let lens_finding = match fit.verdict {
        Verdict::Pass => diagnosis.given_lens(camera),
        _ => None,
    };
    let names = solved.used.iter().map(|u| scenes[u.scene].name.clone());
    let another_lens = diagnosis.another_lens(camera, &names.collect::<Vec<String>>());
    // What is wrong with the corners is wrong with all that rests on them.
    let also = match fit.verdict {
        Verdict::Pass => lens_finding.as_ref(),
        _ => Some(&fit),
    };
    let also = also.cloned().map(Box::new);
    if center_rms_m > STRANGERS_M {
        return Err(Error::NotJoined {
            first: camera.to_owned(),
            second: "lidar".to_owned(),
            cause: JoinProblem::MiddlesApart {
                rms_m: center_rms_m,
                also,
            },
        });
    }
    let PatternSize {
        factor,
        sigma: factor_sigma,
    } = pattern_size(board, scenes, solved, config)?;
    let (scale, scale_sigma) = (1.0 / factor, factor_sigma / (factor * factor));
    if (scale - 1.0).abs() > (5.0 * scale_sigma).max(WRONG_SCALE) {
        let wrong = WrongSize::Measured {
            pattern: checks::pattern_excess(board, scale, scale_sigma),
            also,
        };
        return Err(wrong.into());
    }
    let apart = Apart {
        board,
        camera,
        scenes,
        joined,
        config,
    };
    let parts = apart.halves();
    let holdout = apart.holdout(solved);
    let PlateShift {
        shift_m,
        covariance: shift_covariance,
    } = plate_shift(board, scenes, solved, config)?;
    let late = clocks::lidar_late(scenes, solved);
    let corners = solved.used.iter().flat_map(|u| {
        let pose = &scenes[u.scene].in_camera.camera_from_board;
        let corners = 0..board.target.corner_count();
        corners.filter_map(|k| lens.project(&(*pose * board.corner(k))))
    });
    let difference = parts.map(|[a, b]| (a.inverse() * b).log());
    let mut calibration = LidarCameraCalibration {
        corner_rms_px,
        camera: camera.to_owned(),
        camera_from_lidar: solved.camera_from_lidar,
        covariance: solved.covariance,
        sigma: std::array::from_fn(|k| solved.covariance[(k, k)].max(0.0).sqrt()),
        poses,
        center_rms_m,
        range_noise_m: solved.range_noise_m,
        beam_noise_m: solved.beam_noise_m,
        beam_offsets_m: solved.beam_offsets_m.clone(),
        dark_excess_m: solved.dark.map(|d| d.excess_m),
        dark_excess_sigma_m: solved.dark.map(|d| d.sigma_m),
        edge_excess_m: solved.apparent_m.xy().into(),
        edge_excess_sigma_m: solved.apparent_sigma_m.xy().into(),
        range_excess_m: solved.apparent_m.z,
        range_excess_sigma_m: solved.apparent_sigma_m.z,
        scale,
        scale_sigma,
        spread: solved.spread,
        halves_rotation_rad: difference.map(|d| d.fixed_rows::<3>(0).norm()),
        halves_translation_m: difference.map(|d| d.fixed_rows::<3>(3).norm()),
        holdout_center_rms_m: holdout.map(|h| h[0]),
        holdout_normal_rms_rad: holdout.map(|h| h[1]),
        offset_error_m: shift_m.into(),
        offset_error_sigma_m: [0, 1].map(|k| shift_covariance[(k, k)].max(0.0).sqrt()),
        lidar_late_s: late.map(|l| l.seconds),
        lidar_late_sigma_s: late.map(|l| l.sigma_s),
        cells: cells(lens, corners),
        image_px: [lens.width, lens.height],
        residuals: BoardResiduals {
            ranges_m: ranges_m(solved),
            edges_m: edge_errors_m(board, scenes, solved),
            centers_px: alone
                .iter()
                .filter_map(|a| {
                    let own = lens.project(&a.camera_center)?;
                    Some([own.into(), lens.project(&a.lidar_center)?.into()])
                })
                .collect(),
        },
        findings: vec![fit],
    };
    calibration.findings.extend(lens_finding);
    calibration.findings.extend(another_lens);
    if let Some(parts) = parts {
        let from_whole = parts.map(|part| (solved.camera_from_lidar.inverse() * part).log());
        let finding = halves::finding(camera, &from_whole, &calibration.sigma);
        calibration.findings.push(finding);
    }
    let checked = checks::findings(&calibration, board, scenes, solved);
    calibration.findings.extend(checked);
    Ok(calibration)
}

/// What the corners of the poses used say.
pub(super) fn diagnosis<'a>(
    board: &'a MountedBoard,
    lens: &'a Camera,
    scenes: &[Scene],
    solved: &Solved,
) -> Diagnosis<'a> {
    let used = solved.used.iter();
    let seen = used.map(|u| seen(board, lens, &scenes[u.scene]));
    Diagnosis::new(&board.target, lens, seen.collect())
}

/// The corners of a pose, less those that are none.
fn seen(board: &MountedBoard, lens: &Camera, scene: &Scene) -> AdjustedView {
    let pose = &scene.in_camera.camera_from_board;
    let off_px = |corner: &Corner| {
        let seen = lens.project(&(*pose * board.corner(corner.index)));
        seen.map_or(f64::INFINITY, |seen| (seen - corner.pixel).norm())
    };
    let known = scene
        .corners
        .iter()
        .filter(|c| c.index < board.target.corner_count());
    let limit_px = CORNER_OUTLIER * scene.in_camera.rms_px;
    let board_from_target = Se3::new(Default::default(), board.corner(0) - board.target.corner(0));
    AdjustedView {
        camera_from_target: *pose * board_from_target,
        corners: known
            .filter(|c| off_px(c) < limit_px)
            .map(|c| AdjustedCorner {
                point: board.target.corner(c.index),
                pixel: c.pixel,
                velocity_px_s: Vector2::zeros(),
            })
            .collect(),
    }
}

/// A pose that was not used, with the reason as far as it is known here.
fn unused(scene: &Scene) -> PoseFit {
    let why = if !scene.seen_by_camera() {
        "the camera does not see the board"
    } else if scene.in_lidar.is_empty() {
        "no patch in the scan looks like the board: at least three beams must hit it, and it must stand free, with all of its sides in view"
    } else {
        "no patch in the scan matches the pose of the board from the other poses"
    };
    let of_copy = |of: &String| format!("its image duplicates that of {of}");
    let why = scene
        .copy_of
        .as_ref()
        .map_or_else(|| why.to_owned(), of_copy);
    PoseFit {
        name: scene.name.clone(),
        rejected: Some(why),
        distance_m: scene.in_camera.camera_from_board.translation.norm(),
        points: 0,
        edges: 0,
        center_error_m: 0.0,
        normal_error_rad: 0.0,
        corner_rms_px: scene.in_camera.rms_px,
    }
}

/// Corners per part of the image, by rows from the upper left.
fn cells(lens: &Camera, pixels: impl Iterator<Item = Vector2<f64>>) -> Vec<u32> {
    let [columns, rows] = COVERAGE_CELLS;
    let mut cells = vec![0; columns * rows];
    for pixel in pixels.filter(|p| lens.contains(p, 0.0)) {
        let part = |x: f64, size: u32, count: usize| {
            ((x.max(0.0) / f64::from(size) * count as f64) as usize).min(count - 1)
        };
        let at = part(pixel.y, lens.height, rows) * columns + part(pixel.x, lens.width, columns);
        cells[at] += 1;
    }
    cells
}

/// Ranges of all returns less those of the planes found.
fn ranges_m(solved: &Solved) -> Vec<f64> {
    let points = solved
        .used
        .iter()
        .flat_map(|u| u.chords.iter().flat_map(|c| &c.points).map(move |p| (u, p)));
    points
        .filter_map(|(u, point)| u.fit.plane.range_error_m(point))
        .collect()
}

fn alone(
    board: &MountedBoard,
    scenes: &[Scene],
    used: &Used,
    solved: &Solved,
    camera_from_lidar: &Se3,
) -> Alone {
    let in_camera = &scenes[used.scene].in_camera.camera_from_board;
    let patch = patch(scenes, used);
    let plane = &used.fit.plane;
    // Where all poses together have it: from there the edges alone decide.
    let pose = solved.camera_from_lidar.inverse() * used.camera_from_board;
    let long_axis = if board.width_m >= board.height_m {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let along = plane
        .local(&(plane.origin + pose.rotation * long_axis))
        .xy();
    let start = Rectangle {
        center: plane.local(&pose.translation).xy(),
        along: along.try_normalize(1e-9).unwrap_or_else(Vector2::x),
        size_m: patch.rectangle.size_m,
    };
    let apparent = Vector2::new(board.width_m, board.height_m) + solved.apparent_m.xy() * 2.0;
    let sides = [apparent.max(), apparent.min()];
    let rectangle = fitted(plane, &patch.edges, &start, sides);
    let in_lidar =
        plane.origin + plane.axes[0] * rectangle.center.x + plane.axes[1] * rectangle.center.y;
    let in_lidar = in_lidar * (1.0 - solved.apparent_m.z / in_lidar.norm());
    let normal = camera_from_lidar.rotation * plane.normal;
    Alone {
        lidar_center: *camera_from_lidar * in_lidar,
        camera_center: in_camera.translation,
        normal_error_rad: normal.angle(&scenes[used.scene].normal_in_camera()),
    }
}

/// Solutions from parts of the poses.
struct Apart<'a> {
    board: &'a MountedBoard,
    camera: &'a str,
    scenes: &'a [Scene<'a>],
    joined: &'a Joined,
    config: &'a LidarCameraConfig,
}

impl Apart<'_> {
    /// The transform from the joined poses whose number is wanted.
    fn solved_from(&self, wanted: impl Fn(usize) -> bool) -> Option<Se3> {
        let mut at = 0;
        let patch = self.joined.patch.iter().map(|p| {
            let chosen = wanted(at);
            at += usize::from(p.is_some());
            p.filter(|_| chosen)
        });
        let part = Joined {
            patch: patch.collect(),
            camera_from_lidar: self.joined.camera_from_lidar,
            distance_sum_m: self.joined.distance_sum_m,
        };
        let solved = adjust(self.board, self.camera, self.scenes, &part, self.config).ok()?;
        Some(solved.camera_from_lidar)
    }

    fn are_enough(&self) -> bool {
        self.joined.patch.iter().flatten().count() >= MIN_FOR_PARTS
    }

    /// From every other pose, and from the rest: what another session would have given.
    fn halves(&self) -> Option<[Se3; 2]> {
        if !self.are_enough() {
            return None;
        }
        Some([
            self.solved_from(|k| k % 2 == 0)?,
            self.solved_from(|k| k % 2 == 1)?,
        ])
    }

    /// Root mean square of the errors of middles (m) and normals (rad) of poses that a solution does not know.
    fn holdout(&self, solved: &Solved) -> Option<[f64; 2]> {
        if !self.are_enough() {
            return None;
        }
        let numbers = self.joined.patch.iter().scan(0, |at, p| {
            let own = *at;
            *at += usize::from(p.is_some());
            Some(own)
        });
        let numbers: Vec<usize> = numbers.collect();
        let (mut squares, mut count) = ([0.0; 2], 0.0);
        for part in 0..PARTS {
            let camera_from_lidar = self.solved_from(|k| k % PARTS != part)?;
            let own = solved
                .used
                .iter()
                .filter(|u| numbers[u.scene] % PARTS == part);
            for u in own {
                let a = alone(self.board, self.scenes, u, solved, &camera_from_lidar);
                squares[0] += (a.lidar_center - a.camera_center).norm_squared();
                squares[1] += a.normal_error_rad.powi(2);
                count += 1.0;
            }
        }
        Some(squares.map(|s| (s / f64::max(count, 1.0)).sqrt()))
    }
}
