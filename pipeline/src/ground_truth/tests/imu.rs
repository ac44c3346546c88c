//! An IMU that is not as good as its noise and biases say.

use lsfb_types::{Finding, Verdict};

use super::super::accel_axes::misread_axis;
use super::super::imu_refinement::ImuRefinement;
use super::super::map_agreement::MapAgreement;
use super::*;

/// What a solve makes of a walk, and how far it is off.
struct Found {
    imu: ImuRefinement,
    map: MapAgreement,
    worst_m: f64,
    /// Mean squared error of the poses in their standard deviations, of six.
    nees: f64,
    /// Share of the poses within the region that 95 % should be in.
    within: f64,
}

/// 95 % of squared norms of six standard normal numbers are below this.
const CHI_SQUARED_95: f64 = 12.591_587;

fn found(inertial: InertialPriors, spoil: impl Fn(&mut [Stamped<ImuSample>])) -> Found {
    found_in(1.0, Vector3::zeros(), inertial, spoil)
}

/// In a map that is so many times too large, and turned.
fn found_in(
    scale: f64,
    turn: Vector3<f64>,
    inertial: InertialPriors,
    spoil: impl Fn(&mut [Stamped<ImuSample>]),
) -> Found {
    let MadeUp { mut walk, features } = make_walk(60, 60, |_| true);
    let turned = so3::exp(&turn);
    for frame in &mut walk.frames {
        for seen in &mut frame.recognised {
            seen.point_in_world = turned * seen.point_in_world * scale;
        }
        let localized = frame.localized.as_mut().expect("localized");
        let pose = &mut localized.world_from_rig;
        *pose = Se3::new(turned * pose.rotation, turned * pose.translation * scale);
    }
    spoil(&mut walk.imu);
    let config = GroundTruthConfig {
        inertial,
        ..GroundTruthConfig::default()
    };
    let start = started(&walk, &config);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");
    let imu = ImuRefinement::of(&walk, &solved.last, &config).expect("samples");
    walk.loosen_imu(imu.noise_factor());
    let (estimate, points) = (&solved.last.estimate, &solved.last.points);
    let map = MapAgreement::of(&walk, &solved.last, &solved.config).expect("samples");
    let poses =
        uncertainty(&walk, estimate, points, &solved.config, &no_progress).expect("covariances");
    let squared = poses.poses.iter().enumerate().map(|(k, covariance)| {
        let truth = truth(k as f64 * FRAME_SECS);
        let truth = Se3::new(turned * truth.rotation, turned * truth.translation * scale);
        let error = (truth.inverse() * *estimate.pose(k)).log();
        let information = covariance.expect("determined").try_inverse();
        error.dot(&(information.expect("regular") * error))
    });
    let squared: Vec<f64> = squared.collect();
    let within = squared.iter().filter(|s| **s <= CHI_SQUARED_95).count();
    Found {
        imu,
        map,
        worst_m: errors(&walk, &estimate.states).worst_m,
        nees: squared.iter().sum::<f64>() / FRAMES as f64,
        within: within as f64 / FRAMES as f64,
    }
}

/// A phone's: forces 3 % too strong, 5 ms late and turned by 0.5°, rates 1 % too fast.
fn like_a_phones(imu: &mut [Stamped<ImuSample>]) {
    let forces: Vec<_> = imu.iter().map(|s| s.sample.specific_force_m_s2).collect();
    // Samples are 5 ms apart.
    for (s, force) in imu[1..].iter_mut().zip(forces) {
        s.sample.specific_force_m_s2 = force;
    }
    turn_forces(
        imu,
        &UnitQuaternion::from_euler_angles(0.005, -0.004, 0.006),
    );
    for s in imu {
        s.sample.specific_force_m_s2 = s.sample.specific_force_m_s2.map(|v| 1.03 * v);
        s.sample.angular_velocity_rad_s = s.sample.angular_velocity_rad_s.map(|v| 1.01 * v);
    }
}

fn turn_forces(imu: &mut [Stamped<ImuSample>], turn: &UnitQuaternion<f64>) {
    for s in imu {
        s.sample.specific_force_m_s2 = (turn * Vector3::from(s.sample.specific_force_m_s2)).into();
    }
}

/// Verdict of a finding by its code.
fn verdict(findings: &[Finding], code: &str) -> Option<Verdict> {
    findings.iter().find(|f| f.code == code).map(|f| f.verdict)
}

#[test]
fn errors_of_an_imu_are_found_and_named_and_bend_nothing() {
    let right = found(InertialPriors::default(), |_| {});
    let findings = [&right.imu.findings()[..], &right.map.findings(0.0)].concat();
    assert!(
        findings.iter().all(|f| f.verdict == Verdict::Pass),
        "{findings:?}"
    );
    assert!(right.imu.imu_error_sigmas < 1.0, "{:?}", right.imu);
    assert!(right.within > 0.9, "NEES {:.1}", right.nees);

    let phone = found(InertialPriors::default(), like_a_phones);
    let (imu, worst_m) = (&phone.imu, phone.worst_m);
    assert!((4e-3..6.5e-3).contains(&imu.accel_delay_s), "{imu:?}");
    assert!((5e-3..1.2e-2).contains(&imu.gyro_scale[2]), "{imu:?}");
    assert!(worst_m < 0.005, "{worst_m} m");
    assert!(phone.within > 0.93, "NEES {:.1}", phone.nees);
    assert_eq!(
        verdict(&imu.findings(), "imu-errors"),
        Some(Verdict::Warn),
        "{imu:?}"
    );
}

/// Half a degree was not said, and four bent the walk by a centimetre with standard deviations of millimetres.
#[test]
fn an_accelerometer_that_is_turned_on_its_gyroscope_is_found() {
    let axis = Vector3::new(0.5, -0.4, 0.6).normalize();
    for (turn_deg, found_deg) in [(0.5, 0.15..0.6), (4.0, 3.98..4.02)] {
        let turn = UnitQuaternion::new(axis * f64::to_radians(turn_deg));
        let found = found(InertialPriors::default(), |imu| turn_forces(imu, &turn));
        let along = axis.dot(&Vector3::from(found.imu.accel_turn_deg));
        assert!(found_deg.contains(&along), "{:?}", found.imu);
        assert!(found.worst_m < 0.004, "{} m", found.worst_m);
        assert!(found.within > 0.93, "NEES {:.1}", found.nees);
        // Half a degree is usual.
        let expected = Verdict::Warn.unless(turn_deg < 1.0);
        let findings = found.imu.findings();
        assert_eq!(verdict(&findings, "imu-errors"), Some(expected));
    }
}

/// A turn of 8° is found, but what is left of it to the second order is no unknown; nor are rates in steps, as of a gyroscope with few bits.
#[test]
fn what_no_unknown_stands_for_is_said() {
    let axis = Vector3::new(0.5, -0.4, 0.6).normalize();
    let turn = UnitQuaternion::new(axis * f64::to_radians(8.0));
    let turned = found(InertialPriors::default(), |imu| turn_forces(imu, &turn));
    let in_steps = found(InertialPriors::default(), |imu| {
        for s in imu {
            let rates = &mut s.sample.angular_velocity_rad_s;
            *rates = rates.map(|rate| 0.1 * (rate / 0.1).round());
        }
    });
    for found in [turned, in_steps] {
        let findings = found.imu.findings();
        assert_eq!(
            verdict(&findings, "imu-agreement"),
            Some(Verdict::Warn),
            "{:?}",
            found.imu
        );
        assert!(found.imu.noise_factor() > 1.0);
        assert!(found.within > 0.93, "NEES {:.1}", found.nees);
    }
}

/// As of an accelerometer that was knocked by 0.1 m/s² (1.1 cm off before, where millimetres were stated, without a word), and a gyroscope that warms
/// up by 0.34 °/s each second.
#[test]
fn biases_that_change_more_than_their_noise_allows_are_said_and_allowed() {
    let right = found(InertialPriors::default(), |_| ());
    assert_eq!(
        verdict(&right.imu.findings(), "imu-wander"),
        Some(Verdict::Pass),
        "{:?}",
        right.imu
    );
    let knocked = found(InertialPriors::default(), |imu| {
        let half = imu.len() / 2;
        for s in &mut imu[half..] {
            s.sample.specific_force_m_s2[0] += 0.1;
        }
    });
    let warming = found(InertialPriors::default(), |imu| {
        // Samples are 5 ms apart.
        for (k, s) in imu.iter_mut().enumerate() {
            s.sample.angular_velocity_rad_s[1] += 6e-3 * 0.005 * k as f64;
        }
    });
    for (found, largest_m) in [(knocked, 7e-3), (warming, 1e-2)] {
        assert_eq!(
            verdict(&found.imu.findings(), "imu-wander"),
            Some(Verdict::Warn),
            "{:?}",
            found.imu
        );
        assert!(found.worst_m < largest_m, "{:.1} mm", 1e3 * found.worst_m);
        assert!(found.within > 0.93, "NEES {:.1}", found.nees);
    }
}

/// Such walks were refused with "the map is poor here".
#[test]
fn axes_of_an_accelerometer_that_are_wrong_are_named() {
    let misread = |change: fn(&mut [f64; 3])| {
        let MadeUp { mut walk, .. } = make_walk(60, 60, |_| true);
        for s in &mut walk.imu {
            change(&mut s.sample.specific_force_m_s2);
        }
        misread_axis(&walk)
    };
    assert_eq!(misread(|_| {}), None);
    // A scale of 20 % is an error of another kind.
    assert_eq!(misread(|f| *f = f.map(|v| 1.2 * v)), None);
    let swapped = misread(|f| f.swap(0, 1)).expect("x and y");
    let (own, other) = match swapped.axis {
        'x' => (0, 1),
        _ => (1, 0),
    };
    assert!(swapped.felt[own].abs() < 0.4, "{swapped:?}");
    assert!((swapped.felt[other] - 1.0).abs() < 0.3, "{swapped:?}");
    let negative = misread(|f| *f = f.map(|v| -v)).expect("signs");
    assert!(
        negative.felt.iter().any(|v| (v + 1.0).abs() < 0.3),
        "{negative:?}"
    );
    let in_g = misread(|f| *f = f.map(|v| v / 9.81)).expect("units");
    assert!(in_g.felt.iter().any(|v| *v > 3.0), "{in_g:?}");
    // Places that have nothing to do with the walk say nothing.
    let MadeUp { mut walk, .. } = make_walk(60, 60, |_| true);
    let mut rng = Gauss(ChaCha8Rng::seed_from_u64(3));
    for frame in &mut walk.frames {
        let shift_m = rng.vector(0.5);
        let pose = &mut frame.localized.as_mut().expect("localized").world_from_rig;
        pose.translation += shift_m;
    }
    assert_eq!(misread_axis(&walk), None);
}

/// Beyond what an IMU can have, what the solve calls its errors may be something else, by which the walk is bent: that was exit code 0.
#[test]
fn errors_that_no_imu_has_fail() {
    let late = |samples: usize| {
        found(InertialPriors::default(), |imu| {
            let all: Vec<_> = imu.iter().map(|s| s.sample).collect();
            for (s, earlier) in imu[samples..].iter_mut().zip(all) {
                s.sample.specific_force_m_s2 = earlier.specific_force_m_s2;
            }
        })
    };
    for (samples, expected) in [(1, Verdict::Pass), (4, Verdict::Warn), (10, Verdict::Fail)] {
        let found = late(samples);
        let said = verdict(&found.imu.findings(), "imu-errors");
        assert_eq!(said, Some(expected), "{:?}", found.imu);
    }
}

/// A map of another scale fits its images as well as the right one: only the IMU tells.
#[test]
fn a_map_of_another_scale_and_one_that_leans_are_said() {
    let in_map = |scale, lean_deg: f64| {
        let lean = Vector3::new(lean_deg.to_radians(), 0.0, 0.0);
        found_in(scale, lean, InertialPriors::default(), |_| {})
    };
    let wrong = [
        (0.96, 0.0, "map-scale", Verdict::Warn),
        (1.04, 0.0, "map-scale", Verdict::Warn),
        (1.2, 0.0, "map-scale", Verdict::Fail),
        (1.0, 1.5, "map-level", Verdict::Warn),
    ];
    for (scale, lean_deg, code, expected) in wrong {
        let found = in_map(scale, lean_deg);
        // A few frozen images are no reason to be silent.
        let findings = found.map.findings(0.02);
        assert_eq!(verdict(&findings, code), Some(expected), "{:?}", found.map);
        // Of a walk that a camera's frozen images cut in two, a few percent are the IMU's drift: that was said of the map too.
        let of_frozen = match (code, expected) {
            ("map-scale", Verdict::Warn) => Verdict::Unknown,
            _ => expected,
        };
        let findings = found.map.findings(0.3);
        assert_eq!(verdict(&findings, code), Some(of_frozen), "{:?}", found.map);
        let told = found.map.scale.expect("moves");
        let off = told.too_large_percent - 100.0 * (1.0 - f64::recip(scale));
        assert!(off.abs() < 3.0 * told.sigma_percent, "{told:?} of {scale}");
        // The IMU does not bend the walk within its map.
        assert!(found.within > 0.93, "{scale}: NEES {:.1}", found.nees);
    }
}

/// What swings was taken into the path as it was, without a word: images tell it from all frames together alone, and only what moves the path by
/// more than the finding says.
#[test]
fn samples_that_swing_and_images_that_do_not_are_said() {
    let swinging = |hz: f64, forces: [f64; 3], rates: [f64; 3]| {
        let found = found(InertialPriors::default(), |imu| {
            for s in imu {
                let swing = (std::f64::consts::TAU * hz * s.time.nanos() as f64 * 1e-9).sin();
                for axis in 0..3 {
                    s.sample.specific_force_m_s2[axis] += forces[axis] * swing;
                    s.sample.angular_velocity_rad_s[axis] += rates[axis] * swing;
                }
            }
        });
        let swing = found.imu.imu_swing.expect("long enough");
        (swing, verdict(&found.imu.findings(), "imu-swing"))
    };
    let none = [0.0; 3];
    let (still, said) = swinging(3.3, none, none);
    assert_eq!(said, Some(Verdict::Pass), "{still:?}");
    for (hz, axis) in [(2.2, 2), (3.3, 0), (4.1, 1)] {
        // Two and a half times what the finding says.
        let mut forces = none;
        let per_s = std::f64::consts::TAU * hz;
        forces[axis] = 2.5 * still.noticed_from_m * per_s * per_s;
        let (swing, said) = swinging(hz, forces, none);
        assert_eq!(said, Some(Verdict::Warn), "{swing:?}");
        assert!((swing.hz - hz).abs() < 0.15, "{swing:?} of {hz} Hz");
    }
    let (swing, said) = swinging(3.7, none, [0.0, 0.0, 0.05]);
    assert_eq!(said, Some(Verdict::Warn), "{swing:?}");
    assert!((swing.hz - 3.7).abs() < 0.15, "{swing:?}");
}
