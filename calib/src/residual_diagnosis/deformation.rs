//! The board if it may be deformed, and what moves pixels that the models of lens and board do not know of.

use lsfb_geometry::Camera;
use nalgebra::{DMatrix, RowSVector, SMatrix, SVector, SymmetricEigen};

use super::field::{DEFORMATIONS, FIELD, FREED, Field, Unmodelled, usual_sigma};
use super::sums::{STRETCH, Sums, UNMODELLED};
use super::{BoardDeformation, Deformation};
use crate::board::Target;

/// Standard deviations of a board: how far the middle of an edge is out of its plane, metres; stretch and shear.
const BEND_SIGMA_M: f64 = 2e-3;
const STRETCH_SIGMA: f64 = 1e-3;
/// Chi-square of [`DEFORMATIONS`] that a flat board exceeds once in a thousand recordings.
const FLAT_CHI_SQUARE: f64 = 20.5;
/// Chi-square of [`FIELD`] that noise exceeds once in a thousand recordings, and of [`FREED`].
const FIELD_CHI_SQUARE: f64 = 31.3;
const UNMODELLED_CHI_SQUARE: f64 = 39.3;

/// Both, freed together.
struct Freed {
    step: SVector<f64, FREED>,
    covariance: SMatrix<f64, FREED, FREED>,
}

impl Sums {
    /// What moves pixels that lens and board do not know of, beside a board that may be deformed; `None` where it could be noise.
    pub fn field(&self, camera: &Camera, variance: f64) -> Option<Field> {
        let Freed { step, covariance } = self.freed(camera, variance)?;
        let own = covariance.fixed_view::<FIELD, FIELD>(DEFORMATIONS, DEFORMATIONS);
        let field: Field = step.fixed_rows::<FIELD>(DEFORMATIONS).into_owned();
        let chi_square = field.dot(&(own.into_owned().try_inverse()? * field));
        (chi_square > FIELD_CHI_SQUARE).then_some(field)
    }

    /// The same with the deformations of the board.
    pub fn unmodelled(&self, camera: &Camera, variance: f64) -> Option<Unmodelled> {
        let Freed { step, covariance } = self.freed(camera, variance)?;
        let chi_square = step.dot(&(covariance.try_inverse()? * step));
        (chi_square > UNMODELLED_CHI_SQUARE).then(|| Unmodelled {
            field: step.fixed_rows::<FIELD>(DEFORMATIONS).into_owned(),
            board: step.fixed_rows::<DEFORMATIONS>(0).into_owned(),
            spread: root(&covariance),
        })
    }

    /// Deformations of the board and [`Field`], beside the lens, within what is usual.
    fn freed(&self, camera: &Camera, variance: f64) -> Option<Freed> {
        let reduced = self.reduced(camera);
        let rows: [usize; FREED] = std::array::from_fn(|k| match k.checked_sub(DEFORMATIONS) {
            Some(k) => UNMODELLED + k,
            None => STRETCH + k,
        });
        let variance = variance.max(1e-12);
        let usual = self.usual_deformation();
        let information = SMatrix::<f64, FREED, FREED>::from_fn(|i, j| {
            let prior = match usual.get(i) {
                Some(usual) => *usual,
                None => usual_sigma(i - DEFORMATIONS).powi(-2),
            };
            let prior = if i == j { prior } else { 0.0 };
            reduced.matrix[(rows[i], rows[j])] / variance + prior
        });
        let covariance = information.try_inverse()?;
        let gradient = SVector::<f64, FREED>::from_fn(|i, _| reduced.gradient[rows[i]] / variance);
        Some(Freed {
            step: -covariance * gradient,
            covariance,
        })
    }

    /// Information beforehand of stretch, shear and bends, by what boards usually are.
    fn usual_deformation(&self) -> [f64; DEFORMATIONS] {
        let half_m = self.half_m();
        let bend = (half_m * half_m / BEND_SIGMA_M).powi(2);
        let stretch = STRETCH_SIGMA.powi(-2);
        [stretch, stretch, bend, bend, bend]
    }

    /// The board if it may be stretched, sheared and bent, by what boards usually are.
    pub fn board(&self, target: &Target, camera: &Camera, variance: f64) -> Deformation {
        let variance = variance.max(1e-12);
        let reduced = self.reduced(camera);
        let usual = SVector::from(self.usual_deformation());
        let own = reduced
            .matrix
            .fixed_view::<DEFORMATIONS, DEFORMATIONS>(STRETCH, STRETCH);
        let information = own / variance + SMatrix::from_diagonal(&usual);
        let lens = reduced.lens_by_cause.nrows();
        let Some(covariance) = information.try_inverse() else {
            return Deformation {
                board: BoardDeformation::default(),
                lens_covariance: DMatrix::zeros(lens, lens),
            };
        };
        let gradient = reduced.gradient.fixed_rows::<DEFORMATIONS>(STRETCH) / variance;
        let step = -covariance * gradient;
        // What freeing the board takes off, in variances, is a chi-square where it is flat.
        let is_likely = -gradient.dot(&step) > FLAT_CHI_SQUARE;
        let by_deformation = reduced.lens_by_cause.columns(STRETCH, DEFORMATIONS);
        let lens_covariance = if is_likely {
            by_deformation * (covariance + step * step.transpose()) * by_deformation.transpose()
        } else {
            DMatrix::zeros(lens, lens)
        };
        let root = |variance: f64| variance.max(0.0).sqrt();

        let focal_px = camera.focal_px();
        let of_focal = |row: usize| -> RowSVector<f64, DEFORMATIONS> {
            let of_lens = reduced
                .lens_by_cause
                .fixed_view::<1, DEFORMATIONS>(row, STRETCH);
            of_lens * (0.5 / focal_px[row])
        };
        let of_focal = of_focal(0) + of_focal(1);

        let height = |k: usize| -> RowSVector<f64, DEFORMATIONS> {
            let from = target.corner(k) - self.centre;
            [0.0, 0.0, from.x * from.x, from.x * from.y, from.y * from.y].into()
        };
        let count = target.corner_count();
        // The plane is that of the mean.
        let mean = (0..count)
            .map(height)
            .sum::<RowSVector<f64, DEFORMATIONS>>()
            / count.max(1) as f64;
        let (bend_m, bend_sigma_m) = (0..count)
            .map(|k| {
                let by = height(k) - mean;
                (
                    (by * step)[0].abs(),
                    root((by * covariance * by.transpose())[0]),
                )
            })
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or_default();
        Deformation {
            board: BoardDeformation {
                bend_m,
                bend_sigma_m,
                focal_change: (of_focal * step)[0],
                focal_sigma: root((of_focal * covariance * of_focal.transpose())[0]),
                is_likely,
            },
            lens_covariance,
        }
    }
}

/// The symmetric root of a covariance.
fn root(covariance: &SMatrix<f64, FREED, FREED>) -> SMatrix<f64, FREED, FREED> {
    // Of numbers of one size: heights in metres are far smaller than bends.
    let scale = covariance
        .diagonal()
        .map(|v| v.max(f64::MIN_POSITIVE).sqrt());
    let scaled =
        SMatrix::<f64, FREED, FREED>::from_fn(|i, j| covariance[(i, j)] / (scale[i] * scale[j]));
    let eigen = SymmetricEigen::new(scaled);
    let roots = eigen.eigenvalues.map(|v: f64| v.max(0.0).sqrt());
    let root = eigen.eigenvectors * SMatrix::from_diagonal(&roots) * eigen.eigenvectors.transpose();
    SMatrix::from_diagonal(&scale) * root
}
