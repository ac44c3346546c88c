use super::*;
use crate::config::{SimConfig, WalkConfig};
use crate::walk::Walker;
use crate::world::FloorPlan;
use lsfb_geometry::so3;

fn walk(duration_s: f64) -> Walk {
    let config = WalkConfig {
        duration_s,
        ..WalkConfig::default()
    };
    Walk::new(&FloorPlan::new(5), Walker::Backpack, &config, 5)
}

/// Fourth order: a Magnus step for the attitude and Simpson's rule for velocity and position, over pairs of
/// intervals of 1 ms.
#[test]
fn exact_samples_integrate_to_the_walk() {
    let walk = walk(20.0);
    let (start_s, dt) = (4.0, 1e-3);
    let first = walk.at(start_s);
    let mut rotation = first.world_from_rig.rotation;
    let mut position = first.world_from_rig.translation;
    let mut velocity = first.velocity_m_s;
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY_M_S2);
    let h = 2.0 * dt;
    for k in 0..5000 {
        let t = start_s + f64::from(k) * h;
        let [s0, s1, s2] = [0.0, dt, h].map(|d| exact_sample(&walk.at(t + d)));
        let w = [s0, s1, s2].map(|s| Vector3::from(s.angular_velocity_rad_s));
        let f = [s0, s1, s2].map(|s| Vector3::from(s.specific_force_m_s2));
        let half = (w[0] * 5.0 + w[1] * 8.0 - w[2]) * (h / 24.0)
            + ((w[0] + w[1]) * 0.5).cross(&(w[1] - w[0])) * (dt * dt / 12.0);
        let whole =
            (w[0] + w[1] * 4.0 + w[2]) * (h / 6.0) + w[1].cross(&(w[2] - w[0])) * (h * h / 12.0);
        let middle = rotation * so3::exp(&half);
        let end = rotation * so3::exp(&whole);
        let a = [rotation * f[0], middle * f[1], end * f[2]].map(|a| a + gravity);
        position += velocity * h + (a[0] + a[1] * 2.0) * (h * h / 6.0);
        velocity += (a[0] + a[1] * 4.0 + a[2]) * (h / 6.0);
        rotation = end;
    }
    let last = walk.at(start_s + 10.0);
    let off_m = (position - last.world_from_rig.translation).norm();
    let off_rad = so3::log(&(rotation.inverse() * last.world_from_rig.rotation)).norm();
    assert!(off_m < 1e-6 && off_rad < 1e-8, "{off_m} m, {off_rad} rad");
}

#[test]
fn noise_and_biases_have_the_stated_densities() {
    let walk = walk(60.0);
    let config = SimConfig::default().glasses_imu;
    let samples = simulate(&walk, &config, 9);
    assert_eq!(samples.len(), 60 * 200 + 1);
    let mut gyro = 0.0;
    let mut accel = 0.0;
    let mut steps = 0.0;
    for pair in samples.windows(2) {
        let exact = exact_sample(&walk.at(pair[0].offset_ns as f64 * 1e-9));
        for i in 0..3 {
            let s = &pair[0];
            gyro += (s.sample.angular_velocity_rad_s[i]
                - exact.angular_velocity_rad_s[i]
                - s.gyro_bias_rad_s[i])
                .powi(2);
            accel += (s.sample.specific_force_m_s2[i]
                - exact.specific_force_m_s2[i]
                - s.accel_bias_m_s2[i])
                .powi(2);
            steps += (pair[1].gyro_bias_rad_s[i] - s.gyro_bias_rad_s[i]).powi(2);
        }
    }
    let n = 3.0 * (samples.len() - 1) as f64;
    let rate = 200.0_f64;
    let near = |got: f64, expected: f64| (got / expected - 1.0).abs() < 0.03;
    assert!(near(
        (gyro / n).sqrt(),
        config.gyro_noise_density * rate.sqrt()
    ));
    assert!(near(
        (accel / n).sqrt(),
        config.accel_noise_density * rate.sqrt()
    ));
    assert!(near(
        (steps / n).sqrt(),
        config.gyro_bias_walk / rate.sqrt()
    ));
    assert!(Vector3::from(samples[0].gyro_bias_rad_s).norm() > 1e-4);
}

#[test]
fn at_rest_it_feels_gravity_upwards() {
    let force = exact_sample(&walk(10.0).at(0.5)).specific_force_m_s2;
    assert!((Vector3::from(force).norm() - 9.80665).abs() < 1e-12 && force[2] > 9.7);
}

/// Overlapping Allan deviation of an angular-rate or force log, over `cluster` samples (IEEE 952, annex C).
fn allan_deviation(values: &[f64], rate_hz: f64, cluster: usize) -> f64 {
    let mut sums = vec![0.0];
    for v in values {
        sums.push(sums[sums.len() - 1] + v / rate_hz);
    }
    let tau_s = cluster as f64 / rate_hz;
    let terms = sums.len() - 2 * cluster;
    let sum: f64 = (0..terms)
        .map(|k| (sums[k + 2 * cluster] - 2.0 * sums[k + cluster] + sums[k]).powi(2))
        .sum();
    (sum / (2.0 * tau_s * tau_s * terms as f64)).sqrt()
}

/// Two hours at rest, at a tenth of the usual rate: the densities do not depend on it.
fn at_rest_for_two_hours(config: &ImuConfig) -> [Vec<f64>; 6] {
    let still = WalkConfig {
        duration_s: 7200.0,
        rest_s: 7200.0,
        ..WalkConfig::default()
    };
    let walk = Walk::new(&FloorPlan::new(5), Walker::Backpack, &still, 5);
    let samples = simulate(&walk, config, 21);
    std::array::from_fn(|axis| {
        samples
            .iter()
            .map(|s| match axis {
                0..3 => s.sample.angular_velocity_rad_s[axis],
                _ => s.sample.specific_force_m_s2[axis - 3],
            })
            .collect()
    })
}

fn mean_deviation(axes: &[Vec<f64>], rate_hz: f64, tau_s: f64) -> f64 {
    let cluster = (tau_s * rate_hz) as usize;
    let squares: f64 = axes
        .iter()
        .map(|axis| allan_deviation(axis, rate_hz, cluster).powi(2))
        .sum();
    (squares / axes.len() as f64).sqrt()
}

#[test]
fn allan_deviation_of_two_hours_at_rest_matches_the_densities() {
    let config = ImuConfig {
        rate_hz: 20,
        ..ImuConfig::default()
    };
    let axes = at_rest_for_two_hours(&config);
    for (triad, noise, walk) in [
        (&axes[..3], config.gyro_noise_density, config.gyro_bias_walk),
        (
            &axes[3..],
            config.accel_noise_density,
            config.accel_bias_walk,
        ),
    ] {
        // White noise alone at a tenth of a second; both, by IEEE 952, further on.
        for tau_s in [0.1, 1.0, 3.0, 10.0, 30.0, 100.0] {
            let expected = (noise * noise / tau_s + walk * walk * tau_s / 3.0).sqrt();
            let got = mean_deviation(triad, 20.0, tau_s);
            assert!(
                (got / expected - 1.0).abs() < 0.1,
                "at {tau_s} s: {got} for {expected}"
            );
        }
    }
}

#[test]
fn bias_instability_is_the_flat_of_the_allan_deviation() {
    let config = ImuConfig {
        rate_hz: 20,
        gyro_noise_density: 0.0,
        gyro_bias_walk: 0.0,
        gyro_bias_instability: 1e-4,
        ..ImuConfig::default()
    };
    let axes = at_rest_for_two_hours(&config);
    for tau_s in [3.0, 10.0, 30.0, 100.0] {
        let got = mean_deviation(&axes[..3], 20.0, tau_s) / 0.664;
        assert!((got / 1e-4 - 1.0).abs() < 0.15, "at {tau_s} s: {got}");
    }
}

#[test]
fn scale_misalignment_and_range_are_as_stated() {
    let motion = walk(20.0).at(7.0);
    let exact = Vector3::from(exact_sample(&motion).specific_force_m_s2);
    let mut errors = 0.0;
    for seed in 0..300 {
        let matrix = axes(0.002, 0.001, seed, 1);
        errors += (matrix * exact - exact).norm_squared();
    }
    let expected = (0.002_f64.powi(2) + 2.0 * 0.001_f64.powi(2)) * exact.norm_squared();
    assert!((errors / 300.0 / expected - 1.0).abs() < 0.2);

    let narrow = ImuConfig {
        accel_range_m_s2: 5.0,
        gyro_range_rad_s: 0.1,
        ..ImuConfig::default()
    };
    let samples = simulate(&walk(20.0), &narrow, 3);
    let most = |f: fn(&BiasedSample) -> [f64; 3]| {
        samples.iter().flat_map(f).map(f64::abs).fold(0.0, f64::max)
    };
    assert_eq!(most(|s| s.sample.specific_force_m_s2), 5.0);
    assert_eq!(most(|s| s.sample.angular_velocity_rad_s), 0.1);
}
