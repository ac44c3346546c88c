//! Constants of the MIP protocol, as in the vendor's open SDK (LORD-MicroStrain/mip_sdk at e5a847d).

/// USB vendor of the units.
pub const USB_VENDOR: u16 = 0x199B;

/// First two bytes of every packet.
pub const SYNC: [u8; 2] = [0x75, 0x65];
/// Bytes before the payload: sync, descriptor set, payload length.
pub const HEADER_LEN: usize = 4;
/// Bytes after the payload.
pub const CHECKSUM_LEN: usize = 2;

/// Default speed of the line, baud.
pub const DEFAULT_BAUD: u32 = 921_600;

/// Standard gravity, m/s² per g, as the unit defines it.
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

/// Descriptor sets. From [`set::SENSOR`] on they carry data, below it commands and their answers.
pub mod set {
    /// Commands of every unit.
    pub const BASE: u8 = 0x01;
    /// Commands of the 3DM family.
    pub const THREE_DM: u8 = 0x0C;
    /// Inertial data.
    pub const SENSOR: u8 = 0x80;
    /// Data of the unit's own filter.
    pub const FILTER: u8 = 0x82;
    /// Data about the unit.
    pub const SYSTEM: u8 = 0xA0;
}

/// Field descriptors of commands and their answers.
pub mod command {
    /// Are you there ([`super::set::BASE`]).
    pub const PING: u8 = 0x01;
    /// Stop sending data ([`super::set::BASE`]).
    pub const IDLE: u8 = 0x02;
    /// Go on sending data ([`super::set::BASE`]).
    pub const RESUME: u8 = 0x06;
    /// Ask for the rate that decimations divide ([`super::set::THREE_DM`]).
    pub const GET_BASE_RATE: u8 = 0x0E;
    /// Set the fields of a data set ([`super::set::THREE_DM`]).
    pub const MESSAGE_FORMAT: u8 = 0x0F;
    /// Answer to [`GET_BASE_RATE`].
    pub const BASE_RATE_REPLY: u8 = 0x8E;
    /// The unit carried out a command, or says why not.
    pub const ACK: u8 = 0xF1;
}

/// Field descriptors of data. Those from [`field::SHARED`] on mean the same in every data set.
pub mod field {
    /// Specific force, g ([`super::set::SENSOR`]).
    pub const ACCELEROMETER: u8 = 0x04;
    /// Angular velocity, rad/s ([`super::set::SENSOR`]).
    pub const GYROSCOPE: u8 = 0x05;
    /// Magnetic field, Gauss ([`super::set::SENSOR`]).
    pub const MAGNETOMETER: u8 = 0x06;
    /// Rotation since the last sample, rad ([`super::set::SENSOR`]).
    pub const DELTA_THETA: u8 = 0x07;
    /// Velocity since the last sample, g s ([`super::set::SENSOR`]).
    pub const DELTA_VELOCITY: u8 = 0x08;
    /// GPS time of older units ([`super::set::SENSOR`]).
    pub const GPS_TIMESTAMP: u8 = 0x12;
    /// Air pressure, mbar ([`super::set::SENSOR`]).
    pub const PRESSURE: u8 = 0x17;
    /// First of the shared descriptors.
    pub const SHARED: u8 = 0xD0;
    /// Counter of the unit.
    pub const TICKS: u8 = 0xD1;
    /// GPS time.
    pub const GPS_TIME: u8 = 0xD3;
    /// Time since power-up, nanoseconds.
    pub const REFERENCE_TIME: u8 = 0xD5;
    /// Reference time since the packet before, nanoseconds.
    pub const REFERENCE_DELTA: u8 = 0xD6;
    /// Time fed in from outside, nanoseconds.
    pub const EXTERNAL_TIME: u8 = 0xD7;
}
