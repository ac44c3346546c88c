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
    assert!((Vector3::from(force).norm() - 9.81).abs() < 1e-12 && force[2] > 9.7);
}
