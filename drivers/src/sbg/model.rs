//! Constants of the SBG CAN protocol, as in the vendor's open SDK (SBG-Systems/sbgECom at 05c19cd). Identifiers are the
//! factory's; they can be changed in the unit.

/// Identifiers of messages, 11 bits.
pub mod id {
    /// Time of the unit and GPS time of week.
    pub const UTC_TIME: u16 = 0x110;
    /// Date and time of day.
    pub const UTC_DATE: u16 = 0x111;
    /// Time of a sample, status, temperature.
    pub const IMU_INFO: u16 = 0x120;
    /// Specific force.
    pub const IMU_ACCELEROMETER: u16 = 0x121;
    /// Angular velocity.
    pub const IMU_GYROSCOPE: u16 = 0x122;
    /// All of them.
    pub const ALL: [u16; 5] = [
        UTC_TIME,
        UTC_DATE,
        IMU_INFO,
        IMU_ACCELEROMETER,
        IMU_GYROSCOPE,
    ];
}

/// Steps of specific force per m/s².
pub const ACCELEROMETER_STEPS: f64 = 100.0;
/// Steps of angular velocity per rad/s.
pub const GYROSCOPE_STEPS: f64 = 1000.0;
/// Steps of temperature per °C.
pub const TEMPERATURE_STEPS: f64 = 100.0;
