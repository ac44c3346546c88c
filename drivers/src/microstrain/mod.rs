//! MicroStrain inertial units (3DM-GX5, CX5, CV5, CV7) speaking MIP over a serial line or USB.
//!
//! Wiring: USB units appear as `/dev/ttyACM*` and take any baud; serial ones at 921 600 baud. The rules in
//! `udev/70-lsfb-imu.rules` name the line `/dev/lsfb/imu_mip`. Samples are stamped with the unit's reference time in
//! nanoseconds since power-up; with PPS and a GPS time fed in, GPS time comes beside it.
//!
//! [`MipImu`] configures the unit and yields its bytes, [`Decoder`] turns them into samples, [`wire`] speaks the protocol
//! in both directions, and [`MipUnit`] is the unit's side of a conversation, for mocks.

mod decode;
mod device;
pub mod model;
#[cfg(test)]
mod recordings;
mod unit;
pub mod wire;

pub use decode::{Decoder, MipCounters, MipReading};
pub use device::{MipConfig, MipImu};
pub use unit::MipUnit;
