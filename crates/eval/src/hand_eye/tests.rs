use super::continuous::tests::{motion, sampled};
use super::*;
use lsfb_geometry::{Vector6, so3};
use lsfb_types::{Timestamp, Verdict, no_progress};

/// Repeatable, nearly normal numbers of σ 1.
pub fn normal(i: usize) -> f64 {
    let even = |k: usize| ((12 * i + k) as f64 * 12.9898).sin() * 43_758.545;
    (0..12).map(|k| even(k).rem_euclid(1.0)).sum::<f64>() - 6.0
}

pub fn shaken(poses: &[StampedPose], turn_rad: f64, shift_m: f64, seed: usize) -> Vec<StampedPose> {
    let shake = |(i, p): (usize, &StampedPose)| {
        let delta = Vector6::from_fn(|k, _| {
            normal(seed + 6 * i + k) * if k < 3 { turn_rad } else { shift_m }
        });
        StampedPose {
            world_from_rig: p.world_from_rig.retract(&delta),
            ..*p
        }
    };
    poses.iter().enumerate().map(shake).collect()
}

/// A setup: what is to be found.
struct Setup {
    /// `G_T_H`.
    world: Se3,
    /// `N_T_A`.
    body: Se3,
    offset_secs: f64,
    drift: f64,
}

impl Setup {
    fn new(offset_secs: f64) -> Self {
        Self {
            world: Se3::exp(&Vector6::new(0.02, -0.03, 2.1, 40.0, -25.0, 3.0)),
            body: Se3::exp(&Vector6::new(0.4, -1.1, 0.6, 0.35, -0.12, 0.8)),
            offset_secs,
            drift: 0.0,
        }
    }

    /// The reference's poses at its own stamps `t`: `G_T_N(t) = G_T_H H_T_A(t − t₀) N_T_A⁻¹`.
    fn reference(
        &self,
        rate_hz: f64,
        seconds: f64,
        motion: impl Fn(f64) -> Se3,
    ) -> Vec<StampedPose> {
        let start_secs = self.offset_secs;
        let mut poses = sampled(rate_hz, seconds, |t| {
            self.world * motion(t - self.drift * (t - 0.5 * seconds)) * self.body.inverse()
        });
        for pose in &mut poses {
            pose.time = pose.time.plus_secs(start_secs);
        }
        poses
    }

    /// Angle, degrees, distance, metres, and offset, seconds, by which an answer is wrong.
    fn errors(&self, found: &HandEye) -> [f64; 3] {
        let off = self.body.local(&found.body);
        [
            off.fixed_rows::<3>(0).norm().to_degrees(),
            (self.body.translation - found.body.translation).norm(),
            (found.offset_secs - self.offset_secs).abs(),
        ]
    }
}

#[test]
fn gnss_beside_glasses_to_a_centimetre_and_a_millisecond() {
    for (offset_secs, seed) in [(3.217, 0), (-8.4031, 50_000)] {
        let setup = Setup::new(offset_secs);
        let estimate = shaken(&sampled(30.0, 90.0, motion), 0.002, 0.01, seed);
        // INS at 100 Hz: 0.01° and 5 mm.
        let reference = shaken(
            &setup.reference(100.0, 90.0, motion),
            0.0002,
            0.005,
            seed + 9,
        );
        let found = align_trajectories(
            &estimate,
            &reference,
            &HandEyeConfig::default(),
            &no_progress,
        )
        .expect("aligned");
        let [angle_deg, distance_m, offset_off_secs] = setup.errors(&found);
        assert!(
            angle_deg < 0.1 && distance_m < 0.01 && offset_off_secs < 1e-3,
            "{angle_deg} {distance_m} {offset_off_secs}"
        );
        // Errors are as large as stated.
        let sigma = found.reference_from_estimate_body.sigma_translation_m;
        let off = found.body.translation - setup.body.translation;
        let stated = sigma.iter().map(|s| s * s).sum::<f64>().sqrt();
        assert!(off.norm() < 4.0 * stated, "{off} {sigma:?}");
        assert!(offset_off_secs < 4.0 * found.sigma_offset_secs);
        assert!(
            found.findings.iter().all(|f| f.verdict == Verdict::Pass),
            "{:?}",
            found.findings
        );
        // The reference as the estimate's ground truth.
        let truth = found.as_truth(&estimate, &reference).poses;
        let judged =
            crate::evaluate(&truth, &estimate, &crate::EvalConfig::default()).expect("judged");
        assert!(
            judged.ate_translation_m.rmse < 0.025,
            "{:?}",
            judged.ate_translation_m
        );
    }
}

#[test]
fn motion_capture_to_two_millimetres() {
    let setup = Setup::new(-0.7321);
    let estimate = shaken(&sampled(30.0, 60.0, motion), 0.001, 0.004, 3);
    // Markers: 0.2 mm, over a body of 10 cm 0.1°.
    let reference = shaken(&setup.reference(120.0, 60.0, motion), 0.002, 0.0002, 77);
    let found = align_trajectories(
        &estimate,
        &reference,
        &HandEyeConfig::default(),
        &no_progress,
    )
    .expect("aligned");
    let [angle_deg, distance_m, offset_off_secs] = setup.errors(&found);
    assert!(
        angle_deg < 0.2 && distance_m < 0.002 && offset_off_secs < 1e-3,
        "{angle_deg} {distance_m} {offset_off_secs}"
    );
}

/// A marker that is taken for its neighbour turns the body; least squares without doubt would follow.
#[test]
fn dropped_and_swapped_markers_do_no_harm() {
    let setup = Setup::new(1.05);
    let estimate = shaken(&sampled(30.0, 60.0, motion), 0.001, 0.004, 3);
    let mut reference = shaken(&setup.reference(120.0, 60.0, motion), 0.002, 0.0002, 77);
    let swap = Se3::exp(&Vector6::new(0.0, 2.0, 0.3, 0.05, 0.0, 0.02));
    for range in [1000..1400, 3000..3060, 5000..5700] {
        for pose in &mut reference[range] {
            pose.world_from_rig = pose.world_from_rig * swap;
        }
    }
    reference.drain(2000..2300);
    reference.drain(6000..6100);
    let found = align_trajectories(
        &estimate,
        &reference,
        &HandEyeConfig::default(),
        &no_progress,
    )
    .expect("aligned");
    let [angle_deg, distance_m, offset_off_secs] = setup.errors(&found);
    assert!(
        angle_deg < 0.2 && distance_m < 0.002 && offset_off_secs < 1e-3,
        "{angle_deg} {distance_m} {offset_off_secs}"
    );
    assert!(
        found.outliers > 200 && found.outliers < 450,
        "{}",
        found.outliers
    );
}

/// Turned about the vertical only, the device may sit at any height on the car: an answer would be any.
#[test]
fn one_axis_is_refused() {
    let flat = |t: f64| {
        let heading = Vector3::new(0.0, 0.0, 0.8 * (0.5 * t).sin() + 0.3 * t);
        Se3::new(
            so3::exp(&heading),
            Vector3::new(3.0 * (0.2 * t).sin(), 2.0 * (0.3 * t).cos(), 0.0),
        )
    };
    let setup = Setup::new(0.2);
    let estimate = shaken(&sampled(30.0, 60.0, flat), 0.0005, 0.005, 3);
    let reference = setup.reference(100.0, 60.0, flat);
    let refused = align_trajectories(
        &estimate,
        &reference,
        &HandEyeConfig::default(),
        &no_progress,
    )
    .expect_err("flat");
    assert!(matches!(refused, Error::OneAxis { .. }), "{refused}");
}

#[test]
fn a_clock_that_drifts_is_followed() {
    let setup = Setup {
        drift: 2e-4,
        ..Setup::new(0.4)
    };
    let estimate = shaken(&sampled(30.0, 60.0, motion), 0.0005, 0.002, 3);
    let reference = setup.reference(100.0, 60.0, motion);
    let config = HandEyeConfig {
        clock: ClockModel::Drifting,
        ..HandEyeConfig::default()
    };
    let found = align_trajectories(&estimate, &reference, &config, &no_progress).expect("aligned");
    assert!((found.drift - 2e-4).abs() < 2e-5, "{}", found.drift);
    assert!(setup.errors(&found)[1] < 0.002);
}

#[test]
fn halves_that_contradict_each_other_are_told() {
    let verdict = |setup: &Setup, seed: usize| {
        let estimate = shaken(&sampled(30.0, 60.0, motion), 0.0005, 0.002, seed);
        let reference = setup.reference(100.0, 60.0, motion);
        let found = align_trajectories(
            &estimate,
            &reference,
            &HandEyeConfig::default(),
            &no_progress,
        )
        .expect("aligned");
        let halves = found.findings.iter().find(|f| f.code == "halves");
        halves.expect("compared").verdict
    };
    for seed in 1..6 {
        assert_eq!(verdict(&Setup::new(0.4), seed), Verdict::Pass, "{seed}");
    }
    let drifting = Setup {
        drift: 2e-4,
        ..Setup::new(0.4)
    };
    // 6 ms from one half to the other: truth on one clock is wrong for both.
    assert_eq!(verdict(&drifting, 3), Verdict::Fail);
    // Half a millisecond is no matter of a truth in centimetres.
    let hardly = Setup {
        drift: 2e-5,
        ..Setup::new(0.4)
    };
    assert_ne!(verdict(&hardly, 3), Verdict::Fail);
}

/// Glasses that slip by 3 cm, and a clock that jumps by 100 ms, in the middle of the walk: the truth was written, with exit code 0, and is
/// wrong by half of it throughout.
#[test]
fn a_mount_that_slips_and_a_clock_that_jumps_are_no_truth() {
    let setup = Setup::new(0.4);
    let reference = setup.reference(100.0, 60.0, motion);
    let failed = |change: &dyn Fn(&mut StampedPose)| -> Vec<String> {
        let mut estimate = shaken(&sampled(30.0, 60.0, motion), 0.0005, 0.002, 3);
        let half = estimate.len() / 2;
        estimate[half..].iter_mut().for_each(change);
        let found = align_trajectories(
            &estimate,
            &reference,
            &HandEyeConfig::default(),
            &no_progress,
        )
        .expect("aligned");
        let failed = found.findings.iter().filter(|f| f.verdict == Verdict::Fail);
        failed.map(|f| f.code.to_string()).collect()
    };
    let slip = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.03, 0.0));
    let slipped = failed(&|p| p.world_from_rig = p.world_from_rig * slip);
    assert!(slipped.contains(&"halves".to_owned()), "{slipped:?}");
    let jumped = failed(&|p| p.time = p.time.plus_secs(0.1));
    assert!(jumped.contains(&"halves".to_owned()), "{jumped:?}");
    assert!(failed(&|_| {}).is_empty());
}

/// Markers that are swapped for two fifths of the time: a WARN, and the swapped poses stood in the ground truth. Where the estimate jumps, the
/// truth stays: without it the estimate would seem better than it is.
#[test]
fn poses_at_which_the_reference_jumps_are_no_truth() {
    let setup = Setup::new(1.05);
    let estimate = shaken(&sampled(30.0, 60.0, motion), 0.001, 0.004, 3);
    let swap = Se3::exp(&Vector6::new(0.0, 2.0, 0.3, 0.05, 0.0, 0.02));
    let swapped_for = |frames: usize| {
        let mut reference = shaken(&setup.reference(120.0, 60.0, motion), 0.002, 0.0002, 77);
        let mut swapped = 0;
        for twelve_seconds in reference.chunks_mut(1440) {
            for pose in twelve_seconds.iter_mut().take(frames) {
                pose.world_from_rig = pose.world_from_rig * swap;
                swapped += 1;
            }
        }
        let found = align_trajectories(
            &estimate,
            &reference,
            &HandEyeConfig::default(),
            &no_progress,
        );
        (found, reference, swapped)
    };
    let (found, reference, swapped) = swapped_for(576);
    let found = found.expect("aligned");
    let truth = found.as_truth(&estimate, &reference);
    // Those before the first and behind the last pose of the estimate cannot be compared.
    assert!(
        truth.left_out.abs_diff(swapped) < 40
            && truth.poses.len() + truth.left_out == reference.len(),
        "{} of {swapped}",
        truth.left_out
    );
    assert!(truth.finding().is_some_and(|f| f.verdict == Verdict::Warn));
    let inside = |p: &&StampedPose| {
        let secs = p.time.secs_since(estimate[0].time);
        (0.2..59.8).contains(&secs)
    };
    for pose in truth.poses.iter().filter(inside) {
        let true_pose = setup.world * motion(pose.time.secs_since(estimate[0].time));
        let off = true_pose.local(&pose.world_from_rig);
        assert!(off.norm() < 0.05, "{off}");
    }
    assert_eq!(judge::of_inliers(0.45), Verdict::Fail);
    assert_eq!(judge::of_inliers(0.55), Verdict::Warn);
    // The estimate jumps by a metre for ten seconds.
    let mut jumped = estimate.clone();
    for pose in &mut jumped[600..900] {
        pose.world_from_rig.translation.x += 1.0;
    }
    let reference = shaken(&setup.reference(120.0, 60.0, motion), 0.002, 0.0002, 77);
    let found = align_trajectories(&jumped, &reference, &HandEyeConfig::default(), &no_progress)
        .expect("aligned");
    assert!(found.outliers > 250);
    let truth = found.as_truth(&jumped, &reference);
    assert_eq!((truth.left_out, truth.finding()), (0, None));
}

#[test]
fn what_is_not_one_body_is_refused() {
    let setup = Setup::new(0.0);
    let estimate = sampled(30.0, 60.0, motion);
    let other = |t: f64| motion(1.7 * t + 300.0 + 3.0 * (0.37 * t).sin());
    let refused = |reference: &[StampedPose]| {
        align_trajectories(
            &estimate,
            reference,
            &HandEyeConfig::default(),
            &no_progress,
        )
        .expect_err("refused")
    };
    let stranger = refused(&setup.reference(100.0, 60.0, other));
    assert!(
        matches!(
            stranger,
            Error::NotOneBody { .. } | Error::TwoOffsets { .. }
        ),
        "{stranger}"
    );
    let mut later = setup.reference(100.0, 60.0, motion);
    later
        .iter_mut()
        .for_each(|p| p.time = p.time.plus_secs(4000.0));
    assert!(matches!(refused(&later), Error::NoCommonTime { .. }));
    assert!(matches!(refused(&later[..5]), Error::TooFewPoses { .. }));
    let still = setup.reference(100.0, 60.0, |_| motion(0.0));
    assert!(matches!(
        refused(&still),
        Error::EvenRotation { role: "reference" }
    ));
    later[0].time = later[0].time.plus_secs(-1e9);
    assert!(matches!(refused(&later), Error::TooLong { .. }));
    // A motion that repeats itself fits at every period.
    let circle = |t: f64| motion((2.0 * std::f64::consts::PI * t / 3.0).sin());
    let periodic = sampled(30.0, 60.0, circle);
    let twice = align_trajectories(
        &periodic,
        &setup.reference(100.0, 60.0, circle),
        &HandEyeConfig::default(),
        &no_progress,
    );
    assert!(matches!(twice, Err(Error::TwoOffsets { .. })), "{twice:?}");
}

/// Easting and northing of a surveyor: half a thousand kilometres from the origin.
#[test]
fn far_from_the_origin_nothing_changes() {
    let mut setup = Setup::new(0.5);
    setup.world.translation += Vector3::new(458_074.6, 5_429_380.2, 162.9);
    let estimate = shaken(&sampled(30.0, 60.0, motion), 0.001, 0.004, 3);
    let reference = setup.reference(100.0, 60.0, motion);
    let found = align_trajectories(
        &estimate,
        &reference,
        &HandEyeConfig::default(),
        &no_progress,
    )
    .expect("aligned");
    let [angle_deg, distance_m, _] = setup.errors(&found);
    assert!(angle_deg < 0.1 && distance_m < 0.005);
    let place = setup.world * Vector3::new(1.0, 2.0, 0.5);
    assert!((found.world * Vector3::new(1.0, 2.0, 0.5) - place).norm() < 0.01);
}

#[test]
fn a_gyroscope_is_aligned() {
    let turn = so3::exp(&Vector3::new(0.3, -0.9, 1.4));
    let bias = Vector3::new(0.01, -0.02, 0.005);
    let poses = shaken(&sampled(120.0, 30.0, motion), 0.001, 0.0002, 5);
    let samples: Vec<GyroSample> = (0..6000)
        .map(|i| {
            let (t, h) = (f64::from(i) / 200.0, 1e-4);
            let rate = so3::local(&motion(t - h).rotation, &motion(t + h).rotation) / (2.0 * h);
            let noise = Vector3::from_fn(|k, _| 0.005 * normal(3 * i as usize + k));
            GyroSample {
                time: Timestamp::from_nanos(i64::from(i) * 5_000_000 - 1_300_000_000),
                rate_rad_s: turn * rate + bias + noise,
            }
        })
        .collect();
    let found = align_gyroscope(&poses, &samples, &HandEyeConfig::default(), &no_progress)
        .expect("aligned");
    let rotation = lsfb_geometry::UnitQuaternion::new_normalize(nalgebra::Quaternion::from_vector(
        found.rotation_xyzw.into(),
    ));
    assert!(so3::local(&turn, &rotation).norm().to_degrees() < 0.2);
    assert!(
        (found.offset_secs + 1.3).abs() < 1e-3,
        "{}",
        found.offset_secs
    );
    assert!((Vector3::from(found.bias_rad_s) - bias).norm() < 1e-3);
}

#[test]
fn another_unit_and_another_order_of_the_quaternion_are_named() {
    let setup = Setup::new(1.37);
    let estimate = shaken(&sampled(30.0, 60.0, motion), 0.001, 0.003, 3);
    let reference = setup.reference(20.0, 60.0, motion);
    let named = |change: &dyn Fn(&mut Se3)| -> Vec<String> {
        let mut estimate = estimate.clone();
        for pose in &mut estimate {
            change(&mut pose.world_from_rig);
        }
        match align_trajectories(
            &estimate,
            &reference,
            &HandEyeConfig::default(),
            &no_progress,
        ) {
            Ok(found) => {
                let failed = found.findings.iter().filter(|f| f.verdict == Verdict::Fail);
                failed.map(|f| f.code.to_string()).collect()
            }
            Err(error) => vec![error.to_string()],
        }
    };
    let nothing: Vec<String> = Vec::new();
    assert_eq!(named(&|_| {}), nothing);
    for times in [1000.0, 100.0, 1.0 / 0.3048, 0.001] {
        let said = named(&|pose| pose.translation *= times);
        assert!(said.contains(&"unit".to_owned()), "{times}: {said:?}");
    }
    let said = named(&|pose| {
        let q = pose.rotation.into_inner();
        let first = lsfb_geometry::Quaternion::new(q.k, q.w, q.i, q.j);
        pose.rotation = lsfb_geometry::UnitQuaternion::new_normalize(first);
    });
    assert!(said.contains(&"orientations".to_owned()), "{said:?}");
}

/// A mirror image was refused for how uncertain its lever is, which is no word of its cause; a file aligned to itself passed.
#[test]
fn a_mirror_image_and_the_reference_itself_are_named() {
    let setup = Setup::new(0.3);
    let reference = setup.reference(100.0, 60.0, motion);
    let estimate = shaken(&sampled(30.0, 60.0, motion), 0.001, 0.003, 3);
    let codes = |estimate: &[StampedPose], reference: &[StampedPose]| -> Vec<String> {
        let found =
            align_trajectories(estimate, reference, &HandEyeConfig::default(), &no_progress);
        let found = found.expect("aligned").findings.into_iter();
        let told = found.filter(|f| f.verdict >= Verdict::Warn);
        told.map(|f| f.code.to_string()).collect()
    };
    let mut mirrored = estimate.clone();
    for pose in &mut mirrored {
        pose.world_from_rig.translation.y *= -1.0;
    }
    let said = codes(&mirrored, &reference);
    assert!(said.contains(&"positions".to_owned()), "{said:?}");
    let said = codes(&reference, &reference);
    assert!(said.contains(&"same".to_owned()), "{said:?}");
}
