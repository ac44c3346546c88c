//! Hesai LiDARs over UDP: PandarXT-32, Pandar64, PandarQT.
//!
//! **What it is.** Spinning multi-beam LiDARs. They send data packets of 1080 (XT32), 1194 or 1198 (Pandar64) and 1072 bytes
//! (QT64) to UDP port 2368, with the sensor's date and time in each, and packets of 512 bytes about their GPS input to port
//! 10110, which are recorded and not read.
//!
//! **How to wire it up.** Factory address 192.168.1.201, sending to 255.255.255.255: give the host's interface
//! 192.168.1.100/24. Time comes by PTP or by PPS and NMEA; the data packets do not say whether it is there, so that their time
//! past the hour is fitted to arrival. It needs no udev rule; the receive buffer wants `sysctl net.core.rmem_max=33554432` or
//! `CAP_NET_ADMIN`.
//!
//! **Beam angles.** Each unit comes with a file of its own, which the sensor's web page gives as "angle correction":
//! [`crate::lidar::BeamAngles`] reads it. Without it the model's angles are taken; for an XT32 they are off by up to 0.1°, which
//! is 5 cm at 30 m.
//!
//! **What is refused by name.** Pandar40P, Pandar128 and OT128, QT128, XT16, XT32M, AT128.
//!
//! Layouts are those of the user manuals (PandarXT-32 § 3.1.2 "UDP Data", Pandar64 § 3.1, PandarQT § 3.1). The frame is
//! x forward (the sensor's azimuth 0), y left, z up. Azimuths are the rotor's at the block, as the manuals say: the rotor's
//! motion between the firings of a block (0.17° in an XT32 at 600 rpm) is not applied.

mod decode;
mod device;
pub mod model;
#[cfg(all(test, feature = "rosbag2"))]
mod reference;
pub mod wire;

pub use decode::{DecodeError, Decoder, DecoderConfig, device_ns, is_beside, position, recognise};
pub use device::{HesaiConfig, PAGE, open};
pub use model::{FACTORY_PORTS, Model};
pub use wire::blank_packets;
