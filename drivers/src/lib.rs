//! Sensor drivers: bytes to packets to samples, and back.
//!
//! - [`transport`] moves bytes: a [`transport::PacketSource`] per kind of wire or file. Nothing else in the workspace
//!   opens a socket, a device node or a pcap.
//! - Each device has the same five files: `wire` (byte layout, both directions), `model` (constants and where they
//!   come from), `decode` (packets to samples, no I/O), `device` (open and configure), `mod` (what it is, how to wire it).
//! - Decoders are pushed packets and return device ticks in [`Decoded`]; only `lsfb-capture` turns ticks into time.
//!
//! Setters and `emit` exist for everything that can be read, so that the simulator speaks the real protocols.

pub mod camera;
mod decoded;
mod error;
pub mod imu;
pub mod phone;
#[cfg(test)]
mod test_random;
pub mod transport;
pub mod velodyne;

pub use decoded::Decoded;
pub use error::{Error, WireError};
