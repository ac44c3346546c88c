//! Walks of images alone.

use lsfb_geometry::Rig;
use lsfb_types::Verdict;

use super::recorded::{Measured, Paint, WALK_FRAMES, map, rig, run};
use super::*;

/// Without its IMU, and with images as cameras have them: no two are the same.
fn images_alone(paint: Paint) -> Measured {
    let mut measured = Measured::in_room(paint, WALK_FRAMES);
    measured.imu.clear();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for (_, image) in &mut measured.images {
        for grey in &mut image.sample.pixels {
            *grey = grey.saturating_add(rng.random_range(0..3u8));
        }
    }
    measured
}

/// Largest errors of poses at such times: metres, radians.
fn worst(found: &GroundTruth) -> [f64; 2] {
    let poses = found.trajectory.poses().iter();
    poses.fold([0.0, 0.0], |[metres, radians], pose| {
        let error = truth(pose.time.nanos() as f64 * 1e-9).inverse() * pose.world_from_rig;
        [
            f64::max(metres, error.translation.norm()),
            f64::max(radians, so3::log(&error.rotation).norm()),
        ]
    })
}

#[test]
fn images_alone_place_a_walk_and_it_is_said_that_they_do() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    let map = map(1);
    let walked = |measured: Measured, rig_file: &Rig| {
        measured.record(&path, rig_file);
        run(&path, &map)
    };
    let of_cameras = Rig {
        imus: Default::default(),
        ..rig()
    };
    for (rig_file, in_rig) in [(rig(), true), (of_cameras.clone(), false)] {
        let found = walked(images_alone(Paint::of(1)), &rig_file).expect("ground truth");
        assert_eq!(found.trajectory.len(), WALK_FRAMES);
        let [metres, radians] = worst(&found);
        assert!(
            metres < 0.01 && radians < 0.005,
            "{metres} m, {radians} rad"
        );
        let report = &found.report;
        assert_eq!(report.warnings, [GroundTruthWarning::WithoutImu { in_rig }]);
        assert!(report.is_whole());
        assert!(report.imu.is_none() && report.map.is_none());
        let findings = report.findings();
        let said = findings.iter().find(|f| f.code == "without-imu");
        assert_eq!(said.map(|f| f.verdict), Some(Verdict::Warn));
        assert!(!findings.iter().any(|f| f.code == "map-scale"));
        // There is nothing between the images.
        assert_eq!(found.states.len(), WALK_FRAMES);
        for state in &found.states[1..WALK_FRAMES - 1] {
            let rate = true_motion(state.time.nanos() as f64 * 1e-9).turn_rate_rad_s;
            let off = (state.turn_rate_rad_s - rate).norm();
            assert!(off < 0.05, "{off} rad/s of {}", rate.norm());
        }
        for (pose, covariance) in found.trajectory.poses().iter().zip(&found.covariances) {
            let t = pose.time.nanos() as f64 * 1e-9;
            let error = (truth(t).inverse() * pose.world_from_rig).log();
            let information = covariance.try_inverse().expect("determined");
            assert!(error.dot(&(information * error)) < 60.0, "{t} s: {error}");
        }
    }

    // Its axes and noise are not known.
    let with_imu = Measured::in_room(Paint::of(1), WALK_FRAMES);
    let error = walked(with_imu, &of_cameras).expect_err("an IMU of which nothing is known");
    assert!(
        matches!(error, Error::SensorMissing { sensor: "IMU", .. }),
        "{error}"
    );
    let error = walked(images_alone(Paint::other_floor(1)), &rig()).expect_err("another floor");
    assert!(
        matches!(error, Error::Refused(Refusal::PointsAbsent { .. })),
        "{error}"
    );
}

/// Images that are sent once more would hold the device where it was: without an IMU nothing says that it moved.
#[test]
fn without_an_imu_images_that_repeat_are_not_used() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    let mut measured = images_alone(Paint::of(1));
    let stuck = 2 * 8;
    for k in stuck..stuck + 6 {
        let pixels = measured.images[k - 2].1.sample.pixels.clone();
        measured.images[k].1.sample.pixels = pixels;
    }
    measured.record(&path, &rig());
    let found = run(&path, &map(1)).expect("ground truth");
    let frozen = GroundTruthWarning::FrozenImages { images: 6 };
    assert!(
        found.report.warnings.contains(&frozen),
        "{:?}",
        found.report.warnings
    );
    // In between the body may have turned anyhow.
    assert_eq!(found.trajectory.len(), WALK_FRAMES - 3);
    let [metres, radians] = worst(&found);
    assert!(
        metres < 0.01 && radians < 0.005,
        "{metres} m, {radians} rad"
    );
}

/// What no IMU says in the end: false localizations are found out by the others, and a stretch that sees nothing of the map is left out.
#[test]
fn without_an_imu_false_places_are_found_out_and_blind_stretches_left_out() {
    let seen = |k: usize| !(45..65).contains(&k);
    let MadeUp {
        mut walk,
        mut features,
    } = make_walk(220, 220, seen);
    walk.imu.clear();
    for k in [20, 80] {
        let elsewhere = Se3::new(Default::default(), Vector3::new(1.0, -0.5, 0.2));
        let localized = walk.frames[k].localized.as_mut().expect("localized");
        localized.world_from_rig = elsewhere * truth(k as f64 * FRAME_SECS);
        for seen in &mut walk.frames[k].recognised {
            seen.point_in_world = elsewhere * seen.point_in_world;
        }
    }
    // In the dark.
    for image in &mut features[2 * 45..2 * 65] {
        *image = Features::default();
    }
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    assert_eq!(start.accepted_count, FRAMES - 20 - 2);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");
    let estimate = &solved.last.estimate;
    let Uncertainty { poses, .. } =
        uncertainty(&walk, estimate, &solved.last.points, &config, &no_progress)
            .expect("covariances");
    let found = Solution {
        states: &estimate.states,
        accepted: &start.accepted,
        covariances: &poses,
        disagreements_m: &[0.0; FRAMES],
        in_view: &[],
    };
    let trusted = trusted(&walk, &found, &config);
    for pose in &trusted.poses {
        let error = truth(pose.time.nanos() as f64 * 1e-9).inverse() * pose.world_from_rig;
        assert!(
            error.translation.norm() < 0.01,
            "{} m",
            error.translation.norm()
        );
    }
    assert!(
        trusted.poses.len() >= FRAMES - 20 - 2,
        "{}",
        trusted.poses.len()
    );
    assert!(
        trusted.poses.len() <= FRAMES - 15,
        "{}",
        trusted.poses.len()
    );
}
