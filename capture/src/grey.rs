//! What some pixels of an image tell of all of them.

use lsfb_types::Image;

/// Of so many pixels one is looked at.
const PIXEL_STRIDE: usize = 16;
/// Video's black (ITU-R BT.601-7): what is darker tells nothing apart.
const BLACK: u8 = 16;
/// Share of the pixels from which an image is black.
const BLACK_SHARE: f64 = 0.99;

/// Some of its pixels. Sensors have noise, so that not even a dark one sends the same twice.
pub(crate) fn some_pixels(image: &Image) -> Vec<u8> {
    image.pixels.iter().step_by(PIXEL_STRIDE).copied().collect()
}

/// Whether these pixels are those of an image that shows nothing.
pub(crate) fn is_black(some: &[u8]) -> bool {
    !some.is_empty() && share(some, |grey| grey <= BLACK) >= BLACK_SHARE
}

/// Share of these pixels that are white, 0–1.
pub(crate) fn saturated_share(some: &[u8]) -> f64 {
    share(some, |grey| grey == u8::MAX)
}

fn share(some: &[u8], is: impl Fn(u8) -> bool) -> f64 {
    some.iter().filter(|grey| is(**grey)).count() as f64 / some.len().max(1) as f64
}
