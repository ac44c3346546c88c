use super::*;
use lsfb_geometry::UnitQuaternion;
use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2};
use rand::{RngExt, SeedableRng};

const NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1e-4,
    accel_noise_density: 1e-3,
    gyro_bias_walk: 1e-5,
    accel_bias_walk: 1e-4,
};

/// Samples at 200 Hz of an IMU at rest, turned by `world_from_rig`.
fn at_rest(world_from_rig: &UnitQuaternion<f64>, gyro_bias: [f64; 3]) -> Vec<Stamped<ImuSample>> {
    let force = world_from_rig.inverse() * Vector3::new(0.0, 0.0, STANDARD_GRAVITY_M_S2);
    (0..400)
        .map(|i| Stamped {
            time: Timestamp::from_nanos(i * 5_000_000),
            arrival: Timestamp::from_nanos(i * 5_000_000),
            device_ticks: 0,
            sample: ImuSample {
                angular_velocity_rad_s: gyro_bias,
                specific_force_m_s2: force.into(),
            },
        })
        .collect()
}

#[test]
fn starts_level_with_heading_zero_and_stays() {
    let tilted = so3::exp(&Vector3::new(0.2, -0.1, 0.0));
    let samples = at_rest(&tilted, [0.004, -0.002, 0.001]);
    let zero = Timestamp::from_nanos(0);
    let mut filter = InertialFilter::start(&samples[..20], zero, &NOISE).expect("samples");
    let knots = filter.predict(&samples, Timestamp::from_nanos(1_002_500_000));
    assert_eq!(knots.len(), 202);
    let end = filter.state();
    assert_eq!(filter.time().nanos(), 1_002_500_000);
    assert!(end.world_from_rig.translation.norm() < 1e-9);
    let forward = end.world_from_rig.rotation * Vector3::x();
    assert!(forward.y.abs() < 1e-9);
    let up = end.world_from_rig.rotation.inverse() * Vector3::z();
    assert!((up - tilted.inverse() * Vector3::z()).norm() < 1e-9);
}

#[test]
fn upside_down_is_level_too() {
    let samples = at_rest(
        &UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI),
        [0.0; 3],
    );
    // Exactly upside down, where no shortest way leads to level.
    let exactly: Vec<_> = samples
        .iter()
        .cloned()
        .map(|mut s| {
            s.sample.specific_force_m_s2 = [0.0, 0.0, -STANDARD_GRAVITY_M_S2];
            s
        })
        .collect();
    for samples in [samples, exactly] {
        let zero = Timestamp::from_nanos(0);
        let mut filter = InertialFilter::start(&samples, zero, &NOISE).expect("samples");
        let up = filter.state().world_from_rig.rotation * -Vector3::z();
        assert!((up - Vector3::z()).norm() < 1e-6, "{up}");
        filter.predict(&samples, Timestamp::from_nanos(500_000_000));
        assert!(filter.state().velocity_m_s.norm() < 1e-6);
    }
}

/// Naively a gap of 45 ms was taken for even motion, and a second at 1 m/s² cost several centimetres a second.
#[test]
fn a_gap_of_45_ms_is_bridged_by_its_ends() {
    let samples: Vec<_> = at_rest(&UnitQuaternion::identity(), [0.0; 3])
        .into_iter()
        .enumerate()
        .filter(|(i, _)| i.is_multiple_of(20) || i % 20 > 8)
        .map(|(_, mut s)| {
            s.sample.specific_force_m_s2[0] = 1.0;
            s
        })
        .collect();
    let zero = Timestamp::from_nanos(0);
    let mut filter = InertialFilter::start(&samples[..1], zero, &NOISE).expect("samples");
    // The start takes what it feels for up, and for standing: here the world is known, and that it gathers speed.
    filter.state.world_from_rig = Se3::identity();
    filter.standing = None;
    filter.predict(&samples, Timestamp::from_nanos(1_000_000_000));
    let velocity = filter.state().velocity_m_s;
    assert!((velocity.x - 1.0).abs() < 0.01, "{velocity}");
}

/// A clock that was set while the carrier stood: a year in steps of a tenth of a second filled the memory.
#[test]
fn a_gap_of_a_year_is_crossed_at_once() {
    let samples = at_rest(&UnitQuaternion::identity(), [0.0; 3]);
    let zero = Timestamp::from_nanos(0);
    let mut filter = InertialFilter::start(&samples, zero, &NOISE).expect("samples");
    let year = Timestamp::from_nanos(31_536_000_000_000_000);
    let mut later = samples.clone();
    later
        .iter_mut()
        .for_each(|s| s.time = s.time.plus_nanos(year.nanos()));
    for samples in [samples.clone(), [samples, later].concat()] {
        let path = filter.clone().predict(&samples, year.plus_secs(0.5));
        assert!(path.len() < 1_000, "{}", path.len());
        assert_eq!(path.last().expect("an end").time, year.plus_secs(0.5));
    }
    assert!(filter.predict(&[], year).len() == 1);
}

#[test]
fn a_gap_widens_the_prior() {
    let samples = at_rest(&UnitQuaternion::identity(), [0.0; 3]);
    let (zero, end) = (Timestamp::from_nanos(0), Timestamp::from_nanos(600_000_000));
    let information = |samples: &[Stamped<ImuSample>]| {
        let mut filter = InertialFilter::start(&samples[..20], zero, &NOISE).expect("samples");
        filter.predict(samples, end);
        filter.pose_prior().information
    };
    let whole = information(&samples);
    let mut holed = samples.clone();
    holed.drain(20..110);
    let gap = information(&holed);
    for i in 0..6 {
        assert!(gap[(i, i)] < 0.1 * whole[(i, i)], "{i}: {gap} {whole}");
    }
}

#[test]
fn poses_teach_the_accelerometer_bias() {
    let samples: Vec<_> = at_rest(&UnitQuaternion::identity(), [0.0; 3])
        .into_iter()
        .map(|mut s| {
            s.sample.specific_force_m_s2[2] += 0.05;
            s
        })
        .collect();
    let zero = Timestamp::from_nanos(0);
    let mut filter = InertialFilter::start(&samples[..20], zero, &NOISE).expect("samples");
    let information = Matrix6::identity() * 1e6;
    for i in 1..19 {
        filter.predict(&samples, Timestamp::from_nanos(i * 100_000_000));
        filter.correct(&Se3::identity(), &information, &information);
    }
    let state = filter.state();
    // The length of gravity is known to a centimetre per second squared: the rest is bias.
    assert!((state.accel_bias_m_s2.z - 0.05).abs() < 0.005, "{state:?}");
    assert!(state.velocity_m_s.norm() < 2e-3, "{state:?}");
}

/// A clock that is set while the carrier stands tells nothing more of the bias: a minute's pause was a minute of standing.
#[test]
fn a_pause_is_no_standing() {
    let samples = at_rest(&UnitQuaternion::identity(), [0.0; 3]);
    let zero = Timestamp::from_nanos(0);
    let sigma = |pause_ns: i64| {
        let mut samples = samples.clone();
        for s in &mut samples[200..] {
            s.time = s.time.plus_nanos(pause_ns);
        }
        let mut filter = InertialFilter::start(&samples[..20], zero, &NOISE).expect("samples");
        filter.predict(&samples, samples[399].time);
        assert!(filter.stands());
        filter.known_bias(filter.time()).sigma_rad_s.max()
    };
    let (whole, paused) = (sigma(0), sigma(60_000_000_000));
    assert!(paused > 0.9 * whole, "{paused} {whole}");
}

/// Of a walk that turns at two radians a second with a gyroscope that reads a twentieth too much, motion told a bias of 25 mrad/s: the walk was begun again with
/// it, and turned by that while it stood.
#[test]
fn a_bias_that_standing_denies_is_none() {
    let known = |z: f64, sigma: f64| KnownBias {
        rad_s: Vector3::new(0.004, -0.003, z),
        sigma_rad_s: Vector3::repeat(sigma),
    };
    let at_rest = known(0.0065, 0.0047);
    assert!(!known(0.0251, 0.0009).agrees(&at_rest));
    assert!(known(0.0150, 0.0009).agrees(&at_rest));
    assert!(!known(f64::NAN, 0.0009).agrees(&at_rest));
}

/// Who stands sways, by some milliradians, slowly: what is stated of a turn after a second and a half of standing and a second of motion is enough
/// for that; as of many independent means, or by the gyroscope's noise, it would be far too little.
#[test]
fn turns_are_known_as_well_as_people_stand() {
    const SWAY_RAD: [f64; 2] = [3.5e-3, 1.2e-3];
    const SWAY_RAD_S: [f64; 2] = [std::f64::consts::TAU * 0.2, std::f64::consts::TAU * 0.5];
    const RATE_HZ: i64 = 200;
    let noise = ImuNoiseModel {
        gyro_noise_density: 5.2e-4,
        ..NOISE
    };
    let ms = |ms: i64| Timestamp::from_nanos(ms * 1_000_000);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let draws = 60;
    let mut squared_sigmas = Vec::new();
    for _ in 0..draws {
        let phases: [Vector3<f64>; 2] = std::array::from_fn(|_| {
            Vector3::from_fn(|_, _| rng.random_range(0.0..std::f64::consts::TAU))
        });
        let sum = |of: &dyn Fn(usize, f64) -> f64| -> Vector3<f64> {
            phases[0].map(|p| of(0, p)) + phases[1].map(|p| of(1, p))
        };
        let swayed = |t: f64| sum(&|k, p| SWAY_RAD[k] * (SWAY_RAD_S[k] * t + p).sin());
        let swaying =
            |t: f64| sum(&|k, p| SWAY_RAD[k] * SWAY_RAD_S[k] * (SWAY_RAD_S[k] * t + p).cos());
        let mut gaussian = || -> f64 {
            let (u, v): (f64, f64) = (rng.random(), rng.random());
            (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
        };
        let white = noise.gyro_noise_density * (RATE_HZ as f64).sqrt();
        let bias = Vector3::from_fn(|_, _| 0.003 * gaussian());
        let mut samples = at_rest(&UnitQuaternion::identity(), [0.0; 3]);
        samples.extend(samples.clone().into_iter().map(|mut s| {
            s.time = s.time.plus_nanos(2_000_000_000);
            s
        }));
        for s in &mut samples {
            let t = s.time.secs_since(ms(0));
            let rate = match t < 1.5 {
                true => swaying(t),
                false => Vector3::z() * 0.5,
            };
            let measured = rate + bias + Vector3::from_fn(|_, _| white * gaussian());
            s.sample.angular_velocity_rad_s = measured.into();
        }
        let mut filter = InertialFilter::start(&samples[..21], ms(0), &noise).expect("samples");
        filter.predict(&samples, ms(100));
        filter.become_origin();
        let begun = filter.state().world_from_rig.rotation;
        filter.predict(&samples, ms(2500));
        assert!(!filter.stands());
        let turned = begun.inverse() * filter.state().world_from_rig.rotation;
        let truth = so3::exp(&(swayed(1.5) - swayed(0.1))) * so3::exp(&(Vector3::z() * 0.5));
        let off = so3::log(&(turned.inverse() * truth));
        let covariance: Matrix3<f64> = filter.reported_covariance().fixed_view::<3, 3>(0, 0).into();
        squared_sigmas.push(off.dot(&covariance.cholesky().expect("known").solve(&off)));
    }
    // χ² of three numbers.
    let within = squared_sigmas.iter().filter(|s| **s < 7.815).count();
    let mean = squared_sigmas.iter().sum::<f64>() / f64::from(draws);
    assert!(within >= 48, "{within} of {draws}, NEES {mean:.1} of 3");
    assert!(mean > 2.0, "{within} of {draws}, NEES {mean:.1} of 3");
}

/// The force on an accelerometer that leans with who stands changes by 0.1 m/s² in half a degree: taken for the first step, it left the walk to the IMU
/// alone until that came, up to 8 cm.
#[test]
fn who_leans_still_stands() {
    let mut samples = at_rest(&UnitQuaternion::identity(), [0.0; 3]);
    // By 0.6 degrees, in 0.8 s, from 0.5 s on.
    let rate_rad_s = 0.014;
    let start = samples[0].time;
    for s in &mut samples {
        let leant_s = (s.time.secs_since(start) - 0.5).clamp(0.0, 0.8);
        let is_leaning = leant_s > 0.0 && leant_s < 0.8;
        let turned = so3::exp(&(Vector3::y() * (rate_rad_s * leant_s)));
        let force = turned.inverse() * Vector3::new(0.0, 0.0, STANDARD_GRAVITY_M_S2);
        s.sample.specific_force_m_s2 = force.into();
        let rate = if is_leaning { rate_rad_s } else { 0.0 };
        s.sample.angular_velocity_rad_s = [0.0, rate, 0.0];
    }
    let mut filter = InertialFilter::start(&samples[..20], start, &NOISE).expect("samples");
    filter.predict(&samples, samples[399].time);
    assert!(filter.stands());
    let place: Matrix3<f64> = filter.reported_covariance().fixed_view::<3, 3>(3, 3).into();
    let sigma_m = place.trace().sqrt();
    assert!(sigma_m < 0.02, "{sigma_m}");
    assert!(filter.state().world_from_rig.translation.norm() < 0.02);
}
