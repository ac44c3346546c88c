//! An IMU that is not as good as its noise and biases say.

use lsfb_types::Verdict;

use super::super::imu_refinement::ImuRefinement;
use super::*;

/// What a solve makes of a walk, and how far it is off.
struct Found {
    imu: ImuRefinement,
    worst_m: f64,
    /// Mean squared error of the poses in their standard deviations, of six.
    nees: f64,
    /// Share of the poses within the region that 95 % should be in.
    within: f64,
}

/// 95 % of squared norms of six standard normal numbers are below this.
const CHI_SQUARED_95: f64 = 12.591_587;

fn found(inertial: InertialPriors, spoil: impl Fn(&mut [Stamped<ImuSample>])) -> Found {
    let MadeUp { mut walk, features } = make_walk(60, 60, |_| true);
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
    let poses = uncertainty(&walk, estimate, points, &config, &no_progress).expect("covariances");
    let squared = poses.poses.iter().enumerate().map(|(k, covariance)| {
        let error = (truth(k as f64 * FRAME_SECS).inverse() * *estimate.pose(k)).log();
        let information = covariance.expect("determined").try_inverse();
        error.dot(&(information.expect("regular") * error))
    });
    let squared: Vec<f64> = squared.collect();
    let within = squared.iter().filter(|s| **s <= CHI_SQUARED_95).count();
    Found {
        imu,
        worst_m: errors(&walk, &estimate.states).worst_m,
        nees: squared.iter().sum::<f64>() / FRAMES as f64,
        within: within as f64 / FRAMES as f64,
    }
}

/// A phone's: forces 3 % too strong and 5 ms late, rates 1 % too fast.
fn like_a_phones(imu: &mut [Stamped<ImuSample>]) {
    let forces: Vec<_> = imu.iter().map(|s| s.sample.specific_force_m_s2).collect();
    // Samples are 5 ms apart.
    for (s, force) in imu[1..].iter_mut().zip(forces) {
        s.sample.specific_force_m_s2 = force;
    }
    for s in imu {
        s.sample.specific_force_m_s2 = s.sample.specific_force_m_s2.map(|v| 1.03 * v);
        s.sample.angular_velocity_rad_s = s.sample.angular_velocity_rad_s.map(|v| 1.01 * v);
    }
}

#[test]
fn errors_of_an_imu_are_found_and_named_and_bend_nothing() {
    let right = found(InertialPriors::default(), |_| {});
    let findings = right.imu.findings();
    assert!(
        findings.iter().all(|f| f.verdict == Verdict::Pass),
        "{findings:?}"
    );
    assert!(right.imu.imu_error_sigmas < 1.0, "{:?}", right.imu);
    assert!(right.within > 0.9, "NEES {:.1}", right.nees);

    let phone = found(InertialPriors::default(), like_a_phones);
    let (imu, worst_m) = (&phone.imu, phone.worst_m);
    // What is known beforehand, 2 ms and 0.5 %, draws them back.
    assert!((2.5e-3..5.5e-3).contains(&imu.accel_delay_s), "{imu:?}");
    assert!((5e-3..1.2e-2).contains(&imu.gyro_scale[2]), "{imu:?}");
    assert!(worst_m < 0.005, "{worst_m} m");
    assert!(phone.within > 0.9, "NEES {:.1}", phone.nees);
    let findings = imu.findings();
    let named = |code: &str| {
        findings
            .iter()
            .any(|f| f.code == code && f.verdict == Verdict::Warn)
    };
    assert!(named("imu-errors"), "{findings:?}");

    // Taken for right, as they were, they bend the walk, and its standard deviations do not say so.
    let held = InertialPriors {
        gyro_scale_sigma: 1e-5,
        accel_scale_sigma: 1e-5,
        accel_delay_sigma_s: 1e-5,
        gravity_size_sigma_m_s2: 0.05,
    };
    let held = found(held, like_a_phones);
    assert!(held.nees > 2.0 * phone.nees, "NEES {:.1}", held.nees);
}

/// An accelerometer that is turned by 4° on the gyroscope is no unknown of the solve: the walk is bent by a centimetre, what is left tells.
#[test]
fn what_no_unknown_stands_for_is_said() {
    let askew = UnitQuaternion::from_euler_angles(0.03, -0.04, 0.05);
    let found = found(InertialPriors::default(), |imu| {
        for s in imu {
            let force = askew * Vector3::from(s.sample.specific_force_m_s2);
            s.sample.specific_force_m_s2 = force.into();
        }
    });
    let findings = found.imu.findings();
    let left = findings.iter().find(|f| f.code == "imu-agreement");
    assert_eq!(
        left.map(|f| f.verdict),
        Some(Verdict::Warn),
        "{:?}",
        found.imu
    );
    assert!(found.imu.noise_factor() > 1.0);
}
