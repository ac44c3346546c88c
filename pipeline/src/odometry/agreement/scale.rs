//! Whether scans and accelerometer measure in the same unit: both see the same accelerations.
//!
//! Over three scans, `a = s f + G + R b`: the acceleration by their places, and the mean force by the accelerometer in the world. Scale `s`, gravity `G`
//! and the accelerometer's bias `b`, which turns with the rig (`R`), are found by least squares over the walk. Clouds in feet give 3.28, an accelerometer
//! that measures gravity instead of what holds against it −1, ranges that are a twentieth too long 1.05. What is left of the accelerometer in the poses
//! draws `s` towards 1, never away from it; so does what the attitude between scans that are seconds apart is off by, which adds to the forces, and these
//! are left out.
//!
//! It is asked twice. What scans alone say of their places is free of the accelerometer and coarse: over fractions of a second it tells a wrong unit. The
//! poses of the trajectory are a few times smoother, and over more than a second they follow the scans: they tell percents.

use lsfb_geometry::Vector3;
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};
use nalgebra::{SMatrix, SVector};

use super::triples::Triple;
use super::turns::{scatter, weight};

/// Fewer tell nothing.
const MIN_TRIPLES: usize = 20;
const ROUNDS: u32 = 12;
/// Gravity beforehand: what it may be in clouds in millimetres, m/s².
const PRIOR_M_S2: f64 = 1e5;
const PRIOR_SCALE: f64 = 1e4;
/// And the bias: in a smaller unit than metres it is none to speak of.
const PRIOR_BIAS_M_S2: f64 = 0.3;
/// A factor is known that is known to a fifth (of one, where it is less).
const KNOWN: f64 = 0.2;

/// How the scale is asked for.
struct Question {
    /// From the first scan to the third, seconds, at most.
    most_s: f64,
    /// Accelerations are known no better than this, m/s².
    least_sigma_m_s2: f64,
    /// So many triples share their errors, and count as one.
    shared: f64,
    /// What is said: a factor that is off by more than this, and by more standard deviations.
    least_off: f64,
    sigmas: f64,
}

/// Of what scans alone say: each is in six triples.
const OF_UNIT: Question = Question {
    most_s: 0.8,
    least_sigma_m_s2: 0.02,
    shared: 6.0,
    least_off: 0.25,
    sigmas: 6.0,
};

/// From one scan to the next, seconds, where percents are asked for.
pub(super) const PERCENTS_S: f64 = 1.2;
/// Of the trajectory. By its standard deviation 31 right simulated walks of 12 and 20 s are off by 0.95 of it rms and by 2.0 at most, that is by 0.7 %.
const OF_LENGTHS: Question = Question {
    most_s: 3.2,
    least_sigma_m_s2: 0.002,
    shared: 12.0,
    least_off: 0.0125,
    sigmas: 4.0,
};

/// Accelerations by the scans as a multiple of those by the accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ScaleOff {
    pub scale: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// The scale, where a unit is wrong for certain; of the poses that scans have without the IMU's help.
pub(super) fn scale_off(triples: &[Triple]) -> Option<ScaleOff> {
    OF_UNIT.off(triples)
}

/// The scale, where it is off by percents for certain; of the poses of the trajectory, [`PERCENTS_S`] apart: at least so much it is off.
pub(super) fn lengths_off(triples: &[Triple]) -> Option<ScaleOff> {
    OF_LENGTHS.off(triples)
}

/// Scale, gravity and bias.
type Vector7 = SVector<f64, 7>;

/// A triple, in the directions that its scans see.
struct Seen {
    by_scans: Vector3<f64>,
    /// Derivative by scale, gravity and bias: what the accelerometer makes of these.
    by_imu: SMatrix<f64, 3, 7>,
}

impl Seen {
    fn of(triple: &Triple) -> Self {
        let mut by_imu = SMatrix::<f64, 3, 7>::zeros();
        let of_bias = triple.seen * triple.world_from_rig;
        by_imu.set_column(0, &(triple.seen * triple.by_imu()));
        by_imu.fixed_columns_mut::<3>(1).copy_from(&triple.seen);
        by_imu.fixed_columns_mut::<3>(4).copy_from(&of_bias);
        Self {
            by_scans: triple.seen * triple.by_scans,
            by_imu,
        }
    }
}

impl Question {
    fn off(&self, triples: &[Triple]) -> Option<ScaleOff> {
        let near = triples.iter().filter(|t| t.span_s <= self.most_s);
        let triples: Vec<_> = near.map(Seen::of).collect();
        if triples.len() < MIN_TRIPLES {
            return None;
        }
        let mut start = Vector7::zeros();
        start[0] = 1.0;
        let equations = |found: &Vector7| Some(self.equations(&triples, found));
        let found = minimise(start, ROUNDS, equations, |_| Next::Iterate)?;
        let sigma = found.information.cholesky()?.inverse()[(0, 0)].sqrt();
        let scale = found.value[0];
        let is_known = sigma < KNOWN * scale.abs().max(1.0);
        let is_off = (scale - 1.0).abs() > self.least_off.max(self.sigmas * sigma);
        (is_known && is_off).then_some(ScaleOff { scale, sigma })
    }

    /// Weighted by how the triples scatter; those that do not fit lose their weight (Cauchy).
    fn equations(&self, triples: &[Seen], found: &Vector7) -> NormalEquations<7> {
        let each = triples.iter();
        let residuals: Vec<_> = each.map(|t| t.by_imu * found - t.by_scans).collect();
        let sigma = scatter(&residuals).max(self.least_sigma_m_s2);
        let mut equations = NormalEquations::default();
        for (triple, r) in triples.iter().zip(&residuals) {
            equations.add_block(r, &triple.by_imu, weight(r, sigma) / self.shared);
        }
        let mut prior = Vector7::repeat(PRIOR_M_S2.powi(-2));
        prior[0] = PRIOR_SCALE.powi(-2);
        prior.fixed_rows_mut::<3>(4).fill(PRIOR_BIAS_M_S2.powi(-2));
        equations.add_prior(found, &SMatrix::from_diagonal(&prior));
        equations
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::StampedPose;

    use lsfb_types::{ImuSample, Stamped};

    use super::super::triples::{LEAST_S, triples};
    use super::*;
    use crate::odometry::tests::room;

    /// Poses of the closed-form walk ten times a second, in units of `1 / unit` metres, off by up to so much.
    fn poses(seconds: f64, unit: f64, off_m: f64) -> Vec<StampedPose> {
        (0..(10.0 * seconds) as u32)
            .map(|k| {
                let t = 0.1 * f64::from(k) + 0.1;
                let mut world_from_rig = room::world_from_rig(t);
                // Each time another.
                let noise = off_m * (f64::from(k) * 12.9898).sin();
                world_from_rig.translation =
                    (world_from_rig.translation + Vector3::new(noise, -noise, 0.5 * noise)) * unit;
                StampedPose {
                    time: room::time(t),
                    world_from_rig,
                }
            })
            .collect()
    }

    /// Its samples, with forces that are changed.
    fn samples(seconds: f64, change: impl Fn(f64) -> f64) -> Vec<Stamped<ImuSample>> {
        let mut samples = room::imu_samples(seconds + 0.5, 3);
        for sample in &mut samples {
            sample.sample.specific_force_m_s2 = sample.sample.specific_force_m_s2.map(&change);
        }
        samples
    }

    /// Half a centimetre is what scans alone are off by. Forces are multiplied by `sign`.
    fn walk(unit: f64, sign: f64) -> Option<ScaleOff> {
        let poses = poses(11.0, unit, 0.005);
        let samples = samples(11.0, |force| force * sign);
        scale_off(&triples(&poses, &[], &samples, 0.0, LEAST_S))
    }

    /// Naively ranges that were a tenth too long went by: scans alone do not tell, and the trajectory was not asked. A bias is none of that.
    #[test]
    fn ranges_that_are_a_twentieth_off_are_seen_and_a_bias_is_not_taken_for_it() {
        let lengths = |unit: f64, bias_m_s2: f64| {
            let (poses, samples) = (poses(20.0, unit, 0.001), samples(20.0, |f| f + bias_m_s2));
            lengths_off(&triples(&poses, &[], &samples, 0.0, PERCENTS_S))
        };
        for bias_m_s2 in [0.0, 0.2] {
            assert_eq!(lengths(1.0, bias_m_s2), None, "{bias_m_s2}");
            for unit in [1.1, 1.05, 1.02, 0.95] {
                let found = lengths(unit, bias_m_s2);
                let found = found.unwrap_or_else(|| panic!("{unit} {bias_m_s2}: not seen"));
                assert!((found.scale / unit - 1.0).abs() < 0.01, "{unit}: {found:?}");
            }
        }
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
