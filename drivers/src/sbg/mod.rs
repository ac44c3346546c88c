//! SBG Systems inertial units (Ellipse, Quanta, Apogee) on a CAN bus.
//!
//! Wiring: a CAN adapter with a SocketCAN driver, 500 kbit/s or 1 Mbit/s as set in the unit:
//! `ip link set can0 type can bitrate 1000000 restart-ms 100; ip link set can0 up`. The rule in `udev/` names candleLight
//! adapters `can_imu`. The identifiers are off in a new unit: switch on 0x120, 0x121, 0x122 (and 0x110, 0x111 for UTC).
//!
//! A sample is three frames: 0x120 carries the time, 0x121 the specific force and 0x122 the angular velocity, in steps of
//! 0.01 m/s² and 0.001 rad/s. That is coarse: for preintegration, take a unit on a serial line.

mod decode;
mod device;
pub mod model;
pub mod wire;

pub use decode::{Decoder, SbgCounters, SbgReading, UtcFix};
pub use device::{SbgConfig, SbgImu};
