//! What a LiDAR–camera calibration leaves, and what should be recorded better.

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{Se3, Vector2, Vector3};

use super::adjustment::{Solved, Used, adjust, patch};
use super::association::{Joined, direction_name};
use super::outline::{Rectangle, fitted};
use super::{Board, LidarCameraCalibration, LidarCameraConfig, PoseFit, Scene};
use crate::Error;

/// Poses from which halves are compared.
const MIN_FOR_HALVES: usize = 8;
/// Apparent excess of half the plate that the width of the beam does not explain, metres.
const LARGE_EXCESS_M: f64 = 0.015;
/// Scale that differs from one by more than this, and by more than its own spread, is no accident.
const LARGE_SCALE: f64 = 0.01;
const WRONG_SCALE: f64 = 0.03;
/// Standard deviations beyond which more poses are asked for.
const GOOD_ROTATION_DEG: f64 = 0.1;
const GOOD_TRANSLATION_M: f64 = 0.01;
/// Distance between the middles beyond which sensors have not seen the same boards, metres.
const STRANGERS_M: f64 = 0.06;
/// Spread of planes and outlines beyond which the sensors contradict each other.
const LARGE_SPREAD: f64 = 3.0;

/// A board as each sensor alone has it, in the camera's frame.
struct Alone {
    lidar_center: Vector3<f64>,
    camera_center: Vector3<f64>,
    normal_error_rad: f64,
}

pub(super) fn summarize(
    board: &Board,
    camera: &str,
    scenes: &[Scene],
    joined: &Joined,
    solved: &Solved,
    config: &LidarCameraConfig,
) -> Result<LidarCameraCalibration, Error> {
    let alone: Vec<Alone> = solved
        .used
        .iter()
        .map(|u| alone(board, scenes, u, solved))
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
    if center_rms_m > STRANGERS_M {
        return Err(Error::NotJoined {
            first: camera.to_owned(),
            second: "lidar".to_owned(),
            problem: format!(
                "middles of the board are {:.0} mm apart where both sensors agree best: images and scans do not belong together, or the board's size is wrong",
                center_rms_m * 1e3
            ),
        });
    }
    let (scale, scale_sigma) = scale(&alone, center_rms_m);
    if (scale - 1.0).abs() > (5.0 * scale_sigma).max(WRONG_SCALE) {
        return Err(Error::BoardSize {
            problem: format!(
                "distances between boards are {scale:.3} ± {scale_sigma:.3} times as large in {camera} as in the LiDAR: the squares or tags are {:.3} times as large as was said",
                1.0 / scale
            ),
        });
    }
    let halves = halves(board, camera, scenes, joined, config);
    let difference = halves.map(|[a, b]| (a.inverse() * b).log());
    let mut calibration = LidarCameraCalibration {
        camera: camera.to_owned(),
        camera_from_lidar: solved.camera_from_lidar,
        covariance: solved.covariance,
        sigma: std::array::from_fn(|k| solved.covariance[(k, k)].max(0.0).sqrt()),
        poses,
        center_rms_m,
        range_noise_m: solved.range_noise_m,
        beam_noise_m: solved.beam_noise_m,
        beam_offsets_m: solved.beam_offsets_m.clone(),
        edge_excess_m: solved.apparent_m.xy().into(),
        edge_excess_sigma_m: solved.apparent_sigma_m.xy().into(),
        range_excess_m: solved.apparent_m.z,
        range_excess_sigma_m: solved.apparent_sigma_m.z,
        scale,
        scale_sigma,
        spread: solved.spread,
        halves_rotation_rad: difference.map(|d| d.fixed_rows::<3>(0).norm()),
        halves_translation_m: difference.map(|d| d.fixed_rows::<3>(3).norm()),
        warnings: Vec::new(),
    };
    calibration.warnings = warnings(&calibration, scenes, solved);
    Ok(calibration)
}

/// A pose that was not used, with the reason as far as it is known here.
fn unused(scene: &Scene) -> PoseFit {
    let why = if !scene.seen_by_camera() {
        "the camera does not see the board"
    } else if scene.in_lidar.is_empty() {
        "no patch in the scan is like the board: it must stand free, with all of its sides in view"
    } else {
        "no patch in the scan is where the other poses put the board"
    };
    PoseFit {
        name: scene.name.clone(),
        rejected: Some(why.to_owned()),
        distance_m: scene.in_camera.camera_from_board.translation.norm(),
        points: 0,
        edges: 0,
        center_error_m: 0.0,
        normal_error_rad: 0.0,
        corner_rms_px: scene.in_camera.rms_px,
    }
}

fn alone(board: &Board, scenes: &[Scene], used: &Used, solved: &Solved) -> Alone {
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
    let normal = solved.camera_from_lidar.rotation * plane.normal;
    Alone {
        lidar_center: solved.camera_from_lidar * in_lidar,
        camera_center: in_camera.translation,
        normal_error_rad: normal.angle(&scenes[used.scene].normal_in_camera()),
    }
}

/// Size of the camera's scene over the LiDAR's, and its standard deviation.
fn scale(alone: &[Alone], center_rms_m: f64) -> (f64, f64) {
    let camera: Vec<Vector3<f64>> = alone.iter().map(|a| a.camera_center).collect();
    let lidar: Vec<Vector3<f64>> = alone.iter().map(|a| a.lidar_center).collect();
    let Some(found) = umeyama(&lidar, &camera, Scale::Free) else {
        return (1.0, f64::INFINITY);
    };
    let mean = lidar.iter().sum::<Vector3<f64>>() / lidar.len() as f64;
    let extent = lidar.iter().map(|p| (p - mean).norm_squared()).sum::<f64>();
    let sigma = center_rms_m / 3f64.sqrt() / extent.sqrt().max(1e-9);
    (found.scale, sigma)
}

/// Solutions from every other pose: what another session would have given.
fn halves(
    board: &Board,
    camera: &str,
    scenes: &[Scene],
    joined: &Joined,
    config: &LidarCameraConfig,
) -> Option<[Se3; 2]> {
    if joined.patch.iter().flatten().count() < MIN_FOR_HALVES {
        return None;
    }
    let half = |odd: bool| {
        let mut at = 0;
        let patch = joined
            .patch
            .iter()
            .map(|p| {
                let chosen = p.is_some() && (at % 2 == 1) == odd;
                at += usize::from(p.is_some());
                p.filter(|_| chosen)
            })
            .collect();
        let part = Joined {
            patch,
            camera_from_lidar: joined.camera_from_lidar,
            misfit_m: joined.misfit_m,
        };
        let solved = adjust(board, camera, scenes, &part, config).ok()?;
        Some(solved.camera_from_lidar)
    };
    Some([half(false)?, half(true)?])
}

fn warnings(c: &LidarCameraCalibration, scenes: &[Scene], solved: &Solved) -> Vec<String> {
    let mut out = Vec::new();
    let left_out = c.poses.iter().filter(|p| p.rejected.is_some()).count();
    if 4 * left_out > c.poses.len() {
        out.push(format!(
            "{left_out} of {} poses were left out: see the table for the reasons",
            c.poses.len()
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
    if (c.scale - 1.0).abs() > (4.0 * c.scale_sigma).max(LARGE_SCALE) {
        out.push(format!(
            "the pattern looks {:.1} % too large to the camera: measure its squares or tags, and check the camera's focal length",
            (c.scale - 1.0) * 100.0
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
    for (name, spread) in ["corners", "planes", "outlines"].iter().zip(c.spread) {
        if spread > LARGE_SPREAD {
            out.push(format!(
                "{name} miss by {spread:.1} times what their noise explains: check the lens, that the board is flat, and that it stood still"
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
