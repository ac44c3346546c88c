//! Whether errors are as large as an estimate's own covariance says: the normalised estimation error squared (NEES).
//!
//! Where the estimate's world is its own, the transform to the truth's is what makes the whole of all errors least by the covariances. That
//! which brings positions closest leaves orientations open where a walk is short or straight: a millimetre over 30 cm is a fifth of a
//! degree, which is no error of the estimate.

use lsfb_geometry::{Matrix6, Se3, UnitQuaternion, Vector3};
use lsfb_solver::gauss_newton::{NormalEquations, minimise, until_shorter_than};
use nalgebra::Quaternion;
use serde::Serialize;

use crate::alignment::AlignmentMode;
use crate::association::PosePair;

/// 95 % of squared norms of six standard normal numbers are below this (chi squared, six degrees of freedom).
const CHI_SQUARED_95: f64 = 12.591_587;
/// The same for three.
const CHI_SQUARED_95_OF_THREE: f64 = 7.814_728;

/// NEES over all matched poses. Errors of neighbouring poses are alike, so that no interval is given for the means.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Consistency {
    /// Poses whose covariance could be inverted.
    pub poses: usize,
    /// Poses whose covariance is none: not positive definite.
    pub bad_covariances: usize,
    /// Mean over whole poses; 6 where the covariance is right, more where it is too small.
    pub nees_mean: f64,
    /// Share of poses within the 95 % region, 0 to 1.
    pub within_95: f64,
    /// Mean over rotations alone; 3 where right.
    pub rotation_nees_mean: f64,
    /// Mean over translations alone; 3 where right.
    pub translation_nees_mean: f64,
    /// Share of translations within their 95 % region.
    pub translation_within_95: f64,
}

/// Of aligned pairs and the covariance of each estimate, in its tangent and its own scale, of which one unit is `scale` metres of the truth.
/// `None` where no covariance can be inverted.
pub(crate) fn consistency(
    pairs: &[PosePair],
    covariances: &[Matrix6<f64>],
    mode: AlignmentMode,
    scale: f64,
) -> Option<Consistency> {
    let scaled = covariances.iter().map(|covariance| {
        let mut covariance = *covariance;
        covariance.fixed_rows_mut::<3>(3).scale_mut(scale);
        covariance.fixed_columns_mut::<3>(3).scale_mut(scale);
        covariance
    });
    let scaled: Vec<Matrix6<f64>> = scaled.collect();
    let aligned = judged_in(&Se3::identity(), pairs, &scaled)?;
    let refined = best_world(pairs, &scaled, mode);
    let refined = refined.and_then(|world| judged_in(&world, pairs, &scaled));
    Some(match refined {
        Some(refined) if refined.nees_mean < aligned.nees_mean => refined,
        _ => aligned,
    })
}

/// Steps at most, each of which takes away most of what is left.
const STEPS: u32 = 10;
/// A step that is shorter, in radians and metres, is the last.
const LEAST_STEP: f64 = 1e-9;

/// What moves the aligned estimate so that the sum of all its squared errors is least by their covariances, by Gauss–Newton. `None` where the
/// mode leaves nothing open, or the covariances do not tell.
fn best_world(
    pairs: &[PosePair],
    covariances: &[Matrix6<f64>],
    mode: AlignmentMode,
) -> Option<Se3> {
    let (start, held): (Se3, &[usize]) = match mode {
        AlignmentMode::None | AlignmentMode::Given(_) | AlignmentMode::Origin => return None,
        AlignmentMode::Se3 | AlignmentMode::Sim3 => (by_orientations(pairs)?, &[]),
        // Both know which way is up.
        AlignmentMode::Yaw => (Se3::identity(), &[0, 1]),
    };
    let terms = |world: &Se3| {
        let mut terms = NormalEquations::<6>::default();
        for (pair, covariance) in pairs.iter().zip(covariances) {
            let Some(covariance) = covariance.cholesky() else {
                continue;
            };
            let estimate = *world * pair.estimate.world_from_rig;
            let error = estimate.local(&pair.truth.world_from_rig);
            // What moves the world on its right moves the estimate on its own by this.
            let moved = pair.estimate.world_from_rig.inverse().adjoint();
            let weighed = covariance.solve(&moved);
            terms.information += moved.transpose() * weighed;
            terms.gradient -= weighed.transpose() * error;
        }
        for &k in held {
            terms.information.row_mut(k).fill(0.0);
            terms.information.column_mut(k).fill(0.0);
            terms.information[(k, k)] = 1.0;
            terms.gradient[k] = 0.0;
        }
        Some(terms)
    };
    let world = minimise(start, STEPS, terms, until_shorter_than(LEAST_STEP))?.value;
    let is_known = world.log().iter().all(|x| x.is_finite());
    is_known.then_some(world)
}

/// The mean turn of the orientations, and what brings the middle of the positions there: positions on a line leave half a turn about it open.
fn by_orientations(pairs: &[PosePair]) -> Option<Se3> {
    let turns = pairs.iter().map(|pair| {
        let (truth, estimate) = (&pair.truth.world_from_rig, &pair.estimate.world_from_rig);
        *(truth.rotation * estimate.rotation.inverse()).quaternion()
    });
    let turns: Vec<Quaternion<f64>> = turns.collect();
    let first = turns.first()?;
    // A turn is the same with the other sign.
    let sum = turns.iter().fold(Quaternion::from_real(0.0), |sum, turn| {
        sum + *turn * turn.dot(first).signum()
    });
    let rotation = UnitQuaternion::try_new(sum, f64::MIN_POSITIVE)?;
    let apart = pairs.iter().map(|pair| {
        pair.truth.world_from_rig.translation - rotation * pair.estimate.world_from_rig.translation
    });
    let middle = apart.sum::<Vector3<f64>>() / pairs.len() as f64;
    Some(Se3::new(rotation, middle))
}

/// NEES of the estimate where its world is moved by this.
fn judged_in(world: &Se3, pairs: &[PosePair], covariances: &[Matrix6<f64>]) -> Option<Consistency> {
    let mut sums = [0.0; 3];
    let (mut inside, mut translation_inside) = (0, 0);
    let mut poses = 0;
    for (pair, covariance) in pairs.iter().zip(covariances) {
        let error = (*world * pair.estimate.world_from_rig).local(&pair.truth.world_from_rig);
        let turn = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let shift = covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let (Some(all), Some(turn), Some(shift)) =
            (covariance.cholesky(), turn.cholesky(), shift.cholesky())
        else {
            continue;
        };
        let whole = error.dot(&all.solve(&error));
        let rotation = error.fixed_rows::<3>(0).into_owned();
        let translation = error.fixed_rows::<3>(3).into_owned();
        let of_translation = translation.dot(&shift.solve(&translation));
        if !whole.is_finite() || !of_translation.is_finite() {
            continue;
        }
        poses += 1;
        inside += usize::from(whole <= CHI_SQUARED_95);
        translation_inside += usize::from(of_translation <= CHI_SQUARED_95_OF_THREE);
        sums[0] += whole;
        sums[1] += rotation.dot(&turn.solve(&rotation));
        sums[2] += of_translation;
    }
    if poses == 0 {
        return None;
    }
    let n = poses as f64;
    Some(Consistency {
        poses,
        bad_covariances: covariances.len() - poses,
        nees_mean: sums[0] / n,
        within_95: inside as f64 / n,
        rotation_nees_mean: sums[1] / n,
        translation_nees_mean: sums[2] / n,
        translation_within_95: translation_inside as f64 / n,
    })
}
