//! Random inputs of the residuals' laws.

use lsfb_geometry::{Se3, Vector3, Vector6};
use proptest::prelude::*;

/// A pose turned by at most √3 radians.
pub fn pose() -> impl Strategy<Value = Se3> {
    prop::array::uniform6(-1.0..1.0f64).prop_map(|a| Se3::exp(&Vector6::from(a)))
}

/// A point or direction.
pub fn vector() -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-3.0..3.0f64).prop_map(Vector3::from)
}
