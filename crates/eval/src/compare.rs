use serde::Serialize;

use crate::evaluation::Evaluation;
use crate::relation::DeltaUnit;

/// An estimate with its name.
#[derive(Clone, Copy, Debug)]
pub struct Contender<'a> {
    /// As the table calls it.
    pub name: &'a str,
    /// How it was judged.
    pub evaluation: &'a Evaluation,
}

/// One row of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// As the table calls it.
    pub name: String,
    /// Root mean square of the absolute translation error, metres.
    pub ate_rmse_m: f64,
    /// Largest absolute translation error, metres.
    pub ate_max_m: f64,
    /// Root mean square of the absolute rotation error, degrees; absent without orientations.
    pub ate_rotation_rmse_deg: Option<f64>,
    /// Delta of the relative errors.
    pub rpe_delta: Option<f64>,
    /// Unit of that delta.
    pub rpe_delta_unit: Option<DeltaUnit>,
    /// Root mean square of the relative translation error, metres; absent where none was asked for.
    pub rpe_translation_rmse_m: Option<f64>,
    /// Root mean square of the relative rotation error, degrees.
    pub rpe_rotation_rmse_deg: Option<f64>,
    /// By how many per cent the estimate is too large.
    pub scale_error_percent: Option<f64>,
    /// Share of the truth it speaks about, 0 to 1.
    pub coverage: f64,
    /// Poses that matched.
    pub matched_poses: usize,
}

/// One row per contender, the smallest translation error first; of equal ones in the order given.
pub fn compare(contenders: &[Contender<'_>]) -> Vec<Comparison> {
    let mut rows: Vec<Comparison> = contenders
        .iter()
        .map(|contender| {
            let e = contender.evaluation;
            let rpe = e.rpe.first();
            Comparison {
                name: contender.name.to_owned(),
                ate_rmse_m: e.ate_translation_m.rmse,
                ate_max_m: e.ate_translation_m.max,
                ate_rotation_rmse_deg: e.ate_rotation_deg.map(|r| r.rmse),
                rpe_delta: rpe.map(|r| r.delta),
                rpe_delta_unit: rpe.map(|r| r.delta_unit),
                rpe_translation_rmse_m: rpe.and_then(|r| Some(r.translation_m?.rmse)),
                rpe_rotation_rmse_deg: rpe.and_then(|r| Some(r.rotation_deg?.rmse)),
                scale_error_percent: e.scale_error_percent,
                coverage: e.coverage.fraction,
                matched_poses: e.matched_poses,
            }
        })
        .collect();
    rows.sort_by(|a, b| a.ate_rmse_m.total_cmp(&b.ate_rmse_m));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{EvalConfig, evaluate};
    use lsfb_geometry::{Se3, StampedPose, Vector3};
    use lsfb_types::Timestamp;

    #[test]
    fn best_comes_first() {
        let walk = |noise_m: f64| -> Vec<StampedPose> {
            (0..200)
                .map(|i| {
                    let t = f64::from(i) * 0.05;
                    let place = Vector3::new(3.0 * t.cos(), 3.0 * t.sin(), 0.1 * t)
                        + Vector3::repeat(noise_m * (7.0 * t).sin());
                    StampedPose {
                        time: Timestamp::from_nanos(i64::from(i) * 50_000_000),
                        world_from_rig: Se3::new(Default::default(), place),
                    }
                })
                .collect()
        };
        let truth = walk(0.0);
        let judged = |noise_m: f64, with_rpe: bool| {
            let mut config = EvalConfig::default();
            if !with_rpe {
                config.rpe.clear();
            }
            evaluate(&truth, &walk(noise_m), &config).expect("valid")
        };
        let (rough, fine) = (judged(0.1, true), judged(0.01, false));
        let rows = compare(&[
            Contender {
                name: "rough",
                evaluation: &rough,
            },
            Contender {
                name: "fine",
                evaluation: &fine,
            },
        ]);
        assert_eq!(
            (rows[0].name.as_str(), rows[1].name.as_str()),
            ("fine", "rough")
        );
        assert_eq!(rows[1].ate_max_m, rough.ate_translation_m.max);
        assert_eq!(
            rows[1].rpe_translation_rmse_m,
            rough.rpe[0].translation_m.map(|t| t.rmse)
        );
        assert_eq!(
            (rows[0].rpe_delta, rows[0].coverage, rows[0].matched_poses),
            (None, 1.0, 200)
        );
    }
}
