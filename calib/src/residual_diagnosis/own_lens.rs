//! The lens that views have for themselves, beside one that was given.

use lsfb_geometry::Camera;
use lsfb_types::{Finding, Verdict};
use nalgebra::{DMatrix, DVector};

use super::sums::{Sums, inverse, is_determined};

/// Share of the squares, and of their variance, that another lens must take off one that was given.
const LENS_SHARE: f64 = 0.2;
const LENS_CHI_SQUARE: f64 = 60.0;
/// Standard deviations of lenses about those that were given where these do not fit: focal lengths as a share, the principal
/// point as a share of the image's width, distortion.
const LENS_SIGMAS: [f64; 3] = [0.005, 0.01, 0.02];

/// A step of a lens's own parameters.
struct OwnLens {
    inverse: DMatrix<f64>,
    /// Which parameters the views tell at all.
    is_determined: Vec<bool>,
    step: DVector<f64>,
    /// Squares that it takes off.
    taken: f64,
    /// Of a corner in one direction then, px².
    variance: f64,
}

impl Sums {
    /// A lens that was given, beside the one that these views have for themselves: one step of its own parameters.
    pub fn given_lens(&self, name: &str, camera: &Camera) -> Option<Finding> {
        let lens = camera.lens.parameters();
        let OwnLens {
            inverse,
            is_determined,
            step,
            taken,
            variance,
        } = self.own_lens(camera)?;
        let fits = format!(
            "the given lens does not fit these images: another one would explain {:.0} % of the squared residuals",
            100.0 * taken / self.squares
        );
        let finding = |what| {
            Finding::new("given-lens", Verdict::Warn, name, what)
                .remedy("calibrate the camera again")
        };
        // Focal lengths and the principal point come first in every model.
        let sigma = |k: usize| (inverse[(k, k)] * variance).max(0.0).sqrt();
        let told = (0..4).filter(|k| is_determined[*k]);
        let clearest = told.max_by(|a, b| {
            let clear = |k: usize| step[k].abs() / sigma(k).max(1e-12);
            clear(*a).total_cmp(&clear(*b))
        });
        let Some(clearest) = clearest else {
            return Some(finding(format!(
                "{fits}; the images do not determine which"
            )));
        };
        let value = lens.values[clearest] + step[clearest];
        let what = format!(
            "{fits}, with {} = {value:.1} ± {:.1} px instead of {:.1}",
            camera.lens.model().parameter_names()[clearest],
            sigma(clearest),
            lens.values[clearest]
        );
        Some(finding(what).value(value, "px").sigma(sigma(clearest)))
    }

    /// The lens that these views have for themselves where that fits clearly better than the one that was given; parameters that few
    /// views do not tell stay near those given, as lenses usually do.
    pub fn lens_of_its_own(&self, camera: &Camera) -> Option<Camera> {
        let OwnLens { variance, .. } = self.own_lens(camera)?;
        let lens = camera.lens.parameters();
        let mut information = self
            .matrix
            .view((0, 0), (lens.count, lens.count))
            .into_owned();
        for k in 0..lens.count {
            let usual = match k {
                0 | 1 => LENS_SIGMAS[0] * lens.values[k],
                2 | 3 => LENS_SIGMAS[1] * f64::from(camera.width),
                _ => LENS_SIGMAS[2],
            };
            information[(k, k)] += variance / (usual * usual);
        }
        let gradient = self.gradient.rows(0, lens.count).into_owned();
        let step = information.cholesky()?.solve(&gradient);
        let mut values = lens.values;
        for (value, step) in values.iter_mut().zip(step.iter()) {
            *value -= step;
        }
        let own = camera.lens.model().lens(&values);
        own.problem().is_none().then_some(Camera {
            lens: own,
            ..*camera
        })
    }

    /// One step of a lens's own parameters; `None` where it is no clear gain.
    fn own_lens(&self, camera: &Camera) -> Option<OwnLens> {
        let count = camera.lens.parameters().count;
        let own = self.matrix.view((0, 0), (count, count)).into_owned();
        let is_determined = is_determined(&own, &own.diagonal());
        let inverse = inverse(&own, &own.diagonal());
        let gradient = self.gradient.rows(0, count).into_owned();
        let step = -(&inverse * &gradient);
        let taken = -gradient.dot(&step);
        let left = (self.squares - taken).max(1e-12);
        let variance = left / (2.0 * self.corners - count as f64).max(1.0);
        let clear = taken >= LENS_SHARE * self.squares && taken >= LENS_CHI_SQUARE * variance;
        clear.then_some(OwnLens {
            inverse,
            is_determined,
            step,
            taken,
            variance,
        })
    }
}
