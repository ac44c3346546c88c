use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Matrix3, UnitQuaternion, Vector2, Vector6};
use lsfb_types::{LidarPoint, no_progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const BOARD: Board = Board {
    target: Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio: 0.3,
    },
    width_m: 0.83,
    height_m: 0.75,
    offset_m: [0.0, 0.0],
};

/// VLP-32C (63-9325, p. 54): elevation in 0.001°, azimuth offset in 0.1°, from the lowest beam.
const BEAMS: [(i32, i32); 32] = [
    (-25_000, 14),
    (-15_639, -14),
    (-11_310, 14),
    (-8_843, -14),
    (-7_254, 14),
    (-6_148, -14),
    (-5_333, 42),
    (-4_667, 14),
    (-4_000, -14),
    (-3_667, -42),
    (-3_333, 42),
    (-3_000, 14),
    (-2_667, -14),
    (-2_333, -42),
    (-2_000, 42),
    (-1_667, 14),
    (-1_333, -14),
    (-1_000, -42),
    (-667, 42),
    (-333, 14),
    (0, -14),
    (333, -42),
    (667, 42),
    (1_000, 14),
    (1_333, -14),
    (1_667, -42),
    (2_333, 14),
    (3_333, -14),
    (4_667, 14),
    (7_000, -14),
    (10_333, 14),
    (15_000, -14),
];

fn camera() -> Camera {
    Camera {
        width: 1280,
        height: 800,
        lens: Lens::KannalaBrandt {
            focal_px: [560.0, 561.0],
            principal_px: [641.0, 397.0],
            distortion: [-0.02, 0.006, -0.003, 0.0004],
        },
    }
}

/// A camera that looks along the LiDAR's x axis, a little beside and below it.
fn truth() -> Se3 {
    let axes = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0);
    let forward = UnitQuaternion::from_matrix(&axes);
    Se3::new(forward, Vector3::zeros())
        * Se3::exp(&Vector6::new(0.02, -0.03, 0.01, 0.1, 0.02, -0.2))
}

/// What else the simulated session does.
#[derive(Clone, Copy)]
struct Session {
    poses: usize,
    tilt_rad: f64,
    noise_m: f64,
    /// The board as it is.
    board: Board,
    /// Whether the LiDAR sees it.
    behind_wall: bool,
}

const GOOD: Session = Session {
    poses: 30,
    tilt_rad: 0.7,
    noise_m: 0.03,
    board: BOARD,
    behind_wall: false,
};

fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
    (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

fn session(session: &Session, seed: u64) -> Vec<BoardPose> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let camera = camera();
    let mut poses = Vec::new();
    while poses.len() < session.poses {
        let mut uniform = |size: f64| rng.random_range(-1.0..=1.0) * size;
        let distance = 2.0 + uniform(0.7);
        let place = Vector3::new(uniform(0.45) * distance, uniform(0.2) * distance, distance);
        let tilt = [uniform(session.tilt_rad), uniform(session.tilt_rad)];
        let spin = uniform(0.6);
        let facing = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let tilted = UnitQuaternion::from_euler_angles(tilt[0], tilt[1], spin);
        let camera_from_board = Se3::new(tilted * facing, place);
        let mut corners = Vec::new();
        for index in 0..session.board.target.corner_count() {
            let point = camera_from_board * session.board.corner(index);
            let Some(pixel) = camera.project(&point).filter(|p| camera.contains(p, 5.0)) else {
                continue;
            };
            let noise = Vector2::new(gauss(&mut rng), gauss(&mut rng)) * 0.15;
            corners.push(Corner {
                index,
                pixel: pixel + noise,
            });
        }
        if corners.len() < session.board.target.corner_count() {
            continue;
        }
        let lidar_from_board = truth().inverse() * camera_from_board;
        poses.push(BoardPose {
            name: format!("pose {:02}", poses.len()),
            corners,
            scan: scan(session, &lidar_from_board, &mut rng),
        });
    }
    poses
}

/// The board on a pole in a room of 9 × 7 × 3 m.
fn scan(session: &Session, lidar_from_board: &Se3, rng: &mut ChaCha8Rng) -> LidarScan {
    let board_from_lidar = lidar_from_board.inverse();
    let origin = board_from_lidar.translation;
    let half = [0.5 * session.board.width_m, 0.5 * session.board.height_m];
    let low = Vector3::new(-4.0, -3.5, -1.3);
    let high = Vector3::new(5.0, 3.5, 1.7);
    let pole = lidar_from_board.translation + Vector3::new(0.06, 0.0, 0.0);
    let phase = rng.random_range(0.0..0.2);
    let mut points = Vec::new();
    for step in 0..1800 {
        for (ring, (elevation, offset)) in BEAMS.iter().enumerate() {
            let azimuth = (0.2 * f64::from(step) + phase + 0.1 * f64::from(*offset)).to_radians();
            let elevation = (f64::from(*elevation) * 1e-3).to_radians();
            let ray = Vector3::new(
                elevation.cos() * azimuth.cos(),
                elevation.cos() * azimuth.sin(),
                elevation.sin(),
            );
            let wall = (0..3)
                .map(|k| if ray[k] > 0.0 { high[k] } else { low[k] } / ray[k])
                .fold(f64::INFINITY, f64::min);
            let mut range = wall;
            let in_board = board_from_lidar.rotation * ray;
            let depth = -origin.z / in_board.z;
            let hit = origin + in_board * depth;
            let on_board = hit.x.abs() < half[0] && hit.y.abs() < half[1];
            if depth > 0.0 && on_board && !session.behind_wall {
                range = range.min(depth);
            }
            // A pole of 4 cm from the middle of the board to the floor.
            let flat = ray.xy().norm_squared();
            let along = pole.xy().dot(&ray.xy()) / flat;
            let miss = (ray.xy() * along - pole.xy()).norm();
            if along > 0.0 && miss < 0.02 && ray.z * along < pole.z {
                range = range.min(along);
            }
            let range = range + session.noise_m * gauss(rng);
            let range = (range / 0.004).round() * 0.004;
            points.push(LidarPoint {
                position_m: (ray * range).map(|x| x as f32).into(),
                ring: ring as u16,
                ..LidarPoint::default()
            });
        }
    }
    LidarScan { points }
}

fn run(board: &Board, poses: &[BoardPose]) -> Result<LidarCameraCalibration, Error> {
    let config = LidarCameraConfig::default();
    calibrate_lidar_camera(board, "cam0", &camera(), poses, &config, &no_progress)
}

#[test]
fn transforms_of_simulated_sessions_are_found() {
    let mut nees = Vec::new();
    for seed in 0..4 {
        let found = run(&BOARD, &session(&GOOD, seed)).expect("calibrated");
        let error = (found.camera_from_lidar.inverse() * truth()).log();
        let turn = error.fixed_rows::<3>(0).norm().to_degrees();
        let shift = error.fixed_rows::<3>(3).norm();
        println!(
            "{seed}: {turn:.4}°, {:.2} mm; {}",
            1e3 * shift,
            found.verdict()
        );
        assert!(turn < 0.05 && shift < 0.005, "{seed}: {turn}° {shift} m");
        let inverse = found.covariance.try_inverse().expect("a covariance");
        nees.push((error.transpose() * inverse * error)[0]);
        assert!((found.range_noise_m - 0.03).abs() < 0.001, "{found:?}");
        assert!(found.center_rms_m < 0.008, "{found:?}");
        for pose in found.poses.iter().filter(|p| p.rejected.is_some()) {
            println!(
                "  {} at {:.2} m: {:?}",
                pose.name, pose.distance_m, pose.rejected
            );
        }
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        assert!(found.verdict().starts_with("PASS"), "{}", found.verdict());
        let left_out = found.poses.iter().filter(|p| p.rejected.is_some());
        assert!(left_out.count() <= 5, "{:?}", found.poses);
    }
    // Six numbers each: their mean is six, and none is beyond 99.99 %.
    let mean = nees.iter().sum::<f64>() / nees.len() as f64;
    assert!(mean > 2.5 && mean < 11.0, "{nees:?}");
    assert!(nees.iter().all(|n| *n < 28.0), "{nees:?}");
}

/// `cargo test --release -p lsfb-calib lidar_camera -- --ignored --nocapture` prints the figures.
#[test]
#[ignore = "a minute of simulation"]
fn errors_lie_within_their_sigmas() {
    let seeds = 400;
    let few = Session { poses: 10, ..GOOD };
    let runs: Vec<Vector6<f64>> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            let found = run(&BOARD, &session(&few, 1000 + seed)).expect("calibrated");
            let error = (found.camera_from_lidar.inverse() * truth()).log();
            let inverse = found.covariance.try_inverse().expect("a covariance");
            let nees = (error.transpose() * inverse * error)[0];
            let turn = error.fixed_rows::<3>(0).norm().to_degrees();
            let shift = error.fixed_rows::<3>(3).norm();
            Vector6::new(nees, turn, shift, found.center_rms_m, 0.0, 0.0)
        })
        .collect();
    // 95 % of a chi-square with six degrees of freedom.
    let inside = runs.iter().filter(|r| r[0] < 12.5916).count() as f64 / seeds as f64;
    let largest = runs
        .iter()
        .fold(Vector6::zeros(), |a: Vector6<f64>, b| a.sup(b));
    let mean = runs.iter().sum::<Vector6<f64>>() / seeds as f64;
    println!(
        "{seeds} sessions of ten poses: {:.1} % within the 95 % region, mean NEES {:.2} of 6; worst {:.4}° and {:.2} mm, mean {:.4}° and {:.2} mm",
        100.0 * inside,
        mean[0],
        largest[1],
        1e3 * largest[2],
        mean[1],
        1e3 * mean[2]
    );
    assert!((0.93..=0.97).contains(&inside), "{inside}");
}

#[test]
fn order_and_copies_of_the_run_do_not_matter() {
    let few = Session { poses: 8, ..GOOD };
    let poses = session(&few, 3);
    let found = run(&BOARD, &poses).expect("calibrated");
    let mut turned = poses.clone();
    turned.reverse();
    turned.swap(1, 5);
    let again = run(&BOARD, &turned).expect("calibrated");
    assert_eq!(found.camera_from_lidar, again.camera_from_lidar);
    assert_eq!(found.covariance, again.covariance);
    assert_eq!(again.poses[0], found.poses[7]);
    assert_eq!(
        found.camera_from_lidar,
        run(&BOARD, &poses).expect("calibrated").camera_from_lidar
    );
}

const FEW: Session = Session { poses: 8, ..GOOD };

fn error(board: &Board, poses: &[BoardPose]) -> String {
    match run(board, poses) {
        Ok(found) => format!("no error but: {}", found.verdict()),
        Err(error) => error.to_string(),
    }
}

#[test]
fn boards_that_are_not_seen_are_named() {
    let hidden = Session {
        behind_wall: true,
        ..FEW
    };
    let text = error(&BOARD, &session(&hidden, 5));
    assert!(text.contains("found in 0 of 8 scans"), "{text}");
    let text = error(&BOARD, &session(&FEW, 5)[..2]);
    assert!(text.contains("2 of 2 images, 3 are needed"), "{text}");
}

#[test]
fn boards_that_face_one_way_are_named() {
    let parallel = Session {
        tilt_rad: 0.0,
        ..FEW
    };
    let text = error(&BOARD, &session(&parallel, 5));
    assert!(text.contains("any direction along the board"), "{text}");
    assert!(text.contains("tilt the board about"), "{text}");
}

#[test]
fn tags_of_another_size_are_named() {
    // 70 mm where 88 mm are said.
    let smaller = Board {
        target: Target::AprilGrid {
            columns: 6,
            rows: 6,
            tag_size_m: 0.070,
            spacing_ratio: 0.3,
        },
        ..BOARD
    };
    let actual = Session {
        board: smaller,
        ..FEW
    };
    let text = error(&BOARD, &session(&actual, 5));
    assert!(
        text.contains("size is wrong") && text.contains("measure"),
        "{text}"
    );
}

#[test]
fn exchanged_sides_are_named() {
    let long = Board {
        width_m: 1.1,
        ..BOARD
    };
    let turned = Board {
        width_m: 0.75,
        height_m: 1.1,
        ..BOARD
    };
    let actual = Session { board: long, ..FEW };
    let text = error(&turned, &session(&actual, 5));
    assert!(text.contains("exchange its width and height"), "{text}");
}

#[test]
fn a_plate_of_another_size_is_named() {
    let wider = Board {
        width_m: 0.89,
        ..BOARD
    };
    let actual = Session {
        board: wider,
        ..FEW
    };
    let found = run(&BOARD, &session(&actual, 5)).expect("calibrated");
    assert!(found.verdict().starts_with("WARN"), "{}", found.verdict());
    let named = |w: &String| w.contains("along the pattern's x axis");
    assert!(found.warnings.iter().any(named), "{:?}", found.warnings);
}

#[test]
fn images_and_scans_of_different_poses_are_named() {
    let good = session(&FEW, 5);
    let mut shuffled = good.clone();
    for (k, pose) in shuffled.iter_mut().enumerate() {
        pose.scan = good[(k + 3) % 8].scan.clone();
    }
    let text = error(&BOARD, &shuffled);
    assert!(text.contains("belong together"), "{text}");
}

#[test]
fn a_board_that_moved_is_left_out() {
    let mut moved = session(&Session { poses: 12, ..GOOD }, 7);
    for point in &mut moved[4].scan.points {
        let [x, y, z] = point.position_m;
        point.position_m = [x + 0.1, y, z];
    }
    let found = run(&BOARD, &moved).expect("calibrated");
    let left_out = |p: &&PoseFit| p.rejected.is_some();
    let names: Vec<&str> = found
        .poses
        .iter()
        .filter(left_out)
        .map(|p| p.name.as_str())
        .collect();
    assert_eq!(names, ["pose 04"]);
    let why = found.poses[4].rejected.as_deref().unwrap_or_default();
    assert!(
        why.contains("moved") || why.contains("where the other poses"),
        "{why}"
    );
}
