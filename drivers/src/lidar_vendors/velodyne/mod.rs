//! Velodyne LiDARs over UDP: VLP-32C (Ultra Puck), VLP-16 (Puck), HDL-32E.
//!
//! **What it is.** A spinning multi-beam LiDAR. It sends data packets of 1206 bytes to UDP port 2368 (1507 per second for
//! a VLP-32C with single returns) and position packets of 512 bytes to port 8308, with the state of its PPS input and the
//! last NMEA sentence it received.
//!
//! **How to wire it up.** Factory address 192.168.1.201, sending to 255.255.255.255 or to what its web page says: give the
//! host's interface 192.168.1.100/24. For UTC time, feed PPS and GPRMC (9600 8N1, status `A`) into the interface box.
//! It needs no udev rule; the receive buffer wants `sysctl net.core.rmem_max=33554432` or `CAP_NET_ADMIN`.
//!
//! **How to set it up.** [`SensorPage`] changes motor, echoes, sector, phase lock and destination through the sensor's web
//! page, and reads each of them back. [`SensorWeb`] is the sensor's side of it, for mocks.
//!
//! **What is refused by name.** VLS-128, HDL-64E, VLP-32A/B, Puck Hi-Res and Velarray; and a VLP-16 whose factory bytes
//! claim an HDL-32E, told by its packet rate.
//!
//! The frame is x forward (the sensor's azimuth 0), y left, z up.

mod decode;
mod device;
mod layout;
pub mod model;
pub mod nmea;
mod points;
#[cfg(all(test, feature = "pcap", feature = "rosbag2"))]
mod recordings;
#[cfg(all(test, feature = "pcap", feature = "rosbag2"))]
mod reference;
pub mod settings;
mod web;
pub mod wire;

pub use decode::{
    DecodeError, Decoder, DecoderConfig, ModelChoice, device_ns, is_beside, position, recognise,
};
pub use device::{VelodyneConfig, open};
pub use layout::{PacketLayout, Return, returns};
pub use model::{FACTORY_PORTS, Model};
pub use points::OpticalOffset;
pub use web::{PAGE, SensorPage, SensorWeb, SettingsHandling};
pub use wire::blank_packets;
