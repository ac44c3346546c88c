//! Phones and glasses: an app beside the rig sends its sensors over HTTPS, protocol `lsfb.sidecar.v1` (`docs/sidecar.md`).
//!
//! Wiring: none; phone and rig share a network, and the rig serves `wss://host:port/v1/stream`. No udev rule.
//!
//! One WebSocket message is one protobuf [`wire::Envelope`]. The app says HELLO, describes each channel by ADVERTISE the
//! way an MCAP file would (topic, encoding, schema, clock), sends DATA numbered without a gap, and says BYE. The rig
//! acknowledges cumulatively what it has stored; the app keeps what is not acknowledged, never has more under way than the
//! rig's CREDIT, and after a lost connection goes on where the rig has got to. In between it asks for the time.
//!
//! [`SidecarClient`] is an app, [`Decoder`] is the receiving side of one connection without the network, [`wire`] the bytes in
//! both directions, [`sensor_logger`] what another app pushes, [`credentials`] what the two know each other by. The rig's server is `lsfb-capture`'s.

mod client;
pub mod credentials;
mod decode;
pub mod model;
pub mod sensor_logger;
pub mod wire;

pub use client::{ClientClock, ClientConfig, ClientCounts, SidecarClient};
pub use decode::{DecodeError, Decoder, SidecarCounters, SidecarMessage};
