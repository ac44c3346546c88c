//! LiDAR to camera on simulated sessions: right answers within their stated spread, and every bad input by its name.

use lsfb_calib::Target;
use lsfb_calib::lidar_camera::{BoardPose, LidarCameraCalibration, MountedBoard};
use lsfb_geometry::{CameraTiming, Rig, RigCamera, RigLidar, Se3, Vector6};
use lsfb_rigs::board::{BOARD, Session, calibrate, camera, error, truth};
use lsfb_types::{Finding, Verdict};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

fn few() -> Session {
    Session {
        poses: 8,
        ..Session::default()
    }
}

/// Degrees and millimetres.
fn sizes(found: &LidarCameraCalibration) -> [f64; 2] {
    let error = error(found);
    [
        error.fixed_rows::<3>(0).norm().to_degrees(),
        error.fixed_rows::<3>(3).norm() * 1e3,
    ]
}

fn refusal(board: &MountedBoard, poses: &[BoardPose]) -> String {
    match calibrate(board, poses) {
        Ok(found) => format!("no error but: {:?}", found.findings),
        Err(error) => error.to_string(),
    }
}

fn left_out(found: &LidarCameraCalibration) -> Vec<&str> {
    let out = found.poses.iter().filter(|p| p.rejected.is_some());
    out.map(|p| p.name.as_str()).collect()
}

/// The one warning of a session.
fn warning(found: &LidarCameraCalibration) -> String {
    let judgement = found.judgement();
    assert_eq!(judgement.verdict(), Verdict::Warn, "{judgement:?}");
    let problems: Vec<&Finding> = judgement.problems().collect();
    assert_eq!(problems.len(), 1, "{problems:?}");
    problems[0].sentence()
}

fn passes(found: &LidarCameraCalibration) -> bool {
    found.judgement().verdict() == Verdict::Pass
}

#[test]
fn transforms_are_found_from_every_pose() {
    for seed in 0..3 {
        let found = calibrate(&BOARD, &Session::default().simulate(seed)).expect("calibrated");
        let [turn_deg, shift_mm] = sizes(&found);
        assert!(
            turn_deg < 0.05 && shift_mm < 5.0,
            "{seed}: {turn_deg}° {shift_mm} mm"
        );
        let inverse = found.covariance.try_inverse().expect("a covariance");
        let error = error(&found);
        // 99.99 % of a chi-square with six degrees of freedom.
        assert!((error.transpose() * inverse * error)[0] < 28.0, "{seed}");
        assert!((found.range_noise_m - 0.03).abs() < 0.001, "{found:?}");
        assert!(found.center_rms_m < 0.008, "{}", found.center_rms_m);
        let held_back_m = found.holdout_center_rms_m.expect("many poses");
        assert!(held_back_m < 0.009, "{held_back_m}");
        assert!(left_out(&found).is_empty(), "{seed}: {:?}", found.poses);
        assert!(passes(&found), "{:?}", found.findings);
    }
}

#[test]
fn a_board_that_moves_is_followed() {
    let moving = Session {
        speed_m_s: 0.3,
        poses: 14,
        ..Session::default()
    };
    let found = calibrate(&BOARD, &moving.simulate(3)).expect("calibrated");
    let [turn_deg, shift_mm] = sizes(&found);
    assert!(
        turn_deg < 0.1 && shift_mm < 5.0,
        "{turn_deg}° {shift_mm} mm"
    );
    assert!(passes(&found), "{:?}", found.findings);
    let (late, sigma) = (found.lidar_late_s, found.lidar_late_sigma_s);
    let (late, sigma) = (late.expect("it moved"), sigma.expect("it moved"));
    assert!(
        late.abs() < 4.0 * sigma && sigma < 0.003,
        "{late} ± {sigma}"
    );
}

#[test]
fn clocks_that_differ_are_named() {
    for late_s in [0.03, -0.05] {
        let late = Session {
            speed_m_s: 0.3,
            poses: 14,
            lidar_late_s: late_s,
            ..Session::default()
        };
        let found = calibrate(&BOARD, &late.simulate(3)).expect("calibrated");
        let named = found.findings.iter().find(|f| f.code == "clocks");
        let word = if late_s > 0.0 { "later" } else { "earlier" };
        assert!(
            named.is_some_and(|f| f.what.contains(word)),
            "{:?}",
            found.findings
        );
        let off = found.lidar_late_s.expect("it moved") - late_s;
        assert!(off.abs() < 0.3 * late_s.abs(), "{off}");
    }
}

#[test]
fn the_order_of_input_does_not_matter() {
    let poses = few().simulate(3);
    let found = calibrate(&BOARD, &poses).expect("calibrated");
    for seed in 0..5 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut other = poses.clone();
        other.shuffle(&mut rng);
        for pose in &mut other {
            pose.scan.points.shuffle(&mut rng);
            pose.sights[0].corners.shuffle(&mut rng);
        }
        let again = calibrate(&BOARD, &other).expect("calibrated");
        let apart = (found.camera_from_lidar.inverse() * again.camera_from_lidar).log();
        assert!(apart.amax() < 1e-9, "{apart}");
        assert!((found.covariance - again.covariance).amax() < 1e-9);
        for (pose, fit) in other.iter().zip(&again.poses) {
            assert_eq!(pose.name, fit.name);
        }
    }
}

#[test]
fn boards_that_are_not_seen_are_named() {
    let hidden = Session {
        behind_wall: true,
        ..few()
    };
    let text = refusal(&BOARD, &hidden.simulate(5));
    assert!(text.contains("found in 0 of 8 scans"), "{text}");
    let mut blind = few().simulate(5);
    let text = refusal(&BOARD, &blind[..2]);
    assert!(text.contains("2 of 2 images (at least 3)"), "{text}");
    for pose in &mut blind {
        pose.sights[0].corners.clear();
    }
    let text = refusal(&BOARD, &blind);
    assert!(text.contains("0 of 8 images (at least 3)"), "{text}");
}

#[test]
fn boards_that_face_one_way_are_named() {
    let parallel = Session {
        tilt_rad: 0.0,
        ..few()
    };
    let text = refusal(&BOARD, &parallel.simulate(5));
    assert!(text.contains("any direction along the board"), "{text}");
    assert!(text.contains("tilt the board about"), "{text}");
}

#[test]
fn tags_of_another_size_are_named() {
    // 70 mm where 88 mm are said.
    let smaller = MountedBoard {
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
        ..few()
    };
    let text = refusal(&BOARD, &actual.simulate(5));
    assert!(
        text.contains("size is wrong") && text.contains("measure"),
        "{text}"
    );
}

#[test]
fn exchanged_sides_are_named() {
    let long = MountedBoard {
        width_m: 1.1,
        ..BOARD
    };
    let turned = MountedBoard {
        width_m: 0.75,
        height_m: 1.1,
        ..BOARD
    };
    let actual = Session {
        board: long,
        ..few()
    };
    let text = refusal(&turned, &actual.simulate(5));
    assert!(text.contains("swap width and height"), "{text}");
}

#[test]
fn a_plate_of_another_size_is_named() {
    let wider = MountedBoard {
        width_m: 0.89,
        ..BOARD
    };
    let actual = Session {
        board: wider,
        ..few()
    };
    let found = calibrate(&BOARD, &actual.simulate(5)).expect("calibrated");
    let text = warning(&found);
    assert!(text.contains("along the pattern's x axis"), "{text}");
}

#[test]
fn a_board_upside_down_changes_nothing_and_a_pattern_upside_down_is_named() {
    let turned = Session {
        turned: true,
        poses: 12,
        ..Session::default()
    };
    let found = calibrate(&BOARD, &turned.simulate(5)).expect("calibrated");
    assert!(passes(&found), "{:?}", found.findings);
    let [turn_deg, shift_mm] = sizes(&found);
    assert!(
        turn_deg < 0.1 && shift_mm < 5.0,
        "{turn_deg}° {shift_mm} mm"
    );

    // The plate's centre is 20 mm above that of the pattern; with the pattern on its head it is 20 mm below.
    let said = MountedBoard {
        offset_m: [0.0, 0.02],
        ..BOARD
    };
    let actual = Session {
        board: MountedBoard {
            offset_m: [0.0, -0.02],
            ..BOARD
        },
        ..turned
    };
    let found = calibrate(&said, &actual.simulate(5)).expect("calibrated");
    let named = found
        .findings
        .iter()
        .find(|f| f.what.contains("upside down"));
    assert!(named.is_some(), "{:?}", found.findings);

    let found = calibrate(&BOARD, &actual.simulate(5)).expect("calibrated");
    let named = found
        .findings
        .iter()
        .find(|f| f.what.contains("plate's centre"));
    assert!(named.is_some(), "{:?}", found.findings);
}

#[test]
fn images_and_scans_of_different_poses_are_named() {
    let good = few().simulate(5);
    let mut shuffled = good.clone();
    for (k, pose) in shuffled.iter_mut().enumerate() {
        pose.scan = good[(k + 3) % 8].scan.clone();
    }
    let text = refusal(&BOARD, &shuffled);
    assert!(text.contains("belong together"), "{text}");
}

#[test]
fn a_board_that_moved_is_left_out() {
    let many = Session {
        poses: 12,
        ..Session::default()
    };
    let mut moved = many.simulate(7);
    for point in &mut moved[4].scan.points {
        let [x, y, z] = point.position_m;
        point.position_m = [x + 0.1, y, z];
    }
    let found = calibrate(&BOARD, &moved).expect("calibrated");
    assert_eq!(left_out(&found), ["pose 04"]);
    let why = found.poses[4].rejected.as_deref().unwrap_or_default();
    assert!(
        why.contains("moved") || why.contains("prediction from the other poses"),
        "{why}"
    );
}

#[test]
fn cameras_that_were_swapped_are_named() {
    let mut found = calibrate(&BOARD, &few().simulate(3)).expect("calibrated");
    let mounted = |rig_from_camera: Se3| RigCamera {
        camera: camera(),
        rig_from_camera,
        timing: CameraTiming::default(),
        sigmas: Default::default(),
    };
    // The LiDAR is the rig; the other camera looks to the left.
    let here = truth().inverse();
    let left = Se3::exp(&Vector6::new(0.0, 0.0, 1.57, 0.0, 0.0, 0.0)) * here;
    let rig = |cam0: Se3, cam1: Se3| Rig {
        name: "backpack".to_owned(),
        calibrated_unix_s: None,
        cameras: [
            ("cam0".to_owned(), mounted(cam0)),
            ("cam1".to_owned(), mounted(cam1)),
        ]
        .into(),
        imus: Default::default(),
        lidars: RigLidar {
            rig_from_lidar: Se3::identity(),
            range_noise_m: 0.03,
        }
        .alone(),
    };
    let before = found.findings.clone();
    found.compare_with(&rig(here, left));
    assert_eq!(found.findings, before);
    found.compare_with(&rig(left, here));
    let text = warning(&found);
    assert!(
        text.contains("cam0: was found where the rig has cam1"),
        "{text}"
    );
    found.findings = before;
    found.compare_with(&rig(left, left));
    assert!(
        warning(&found).contains("from the rig's"),
        "{:?}",
        found.findings
    );
}

/// Once taken for the tilt of each board: 2 cm over half of a plate are 2°.
#[test]
fn a_lidar_that_measures_dark_parts_farther_is_seen_through() {
    let session = Session {
        dark_excess_m: 0.02,
        ..few()
    };
    for seed in 0..3 {
        let poses = session.simulate(seed);
        let found = calibrate(&BOARD, &poses).expect("calibrated");
        let excess = found.dark_excess_m.zip(found.dark_excess_sigma_m);
        let (excess_m, sigma_m) = excess.expect("it is clear");
        assert!(
            (excess_m - session.dark_excess_m).abs() < 4.0 * sigma_m && sigma_m < 0.003,
            "{seed}: {excess_m} ± {sigma_m}"
        );
        // What a sensor that tells no intensities makes of the same ranges.
        let mut blind = poses;
        for pose in &mut blind {
            pose.scan.points.iter_mut().for_each(|p| p.intensity = 0);
        }
        let blind = calibrate(&BOARD, &blind).expect("calibrated");
        assert_eq!(blind.dark_excess_m, None);
        let normals_deg = |found: &LidarCameraCalibration| {
            let squares = found.poses.iter().map(|p| p.normal_error_rad.powi(2));
            (squares.sum::<f64>() / found.poses.len() as f64)
                .sqrt()
                .to_degrees()
        };
        let (own_deg, blind_deg) = (normals_deg(&found), normals_deg(&blind));
        assert!(
            own_deg < 0.4 && own_deg < 0.3 * blind_deg,
            "{seed}: normals {own_deg}° off, without intensities {blind_deg}°"
        );
        let error = error(&found);
        for k in 0..6 {
            let deviations = error[k].abs() / found.sigma[k];
            assert!(deviations < 4.0, "{seed}: {k} {deviations} σ off");
        }
    }
}

/// Parts that look different but are measured alike are left alone.
#[test]
fn a_difference_of_shades_that_could_be_chance_is_not_taken_off() {
    for seed in 0..3 {
        let found = calibrate(&BOARD, &few().simulate(seed)).expect("calibrated");
        assert_eq!(found.dark_excess_m, None, "{seed}");
    }
}

/// Once each copy was one more pose: standard deviations shrank, and halves agreed as each had all of them.
#[test]
fn copies_of_poses_say_nothing_more() {
    let poses = few().simulate(1);
    let alone = calibrate(&BOARD, &poses).expect("calibrated");
    let copies = poses.iter().map(|pose| BoardPose {
        name: format!("{} again", pose.name),
        ..pose.clone()
    });
    let all: Vec<BoardPose> = poses.iter().cloned().chain(copies).collect();
    let found = calibrate(&BOARD, &all).expect("calibrated");
    assert_eq!(found.camera_from_lidar, alone.camera_from_lidar);
    assert_eq!(found.sigma, alone.sigma);
    assert_eq!(left_out(&found).len(), poses.len());
    let reason = found.poses[poses.len()].rejected.as_deref();
    assert!(reason.is_some_and(|why| why.contains("duplicates that of pose 00")));
    assert_eq!(found.judgement().verdict(), Verdict::Warn);
}
