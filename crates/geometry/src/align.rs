//! Closed-form alignment of two point sets (Umeyama 1991).

use nalgebra::{Matrix3, Vector3};

use crate::{Se3, so3};

/// What [`umeyama`] may change besides rotation and translation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Keep metres metres: SE(3).
    Fixed,
    /// Estimate one scale: Sim(3).
    Free,
}

/// `target ≈ scale · target_from_source.rotation · source + target_from_source.translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Rotation and translation.
    pub target_from_source: Se3,
    /// 1 where the scale was fixed.
    pub scale: f64,
}

impl Alignment {
    /// Moves a point of the source set.
    pub fn apply(&self, source: &Vector3<f64>) -> Vector3<f64> {
        self.target_from_source.rotation * (source * self.scale)
            + self.target_from_source.translation
    }
}

/// The alignment that minimises the summed squared distances of corresponding points. `None` with fewer than three
/// points, with points on one line, or with sets of different length.
pub fn umeyama(
    source: &[Vector3<f64>],
    target: &[Vector3<f64>],
    scale: Scale,
) -> Option<Alignment> {
    let n = source.len();
    if n < 3 || n != target.len() {
        return None;
    }
    let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / n as f64;
    let (mean_source, mean_target) = (mean(source), mean(target));
    let mut covariance = Matrix3::zeros();
    let mut variance = 0.0;
    for (s, t) in source.iter().zip(target) {
        let centred = s - mean_source;
        covariance += (t - mean_target) * centred.transpose();
        variance += centred.norm_squared();
    }
    let svd = covariance.svd(true, true);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| svd.singular_values[b].total_cmp(&svd.singular_values[a]));
    let largest = svd.singular_values[order[0]];
    if !(largest > 0.0) || svd.singular_values[order[1]] <= 1e-12 * largest {
        return None;
    }
    let so3::Nearest { rotation, sign } = so3::nearest_of(&svd)?;
    let scale = match scale {
        Scale::Fixed => 1.0,
        Scale::Free => svd.singular_values.component_mul(&sign).sum() / variance,
    };
    let translation = mean_target - rotation * (mean_source * scale);
    Some(Alignment {
        target_from_source: Se3::new(rotation, translation),
        scale,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vector6;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn recovers_a_known_similarity(
            points in prop::collection::vec(prop::array::uniform3(-10.0..10.0f64), 4..30),
            delta in prop::array::uniform6(-2.0..2.0f64),
            scale in 0.2..5.0f64,
        ) {
            let truth = Alignment { target_from_source: Se3::exp(&Vector6::from(delta)), scale };
            let source: Vec<_> = points.into_iter().map(Vector3::from).collect();
            let target: Vec<_> = source.iter().map(|p| truth.apply(p)).collect();
            let found = umeyama(&source, &target, Scale::Free).expect("general position");
            prop_assert!((found.scale - scale).abs() < 1e-9);
            for (s, t) in source.iter().zip(&target) {
                prop_assert!((found.apply(s) - t).norm() < 1e-8);
            }
        }
    }

    #[test]
    fn refuses_what_has_no_answer() {
        let line: Vec<_> = (0..5)
            .map(|i| Vector3::new(f64::from(i), 0.0, 0.0))
            .collect();
        assert!(umeyama(&line, &line, Scale::Fixed).is_none());
        assert!(umeyama(&line[..2], &line[..2], Scale::Fixed).is_none());
        assert!(umeyama(&line, &line[..4], Scale::Fixed).is_none());
    }
}
