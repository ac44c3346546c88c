//! What of an alignment must not be trusted.

use lsfb_geometry::Vector3;
use lsfb_types::{Finding, Limit, Verdict};

use super::super::judge::{LEAST_INLIERS, MOST_APART, of_halves, of_inliers};
use super::MocapAlignment;
use super::filter::Smoothed;
use super::motion::{MOUNT_PLACE, MOUNT_ROTATION};
use super::outcome::Noise;

/// Standard deviations beyond which the result is not to be used: rotation, degrees, and position, metres, of the IMU on the markers' body,
/// clock, seconds.
const MOST_SIGMA: [f64; 3] = [0.2, 0.002, 0.001];
/// Share of the time in which the path should be certain.
const LEAST_GIVEN: f64 = 0.9;
/// Gravity on the ground, m/s²: beyond, the accelerometer's scale or unit is wrong.
const GRAVITY_M_S2: std::ops::RangeInclusive<f64> = 9.6..=10.0;

pub(super) fn judge(
    found: &MocapAlignment,
    noise: Noise,
    halves: Option<&[Smoothed; 2]>,
) -> Vec<Finding> {
    let mut findings = observability(found);
    findings.push(outliers(found));
    findings.push(given(found));
    findings.push(gravity(found));
    let what = format!(
        "the markers' body shakes by {:.2} mm and {:.3}° per axis; standard deviations were increased by a factor of {:.1} because its errors are correlated",
        1000.0 * noise.sigmas[1],
        noise.sigmas[0].to_degrees(),
        noise.factor
    );
    let jitter = Finding::new("jitter", Verdict::Pass, "motion capture", what);
    findings.push(jitter.value(noise.sigmas[1], "m"));
    findings.push(match halves {
        Some(halves) => agreement(halves, noise.factor),
        None => Finding::new(
            "halves",
            Verdict::Unknown,
            "halves",
            "one half of the time alone does not determine the pose of the IMU, so that the standard deviations are not checked",
        ),
    });
    findings
}

fn observability(found: &MocapAlignment) -> Vec<Finding> {
    let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let body = &found.markers_from_imu;
    let rotation_deg = largest(&body.sigma_rotation_deg);
    let translation_m = largest(&body.sigma_translation_m);
    let limits = [
        ("rotation of the IMU", rotation_deg, "°", MOST_SIGMA[0]),
        (
            "position of the IMU",
            1e3 * translation_m,
            "mm",
            1e3 * MOST_SIGMA[1],
        ),
        (
            "clock offset",
            1e3 * found.sigma_offset_secs,
            "ms",
            1e3 * MOST_SIGMA[2],
        ),
    ];
    limits
        .into_iter()
        .map(|(subject, sigma, unit, most)| {
            let verdict = Verdict::Fail.unless(sigma <= most);
            let what = format!("standard deviation {sigma:.3} {unit}");
            Finding::new("observability", verdict, subject, what)
                .value(sigma, unit)
                .limit(Limit::AtMost(most))
                .remedy("rotate the device quickly about two axes, for longer")
        })
        .collect()
}

fn outliers(found: &MocapAlignment) -> Finding {
    let share = 1.0 - found.outliers as f64 / found.poses.max(1) as f64;
    let what = format!(
        "{} of {} poses do not fit; at most {:.2} s were bridged by the IMU",
        found.outliers, found.poses, found.longest_gap_secs
    );
    Finding::new("outliers", of_inliers(share), "poses", what)
        .value(100.0 * share, "%")
        .limit(Limit::AtLeast(100.0 * LEAST_INLIERS.0))
        .remedy("check the markers, and that both are on one rigid body")
}

fn given(found: &MocapAlignment) -> Finding {
    let verdict = Verdict::Warn.unless(found.given >= LEAST_GIVEN);
    let what = format!(
        "the path is reliable in {:.1} % of the time",
        100.0 * found.given
    );
    Finding::new("given", verdict, "path", what)
        .value(100.0 * found.given, "%")
        .limit(Limit::AtLeast(100.0 * LEAST_GIVEN))
        .remedy("keep more markers in view")
}

fn gravity(found: &MocapAlignment) -> Finding {
    let size = Vector3::from(found.gravity_m_s2).norm();
    let verdict = Verdict::Warn.unless(GRAVITY_M_S2.contains(&size));
    let what = format!("gravity is {size:.3} m/s²");
    Finding::new("gravity", verdict, "accelerometer", what)
        .value(size, "m/s²")
        .remedy("check the scale of the accelerometer, and the unit of the motion capture")
}

/// Whether two halves of the time say the same, as their standard deviations promise.
fn agreement(halves: &[Smoothed; 2], factor: f64) -> Finding {
    let [first, second] = halves;
    let between = first.state.local(&second.state);
    let sigma = |k: usize| {
        let both = first.covariance[(k, k)] + second.covariance[(k, k)];
        factor * both.max(f64::MIN_POSITIVE).sqrt()
    };
    let sigmas = (MOUNT_ROTATION..MOUNT_PLACE + 3)
        .map(|k| between[k].abs() / sigma(k))
        .fold(0.0, f64::max);
    let place_m = between.fixed_rows::<3>(MOUNT_PLACE).norm();
    let rotation_deg = between.fixed_rows::<3>(MOUNT_ROTATION).norm().to_degrees();
    // The clock may drift: its halves are not compared.
    let verdict = of_halves(sigmas, [rotation_deg, place_m, 0.0]);
    let what = format!(
        "the two halves of the time differ by {:.2} mm and {rotation_deg:.3}°, {sigmas:.1} standard deviations",
        1000.0 * place_m,
    );
    Finding::new("halves", verdict, "halves", what)
        .value(sigmas, "σ")
        .limit(Limit::AtMost(MOST_APART))
        .remedy("the markers moved on the device, or the IMU's noise is larger than specified; do not trust the standard deviations")
}
