//! Phones and glasses: an app beside the rig sends its sensors over a WebSocket, protocol `lsfb.sidecar.v1`.
//!
//! Wiring: none; phone and rig share a network, and the rig serves `ws://host:port/v1/stream`. No udev rule.
//!
//! One WebSocket message is one protobuf [`wire::Envelope`]. The app says HELLO, describes each channel by ADVERTISE the
//! way an MCAP file would (topic, encoding, schema, clock), sends DATA numbered without a gap, and says BYE. The rig
//! acknowledges cumulatively what it has stored; the app keeps a bounded number of messages unacknowledged.
//!
//! [`SidecarServer`] receives from any number of apps, [`SidecarClient`] is an app, [`Decoder`] is the receiving side of
//! one connection without the network, [`wire`] the bytes in both directions.

mod client;
mod decode;
mod device;
pub mod model;
pub mod wire;

pub use client::{ClientConfig, SidecarClient};
pub use decode::{Decoder, SidecarCounters, SidecarMessage};
pub use device::{Delivery, Receipt, SidecarConfig, SidecarEvent, SidecarServer};
