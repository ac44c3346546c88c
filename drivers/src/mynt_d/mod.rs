//! The inertial unit of Mynt Eye D cameras: a USB HID device beside the camera's own.
//!
//! Wiring: the camera's USB 3 plug. The rule in `udev/70-lsfb-imu.rules` names the unit's usbfs node
//! `/dev/lsfb/imu_mynt_d`. It sends reports of 64 bytes through an interrupt endpoint, with readings of accelerometer and
//! gyroscope and the stamps of the frames.
//!
//! The vendor does not say what its stamps count. They are handed on as they are, and `lsfb-capture` fits them to host time.
//!
//! [`MyntDImu`] opens the unit (feature `hardware`) and yields reports, [`Decoder`] turns them into samples, [`wire`] speaks
//! the reports in both directions.

mod decode;
mod device;
pub mod model;
pub mod wire;

pub use decode::{Decoder, MyntDCounters, MyntDReading};
pub use device::{MyntDConfig, MyntDImu};
