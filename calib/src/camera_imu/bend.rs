//! A board that is not quite flat: `z = a x² + b xy + c y²` about its middle.
//!
//! Sheets of plastic and cardboard twist by a millimetre, which moves focal lengths by a percent: the views alone can hardly tell
//! a bent board from another lens, the views and an IMU can.

use lsfb_geometry::Vector3;

/// Coefficients of a bend.
pub(super) const BEND: usize = 3;

/// `a, b, c`, 1/m.
pub(super) type Bend = Vector3<f64>;

/// `x², xy, y²` of a place seen from the board's middle.
pub(super) fn bends(from_centre: &Vector3<f64>) -> Vector3<f64> {
    let (x, y) = (from_centre.x, from_centre.y);
    Vector3::new(x * x, x * y, y * y)
}
