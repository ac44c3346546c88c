//! Whether scans and accelerometer measure in the same unit: both see the same accelerations.
//!
//! Over three scans, `(p₂ − 2 p₁ + p₀) / T² = s a + G`: the second difference of their places, and the mean `a` of the specific force in the
//! world, weighted by a triangle over the `2 T` from the first to the last. Scale `s` and gravity `G` are found by least squares over the walk. Clouds in feet
//! give 3.28, an accelerometer that measures gravity instead of what holds against it −1. What is left of the accelerometer in the poses of
//! the scans draws `s` towards 1, never away from it.

use lsfb_geometry::{StampedPose, Vector3, so3};
use lsfb_perception::gauss_newton::NormalEquations;
use lsfb_perception::statistics::median;
use lsfb_types::{ImuSample, Stamped};
use nalgebra::{Matrix3x4, Vector4};

/// From the first scan to the second, seconds, at least; and to the third, at most: longer ones have gaps.
const LEAST_S: f64 = 0.15;
const MOST_S: f64 = 0.8;
/// The two halves may differ by so much, as a share.
const UNEVEN: f64 = 0.1;
/// Fewer tell nothing.
const MIN_TRIPLES: usize = 20;
/// Accelerations are known no better than this, m/s².
const LEAST_SIGMA_M_S2: f64 = 0.02;
const ROUNDS: usize = 12;
/// Gravity beforehand: what it may be in clouds in millimetres, m/s².
const PRIOR_M_S2: f64 = 1e5;
const PRIOR_SCALE: f64 = 1e4;
/// What is said: a factor that is off by more than this, and by more standard deviations, and is itself known to a fifth (of one, where it is less).
const LEAST_OFF: f64 = 0.25;
const SIGMAS: f64 = 6.0;
const KNOWN: f64 = 0.2;

/// Accelerations by the scans as a multiple of those by the accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ScaleOff {
    pub scale: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// What three scans and the samples between them say, m/s².
#[derive(Clone, Copy, Debug)]
struct Triple {
    by_scans: Vector3<f64>,
    by_imu: Vector3<f64>,
}

/// The scale, where it is off for certain; of the poses that scans have without the IMU's help.
pub(super) fn scale_off(
    by_scans: &[StampedPose],
    samples: &[Stamped<ImuSample>],
) -> Option<ScaleOff> {
    let triples = triples(by_scans, samples);
    if triples.len() < MIN_TRIPLES {
        return None;
    }
    let mut found = Vector4::new(1.0, 0.0, 0.0, 0.0);
    let mut information = None;
    for _ in 0..ROUNDS {
        let equations = equations(&triples, &found);
        found += equations.step()?;
        information = Some(equations.information);
    }
    let sigma = information?.cholesky()?.inverse()[(0, 0)].sqrt();
    let scale = found[0];
    let off = (scale - 1.0).abs();
    let is_off = off > LEAST_OFF.max(SIGMAS * sigma) && sigma < KNOWN * scale.abs().max(1.0);
    is_off.then_some(ScaleOff { scale, sigma })
}

fn triples(by_scans: &[StampedPose], samples: &[Stamped<ImuSample>]) -> Vec<Triple> {
    let mut triples = Vec::new();
    let next_after = |from: usize| {
        let start = by_scans.get(from)?.time;
        let later = by_scans.iter().enumerate().skip(from + 1);
        let mut far = later.skip_while(|(_, p)| p.time.secs_since(start) < LEAST_S);
        far.next().map(|(k, _)| k)
    };
    for first in 0..by_scans.len() {
        let Some(second) = next_after(first) else {
            break;
        };
        let Some(third) = next_after(second) else {
            break;
        };
        triples.extend(triple(
            [&by_scans[first], &by_scans[second], &by_scans[third]],
            samples,
        ));
    }
    triples
}

fn triple(scans: [&StampedPose; 3], samples: &[Stamped<ImuSample>]) -> Option<Triple> {
    let [first, second, third] = scans;
    let (rise_s, fall_s) = (
        second.time.secs_since(first.time),
        third.time.secs_since(second.time),
    );
    let half_s = 0.5 * (rise_s + fall_s);
    if rise_s + fall_s > MOST_S || (rise_s - fall_s).abs() > UNEVEN * half_s {
        return None;
    }
    let begin = samples.partition_point(|s| s.time < first.time);
    let end = samples.partition_point(|s| s.time <= third.time);
    let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
    let mut world_from_rig = first.world_from_rig.rotation;
    let mut before = None;
    for sample in samples.get(begin..end)? {
        let rate = Vector3::from(sample.sample.angular_velocity_rad_s);
        if let Some(before) = before.replace(sample.time) {
            world_from_rig =
                so3::retract(&world_from_rig, &(rate * sample.time.secs_since(before)));
        }
        let weight = 1.0 - (sample.time.secs_since(second.time).abs() / half_s).min(1.0);
        sum += world_from_rig * Vector3::from(sample.sample.specific_force_m_s2) * weight;
        weights += weight;
    }
    let place = |pose: &StampedPose| pose.world_from_rig.translation;
    // Divided differences, since the two halves are not quite equal.
    let by_scans = ((place(third) - place(second)) / fall_s
        - (place(second) - place(first)) / rise_s)
        / half_s;
    // Fewer samples than these are gaps.
    (weights > 4.0).then(|| Triple {
        by_scans,
        by_imu: sum / weights,
    })
}

/// At a scale and a gravity, weighted by how the triples scatter; those that do not fit lose their weight (Cauchy). Each scan is in six triples.
fn equations(triples: &[Triple], found: &Vector4<f64>) -> NormalEquations<4> {
    const SHARED: f64 = 6.0;
    let gravity: Vector3<f64> = found.fixed_rows::<3>(1).into();
    let residual = |t: &Triple| t.by_imu * found[0] + gravity - t.by_scans;
    let sizes = triples.iter().flat_map(|t| {
        let r = residual(t);
        [r.x.abs(), r.y.abs(), r.z.abs()]
    });
    // 1.4826: from the median to the standard deviation of what is normal.
    let sigma = 1.4826 * median(sizes.collect()).unwrap_or(0.0);
    let sigma = sigma.max(LEAST_SIGMA_M_S2);
    let mut equations = NormalEquations::default();
    for triple in triples {
        let r = residual(triple);
        let a = triple.by_imu;
        let jacobian = Matrix3x4::new(
            a.x, 1.0, 0.0, 0.0, //
            a.y, 0.0, 1.0, 0.0, //
            a.z, 0.0, 0.0, 1.0,
        );
        let weight = 1.0 / (SHARED * (sigma * sigma + r.norm_squared() / 9.0));
        equations.add_block(&r, &jacobian, weight);
    }
    let prior = Vector4::new(
        PRIOR_SCALE.powi(-2),
        PRIOR_M_S2.powi(-2),
        PRIOR_M_S2.powi(-2),
        PRIOR_M_S2.powi(-2),
    );
    equations.add_prior(found, &nalgebra::Matrix4::from_diagonal(&prior));
    equations
}

#[cfg(test)]
mod tests {
    use super::super::tests::room;
    use super::*;

    /// Poses of the closed-form walk ten times a second, in units of `1 / unit` metres, and its samples with forces times `sign`.
    fn walk(unit: f64, sign: f64) -> Option<ScaleOff> {
        let poses: Vec<_> = (0..110)
            .map(|k| {
                let t = 0.1 * f64::from(k) + 0.1;
                let mut world_from_rig = room::world_from_rig(t);
                // A centimetre of noise, each time another.
                let noise = 0.005 * (f64::from(k) * 12.9898).sin();
                world_from_rig.translation =
                    (world_from_rig.translation + Vector3::new(noise, -noise, 0.5 * noise)) * unit;
                StampedPose {
                    time: room::time(t),
                    world_from_rig,
                }
            })
            .collect();
        let mut samples = room::imu_samples(11.5, 3);
        for sample in &mut samples {
            sample.sample.specific_force_m_s2 = sample.sample.specific_force_m_s2.map(|f| f * sign);
        }
        scale_off(&poses, &samples)
    }

    #[test]
    fn feet_millimetres_and_the_wrong_sign_are_seen() {
        assert_eq!(walk(1.0, 1.0), None);
        for (unit, sign, expected) in [
            (3.2808, 1.0, 3.2808),
            (1000.0, 1.0, 1000.0),
            (0.3048, 1.0, 0.3048),
            (1.0, -1.0, -1.0),
        ] {
            let found = walk(unit, sign).unwrap_or_else(|| panic!("{unit} {sign}: not seen"));
            let off = (found.scale / expected - 1.0).abs();
            assert!(off < 0.15, "{unit} {sign}: {found:?}");
        }
    }
}
