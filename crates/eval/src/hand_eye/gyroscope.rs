//! A trajectory or another gyroscope beside a gyroscope on the same body: how the gyroscope is turned on it, its bias, and the offset of
//! the clocks. Two recordings that share no network and no light have one clock so, if both were once turned together.

use lsfb_geometry::{IntegratedGyro, Matrix3, Se3, StampedPose, UnitQuaternion, Vector3, so3};
use lsfb_types::{Finding, Limit, ProgressFn, Timestamp, Verdict};
use serde::Serialize;

use super::continuous::Continuous;
use super::correlation::correlate;
use super::{HandEyeConfig, show_round};
use crate::Error;

/// Rates are compared where this much of them lies around, seconds: white noise averages out.
const WINDOW_SECS: f64 = 0.05;
/// Turns about the second axis that are needed, rad/s rms.
const LEAST_SECOND_RATE: f64 = 0.02;
/// Numbers that are fitted: turn, bias and offset.
const FITTED: f64 = 7.0;
/// Halvings of the interval around the best offset.
const REFINEMENTS: usize = 40;

/// What a gyroscope said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroSample {
    /// When.
    pub time: Timestamp,
    /// Angular velocity in its axes, rad/s.
    pub rate_rad_s: Vector3<f64>,
}

/// Standard deviation of the offset beyond which it is not to be used, and which is worth a look, seconds.
const MOST_SIGMA_SECS: f64 = 5e-3;
const LARGE_SIGMA_SECS: f64 = 1e-3;
/// By so much the offsets of both halves may differ, seconds, and by so many of their standard deviations.
const MOST_APART_SECS: f64 = 1e-3;
const MOST_APART: f64 = 4.0;
/// Rates are differentiated over twice this, seconds.
const SLOPE_SECS: f64 = 5e-3;

/// How a gyroscope sits on a body.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GyroAlignment {
    /// `gyroscope_from_body`: rotation x y z w.
    pub rotation_xyzw: [f64; 4],
    /// What must be added to the trajectory's stamps to have the gyroscope's, seconds.
    pub offset_secs: f64,
    /// Its standard deviation, seconds: by what is left of the rates, and by how far both halves are apart.
    pub sigma_offset_secs: f64,
    /// Offset in the second half less that in the first, seconds; absent where a half alone does not show it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub halves_apart_secs: Option<f64>,
    /// What the gyroscope says at rest, rad/s.
    pub bias_rad_s: [f64; 3],
    /// Root mean square of the rates' difference, rad/s.
    pub rms_rad_s: f64,
    /// Correlation of the angular speeds, by which the offset was found first.
    pub correlation: f64,
    /// What must not be trusted.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

/// Aligns two gyroscopes on one body, both in order of time: the body is that of the first.
pub fn align_gyroscopes(
    first: &[GyroSample],
    second: &[GyroSample],
    config: &HandEyeConfig,
    progress: ProgressFn<'_>,
) -> Result<GyroAlignment, Error> {
    let base = first.first().map_or(Timestamp::from_nanos(0), |s| s.time);
    let mut found = align_gyroscope(&integrated(first, base), second, config, progress)?;
    found.findings.extend(other_unit(first, second));
    Ok(found)
}

/// Rates of one body are as large in both.
fn other_unit(first: &[GyroSample], second: &[GyroSample]) -> Option<Finding> {
    let scatter = |samples: &[GyroSample]| {
        let count = samples.len().max(1) as f64;
        let rates = || samples.iter().map(|s| s.rate_rad_s);
        let mean = rates().sum::<Vector3<f64>>() / count;
        (rates().map(|r| (r - mean).norm_squared()).sum::<f64>() / count).sqrt()
    };
    let times = scatter(second) / scatter(first);
    (!(1.0 / MOST_LARGER..MOST_LARGER).contains(&times)).then(|| {
        let what =
            format!("the reference's angular rates are {times:.3} times as large as the other's");
        Finding::new("unit", Verdict::Fail, "rates", what)
            .value(times, "")
            .remedy("write both in rad/s (a radian is 57.3°)")
    })
}

/// Aligns the rates of a trajectory's body with those of a gyroscope; both in order of time.
pub fn align_gyroscope(
    poses: &[StampedPose],
    samples: &[GyroSample],
    config: &HandEyeConfig,
    progress: ProgressFn<'_>,
) -> Result<GyroAlignment, Error> {
    config.check_bounds("")?;
    let (Some(first), false) = (poses.first(), samples.is_empty()) else {
        return Err(Error::TooFewPoses {
            role: "estimate",
            poses: poses.len().min(samples.len()),
            needed: 1,
        });
    };
    let body = Continuous::new(poses, first.time);
    let gyroscope = Continuous::new(&integrated(samples, first.time), first.time);
    let found = correlate(
        &body,
        &gyroscope,
        config.offset_guess_secs,
        config.search_secs,
        progress,
    )?;
    let [start, end] = body.span_secs().unwrap_or([0.0, 0.0]);
    let middle = 0.5 * (start + end);
    let best_offset = |span, around| best_offset(&body, &gyroscope, span, around, progress);
    let offset_secs = best_offset([start, end], found.offset_secs)?;
    let best = align_rates(&body, &gyroscope, [start, end], offset_secs)?;
    let halves = [[start, middle], [middle, end]].map(|span| best_offset(span, offset_secs).ok());
    // A half that was stopped is not one that determines nothing.
    show_round(REFINEMENTS, REFINEMENTS, progress)?;
    let halves_apart_secs = halves[1].zip(halves[0]).map(|(late, early)| late - early);
    // The difference of two halves has twice the standard deviation of the whole.
    let of_halves = halves_apart_secs.map_or(0.0, |apart| 0.5 * apart.abs());
    let sigma_offset_secs = best.sigma_offset_secs.max(of_halves);
    Ok(GyroAlignment {
        findings: findings(best.sigma_offset_secs, sigma_offset_secs, halves_apart_secs),
        rotation_xyzw: best.rotation.coords.into(),
        offset_secs,
        sigma_offset_secs,
        halves_apart_secs,
        bias_rad_s: best.bias.into(),
        rms_rad_s: best.rms_rad_s,
        correlation: found.correlation,
    })
}

/// Golden sections: the difference of the rates has one valley within a tenth of a second of the best correlation.
fn best_offset(
    body: &Continuous,
    gyroscope: &Continuous,
    span_secs: [f64; 2],
    around_secs: f64,
    progress: ProgressFn<'_>,
) -> Result<f64, Error> {
    let rms = |offset_secs: f64| {
        align_rates(body, gyroscope, span_secs, offset_secs).map(|found| found.rms_rad_s)
    };
    let golden = 0.5 * (5.0f64.sqrt() - 1.0);
    let (mut low, mut high) = (around_secs - 0.1, around_secs + 0.1);
    for round in 0..REFINEMENTS {
        show_round(round, REFINEMENTS, progress)?;
        let (left, right) = (high - golden * (high - low), low + golden * (high - low));
        match rms(left)? < rms(right)? {
            true => high = right,
            false => low = left,
        }
    }
    Ok(0.5 * (low + high))
}

/// `formal_secs` is the standard deviation by what is left of the rates alone.
fn findings(formal_secs: f64, sigma_secs: f64, apart_secs: Option<f64>) -> Vec<Finding> {
    let verdict = match sigma_secs {
        s if s <= LARGE_SIGMA_SECS => Verdict::Pass,
        s if s <= MOST_SIGMA_SECS => Verdict::Warn,
        _ => Verdict::Fail,
    };
    let what = format!(
        "standard deviation of the clock offset: {:.3} ms",
        1e3 * sigma_secs
    );
    let mut findings = vec![
        Finding::new("offset", verdict, "clocks", what)
            .value(1e3 * sigma_secs, "ms")
            .limit(Limit::AtMost(1e3 * LARGE_SIGMA_SECS))
            .remedy("rotate both together for longer, quickly, about two axes"),
    ];
    let limit_secs = MOST_APART_SECS.max(2.0 * MOST_APART * formal_secs);
    match apart_secs {
        None => findings.push(Finding::new(
            "halves",
            Verdict::Warn,
            "clocks",
            "only one half determines the offset, so that its stability is not checked",
        )),
        Some(apart_secs) if apart_secs.abs() > limit_secs => {
            let what = format!(
                "the offset differs by {:.2} ms between the halves: a clock drifts or was set",
                1e3 * apart_secs
            );
            findings.push(
                Finding::new("halves", Verdict::Warn, "clocks", what)
                    .value(1e3 * apart_secs, "ms")
                    .limit(Limit::AtMost((1e6 * limit_secs).round() / 1e3))
                    .remedy("align parts of the recordings separately"),
            );
        }
        Some(_) => {}
    }
    findings
}

/// Orientations that follow from the rates, without a place.
fn integrated(samples: &[GyroSample], base: Timestamp) -> Vec<StampedPose> {
    let rates = samples
        .iter()
        .map(|s| (s.time.secs_since(base), s.rate_rad_s));
    let gyro = IntegratedGyro::new(rates);
    let turned = gyro.rotations().map(|(_, rotation)| rotation);
    let pose = |(sample, rotation): (&GyroSample, _)| StampedPose {
        time: sample.time,
        world_from_rig: Se3::new(rotation, Vector3::zeros()),
    };
    samples.iter().zip(turned).map(pose).collect()
}

/// Rates of two gyroscopes on one body differ by less, as a factor: a part of the time may be the livelier one.
const MOST_LARGER: f64 = 2.0;

struct AlignedRates {
    rotation: UnitQuaternion<f64>,
    bias: Vector3<f64>,
    rms_rad_s: f64,
    sigma_offset_secs: f64,
}

/// The best turn and bias at an offset (Kabsch on the rates without their means), by what is within the span of the body's time.
fn align_rates(
    body: &Continuous,
    gyroscope: &Continuous,
    [start, end]: [f64; 2],
    offset_secs: f64,
) -> Result<AlignedRates, Error> {
    let rate = |of: &Continuous, secs: f64| {
        let from = of.at(secs - 0.5 * WINDOW_SECS)?.rotation;
        let to = of.at(secs + 0.5 * WINDOW_SECS)?.rotation;
        Some(so3::local(&from, &to) / WINDOW_SECS)
    };
    let count = ((end - start) / WINDOW_SECS) as usize;
    let times = || (0..count).map(|i| start + i as f64 * WINDOW_SECS);
    let both = |secs: f64| Some((rate(body, secs)?, rate(gyroscope, secs + offset_secs)?));
    let rates: Vec<(Vector3<f64>, Vector3<f64>)> = times().filter_map(both).collect();
    let n = rates.len().max(1) as f64;
    let mean = rates
        .iter()
        .fold((Vector3::zeros(), Vector3::zeros()), |s, r| {
            (s.0 + r.0, s.1 + r.1)
        });
    let (body_mean, gyro_mean) = (mean.0 / n, mean.1 / n);
    let mut crossed = Matrix3::zeros();
    for (a, b) in &rates {
        crossed += (b - gyro_mean) * (a - body_mean).transpose();
    }
    let mut sizes: Vec<f64> = (crossed / n).singular_values().iter().copied().collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    if !(sizes[1] >= LEAST_SECOND_RATE * LEAST_SECOND_RATE) {
        return Err(Error::OneAxis {
            first_deg: sizes[0].sqrt().to_degrees() * WINDOW_SECS,
            second_deg: sizes[1].sqrt().to_degrees() * WINDOW_SECS,
        });
    }
    let rotation = so3::nearest(&crossed).ok_or(Error::Degenerate)?;
    let bias = gyro_mean - rotation * body_mean;
    let squares: f64 = rates
        .iter()
        .map(|(a, b)| (b - bias - rotation * a).norm_squared())
        .sum();
    let slope = |secs: f64| {
        let at = |step: f64| rate(gyroscope, secs + offset_secs + step);
        Some((at(SLOPE_SECS)? - at(-SLOPE_SECS)?) / (2.0 * SLOPE_SECS))
    };
    let slopes: f64 = times().filter_map(slope).map(|s| s.norm_squared()).sum();
    let freedom = (3.0 * n - FITTED).max(1.0);
    Ok(AlignedRates {
        rotation,
        bias,
        rms_rad_s: (squares / n).sqrt(),
        sigma_offset_secs: (squares / freedom / slopes).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::continuous::tests::motion;
    use super::super::tests::normal;
    use super::*;
    use lsfb_types::no_progress;

    const NOISE_RAD_S: f64 = 0.01;

    /// A gyroscope on the moving body, turned on it, with a bias, white noise and a clock of its own.
    fn samples(
        rate_hz: f64,
        secs: f64,
        turn: UnitQuaternion<f64>,
        clock: impl Fn(f64) -> f64,
        seed: usize,
    ) -> Vec<GyroSample> {
        let bias = Vector3::new(0.01, -0.02, 0.005);
        (0..(rate_hz * secs) as usize)
            .map(|i| {
                let t = i as f64 / rate_hz;
                let [from, to] = [-1e-4, 1e-4].map(|h| motion(t + h).rotation);
                let rate = turn * (so3::local(&from, &to) / 2e-4) + bias;
                let noise = Vector3::from_fn(|k, _| NOISE_RAD_S * normal(seed + 3 * i + k));
                GyroSample {
                    time: Timestamp::from_secs_f64(1e9 + clock(t)),
                    rate_rad_s: rate + noise,
                }
            })
            .collect()
    }

    #[test]
    fn two_devices_on_a_board_have_one_clock_within_a_millisecond() {
        let turn = so3::exp(&Vector3::new(0.4, -1.1, 0.6));
        let mut beyond = 0;
        for (seed, offset_secs) in [(0, 3.217), (40_000, -8.4031), (90_000, 0.0004)] {
            let phone = samples(200.0, 40.0, UnitQuaternion::identity(), |t| t, seed);
            let rig = samples(100.0, 40.0, turn, |t| t + offset_secs, seed + 7);
            let found = align_gyroscopes(&phone, &rig, &HandEyeConfig::default(), &no_progress)
                .expect("one body");
            let off_secs = (found.offset_secs - offset_secs).abs();
            assert!(off_secs < 1e-3, "{off_secs} {found:?}");
            assert!(found.sigma_offset_secs < 1e-3, "{found:?}");
            beyond += usize::from(off_secs > 3.0 * found.sigma_offset_secs);
            let rotation = lsfb_geometry::Quaternion::from_vector(found.rotation_xyzw.into());
            let rotation = UnitQuaternion::new_normalize(rotation);
            assert!(so3::local(&turn, &rotation).norm() < 0.01, "{found:?}");
            assert!(
                found.findings.iter().all(|f| f.verdict == Verdict::Pass),
                "{found:?}"
            );
        }
        assert_eq!(beyond, 0);
    }

    #[test]
    fn degrees_beside_radians_are_named() {
        let phone = samples(200.0, 40.0, UnitQuaternion::identity(), |t| t, 0);
        let mut degrees = samples(100.0, 40.0, UnitQuaternion::identity(), |t| t, 5);
        for sample in &mut degrees {
            sample.rate_rad_s = sample.rate_rad_s.map(f64::to_degrees);
        }
        for (first, second) in [(&phone, &degrees), (&degrees, &phone)] {
            match align_gyroscopes(first, second, &HandEyeConfig::default(), &no_progress) {
                Ok(found) => {
                    let named = found.findings.iter().find(|f| f.code == "unit");
                    let verdict = named.map(|f| f.verdict);
                    assert_eq!(verdict, Some(Verdict::Fail), "{found:?}");
                }
                // Angles that a sample turns by more than half a circle are alike at no offset.
                Err(error) => assert!(matches!(error, Error::NotOneBody { .. }), "{error}"),
            }
        }
    }

    #[test]
    fn a_clock_that_drifts_and_another_body_are_told() {
        let phone = samples(200.0, 40.0, UnitQuaternion::identity(), |t| t, 0);
        // 500 ppm: ten milliseconds from half to half.
        let drifting = samples(100.0, 40.0, UnitQuaternion::identity(), |t| 1.0005 * t, 5);
        let found = align_gyroscopes(&phone, &drifting, &HandEyeConfig::default(), &no_progress);
        let found = found.expect("one body");
        let told = found.findings.iter().find(|f| f.code == "halves");
        assert!(
            told.is_some_and(|f| f.verdict == Verdict::Warn),
            "{found:?}"
        );
        let apart_secs = found.halves_apart_secs.expect("between the halves");
        assert!((apart_secs - 0.01).abs() < 2e-3, "{apart_secs}");
        let other: Vec<GyroSample> = (0..4000_usize)
            .map(|i| GyroSample {
                time: Timestamp::from_secs_f64(1e9 + 0.01 * i as f64),
                rate_rad_s: Vector3::from_fn(|k, _| normal(3 * (i / 20) + k)),
            })
            .collect();
        let refused = align_gyroscopes(&phone, &other, &HandEyeConfig::default(), &no_progress);
        assert!(refused.is_err(), "{refused:?}");
    }
}
