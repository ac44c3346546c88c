//! How a sensor is set before it is recorded, whichever vendor's page does it.

use std::net::{Ipv4Addr, SocketAddr};

use super::Returns;
use crate::Error;

/// What is to be set on a sensor. What is `None` stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorSettings {
    /// Speed of the motor, revolutions per minute.
    pub rpm: Option<u16>,
    /// Which echoes it sends.
    pub returns: Option<Returns>,
    /// First and last degree of the sector in which it fires, clockwise.
    pub field_of_view_deg: Option<[u16; 2]>,
    /// Where the rotor points at each pulse per second, 0.01°.
    pub phase_lock_centideg: Option<u16>,
    /// Where it sends.
    pub destination: Option<Destination>,
}

/// Where packets go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Destination {
    /// Host, or 255.255.255.255 for everyone.
    pub address: Ipv4Addr,
    /// Port of data packets.
    pub data_port: u16,
    /// Port of position packets.
    pub position_port: u16,
}

/// A document, a form or a setting has a value that the sensor does not have, or lacks one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} cannot be `{got}`")]
pub struct SettingsError {
    /// The field.
    pub field: &'static str,
    /// What is there.
    pub got: String,
}

/// The page on which a vendor's sensors are set.
#[derive(Clone, Copy, Debug)]
pub struct Page {
    /// Refuses what the sensors do not have; nothing is sent.
    pub check: fn(&SensorSettings) -> Result<(), SettingsError>,
    /// Sets a sensor by its page at an address, and reads back each setting: the first that was not taken is the error.
    pub apply: fn(SocketAddr, &SensorSettings) -> Result<(), Error>,
}
