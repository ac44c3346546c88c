use super::*;
use crate::hand_eye::continuous::tests::{motion, sampled};
use crate::hand_eye::tests::{normal, shaken};
use lsfb_geometry::{Vector6, so3};
use lsfb_types::{Timestamp, Verdict, no_progress};

const GYRO_BIAS_RAD_S: Vector3<f64> = Vector3::new(0.012, -0.02, 0.007);
const ACCEL_BIAS_M_S2: Vector3<f64> = Vector3::new(0.08, -0.05, 0.1);
/// World from IMU in a world that is not level.
fn world() -> Se3 {
    Se3::exp(&Vector6::new(0.3, -0.2, 0.9, 4.0, -2.0, 1.0))
}

/// What an IMU says on a motion whose world has z up; `noise` is 1 for that of a phone at 200 Hz, 0 for one without biases.
pub fn sample(motion: &dyn Fn(f64) -> Se3, t: f64, noise: f64) -> Stamped<ImuSample> {
    let h = 1e-4;
    let (before, now, after) = (motion(t - h), motion(t), motion(t + h));
    let turn = so3::local(&before.rotation, &after.rotation) / (2.0 * h);
    let acceleration = (after.translation - 2.0 * now.translation + before.translation) / (h * h);
    let force = now.rotation.inverse() * (acceleration + Vector3::new(0.0, 0.0, 9.81));
    let is_real = f64::from(u8::from(noise > 0.0));
    let i = ((t + 10.0) * 1e4).round() as usize;
    let shake = |k: usize, size: f64| Vector3::from_fn(|j, _| noise * size * normal(i + 7 * k + j));
    let time = Timestamp::from_nanos((t * 1e9).round() as i64);
    Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample: ImuSample {
            angular_velocity_rad_s: (turn + GYRO_BIAS_RAD_S * is_real + shake(1, 0.0028)).into(),
            specific_force_m_s2: (force + ACCEL_BIAS_M_S2 * is_real + shake(2, 0.028)).into(),
        },
    }
}

/// As `motion`, by a hand that turns the device quickly, up to 90° a second.
fn lively(t: f64) -> Se3 {
    let turn = Vector3::new(
        0.25 * (5.3 * t).sin(),
        0.25 * (4.1 * t + 1.0).sin(),
        0.15 * (6.7 * t).sin(),
    );
    let pose = motion(t);
    Se3::new(so3::retract(&pose.rotation, &turn), pose.translation)
}

struct Simulated {
    body: Se3,
    markers: Vec<StampedPose>,
    samples: Vec<Stamped<ImuSample>>,
}

/// 120 Hz of markers that shake by 0.2 mm, and 0.1° over a body of 20 cm; the IMU's clock is 0.4 s behind, and drifts.
fn simulated(secs: f64, drift: f64) -> Simulated {
    simulated_of(secs, drift, 0)
}

/// The same with other noise.
fn simulated_of(secs: f64, drift: f64, seed: usize) -> Simulated {
    let body = Se3::exp(&Vector6::new(0.4, -0.6, 1.3, 0.05, -0.08, 0.03));
    let poses = sampled(120.0, secs, |t| {
        let imu_secs = t - 0.4 + drift * (t - 0.5 * secs);
        world() * lively(imu_secs) * body.inverse()
    });
    let sample = |i: i64| {
        let time = i as f64 / 200.0;
        // The noise of another part of the walk.
        let other = sample(&lively, time + seed as f64, 1.0);
        let quiet = sample(&lively, time + seed as f64, 0.0);
        let mut own = sample(&lively, time, 0.0);
        for k in 0..3 {
            own.sample.angular_velocity_rad_s[k] +=
                other.sample.angular_velocity_rad_s[k] - quiet.sample.angular_velocity_rad_s[k];
            own.sample.specific_force_m_s2[k] +=
                other.sample.specific_force_m_s2[k] - quiet.sample.specific_force_m_s2[k];
        }
        own
    };
    Simulated {
        body,
        markers: shaken(&poses, 0.0017, 0.0002, 900 + seed),
        samples: (-60..(200.0 * secs) as i64).map(sample).collect(),
    }
}

/// Largest error of the path, degrees and metres, and root mean squares from one 30th of a second to the next.
fn errors(found: &MocapAlignment) -> [f64; 4] {
    let truth = |p: &StampedPose| world() * lively(p.time.nanos() as f64 * 1e-9);
    let off: Vec<(Se3, Se3)> = found
        .path
        .iter()
        .map(|p| (p.world_from_rig, truth(p)))
        .collect();
    let absolute = off.iter().map(|(found, truth)| truth.local(found));
    let (mut turn, mut shift) = (0.0f64, 0.0f64);
    for error in absolute {
        turn = turn.max(error.fixed_rows::<3>(0).norm().to_degrees());
        shift = shift.max(error.fixed_rows::<3>(3).norm());
    }
    // Where the path is left out there is no step.
    let frames: Vec<&StampedPose> = found.path.iter().step_by(11).collect();
    let steps: Vec<Vector6<f64>> = frames
        .windows(2)
        .filter(|w| w[1].time.secs_since(w[0].time) < 0.05)
        .map(|w| {
            let found = w[0].world_from_rig.inverse() * w[1].world_from_rig;
            (truth(w[0]).inverse() * truth(w[1])).local(&found)
        })
        .collect();
    let rms = |at: usize| {
        let sum: f64 = steps
            .iter()
            .map(|e| e.fixed_rows::<3>(at).norm_squared())
            .sum();
        (sum / steps.len() as f64).sqrt()
    };
    [turn, shift, rms(0).to_degrees(), rms(3)]
}

#[allow(clippy::print_stderr, reason = "figures are asked for")]
fn figures([turn_deg, shift_m, step_deg, step_m]: [f64; 4]) {
    if std::env::var_os("LSFB_FIGURES").is_some() {
        let [shift_mm, step_mm] = [shift_m, step_m].map(|m| 1000.0 * m);
        eprintln!(
            "at most {turn_deg:.3}° {shift_mm:.2} mm; from frame to frame {step_deg:.4}° {step_mm:.3} mm rms"
        );
    }
}

/// As MoCap2GT and its successor claim: 0.2° and 2 mm, from frame to frame 0.02° and 0.2 mm.
#[test]
fn the_path_is_ten_times_smoother_than_the_markers() {
    let setup = simulated(20.0, 0.0);
    let found = align_mocap(
        &setup.markers,
        &setup.samples,
        &MocapConfig::default(),
        &no_progress,
    )
    .expect("aligned");
    let found_errors @ [turn_deg, shift_m, step_deg, step_m] = errors(&found);
    figures(found_errors);
    assert!(turn_deg < 0.2 && shift_m < 0.002, "{turn_deg} {shift_m}");
    assert!(step_deg < 0.02 && step_m < 0.0002, "{step_deg} {step_m}");
    assert!(
        (found.offset_secs - 0.4).abs() < 1e-4,
        "{}",
        found.offset_secs
    );
    let off = setup.body.local(&found.body);
    let sigmas = &found.markers_from_imu;
    for k in 0..3 {
        assert!(
            off[k].to_degrees().abs() < 4.0 * sigmas.sigma_rotation_deg[k],
            "{off}"
        );
        assert!(
            off[3 + k].abs() < 4.0 * sigmas.sigma_translation_m[k],
            "{off}"
        );
    }
    let down = world().rotation.inverse() * Vector3::from(found.gravity_m_s2);
    assert!(
        (down + Vector3::new(0.0, 0.0, 9.81)).norm() < 0.02,
        "{down}"
    );
    assert!((Vector3::from(found.gyro_bias_rad_s) - GYRO_BIAS_RAD_S).norm() < 1e-3);
    let bad: Vec<_> = found
        .findings
        .iter()
        .filter(|f| f.verdict != Verdict::Pass)
        .collect();
    assert!(bad.is_empty(), "{bad:?}");
    assert!(found.given > 0.99 && found.outliers < 5);
}

/// What holds for one noise may be luck.
#[test]
fn the_path_is_as_smooth_with_other_noise() {
    for seed in [1_000, 20_000, 300_000] {
        let setup = simulated_of(20.0, 2e-5, seed);
        let found = align_mocap(
            &setup.markers,
            &setup.samples,
            &MocapConfig::default(),
            &no_progress,
        )
        .expect("aligned");
        let found_errors @ [turn_deg, shift_m, step_deg, step_m] = errors(&found);
        figures(found_errors);
        assert!(turn_deg < 0.2 && shift_m < 0.002, "{turn_deg} {shift_m}");
        assert!(step_deg < 0.02 && step_m < 0.0002, "{step_deg} {step_m}");
    }
}

/// Markers that are taken for each other, and some that are not seen: a filter without doubt would jump with them.
#[test]
fn swapped_and_dropped_markers_are_bridged() {
    let mut setup = simulated(20.0, 4e-5);
    let swap = Se3::exp(&Vector6::new(0.0, 0.3, 0.1, 0.03, 0.0, 0.01));
    for range in [600..660, 1500..1530] {
        for pose in &mut setup.markers[range] {
            pose.world_from_rig = pose.world_from_rig * swap;
        }
    }
    setup.markers.drain(1000..1030);
    let config = MocapConfig {
        clock: ClockModel::Drifting,
        ..MocapConfig::default()
    };
    let found =
        align_mocap(&setup.markers, &setup.samples, &config, &no_progress).expect("aligned");
    let found_errors @ [turn_deg, shift_m, step_deg, step_m] = errors(&found);
    figures(found_errors);
    assert!(turn_deg < 0.2 && shift_m < 0.003, "{turn_deg} {shift_m}");
    assert!(step_deg < 0.02 && step_m < 0.0002, "{step_deg} {step_m}");
    assert!((85..=100).contains(&found.outliers), "{}", found.outliers);
    assert!((found.drift + 4e-5).abs() < 1e-5, "{}", found.drift);
    let [least, most] = found.offset_range_secs;
    assert!(most - least > 4e-4 && most - least < 1.2e-3);
}

/// Turned about one axis only, nothing says where along it the IMU sits.
#[test]
fn what_the_motion_does_not_show_is_refused() {
    let turn = |t: f64| {
        Se3::new(
            so3::exp(&Vector3::new(
                0.0,
                0.0,
                (0.9 * t).sin() + 0.3 * (3.1 * t + 0.2 * t * t).sin(),
            )),
            motion(t).translation,
        )
    };
    let markers = shaken(&sampled(120.0, 10.0, turn), 0.0017, 0.0002, 900);
    let samples: Vec<_> = (0..2000)
        .map(|i| sample(&turn, f64::from(i) / 200.0, 1.0))
        .collect();
    let refused = align_mocap(&markers, &samples, &MocapConfig::default(), &no_progress);
    assert!(matches!(refused, Err(Error::OneAxis { .. })), "{refused:?}");
    let setup = simulated(10.0, 0.0);
    let few = align_mocap(
        &setup.markers[..50],
        &setup.samples,
        &MocapConfig::default(),
        &no_progress,
    );
    assert!(matches!(few, Err(Error::TooFewPoses { .. })));
    let mut in_g = setup.samples.clone();
    for sample in &mut in_g {
        sample.sample.specific_force_m_s2 = sample.sample.specific_force_m_s2.map(|f| f / 9.81);
    }
    let refused = align_mocap(&setup.markers, &in_g, &MocapConfig::default(), &no_progress);
    assert!(
        matches!(refused, Err(Error::NotOneMotion { force_m_s2, .. }) if force_m_s2 < 2.0),
        "{refused:?}"
    );
    let mut gap = setup.samples.clone();
    gap.drain(900..960);
    let refused = align_mocap(&setup.markers, &gap, &MocapConfig::default(), &no_progress);
    assert!(
        matches!(refused, Err(Error::InertialGap { .. })),
        "{refused:?}"
    );
}

/// The search runs from markers to IMU: its error said 100 where the user had said −100, and "-0" where he had said nothing.
#[test]
fn an_error_names_the_offset_that_was_given() {
    let setup = simulated(20.0, 0.0);
    let far: Vec<StampedPose> = setup
        .markers
        .iter()
        .map(|pose| StampedPose {
            time: pose.time.plus_secs(5000.0),
            ..*pose
        })
        .collect();
    for (given, words) in [(-100.0, "an offset of -100 s"), (0.0, "an offset of 0 s")] {
        let config = MocapConfig {
            offset_guess_secs: given,
            ..MocapConfig::default()
        };
        let error =
            align_mocap(&far, &setup.samples, &config, &no_progress).expect_err("no common time");
        assert!(error.to_string().contains(words), "{error}");
    }
}
