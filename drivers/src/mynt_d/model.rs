//! Constants of the unit, as in the vendor's open SDK (slightech/MYNT-EYE-D-SDK at 7d0bcc6) and its udev rule.

/// USB vendor id.
pub const USB_VENDOR: u16 = 0x0483;
/// USB product id.
pub const USB_PRODUCT: u16 = 0x5720;
/// The HID interface.
pub const INTERFACE: u8 = 0;
/// Interrupt endpoint, towards the host.
pub const ENDPOINT_IN: u8 = 0x81;

/// Nanoseconds of a step of its stamps. Assumed: that of the S1 family, which has the same counter of 32 bits.
pub const TICK_NS: u64 = 10_000;

/// Bytes of a report.
pub const REPORT_LEN: usize = 64;
/// Full span of the accelerometer, g over 65 536 steps.
pub const ACCELEROMETER_SPAN_G: f64 = 12.0;
/// Full span of the gyroscope, °/s over 65 536 steps.
pub const GYROSCOPE_SPAN_DEG_S: f64 = 2000.0;
/// Degrees Celsius of a step of temperature, and at zero.
pub const TEMPERATURE_STEP_CELSIUS: f64 = 0.125;
/// See [`TEMPERATURE_STEP_CELSIUS`].
pub const TEMPERATURE_ZERO_CELSIUS: f64 = 23.0;
/// Standard gravity, m/s² per g (ISO 80000-3).
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

/// Numbers of items.
pub mod item {
    /// Accelerometer.
    pub const ACCELEROMETER: u8 = 0;
    /// Gyroscope.
    pub const GYROSCOPE: u8 = 1;
    /// A frame of the camera.
    pub const FRAME: u8 = 2;
}
