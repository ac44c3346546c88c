//! Devices that are not what their rig file says, and recordings that are not what happened.

use lsfb_geometry::Rig;
use lsfb_recording::Recording;
use lsfb_types::Verdict;

use super::recorded::{Measured, Paint, WALK_FRAMES, map, record, rig, run};
use super::*;
use crate::hd_map::HdMap;

/// A walk with something wrong, in the map of its place.
fn walked(
    map: &HdMap,
    rig_file: &Rig,
    spoil: impl Fn(&mut Measured),
) -> Result<GroundTruth, Error> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    let mut measured = Measured::in_room(Paint::of(1), WALK_FRAMES);
    spoil(&mut measured);
    measured.record(&path, rig_file);
    run(&path, map)
}

/// Codes of what is warned of.
fn warned(found: &GroundTruth) -> Vec<String> {
    let codes = found.report.warnings.iter().map(|w| w.finding().code);
    codes.map(|code| code.into_owned()).collect()
}

/// Codes of what fails.
fn failed(found: &GroundTruth) -> Vec<String> {
    let findings = found.report.findings().into_iter();
    let failed = findings.filter(|f| f.verdict == Verdict::Fail);
    failed.map(|f| f.code.into_owned()).collect()
}

/// Largest distance of a pose from the truth, metres.
fn worst_m(found: &GroundTruth) -> f64 {
    let poses = found.trajectory.poses().iter();
    let apart_m = poses.map(|pose| {
        let true_pose = truth(pose.time.nanos() as f64 * 1e-9);
        (pose.world_from_rig.translation - true_pose.translation).norm()
    });
    apart_m.fold(0.0, f64::max)
}

#[test]
fn what_is_wrong_with_a_walk_is_said() {
    let map = map(1);
    let swapped = walked(&map, &rig(), |m| {
        for s in &mut m.imu {
            s.sample.angular_velocity_rad_s.rotate_left(1);
            s.sample.specific_force_m_s2.rotate_left(1);
        }
    });
    let error = swapped.expect_err("axes of the IMU");
    assert!(
        matches!(error, Error::Refused(Refusal::AccelContradicts { .. })),
        "{error}"
    );

    let late = walked(&map, &rig(), |m| {
        for (_, image) in &mut m.images {
            image.time = image.time.plus_nanos(100_000_000);
        }
    });
    let late = late.expect("100 ms");
    assert!(!failed(&late).is_empty(), "{:?}", late.report);
    let said = warned(&late);
    assert!(said.contains(&"camera-off".to_owned()), "{said:?}");

    let mut longer = rig();
    for camera in longer.cameras.values_mut() {
        if let Lens::KannalaBrandt { focal_px, .. } = &mut camera.camera.lens {
            *focal_px = focal_px.map(|f| 1.02 * f);
        }
    }
    let said = warned(&walked(&map, &longer, |_| {}).expect("2 %"));
    assert!(said.contains(&"camera-off".to_owned()), "{said:?}");
}

/// They were refused for a poor map.
#[test]
fn an_accelerometer_that_measures_nothing_or_along_other_axes_is_named() {
    let map = map(1);
    let with = |change: fn(&mut [f64; 3])| {
        walked(&map, &rig(), |m| {
            for s in &mut m.imu {
                change(&mut s.sample.specific_force_m_s2);
            }
        })
    };
    let frozen = with(|f| *f = [0.1, -0.2, 9.7]).expect_err("frozen");
    assert!(
        matches!(frozen, Error::Refused(Refusal::FrozenSensor { .. })),
        "{frozen}"
    );
    let turned = with(|f| f.swap(1, 2)).expect_err("y and z");
    assert!(
        matches!(
            turned,
            Error::Refused(Refusal::AccelContradicts {
                axis: 'y' | 'z',
                ..
            })
        ),
        "{turned}"
    );
    // Gravity tells less of these two: the walk is found, and nobody takes it for right.
    match with(|f| f.swap(0, 1)) {
        Err(refused) => assert!(
            matches!(refused, Error::Refused(Refusal::AccelContradicts { .. })),
            "{refused}"
        ),
        Ok(found) => assert!(failed(&found).contains(&"imu-errors".to_owned())),
    }
}

/// A walk in a map that was found to be bent is no ground truth, however well the walk fits it.
#[test]
fn a_map_that_failed_gives_no_ground_truth_unless_it_is_accepted() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    record(&path, 1, WALK_FRAMES, &rig(), usize::MAX);
    let map = map(1).with_failures(vec!["cam0: turned by 3°".to_owned()]);
    let error = run(&path, &map).expect_err("a failed map").to_string();
    assert!(error.contains("cam0: turned by 3°"), "{error}");
    assert!(error.contains("accept_failed_map"), "{error}");
    let config = GroundTruthConfig {
        accept_failed_map: true,
        ..GroundTruthConfig::default()
    };
    let recording = Recording::open(&path).expect("a recording");
    let found = ground_truth(&recording, &map, &config, &no_progress).expect("accepted");
    assert_eq!(warned(&found), ["failed-map"]);
}

/// The last images are one image, again and again: taken for what is seen, they hold the device where it was, and nothing is said.
#[test]
fn a_frozen_camera_and_a_stamp_given_twice_are_said_and_move_nothing() {
    let map = map(1);
    let cameras = rig().cameras.len();
    let frozen = walked(&map, &rig(), |m| {
        let last = m.images.len() - 4 * cameras;
        for k in last..m.images.len() {
            m.images[k].1.sample = m.images[k - cameras].1.sample.clone();
        }
    });
    let frozen = frozen.expect("frozen at the end");
    assert_eq!(warned(&frozen), ["frozen-images"]);
    assert_eq!(frozen.report.frozen_share(), 0.25);
    assert!(worst_m(&frozen) < 0.03, "{} m", worst_m(&frozen));

    let twice = walked(&map, &rig(), |m| {
        let time = m.images[5 * cameras].1.time;
        let later = m.images[9 * cameras..10 * cameras].to_vec();
        let stamped = later.into_iter().map(|(name, mut image)| {
            image.time = time;
            (name, image)
        });
        let stamped: Vec<_> = stamped.collect();
        m.images.splice(6 * cameras..6 * cameras, stamped);
    });
    let twice = twice.expect("a stamp given twice");
    assert_eq!(warned(&twice), ["repeated-stamps"]);
    assert!(worst_m(&twice) < 0.01, "{} m", worst_m(&twice));
    assert_eq!(twice.report.frozen_share(), 0.0);
}

/// Nothing is lost by messages that were recorded twice, and it is said; what has the stamp of another measurement is lost. A walk without any
/// raises nothing (`a_recorded_walk_is_placed_in_its_map_and_refused_in_another`).
#[test]
fn inertial_samples_that_came_twice_are_counted_and_said() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    let mut measured = Measured::in_room(Paint::of(1), 1);
    let whole = measured.imu.clone();
    let twice: Vec<_> = whole.iter().step_by(3).cloned().collect();
    let mut other = whole[10].clone();
    other.sample.specific_force_m_s2[0] += 1.0;
    measured.imu.extend(twice.iter().cloned().chain([other]));
    measured.record(&path, &rig());
    let recording = Recording::open(&path).expect("a recording");
    let recorded = RecordedWalk::read(&recording, &GroundTruthConfig::default(), &no_progress);
    let recorded = recorded.expect("read");
    let found = (recorded.repeated_samples, recorded.damaged_samples);
    assert_eq!(found, (twice.len() as u64, 1));
    assert_eq!(recorded.imu.len(), whole.len());
    let said = GroundTruthWarning::RepeatedSamples { samples: found.0 }.finding();
    assert_eq!(
        (said.code.as_ref(), said.verdict),
        ("repeated-samples", Verdict::Warn)
    );
}

/// Three seconds in which nothing is seen, neither the map nor anything else: the IMU alone carries them, and says how surely.
#[test]
fn the_imu_carries_three_seconds_of_darkness() {
    let dark = 40..70;
    let MadeUp {
        mut walk,
        mut features,
    } = make_walk(220, 220, |k| !dark.contains(&k));
    for features in &mut features[2 * dark.start..2 * dark.end] {
        *features = Features::default();
    }
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");
    let estimate = &solved.last.estimate;
    let found = uncertainty(&walk, estimate, &solved.last.points, &config, &no_progress);
    let poses = found.expect("covariances").poses;
    let mut worst_m = 0.0f64;
    for (k, covariance) in poses.iter().enumerate() {
        let error = (truth(k as f64 * FRAME_SECS).inverse() * *estimate.pose(k)).log();
        let covariance = covariance.expect("determined");
        let information = covariance.try_inverse().expect("regular");
        let nees = error.dot(&(information * error));
        worst_m = worst_m.max(error.fixed_rows::<3>(3).norm());
        assert!(nees < 40.0, "frame {k}: {nees}");
    }
    assert!(worst_m < 0.05, "{worst_m} m");
    let found = Solution {
        states: &estimate.states,
        accepted: &start.accepted,
        covariances: &poses,
        disagreements_m: &[0.0; FRAMES],
        in_view: &[],
    };
    assert_eq!(trusted(&walk, &found, &config).poses.len(), FRAMES);
}
