//! Constants of the Xsens MTi family.
//!
//! Numbers are those of the MT Low-Level Communication Protocol, as read in the vendor's public `xstypes` headers
//! (`xsdataidentifier.h`, `xsxbusmessageid.h`) and in `ethzasl_xsens_driver` (`mtdef.py`).

/// USB vendor of Xsens converters and units.
pub const USB_VENDOR: u16 = 0x2639;

/// First byte of every message.
pub const PREAMBLE: u8 = 0xFA;
/// Bus id of a unit addressed alone.
pub const BUS_ID: u8 = 0xFF;
/// Largest data length: a message is at most 8 KiB long.
pub const MAX_DATA_LEN: usize = 8186;

/// `SampleTimeFine` counts these per second.
pub const SAMPLE_TIME_FINE_HZ: u64 = 10_000;
/// Nanoseconds of one `SampleTimeFine` tick.
pub const SAMPLE_TIME_FINE_NS: u64 = 100_000;

/// Default speed of the line, baud.
pub const DEFAULT_BAUD: u32 = 921_600;

/// Message identifiers. The answer to a request carries its identifier plus one.
pub mod message {
    /// Ask for the device id.
    pub const REQ_DID: u8 = 0x00;
    /// Start sending data.
    pub const GO_TO_MEASUREMENT: u8 = 0x10;
    /// Stop sending data, accept settings.
    pub const GO_TO_CONFIG: u8 = 0x30;
    /// Measurement data.
    pub const MT_DATA2: u8 = 0x36;
    /// The unit refuses a request or reports a fault; data is one code.
    pub const ERROR: u8 = 0x42;
    /// Set, or with no data ask for, the list of outputs.
    pub const SET_OUTPUT_CONFIGURATION: u8 = 0xC0;
}

/// Data identifiers of MTData2 items, with the coding nibble zero.
pub mod data_id {
    /// Temperature, °C.
    pub const TEMPERATURE: u16 = 0x0810;
    /// Date and time, with nanoseconds.
    pub const UTC_TIME: u16 = 0x1010;
    /// Counter of packets, wraps at 65 536.
    pub const PACKET_COUNTER: u16 = 0x1020;
    /// Sample time, 100 µs ticks, wraps after 4.97 days.
    pub const SAMPLE_TIME_FINE: u16 = 0x1060;
    /// Sample time, whole seconds.
    pub const SAMPLE_TIME_COARSE: u16 = 0x1070;
    /// Orientation, quaternion w x y z.
    pub const QUATERNION: u16 = 0x2010;
    /// Orientation, roll pitch yaw in degrees.
    pub const EULER_ANGLES: u16 = 0x2030;
    /// Pressure, Pa.
    pub const PRESSURE: u16 = 0x3010;
    /// Velocity increment, m/s.
    pub const DELTA_V: u16 = 0x4010;
    /// Specific force, m/s².
    pub const ACCELERATION: u16 = 0x4020;
    /// Specific force at the sensor's own rate, m/s².
    pub const ACCELERATION_HR: u16 = 0x4040;
    /// Pulse on SyncIn line 1.
    pub const TRIGGER_IN1: u16 = 0x4810;
    /// Pulse on SyncIn line 2.
    pub const TRIGGER_IN2: u16 = 0x4820;
    /// Angular velocity, rad/s.
    pub const RATE_OF_TURN: u16 = 0x8020;
    /// Orientation increment, quaternion w x y z.
    pub const DELTA_Q: u16 = 0x8030;
    /// Angular velocity at the sensor's own rate, rad/s.
    pub const RATE_OF_TURN_HR: u16 = 0x8040;
    /// Magnetic field, 1 at the local norm.
    pub const MAGNETIC_FIELD: u16 = 0xC020;
    /// Status, low byte only.
    pub const STATUS_BYTE: u16 = 0xE010;
    /// Status, 32 bits.
    pub const STATUS_WORD: u16 = 0xE020;
}

/// Rate of an output in `SetOutputConfiguration` that comes with every packet.
pub const WITH_EVERY_PACKET: u16 = 0xFFFF;
