use std::io::Read;

use flate2::read::GzDecoder;
use lsfb_geometry::Vector6;
use lsfb_tests::recordings;
use nalgebra::Quaternion;

use super::*;

const NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1.7e-4,
    accel_noise_density: 2.0e-3,
    gyro_bias_walk: 1.9e-5,
    accel_bias_walk: 3.0e-3,
};

fn sample(nanos: i64, gyro: Vector3<f64>, accel: Vector3<f64>) -> Stamped<ImuSample> {
    let time = Timestamp::from_nanos(nanos);
    Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample: ImuSample {
            angular_velocity_rad_s: gyro.into(),
            specific_force_m_s2: accel.into(),
        },
    }
}

/// A rig that turns about its z axis at constant rate on a circle, tilted: everything about it is known in closed form.
fn circle(t: f64) -> (NavState, Vector3<f64>, Vector3<f64>) {
    let (radius, rate) = (2.0, 1.3);
    let (sin, cos) = (rate * t).sin_cos();
    let tilt = so3::exp(&Vector3::new(0.3, -0.2, 0.1));
    let rotation = so3::exp(&Vector3::new(0.0, 0.0, rate * t)) * tilt;
    let state = NavState {
        world_from_rig: Se3::new(rotation, Vector3::new(radius * cos, radius * sin, 1.0)),
        velocity_m_s: Vector3::new(-radius * rate * sin, radius * rate * cos, 0.0),
    };
    let acceleration = Vector3::new(cos, sin, 0.0) * (-radius * rate * rate);
    let gyro = tilt.inverse() * Vector3::new(0.0, 0.0, rate);
    let accel = rotation.inverse() * (acceleration - standard_gravity_m_s2());
    (state, gyro, accel)
}

fn circle_samples(bias: &ImuBias) -> Vec<Stamped<ImuSample>> {
    (0..=200)
        .map(|k| {
            let (_, gyro, accel) = circle(k as f64 * 0.005);
            sample(
                k * 5_000_000,
                gyro + bias.gyro_rad_s,
                accel + bias.accel_m_s2,
            )
        })
        .collect()
}

fn some_bias() -> ImuBias {
    ImuBias {
        gyro_rad_s: Vector3::new(0.02, -0.03, 0.01),
        accel_m_s2: Vector3::new(-0.1, 0.2, 0.15),
    }
}

#[test]
fn a_known_motion_is_predicted_also_between_samples() {
    let bias = some_bias();
    let samples = circle_samples(&bias);
    for (start_nanos, end_nanos) in [(0, 1_000_000_000), (12_300_000, 507_700_000)] {
        let (start, end) = (
            Timestamp::from_nanos(start_nanos),
            Timestamp::from_nanos(end_nanos),
        );
        let sum = PreintegratedImu::integrate(&samples, start, end, bias, &NOISE).expect("covered");
        assert!((sum.duration_secs - end.secs_since(start)).abs() < 1e-12);
        let found = sum.predict(
            &circle(start_nanos as f64 * 1e-9).0,
            &bias,
            &standard_gravity_m_s2(),
        );
        let truth = circle(end_nanos as f64 * 1e-9).0;
        let error = truth.world_from_rig.inverse() * found.world_from_rig;
        assert!(so3::log(&error.rotation).norm() < 1e-9);
        assert!(
            error.translation.norm() < 3e-5,
            "{}",
            error.translation.norm()
        );
        assert!((truth.velocity_m_s - found.velocity_m_s).norm() < 3e-5);
    }
}

/// Shaken and turned about all axes, of which samples at 200 Hz are taken.
fn shaken(bias: &ImuBias) -> Vec<Stamped<ImuSample>> {
    (0..=220)
        .map(|k| {
            let t = k as f64 * 0.005;
            let gyro = Vector3::new(
                2.0 * (19.0 * t).sin(),
                1.0 + 1.5 * (13.0 * t).cos(),
                2.5 * (7.0 * t + 1.0).sin(),
            );
            let accel = Vector3::new(
                4.0 * (23.0 * t).sin(),
                3.0 * (31.0 * t + 2.0).cos(),
                9.8 + 5.0 * (11.0 * t).sin(),
            );
            let nanos = k * 5_000_000;
            sample(nanos, gyro + bias.gyro_rad_s, accel + bias.accel_m_s2)
        })
        .collect()
}

/// Rotation, velocity and position by steps of a microsecond along the straight lines between samples, between instants in microseconds.
fn integrated_at_one_megahertz(
    samples: &[Stamped<ImuSample>],
    micros: std::ops::Range<i64>,
    bias: &ImuBias,
) -> CorrectedChange {
    let secs = 1e-6;
    let (mut velocity, mut position) = (Vector3::zeros(), Vector3::zeros());
    let mut rotation = UnitQuaternion::identity();
    for k in micros {
        // The middle of the step.
        let nanos = k * 1000 + 500;
        let after = samples.partition_point(|s| s.time.nanos() <= nanos);
        let (a, b) = (
            Reading::from(&samples[after - 1]),
            Reading::from(&samples[after]),
        );
        let read = Reading::between(&a, &b, Timestamp::from_nanos(nanos));
        let (rate, force) = (
            read.angular_velocity - bias.gyro_rad_s,
            read.specific_force - bias.accel_m_s2,
        );
        let middle = rotation * so3::exp(&(rate * (0.5 * secs)));
        let gained = middle * force * secs;
        position += velocity * secs + gained * (0.5 * secs);
        velocity += gained;
        rotation *= so3::exp(&(rate * secs));
        rotation.renormalize();
    }
    CorrectedChange {
        rotation,
        rotation_correction: Vector3::zeros(),
        velocity_m_s: velocity,
        position_m: position,
    }
}

#[test]
fn preintegration_is_a_numeric_integration_at_one_megahertz_to_1e_8() {
    let bias = some_bias();
    let samples = shaken(&bias);
    for micros in [0..1_000_000, 12_300..517_701] {
        let [start, end] = [micros.start, micros.end].map(|t| Timestamp::from_nanos(t * 1000));
        let sum = PreintegratedImu::integrate(&samples, start, end, bias, &NOISE).expect("covered");
        let numeric = integrated_at_one_megahertz(&samples, micros.clone(), &bias);
        let turn = so3::log(&(numeric.rotation.inverse() * sum.rotation)).norm();
        let velocity = (sum.velocity_m_s - numeric.velocity_m_s).norm();
        let position = (sum.position_m - numeric.position_m).norm();
        assert!(turn < 1e-8 && velocity < 1e-8 && position < 1e-8);

        // Another bias, to first order: what is left is of second order in its difference.
        let other = ImuBias {
            gyro_rad_s: bias.gyro_rad_s + Vector3::new(1e-5, -2e-5, 1e-5),
            accel_m_s2: bias.accel_m_s2 + Vector3::new(1e-4, 1e-4, -2e-4),
        };
        let corrected = sum.corrected(&other);
        let numeric = integrated_at_one_megahertz(&samples, micros, &other);
        let turn = so3::log(&(numeric.rotation.inverse() * corrected.rotation)).norm();
        let velocity = (corrected.velocity_m_s - numeric.velocity_m_s).norm();
        let position = (corrected.position_m - numeric.position_m).norm();
        assert!(turn < 1e-8 && velocity < 1e-8 && position < 1e-8);
    }
}

#[test]
fn bias_jacobians_match_differences() {
    let samples = circle_samples(&some_bias());
    let (start, end) = (Timestamp::from_nanos(0), Timestamp::from_nanos(300_000_000));
    let integrate = |delta: Vector6<f64>| {
        let bias = ImuBias {
            gyro_rad_s: delta.fixed_rows::<3>(0).into(),
            accel_m_s2: delta.fixed_rows::<3>(3).into(),
        };
        PreintegratedImu::integrate(&samples, start, end, bias, &NOISE).expect("covered")
    };
    let centre = integrate(Vector6::zeros());
    let step = 1e-5;
    for axis in 0..6 {
        let mut delta = Vector6::zeros();
        delta[axis] = step;
        let (plus, minus) = (integrate(delta), integrate(-delta));
        let rotation = so3::log(&(minus.rotation.inverse() * plus.rotation)) / (2.0 * step);
        let velocity = (plus.velocity_m_s - minus.velocity_m_s) / (2.0 * step);
        let position = (plus.position_m - minus.position_m) / (2.0 * step);
        let by = &centre.by_bias;
        let (r, v, p) = if axis < 3 {
            (
                by.rotation_by_gyro.column(axis).into_owned(),
                by.velocity_by_gyro.column(axis).into_owned(),
                by.position_by_gyro.column(axis).into_owned(),
            )
        } else {
            (
                Vector3::zeros(),
                by.velocity_by_accel.column(axis - 3).into_owned(),
                by.position_by_accel.column(axis - 3).into_owned(),
            )
        };
        assert!((rotation - r).norm() < 1e-7, "rotation by {axis}");
        assert!((velocity - v).norm() < 1e-6, "velocity by {axis}");
        assert!((position - p).norm() < 1e-6, "position by {axis}");
    }
}

/// An IMU whose scales are off and whose accelerometer is turned and late, beside one without errors.
#[test]
fn errors_that_are_known_are_taken_off() {
    let errors = ImuErrors {
        gyro_scale: Vector3::new(2e-3, -1e-3, 3e-3),
        accel_scale: Vector3::new(0.02, -0.03, 0.05),
        gyro_shear: Vector3::new(2e-4, 1e-4, -2e-4),
        accel_shear: Vector3::new(-1e-3, 2e-3, 1e-3),
        // What is turned by more is off by what scale and turn do together.
        accel_turn_rad: Vector3::new(5e-5, -3e-5, 4e-5),
        accel_delay_s: 2e-3,
        world_scale: 0.0,
    };
    let read = |nanos: i64| {
        let secs = nanos as f64 * 1e-9;
        let (_, gyro, _) = circle(secs);
        let (_, _, force) = circle(secs - errors.accel_delay_s);
        let force = so3::exp(&errors.accel_turn_rad) * force;
        let read = |true_part: Vector3<f64>, scale: &Vector3<f64>, shear: &Vector3<f64>| {
            let off = Matrix3::from_diagonal(scale)
                + Matrix3::new(
                    0.0, shear.z, shear.y, shear.z, 0.0, shear.x, shear.y, shear.x, 0.0,
                );
            let left = (Matrix3::identity() - off).try_inverse();
            left.expect("regular") * true_part
        };
        sample(
            nanos,
            read(gyro, &errors.gyro_scale, &errors.gyro_shear),
            read(force, &errors.accel_scale, &errors.accel_shear),
        )
    };
    let samples: Vec<_> = (-2..=82).map(|k| read(k * 2_500_000)).collect();
    let (start, end) = (Timestamp::from_nanos(0), Timestamp::from_nanos(200_000_000));
    let none = ImuBias::default();
    let sum = PreintegratedImu::integrate(&samples, start, end, none, &NOISE).expect("covered");
    let (begin, _, _) = circle(0.0);
    let (truth, _, _) = circle(0.2);
    let gravity = standard_gravity_m_s2();
    let off = |found: &CorrectedChange| {
        let rotation = begin.world_from_rig.rotation;
        let velocity = begin.velocity_m_s + gravity * 0.2 + rotation * found.velocity_m_s;
        let turn = (rotation * found.rotation).angle_to(&truth.world_from_rig.rotation);
        [turn, (velocity - truth.velocity_m_s).norm()]
    };
    let [turn, velocity] = off(&sum.corrected_by(&none, &errors));
    assert!(turn < 2e-6 && velocity < 2e-5, "{turn} rad, {velocity} m/s");
    let [turn, velocity] = off(&sum.corrected(&none));
    assert!(turn > 5e-4 && velocity > 0.05, "{turn} rad, {velocity} m/s");
}

/// Covariance against the spread over noisy copies of the same motion.
#[test]
fn covariance_is_the_spread_of_noisy_runs() {
    use rand::{RngExt, SeedableRng};
    let noise = ImuNoiseModel {
        gyro_noise_density: 2e-3,
        accel_noise_density: 2e-2,
        ..NOISE
    };
    let clean = circle_samples(&ImuBias::default());
    let (start, end) = (Timestamp::from_nanos(0), Timestamp::from_nanos(500_000_000));
    let sum = |samples: &[Stamped<ImuSample>]| {
        PreintegratedImu::integrate(samples, start, end, ImuBias::default(), &noise)
            .expect("covered")
    };
    let centre = sum(&clean);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    // Irwin–Hall: near enough to normal for second moments, exactly unit variance.
    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let runs = 1500;
    let mut spread = Matrix9::zeros();
    for _ in 0..runs {
        let mut noisy = clean.clone();
        for s in &mut noisy {
            let root_rate = 200f64.sqrt();
            for k in 0..3 {
                s.sample.angular_velocity_rad_s[k] += normal() * 2e-3 * root_rate;
                s.sample.specific_force_m_s2[k] += normal() * 2e-2 * root_rate;
            }
        }
        let run = sum(&noisy);
        let mut error = SMatrix::<f64, 9, 1>::zeros();
        error
            .fixed_rows_mut::<3>(0)
            .copy_from(&so3::log(&(centre.rotation.inverse() * run.rotation)));
        error
            .fixed_rows_mut::<3>(3)
            .copy_from(&(run.velocity_m_s - centre.velocity_m_s));
        error
            .fixed_rows_mut::<3>(6)
            .copy_from(&(run.position_m - centre.position_m));
        spread += error * error.transpose() / runs as f64;
    }
    for k in 0..9 {
        let ratio = spread[(k, k)] / centre.covariance[(k, k)];
        // 1500 runs know a variance to 3.7 %, one standard deviation.
        assert!((0.85..1.15).contains(&ratio), "variance {k}: ratio {ratio}");
    }
    let correlation = |m: &Matrix9| m[(3, 6)] / (m[(3, 3)] * m[(6, 6)]).sqrt();
    assert!((correlation(&spread) - correlation(&centre.covariance)).abs() < 0.05);
}

#[test]
fn a_gap_is_named() {
    let mut samples = circle_samples(&ImuBias::default());
    let integrate = |samples: &[Stamped<ImuSample>], end: i64| {
        PreintegratedImu::integrate(
            samples,
            Timestamp::from_nanos(100_000_000),
            Timestamp::from_nanos(end),
            ImuBias::default(),
            &NOISE,
        )
    };
    assert!(
        integrate(&samples, 1_020_000_000).is_ok(),
        "held to the end"
    );
    assert!(matches!(
        integrate(&samples, 1_200_000_000),
        Err(ImuGap { .. })
    ));
    samples.drain(60..80);
    let Err(ImuGap { from, to, .. }) = integrate(&samples, 900_000_000) else {
        panic!("a gap of 105 ms");
    };
    assert_eq!((from.nanos(), to.nanos()), (295_000_000, 400_000_000));
    assert!(integrate(&samples[..0], 900_000_000).is_err());
    assert!(integrate(&samples, 100_000_000).is_err());
}

fn read_csv(path: &std::path::Path) -> Vec<Vec<f64>> {
    let mut text = String::new();
    GzDecoder::new(std::fs::File::open(path).expect("file opens"))
        .read_to_string(&mut text)
        .expect("file is text");
    text.lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(|line| {
            line.split(',')
                .map(|word| word.trim().parse().expect("a number"))
                .collect()
        })
        .collect()
}

fn nanos(path: &std::path::Path) -> Vec<i64> {
    let mut text = String::new();
    GzDecoder::new(std::fs::File::open(path).expect("file opens"))
        .read_to_string(&mut text)
        .expect("file is text");
    text.lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(|line| {
            let word = line.split(',').next().unwrap_or_default();
            word.trim().parse().expect("nanoseconds")
        })
        .collect()
}

fn vector(row: &[f64]) -> Vector3<f64> {
    Vector3::new(row[0], row[1], row[2])
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// One second of IMU from true states, on two EuRoC recordings; the figures come from another program.
#[test]
fn euroc_seconds_end_where_an_independent_integration_does() {
    let test = "euroc_seconds_end_where_an_independent_integration_does";
    let Some(folder) = recordings(test, "vision/euroc_imu_gt") else {
        return;
    };
    for (name, rotation_deg, velocity, position) in
        [("V102", 0.071, 0.042, 0.025), ("MH04", 0.019, 0.037, 0.022)]
    {
        let imu_path = folder.join(format!("{name}_imu.csv.gz"));
        let truth_path = folder.join(format!("{name}_groundtruth.csv.gz"));
        let samples: Vec<_> = nanos(&imu_path)
            .iter()
            .zip(read_csv(&imu_path))
            .map(|(t, row)| sample(*t, vector(&row[1..4]), vector(&row[4..7])))
            .collect();
        let truth: Vec<(Timestamp, NavState, ImuBias)> = nanos(&truth_path)
            .iter()
            .zip(read_csv(&truth_path))
            .map(|(t, row)| {
                let q = Quaternion::new(row[4], row[5], row[6], row[7]);
                let state = NavState {
                    world_from_rig: Se3::new(UnitQuaternion::new_normalize(q), vector(&row[1..4])),
                    velocity_m_s: vector(&row[8..11]),
                };
                let bias = ImuBias {
                    gyro_rad_s: vector(&row[11..14]),
                    accel_m_s2: vector(&row[14..17]),
                };
                (Timestamp::from_nanos(*t), state, bias)
            })
            .collect();
        let (mut rotations, mut velocities, mut positions) = (vec![], vec![], vec![]);
        for start in truth.iter().step_by(200) {
            let after = truth.partition_point(|t| t.0 < start.0.plus_nanos(1_000_000_000));
            let Some(end) = truth.get(after) else { break };
            let Ok(sum) = PreintegratedImu::integrate(&samples, start.0, end.0, start.2, &NOISE)
            else {
                continue;
            };
            let found = sum.predict(&start.1, &start.2, &standard_gravity_m_s2());
            let error = end.1.world_from_rig.inverse() * found.world_from_rig;
            rotations.push(so3::log(&error.rotation).norm().to_degrees());
            velocities.push((found.velocity_m_s - end.1.velocity_m_s).norm());
            positions.push(error.translation.norm());
        }
        assert!(rotations.len() > 50, "{name}: {} seconds", rotations.len());
        let found = [median(rotations), median(velocities), median(positions)];
        println!(
            "{name}: rotation {:.3} deg, velocity {:.3} m/s, position {:.3} m",
            found[0], found[1], found[2]
        );
        // Better is no fault. Worse they are by 9 % at most (docs/figures.md).
        for (found, expected) in found.iter().zip([rotation_deg, velocity, position]) {
            assert!(
                *found < 1.12 * expected,
                "{name}: {found} against {expected}"
            );
        }
    }
}
