//! A board that is not quite what its file says: bent by `z = a x² + b xy + c y²` about its middle, `e` longer than wide, with
//! axes that are not quite at right angles, `x += s y`, and all of it larger by `g`.
//!
//! Sheets of plastic and cardboard twist by a millimetre and printers stretch, which moves focal lengths by a percent: the views
//! alone can hardly tell such a board from another lens, the views and an IMU can.

use lsfb_geometry::Vector3;
use nalgebra::{SMatrix, SVector};

/// Coefficients of a bend.
pub(super) const BEND: usize = 6;
/// Which of them is the size.
pub(super) const SIZE: usize = 5;

/// `a, b, c` (1/m), `e`, `s`, `g`.
pub(super) type Bend = SVector<f64, BEND>;

/// How a place seen from the board's middle moves with the coefficients.
pub(super) fn bends(from_centre: &Vector3<f64>) -> SMatrix<f64, 3, BEND> {
    let (x, y) = (from_centre.x, from_centre.y);
    let mut by = SMatrix::zeros();
    by[(2, 0)] = x * x;
    by[(2, 1)] = x * y;
    by[(2, 2)] = y * y;
    by[(1, 3)] = y;
    by[(0, 4)] = y;
    by[(0, SIZE)] = x;
    by[(1, SIZE)] = y;
    by
}

/// Where a place of the flat board is on the bent one.
pub(super) fn bent(point: &Vector3<f64>, centre: &Vector3<f64>, bend: &Bend) -> Vector3<f64> {
    point + bends(&(point - centre)) * bend
}
