//! Whether scans and accelerometer measure in the same unit: both see the same accelerations.
//!
//! Over three scans, `a = s f + G`: the acceleration by their places, and the mean force by the accelerometer in the world. Scale `s` and gravity `G` are
//! found by least squares over the walk. Clouds in feet give 3.28, an accelerometer that measures gravity instead of what holds against it −1. What
//! is left of the accelerometer in the poses of the scans draws `s` towards 1, never away from it; so does what the attitude between scans that are seconds
//! apart is off by, which adds to the forces, and these are left out.

use lsfb_geometry::{Matrix3, Vector3};
use lsfb_perception::gauss_newton::NormalEquations;
use nalgebra::{Matrix3x4, Vector4};

use super::triples::Triple;
use super::turns::{scatter, weight};

/// From the first scan to the third, seconds, at most.
const MOST_S: f64 = 0.8;
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

/// The scale, where it is off for certain; of the poses that scans have without the IMU's help.
pub(super) fn scale_off(triples: &[Triple]) -> Option<ScaleOff> {
    let near = triples.iter().filter(|t| t.span_s <= MOST_S);
    let triples: Vec<_> = near
        .map(|t| (t.seen * t.by_scans, t.seen * t.by_imu(), t.seen))
        .collect();
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

/// At a scale and a gravity, weighted by how the triples scatter; those that do not fit lose their weight (Cauchy). Each scan is in six triples.
fn equations(
    triples: &[(Vector3<f64>, Vector3<f64>, Matrix3<f64>)],
    found: &Vector4<f64>,
) -> NormalEquations<4> {
    const SHARED: f64 = 6.0;
    let gravity: Vector3<f64> = found.fixed_rows::<3>(1).into();
    let each = triples.iter();
    let residuals: Vec<_> = each
        .map(|(by_scans, by_imu, seen)| by_imu * found[0] + seen * gravity - by_scans)
        .collect();
    let sigma = scatter(&residuals).max(LEAST_SIGMA_M_S2);
    let mut equations = NormalEquations::default();
    for ((_, a, seen), r) in triples.iter().zip(&residuals) {
        let mut jacobian = Matrix3x4::zeros();
        jacobian.column_mut(0).copy_from(a);
        jacobian.fixed_view_mut::<3, 3>(0, 1).copy_from(seen);
        equations.add_block(r, &jacobian, weight(r, sigma) / SHARED);
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
    use lsfb_geometry::StampedPose;

    use super::super::triples::triples;
    use super::*;
    use crate::odometry::tests::room;

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
        scale_off(&triples(&poses, &[], &samples, 0.0))
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
