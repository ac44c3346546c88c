//! Whether errors are as large as an estimate's own covariance says: the normalised estimation error squared (NEES).

use lsfb_geometry::Matrix6;
use serde::Serialize;

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
    scale: f64,
) -> Option<Consistency> {
    let mut sums = [0.0; 3];
    let (mut inside, mut translation_inside) = (0, 0);
    let mut poses = 0;
    for (pair, covariance) in pairs.iter().zip(covariances) {
        let mut covariance = *covariance;
        covariance.fixed_rows_mut::<3>(3).scale_mut(scale);
        covariance.fixed_columns_mut::<3>(3).scale_mut(scale);
        let error = pair
            .estimate
            .world_from_rig
            .local(&pair.truth.world_from_rig);
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
