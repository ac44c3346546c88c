//! Sensor drivers: bytes to packets to samples, and back.
//!
//! - [`transport`] moves bytes: a [`transport::PacketSource`] per kind of wire or file. Nothing else in the workspace
//!   opens a socket, a device node or a pcap.
//! - Each device has the same five files: `wire` (byte layout, both directions), `model` (constants and where they
//!   come from), `decode` (packets to samples, no I/O), `device` (open and configure), `mod` (what it is, how to wire it).
//! - Decoders are pushed packets and return device ticks in [`Decoded`]; only `lsfb-capture` turns ticks into time.
//!
//! Setters and `emit` exist for everything that can be read, so that the simulator speaks the real protocols.
//!
//! ```
//! use lsfb_drivers::xsens::wire::{Item, Message, Vector};
//! use lsfb_drivers::xsens::{Decoder, DecoderConfig, model::message};
//! use lsfb_types::{Packet, Timestamp};
//!
//! // What a simulated unit says …
//! let mut data = Vec::new();
//! Item::SampleTimeFine(50).emit(&mut data)?;
//! Item::Acceleration(Vector::single([0.0, 0.0, 9.75])).emit(&mut data)?;
//! Item::RateOfTurn(Vector::single([0.0, 0.5, 0.0])).emit(&mut data)?;
//! let mut bytes = Vec::new();
//! Message { id: message::MT_DATA2, data: &data }.emit(&mut bytes)?;
//!
//! // … is what the decoder of the real one reads.
//! let mut decoder = Decoder::new(DecoderConfig::default());
//! decoder.push(&Packet { arrival: Timestamp::from_nanos(0), bytes });
//! let reading = decoder.next_reading().expect("one packet");
//! assert_eq!(reading.device_ticks, 50);
//! assert_eq!(reading.sample.sample.expect("a sample").specific_force_m_s2, [0.0, 0.0, 9.75]);
//! # Ok::<(), lsfb_drivers::WireError>(())
//! ```

/// The example of the README runs.
#[cfg(all(doctest, feature = "lidar"))]
#[doc = include_str!("../README.md")]
struct Readme;

#[cfg(feature = "lidar")]
pub mod any_lidar;
#[cfg(any(feature = "xsens", feature = "microstrain"))]
mod byte_stream;
#[cfg(any(feature = "xsens", feature = "microstrain"))]
mod conversation;
mod decoded;
mod error;
mod imu_family;
#[cfg(feature = "lidar")]
pub mod lidar;
#[cfg(feature = "lidar")]
mod lidar_vendors;
#[cfg(feature = "microstrain")]
pub mod microstrain;
#[cfg(feature = "mynt-d")]
pub mod mynt_d;
#[cfg(feature = "mynt-s")]
pub mod mynt_s;
#[cfg(any(feature = "mynt-s", feature = "mynt-d"))]
mod pairing;
#[cfg(feature = "sbg")]
pub mod sbg;
#[cfg(feature = "sidecar")]
pub mod sidecar;
#[cfg(test)]
mod test_random;
pub mod transport;
#[cfg(feature = "xsens")]
pub mod xsens;

pub use decoded::Decoded;
pub use error::{Error, WireError};
pub use imu_family::ImuFamily;
#[cfg(feature = "lidar")]
pub use lidar_vendors::*;
