//! Constants of the Mynt Eye S2 family.
//!
//! From the vendor's open SDK (slightech/MYNT-EYE-S-SDK at 78bbe8c, `src/mynteye/device` and `uvc/linux`) and its
//! documentation; what only one of our units could tell is marked as assumed.

/// USB vendor id of the unit's USB controller.
pub const USB_VENDOR: u16 = 0x04B4;
/// USB product id.
pub const USB_PRODUCT: u16 = 0x00F9;

/// Bytes of the trailer.
pub const TRAILER_BYTES: usize = 16;
/// Pixels of the last image that the trailer covers: two bytes each.
pub const DAMAGED_PIXELS: usize = TRAILER_BYTES / 2;
/// First logical byte of the trailer.
pub const TRAILER_HEADER: u8 = 0x3B;
/// Bit of the header byte: the stamp comes from an external time source.
pub const TRAILER_EXTERNAL_TIME: u8 = 0x80;
/// Second logical byte of the trailer.
pub const TRAILER_SIZE: u8 = 0x0C;

/// Nanoseconds of one exposure step. Assumed: the release notes' maximum of 66.5 ms against the field's range 0–655.
pub const EXPOSURE_STEP_NS: u32 = 100_000;

/// First byte of an IMU request.
pub const IMU_REQUEST_HEADER: u8 = 0x5A;
/// First byte of an IMU answer.
pub const IMU_RESPONSE_HEADER: u8 = 0x5B;
/// Default full span of the accelerometer, g (±6 g).
pub const ACCELEROMETER_SPAN_G: u16 = 12;
/// Default full span of the gyroscope, °/s (±500 °/s).
pub const GYROSCOPE_SPAN_DEG_S: u16 = 1000;
/// Standard gravity, m/s² per g (ISO 80000-3).
pub const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
