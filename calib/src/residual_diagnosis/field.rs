//! What pixels do that neither a lens model nor a board bent like a parabola knows of.
//!
//! Lenses are decentred (Brown's `p₁, p₂`: D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32, 1966, here
//! of the distorted image), which most models do without: TUM VI's principal points move by half a pixel with where in the image
//! corners were seen, and stay where they are once these two are known. And boards have hills of a few tenths of a millimetre.

use lsfb_geometry::{Camera, Matrix2x3, Vector2, Vector3};
use nalgebra::{SMatrix, SVector};

/// Decentring, and heights of third and fourth degree.
pub(super) const FIELD: usize = 2 + HEIGHTS;
const HEIGHTS: usize = 9;
/// Standard deviation of what lenses are decentred by, and of heights at the middle of an edge, metres.
const DECENTRING_SIGMA: f64 = 2e-3;
const HEIGHT_SIGMA_M: f64 = 5e-4;

/// `p₁, p₂`, then heights in metres.
pub(crate) type Field = SVector<f64, FIELD>;

/// What a board that may not be flat may be off by: shares by which it is longer than wide and sheared, then its bends
/// `a x² + b xy + c y²`, 1/m.
pub(crate) type BoardShift = SVector<f64, DEFORMATIONS>;
pub(super) const DEFORMATIONS: usize = 5;

/// What a lens model and a flat board do not know of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Unmodelled {
    pub field: Field,
    pub board: BoardShift,
    /// Root of their covariance: the board's rows first.
    pub spread: SMatrix<f64, FREED, FREED>,
}

/// Deformations of the board and [`Field`].
pub(crate) const FREED: usize = DEFORMATIONS + FIELD;

impl Unmodelled {
    /// Nothing.
    pub fn none() -> Self {
        Self {
            field: Field::zeros(),
            board: BoardShift::zeros(),
            spread: SMatrix::zeros(),
        }
    }

    /// One of the directions in which they are uncertain, one standard deviation along it.
    pub fn spread_along(&self, direction: usize) -> (Field, BoardShift) {
        let along = self.spread.column(direction);
        (
            along.fixed_rows::<FIELD>(DEFORMATIONS).into_owned(),
            along.fixed_rows::<DEFORMATIONS>(0).into_owned(),
        )
    }
}

/// Standard deviation of a component of a [`Field`] beforehand.
pub(super) fn usual_sigma(component: usize) -> f64 {
    match component {
        0 | 1 => DECENTRING_SIGMA,
        _ => HEIGHT_SIGMA_M,
    }
}

/// How a pixel moves with a [`Field`]; `by_point` is how it moves with its corner on the board, and `place` where that is from the
/// middle of the board, as a share of half its longer edge.
pub(crate) fn moved_by_field(
    camera: &Camera,
    pixel: &Vector2<f64>,
    by_point: &Matrix2x3<f64>,
    place: &Vector3<f64>,
) -> SMatrix<f64, 2, FIELD> {
    let (focal, middle) = (camera.focal_px(), camera.principal_px());
    let x = (pixel.x - middle[0]) / focal[0];
    let y = (pixel.y - middle[1]) / focal[1];
    let square = x * x + y * y;
    let mut by = SMatrix::<f64, 2, FIELD>::zeros();
    by[(0, 0)] = 2.0 * x * y * focal[0];
    by[(1, 0)] = (square + 2.0 * y * y) * focal[1];
    by[(0, 1)] = (square + 2.0 * x * x) * focal[0];
    by[(1, 1)] = 2.0 * x * y * focal[1];
    let powers = (3..=4).flat_map(|degree| (0..=degree).map(move |k| (degree - k, k)));
    for (k, (i, j)) in powers.enumerate() {
        let height = place.x.powi(i) * place.y.powi(j);
        by.set_column(2 + k, &(by_point.column(2) * height));
    }
    by
}
