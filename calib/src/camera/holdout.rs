//! Views that are held back: how well they are predicted, and whether another lens model predicts them better.
//!
//! Errors that the right model leaves are noise, without a pattern over the image. A polynomial in the place on the image,
//! fitted to the errors of the views adjusted, says how much of the squares on those held back is one. Only where it is more
//! than nothing are the other models tried: the wrong one is named by the right one, not by a limit on pixels.

use std::collections::BTreeMap;

use lsfb_geometry::camera::LensModel;
use lsfb_geometry::{Camera, Vector2, Vector3};
use lsfb_solver::Kernel;
use lsfb_types::{Finding, Limit, Verdict};
use nalgebra::{DMatrix, DVector};

use super::CameraConfig;
use super::batch::Freedom;
use super::guess::fit_lens;
use super::solved::{Solved, Start};
use crate::Error;
use crate::board::Target;

/// Degree of the polynomial, and how many terms it has.
const DEGREE: i32 = 7;
const TERMS: usize = 36;
/// Corners per term that are needed to ask for a pattern.
const CORNERS_PER_TERM: usize = 10;
/// Share of the squares from which on other models are tried, and from which on a pattern that none explains is worth a word.
const SUSPICIOUS_PATTERN: f64 = 0.03;
const UNEXPLAINED_PATTERN: f64 = 0.3;
/// Squares on views held back that another model must leave at most, as a share, and by how many standard deviations it must
/// be better view by view.
const CLEARLY_LESS: f64 = 0.9;
const DEVIATIONS: f64 = 3.0;
/// Models this close to the best are as good, and the most usual is named.
const AS_GOOD: f64 = 1.1;

/// From the most usual to the least.
const MODELS: [LensModel; 5] = [
    LensModel::KannalaBrandt,
    LensModel::PinholeRadtan,
    LensModel::DoubleSphere,
    LensModel::ExtendedUnified,
    LensModel::FieldOfView,
];

/// What views say that an adjustment did not see.
pub(super) struct Holdout {
    pub rms_px: f64,
    /// The lens model, where it does not fit.
    pub wrong_model: Option<Finding>,
}

/// An error and the pixel it is at.
type Errors = Vec<(Vector2<f64>, Vector2<f64>)>;

/// A lens from some views, and what it leaves there and on the others.
struct Prediction {
    camera: Camera,
    kept: Errors,
    held: Errors,
    /// By view that was held back.
    squares: Vec<f64>,
}

impl Prediction {
    fn sum(&self) -> f64 {
        self.squares.iter().sum()
    }

    fn rms_px(&self) -> f64 {
        (self.sum() / self.held.len().max(1) as f64).sqrt()
    }
}

impl Solved<'_> {
    /// Error of views that a second adjustment did not see: only the target's pose is fitted to them. `None` with few views.
    pub(super) fn holdout(
        &self,
        target: &Target,
        k: usize,
        config: &CameraConfig,
    ) -> Result<Option<Holdout>, Error> {
        let start = &self.cameras[k];
        let every = config.holdout_every;
        if every == 0 || start.chosen.len() < 2 * every.max(config.min_views) {
            return Ok(None);
        }
        let own = self.predict(target, k, start.camera, every)?;
        if own.held.is_empty() {
            return Ok(None);
        }
        let pattern = pattern(&own, &start.camera);
        Ok(Some(Holdout {
            rms_px: own.rms_px(),
            wrong_model: match pattern {
                Some(share) if share > SUSPICIOUS_PATTERN => {
                    self.other_models(target, k, every, &own, share)
                }
                _ => None,
            },
        }))
    }

    /// What errors that have a pattern over the image come from.
    fn other_models(
        &self,
        target: &Target,
        k: usize,
        every: usize,
        own: &Prediction,
        pattern: f64,
    ) -> Option<Finding> {
        let model = own.camera.lens.model();
        let seen = own.kept.iter().filter_map(|(pixel, _)| {
            let ray: Vector3<f64> = own.camera.unproject(pixel)?;
            Some((ray, *pixel))
        });
        let seen: Vec<_> = seen.collect();
        let others: Vec<Prediction> = MODELS
            .into_iter()
            .filter(|other| *other != model)
            .filter_map(|other| {
                let camera = Camera {
                    lens: fit_lens(other, &own.camera, &seen),
                    ..own.camera
                };
                // A model that cannot be fitted at all is no better one.
                self.predict(target, k, camera, every).ok()
            })
            .filter(|other| other.held.len() == own.held.len())
            .collect();
        let least = others
            .iter()
            .map(Prediction::sum)
            .fold(f64::INFINITY, f64::min);
        let best = others.iter().find(|o| o.sum() <= AS_GOOD * least);
        let percent = pattern * 100.0;
        let name = &self.cameras[k].views.name;
        let finding = |what: String| {
            Finding::new("lens-model", Verdict::Warn, name, what)
                .value(percent, "%")
                .limit(Limit::AtMost(UNEXPLAINED_PATTERN * 100.0))
        };
        match best {
            Some(best) if is_better(&own.squares, &best.squares) => {
                let better = best.camera.lens.model().name();
                let what = format!(
                    "the lens model does not fit: on held-out views {} has a reprojection error of {:.3} px and {better} {:.3} px; {percent:.0} % of the squared residuals form one pattern over the image",
                    model.name(),
                    own.rms_px(),
                    best.rms_px(),
                );
                let limit = Limit::AtMost(SUSPICIOUS_PATTERN * 100.0);
                Some(
                    finding(what)
                        .limit(limit)
                        .remedy(format!("use --model {better}")),
                )
            }
            _ if pattern > UNEXPLAINED_PATTERN => {
                let what = format!(
                    "{percent:.0} % of the squared residuals on held-out views form one pattern over the image, and no lens model explains it"
                );
                Some(finding(what).remedy(
                    "look for glass in front of the lens, a changed focus or zoom, or a bent board",
                ))
            }
            _ => None,
        }
    }

    /// A lens from the views that are not held back, from `camera` on.
    fn predict(
        &self,
        target: &Target,
        k: usize,
        camera: Camera,
        every: usize,
    ) -> Result<Prediction, Error> {
        let start = &self.cameras[k];
        let split = |held: bool| -> Vec<i64> {
            let numbered = start.chosen.iter().enumerate();
            numbered
                .filter(|(n, _)| (n % every == every - 1) == held)
                .map(|(_, t)| *t)
                .collect()
        };
        let part = |chosen: Vec<i64>, camera: Camera| -> Solved<'_> {
            let poses = chosen
                .iter()
                .map(|t| (*t, start.camera_from_first * self.first_from_target[t]))
                .collect();
            let inliers: BTreeMap<i64, Vec<bool>> = chosen
                .iter()
                .map(|t| (*t, self.inliers[k][t].clone()))
                .collect();
            Solved {
                cameras: vec![Start {
                    views: start.views,
                    chosen,
                    camera,
                    camera_from_first: lsfb_geometry::Se3::identity(),
                    alone_rms_px: None,
                }],
                first_from_target: poses,
                inliers: vec![inliers],
                undetermined: None,
            }
        };
        let mut kept = part(split(false), camera);
        kept.adjust(target, Kernel::Squared, Freedom::Everything)?;
        let camera = kept.cameras[0].camera;
        let mut held = part(split(true), camera);
        held.adjust(target, Kernel::Squared, Freedom::PosesOfTarget)?;
        let held_by_view = held.inlier_errors(target);
        let sum = |errors: &Errors| errors.iter().map(|(_, e)| e.norm_squared()).sum();
        Ok(Prediction {
            camera,
            kept: kept.inlier_errors(target).concat(),
            squares: held_by_view.iter().map(sum).collect(),
            held: held_by_view.concat(),
        })
    }

    /// Errors of the inliers of the first camera, by view.
    fn inlier_errors(&self, target: &Target) -> Vec<Errors> {
        let own = &self.cameras[0];
        own.chosen
            .iter()
            .map(|t| {
                let errors = self.errors_px(target, 0, *t).into_iter();
                let corners = own.views.views[t].iter().zip(&self.inliers[0][t]);
                errors
                    .zip(corners)
                    .filter(|(_, (_, inlier))| **inlier)
                    .filter_map(|(error, (corner, _))| Some((corner.pixel, error?)))
                    .collect()
            })
            .collect()
    }
}

/// Whether another model leaves clearly less, view by view.
fn is_better(own: &[f64], other: &[f64]) -> bool {
    let less: Vec<f64> = own.iter().zip(other).map(|(a, b)| a - b).collect();
    let n = less.len() as f64;
    let mean = less.iter().sum::<f64>() / n;
    let variance = less.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let clear = mean > DEVIATIONS * (variance / n).sqrt();
    clear && other.iter().sum::<f64>() < CLEARLY_LESS * own.iter().sum::<f64>()
}

/// Share of the squares on the views held back that a field fitted to the others takes off; `None` with few corners.
fn pattern(prediction: &Prediction, camera: &Camera) -> Option<f64> {
    if prediction.kept.len() < CORNERS_PER_TERM * TERMS {
        return None;
    }
    let half = Vector2::new(f64::from(camera.width), f64::from(camera.height)) * 0.5;
    let terms = |pixel: &Vector2<f64>| {
        let at = (pixel - half).component_div(&half);
        let powers = (0..=DEGREE).flat_map(|i| (0..=DEGREE - i).map(move |j| (i, j)));
        DVector::from_iterator(TERMS, powers.map(|(i, j)| at.x.powi(i) * at.y.powi(j)))
    };
    let mut normal = DMatrix::<f64>::zeros(TERMS, TERMS);
    let mut right = DMatrix::<f64>::zeros(TERMS, 2);
    for (pixel, error) in &prediction.kept {
        let t = terms(pixel);
        normal.ger(1.0, &t, &t, 1.0);
        right.ger(1.0, &t, error, 1.0);
    }
    for k in 0..TERMS {
        normal[(k, k)] += 1e-9 * prediction.kept.len() as f64;
    }
    let field = normal.cholesky()?.solve(&right);
    let (mut before, mut after) = (0.0, 0.0);
    for (pixel, error) in &prediction.held {
        let expected = field.tr_mul(&terms(pixel));
        before += error.norm_squared();
        after += (error - Vector2::new(expected[0], expected[1])).norm_squared();
    }
    Some(1.0 - after / before.max(1e-12))
}
