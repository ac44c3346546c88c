//! Motion without a map on tracks and inertial samples of real devices, that other front ends followed.
#![cfg(test)]

mod eqvio;
mod revisit;
mod simulated;
mod table;
mod tumvi;
mod vimap;

use std::path::PathBuf;

use lsfb_geometry::align::{Alignment, Scale, umeyama};
use lsfb_geometry::{Se3, StampedPose, Trajectory, UnitQuaternion, Vector3};
use lsfb_perception::imu::{ImuBias, NavState};
use lsfb_pipeline::ground_truth::{
    Beginning, Motion, MotionConfig, TrackedWalk, motion_without_map,
};
use lsfb_pipeline::{Error, Refusal};
use lsfb_types::{ImuSample, no_progress};
use nalgebra::{SMatrix, SVector};

use revisit::Revisit;
use tumvi::Shown;
use vimap::VisualInertialMap;

/// Whether all that a figure needs is to be computed, not only what a test does.
fn all_figures() -> bool {
    std::env::var_os("LSFB_FIGURES").is_some()
}

fn recording(test: &str, name: &str) -> Option<PathBuf> {
    lsfb_tests::recordings(test, &format!("vision/{name}"))
}

fn solved(walk: &TrackedWalk, start: Option<Vec<(NavState, ImuBias)>>) -> Motion {
    let mut config = MotionConfig::default();
    if start.is_some() {
        // Keyframes of a map are rare and see each point seldom: all of them count.
        config.adjustment.local_points_per_image = 1000;
    }
    let found = motion_without_map(walk, start, &config, &no_progress).expect("a motion");
    let wander = &found.imu.bias_wander;
    println!(
        "biases change by {:.2} and {:.2} standard deviations of what their noise allows",
        wander.gyro.sigmas, wander.accel.sigmas
    );
    found
}

/// Root mean square distance from the truth after alignment, metres, and the alignment.
fn ate_m(found: &[StampedPose], truth: &Trajectory, scale: Scale) -> (f64, Alignment) {
    let (found, truth): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = found
        .iter()
        .filter_map(|pose| {
            let truth = truth.at(pose.time)?;
            Some((pose.world_from_rig.translation, truth.translation))
        })
        .unzip();
    let alignment = umeyama(&found, &truth, scale).expect("truth and poses meet");
    let pairs = found.iter().zip(&truth);
    let squares = pairs.map(|(f, t)| (alignment.apply(f) - t).norm_squared());
    (
        (squares.sum::<f64>() / found.len() as f64).sqrt(),
        alignment,
    )
}

fn poses(states: &[(NavState, ImuBias)], walk: &TrackedWalk) -> Vec<StampedPose> {
    let frames = walk.frames.iter().zip(states);
    frames
        .map(|(frame, (nav, _))| StampedPose {
            time: frame.time,
            world_from_rig: nav.world_from_rig,
        })
        .collect()
}

/// Root mean square distance from a truth whose point on the body is another: after the alignment and the arm to that point that make it
/// least, metres; and that arm.
fn ate_of_another_point_m(found: &[StampedPose], truth: &Trajectory) -> (f64, Vector3<f64>) {
    let mut arm = Vector3::zeros();
    for _ in 0..30 {
        let moved: Vec<StampedPose> = found.iter().map(|p| at_arm(p, &arm)).collect();
        let (_, alignment) = ate_m(&moved, truth, Scale::Fixed);
        // With the rotation held, arm and translation are linear least squares.
        let mut information = SMatrix::<f64, 6, 6>::zeros();
        let mut right = SVector::<f64, 6>::zeros();
        for pose in found {
            let Some(true_pose) = truth.at(pose.time) else {
                continue;
            };
            let rotation = alignment.target_from_source.rotation;
            let mut by = SMatrix::<f64, 3, 6>::identity();
            let turn = (rotation * pose.world_from_rig.rotation).to_rotation_matrix();
            by.fixed_view_mut::<3, 3>(0, 3).copy_from(turn.matrix());
            let aim = true_pose.translation - rotation * pose.world_from_rig.translation;
            information += by.transpose() * by;
            right += by.transpose() * aim;
        }
        let solved = information.cholesky().expect("turns tell").solve(&right);
        arm = solved.fixed_rows::<3>(3).into_owned();
    }
    let moved: Vec<StampedPose> = found.iter().map(|p| at_arm(p, &arm)).collect();
    (ate_m(&moved, truth, Scale::Fixed).0, arm)
}

fn at_arm(pose: &StampedPose, arm: &Vector3<f64>) -> StampedPose {
    let place = pose.world_from_rig * *arm;
    StampedPose {
        world_from_rig: Se3::new(pose.world_from_rig.rotation, place),
        ..*pose
    }
}

/// Submaps of EuRoC's V1_01 as a visual-inertial odometry left them. The point that motion capture followed lies about 5 cm beside what
/// the file says: all estimates, of several programs, find the same arm.
#[test]
fn submaps_of_a_drone_come_nearer_to_the_truth() {
    let test = "submaps_of_a_drone_come_nearer_to_the_truth";
    let Some(folder) = recording(test, "maplab_euroc_v101_vimap") else {
        return;
    };
    let truth = vimap::truth(&folder.join("V1_01_easy_ground_truth_first77s.csv.gz"));
    for submap in 0..4 {
        let map = VisualInertialMap::read(&folder.join(format!("submap_{submap}")));
        let given = poses(&map.states, &map.walk);
        let before_m = ate_m(&given, &truth, Scale::Fixed).0;
        let (given_m, _) = ate_of_another_point_m(&given, &truth);
        let found = solved(&map.walk, Some(map.states));
        let (after_m, _) = ate_m(found.trajectory.poses(), &truth, Scale::Fixed);
        let (arm_m, arm) = ate_of_another_point_m(found.trajectory.poses(), &truth);
        let before_px = found
            .errors_before
            .as_ref()
            .expect("states were given")
            .rms_px;
        println!(
            "submap {submap}: {:.2} → {:.2} cm, at the point {:.1} {:.1} {:.1} cm from the IMU {:.2} → {:.2} cm; \
             reprojection {before_px:.2} → {:.2} px, {} points",
            100.0 * before_m,
            100.0 * after_m,
            100.0 * arm.x,
            100.0 * arm.y,
            100.0 * arm.z,
            100.0 * given_m,
            100.0 * arm_m,
            found.errors.rms_px,
            found.points,
        );
        assert!(after_m < before_m && after_m < 0.045);
        assert!(arm_m < 0.02);
        assert!(found.errors.rms_px < before_px && found.errors.rms_px < 0.9);
    }
}

/// A phone's walk of 105 m.
#[test]
fn a_phones_tracks_fit_better() {
    let Some(folder) = recording("a_phones_tracks_fit_better", "maplab_tango_phone_vimap") else {
        return;
    };
    let mut map = VisualInertialMap::read(&folder);
    if !all_figures() {
        map.walk.frames.truncate(200);
        map.states.truncate(200);
    }
    let found = solved(&map.walk, Some(map.states.clone()));
    let before = found.errors_before.expect("states were given");
    println!(
        "phone: reprojection {:.3} → {:.3} px, {} points, {:.3} contradicted, path {:.1} m",
        before.rms_px,
        found.errors.rms_px,
        found.points,
        found.contradicted_share,
        found.trajectory.path_length_m()
    );
    assert!(found.errors.rms_px <= before.rms_px && found.contradicted_share < 0.1);
    let given = poses(&map.states, &map.walk);
    let before = Trajectory::new(given.clone());
    let (apart_m, _) = ate_m(found.trajectory.poses(), &before, Scale::Fixed);
    let (_, alignment) = ate_m(found.trajectory.poses(), &before, Scale::Free);
    println!(
        "{apart_m:.2} m from what was given, {:+.2} % of it",
        100.0 / alignment.scale - 100.0
    );
    if !all_figures() {
        assert!(apart_m < 0.3, "{apart_m} m from what was given");
        return;
    }
    // What was given is an odometry's. It ends where it began, by what is seen there, and not by what it says.
    assert_eq!(found.trajectory.poses().len(), given.len());
    let revisit = Revisit::read(&folder, 130, 110);
    let (before_m, before_deg, count) = revisit.drift(&given);
    let (after_m, after_deg, _) = revisit.drift(found.trajectory.poses());
    println!(
        "end from beginning, {count} landmarks: {before_m:.2} → {after_m:.2} m, {before_deg:.2} → {after_deg:.2}°"
    );
    assert!(after_m <= before_m && after_deg <= before_deg);
}

/// Thirty seconds of one camera, in front of which nothing is known.
#[test]
fn one_camera_and_an_imu_find_scale_and_gravity() {
    let test = "one_camera_and_an_imu_find_scale_and_gravity";
    let (Some(tracks), Some(truth)) = (
        recording(test, "euroc_v101_tracks_30s"),
        recording(test, "maplab_euroc_v101_vimap"),
    ) else {
        return;
    };
    let truth = vimap::truth(&truth.join("V1_01_easy_ground_truth_first77s.csv.gz"));
    let walk = eqvio::read(&tracks.join("eqvio_processed_30s.csv.gz"));
    let found = solved(&walk, None);
    let (ate, _) = ate_m(found.trajectory.poses(), &truth, Scale::Fixed);
    let (_, alignment) = ate_m(found.trajectory.poses(), &truth, Scale::Free);
    println!(
        "mono: {} frames, {:?}, ATE {:.2} cm, scale {:+.2} %, reprojection {:.2} px, {} points, {:.3} contradicted",
        walk.frames.len(),
        found.beginning,
        100.0 * ate,
        100.0 * (alignment.scale - 1.0),
        found.errors.rms_px,
        found.points,
        found.contradicted_share,
    );
    assert_eq!(found.beginning, Beginning::Moving);
    assert!(ate < 0.05 && (alignment.scale - 1.0).abs() < 0.01);
    let arm_m = ate_of_another_point_m(found.trajectory.poses(), &truth).0;
    println!(
        "at the point that motion capture followed: {:.2} cm",
        100.0 * arm_m
    );
    assert!(arm_m < 0.015);
}

/// Seven seconds of the same, spoilt: no motion is better than a wrong one.
#[test]
fn tracks_and_samples_that_contradict_each_other_begin_nothing() {
    let test = "tracks_and_samples_that_contradict_each_other_begin_nothing";
    let Some(tracks) = recording(test, "euroc_v101_tracks_30s") else {
        return;
    };
    let mut whole = eqvio::read(&tracks.join("eqvio_processed_30s.csv.gz"));
    whole.frames = whole.frames[200..340].to_vec();
    let spoilt = |spoil: &dyn Fn(&mut TrackedWalk)| {
        let mut walk = whole.clone();
        spoil(&mut walk);
        motion_without_map(&walk, None, &MotionConfig::default(), &no_progress)
    };
    let right = spoilt(&|_| {}).expect("a motion");
    println!(
        "as it is: {:.3} contradicted, {:.1?}",
        right.contradicted_share, right.cameras[0].largest_sigmas
    );
    let samples = |change: fn(&mut ImuSample)| {
        spoilt(&|walk| walk.imu.iter_mut().for_each(|s| change(&mut s.sample)))
    };
    let in_degrees =
        samples(|s| s.angular_velocity_rad_s = s.angular_velocity_rad_s.map(f64::to_degrees));
    let in_g = samples(|s| s.specific_force_m_s2 = s.specific_force_m_s2.map(|f| f / 9.81));
    let swapped = samples(|s| {
        s.angular_velocity_rad_s.rotate_left(1);
        s.specific_force_m_s2.rotate_left(1);
    });
    let still = samples(|s| s.angular_velocity_rad_s = [0.0; 3]);
    let shuffled = spoilt(&|walk| {
        for (k, frame) in walk.frames.iter_mut().enumerate() {
            let numbers: Vec<u32> = frame.sights.iter().map(|s| s.track).collect();
            let turn = k % numbers.len().max(1);
            let turned = numbers.iter().cycle().skip(turn);
            let pairs = frame.sights.iter_mut().zip(turned);
            pairs.for_each(|(sight, number)| sight.track = *number);
        }
    });
    let none = spoilt(&|walk| walk.frames.iter_mut().for_each(|f| f.sights.clear()));
    // What is not far enough off to be refused is said. The tracks' own focal length is 1 % off, 5.8 standard deviations.
    let late = spoilt(&|walk| {
        let frames = walk.frames.iter_mut();
        frames.for_each(|f| f.time = f.time.plus_nanos(50_000_000));
    });
    let turned = spoilt(&|walk| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 3f64.to_radians());
        walk.cameras[0].rig_from_camera.rotation *= turn;
    });
    for (what, found) in [("50 ms late", late), ("turned by 3°", turned)] {
        let off = found.expect("a motion").cameras[0].largest_sigmas;
        println!("{what}: the camera is {off:.1?} standard deviations off");
        assert!(
            off > 10.0 && off > 2.0 * right.cameras[0].largest_sigmas,
            "{what}: {off:?}"
        );
    }
    for (what, found) in [
        ("degrees a second", in_degrees),
        ("units of gravity", in_g),
        ("axes exchanged", swapped),
        ("a silent gyroscope", still),
        ("tracks shuffled", shuffled),
        ("no tracks", none),
    ] {
        let found = found.map(|m| (m.beginning, m.errors.rms_px, m.points, m.contradicted_share));
        println!("{what}: {found:?}");
        assert!(
            matches!(found, Err(Error::Refused(Refusal::NoBeginning { .. }))),
            "{what}: {found:?}"
        );
    }
}

/// A hand-held pair of fisheye cameras before a wall of tags, none of which is used as such.
#[test]
fn a_hand_held_pair_follows_motion_capture() {
    let test = "a_hand_held_pair_follows_motion_capture";
    let both = ["tumvi_calib_imu1_next", "tumvi_calib_imu1"];
    let all: Vec<(&str, usize)> = both
        .iter()
        .flat_map(|name| [(*name, 1), (*name, 2)])
        .collect();
    let wanted = if all_figures() { &all[..] } else { &all[..1] };
    for (name, cameras) in wanted.iter().copied() {
        let (Some(folder), Some(calibrated)) =
            (recording(test, name), recording(test, "tumvi_calib_imu1"))
        else {
            return;
        };
        let rig = calibrated.join("reference_calibration.json");
        let (walk, truth) = tumvi::read(&folder, &rig, &Shown::all(cameras));
        let sights: usize = walk.frames.iter().map(|f| f.sights.len()).sum();
        let found = solved(&walk, None);
        let (ate, _) = ate_m(found.trajectory.poses(), &truth, Scale::Fixed);
        let (_, free) = ate_m(found.trajectory.poses(), &truth, Scale::Free);
        println!(
            "{name}, {cameras} cameras: {} frames, {:.0} sights each, {:?}, ATE {:.2} cm, scale {:+.2} %, reprojection {:.2} px, {} points, {:.3} contradicted",
            walk.frames.len(),
            sights as f64 / walk.frames.len() as f64,
            found.beginning,
            100.0 * ate,
            100.0 * (free.scale - 1.0),
            found.errors.rms_px,
            found.points,
            found.contradicted_share,
        );
        assert!(ate < 0.005 && (free.scale - 1.0).abs() < 0.01);
    }
}

/// A lens that is covered for two seconds ends all tracks; what is seen again after that tells where the device is.
#[test]
fn what_was_seen_before_the_dark_is_recognised_after_it() {
    let test = "what_was_seen_before_the_dark_is_recognised_after_it";
    let Some(folder) = recording(test, "tumvi_calib_imu1") else {
        return;
    };
    let rig = folder.join("reference_calibration.json");
    let shown = Shown {
        cameras: 1,
        until_secs: 14.0,
        dark_secs: 6.0..8.0,
    };
    let (walk, truth) = tumvi::read(&folder, &rig, &shown);
    let alone = solved(
        &TrackedWalk {
            views: Vec::new(),
            ..walk.clone()
        },
        None,
    );
    let found = solved(&walk, None);
    let last_sigma_m = |motion: &Motion| {
        let last = motion.covariances.last().expect("poses");
        last.fixed_view::<3, 3>(3, 3).trace().sqrt()
    };
    let ate_m = |motion: &Motion| ate_m(motion.trajectory.poses(), &truth, Scale::Fixed).0;
    let [before, after] = [&alone, &found].map(|m| [ate_m(m), last_sigma_m(m)]);
    println!(
        "ATE {:.2} and {:.2} mm, σ of the last position {:.2} and {:.2} mm, {:?}",
        1e3 * before[0],
        1e3 * after[0],
        1e3 * before[1],
        1e3 * after[1],
        found.revisits
    );
    assert!(found.revisits.closed >= 1 && found.revisits.opened == 0);
    assert!(after[0] < 0.005 && after[1] < 0.5 * before[1]);
}
