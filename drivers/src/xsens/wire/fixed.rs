//! Values of a known size.

use crate::WireError;

pub(super) fn fixed<const N: usize>(value: &[u8]) -> Result<[u8; N], WireError> {
    value.try_into().map_err(|_| WireError::Length {
        expected: N,
        got: value.len(),
    })
}
