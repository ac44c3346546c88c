//! Byte layout of Velodyne packets. Multi-byte fields are little-endian.

use crate::WireError;

pub use super::model::{BLOCKS, CHANNELS, returns_of_code};
use super::model::{Model, Product, code_of_returns};
pub use crate::lidar::{Returns, TURN_CENTIDEG};

/// Payload length of a data packet (UDP port 2368 by default).
pub const DATA_PACKET_LEN: usize = 1206;
/// Payload length of a position packet (UDP port 8308 by default).
pub const POSITION_PACKET_LEN: usize = 512;

const BLOCK_LEN: usize = 100;
const TIMESTAMP: usize = 1200;
const RETURN_MODE: usize = 1204;
const PRODUCT: usize = 1205;
const FLAG_UPPER: u16 = 0xEEFF;
const FLAGS_OF_LARGER_SENSORS: [u16; 3] = [0xDDFF, 0xCCFF, 0xBBFF];

/// What the sensor is, by its factory byte or, where it has none, by its block flags.
pub fn identify(bytes: &[u8]) -> Result<Product, WireError> {
    check_length(bytes, DATA_PACKET_LEN)?;
    let product = Product::from_code(bytes[PRODUCT]);
    if product == Product::Vls128 {
        return Ok(product);
    }
    let is_larger =
        |block: usize| FLAGS_OF_LARGER_SENSORS.contains(&u16_at(bytes, block * BLOCK_LEN));
    Ok(if (0..BLOCKS).any(is_larger) {
        Product::Hdl64e
    } else {
        product
    })
}

/// A view of one data packet of a sensor whose blocks all carry the flag `FF EE`
/// (VLP-32C User Manual 63-9325 p. 54, VLP-16 63-9243 Rev. D p. 48).
#[derive(Clone, Debug)]
pub struct DataPacket<T>(T);

impl<T: AsRef<[u8]>> DataPacket<T> {
    /// Checks the length, every block flag and every azimuth, so that no getter can panic.
    pub fn new(bytes: T) -> Result<Self, WireError> {
        let b = bytes.as_ref();
        check_length(b, DATA_PACKET_LEN)?;
        for block in 0..BLOCKS {
            let offset = block * BLOCK_LEN;
            let flag = u16_at(b, offset);
            if flag != FLAG_UPPER {
                return Err(WireError::Constant {
                    offset,
                    expected: FLAG_UPPER.into(),
                    got: flag.into(),
                });
            }
            let azimuth = u16_at(b, offset + 2);
            if azimuth >= TURN_CENTIDEG {
                return Err(WireError::Value {
                    field: "azimuth",
                    offset: offset + 2,
                    got: azimuth.into(),
                });
            }
        }
        Ok(Self(bytes))
    }

    /// Encoder angle at the block's first firing, clockwise seen from above, 0.01°, below 36000.
    pub fn azimuth_centideg(&self, block: usize) -> u16 {
        u16_at(self.bytes(), block * BLOCK_LEN + 2)
    }

    /// Distance of a channel in the model's unit (2 or 4 mm); 0 where nothing came back.
    pub fn distance_raw(&self, block: usize, channel: usize) -> u16 {
        u16_at(self.bytes(), channel_offset(block, channel))
    }

    /// Reflectivity of a channel: 0–100 diffuse, 101–255 retro-reflective.
    pub fn reflectivity(&self, block: usize, channel: usize) -> u8 {
        self.bytes()[channel_offset(block, channel) + 2]
    }

    /// Distance (little-endian) and reflectivity of every channel of a block.
    pub(super) fn channel_bytes(&self, block: usize) -> &[[u8; 3]] {
        let first = channel_offset(block, 0);
        let (channels, _) = self.bytes()[first..first + 3 * CHANNELS].as_chunks();
        channels
    }

    /// The same packet in a buffer of its own, whose content is replaced.
    pub(super) fn copied_into(&self, mut buffer: Vec<u8>) -> DataPacket<Vec<u8>> {
        buffer.clear();
        buffer.extend_from_slice(self.bytes());
        DataPacket(buffer)
    }

    /// Microseconds since the top of the hour at the first firing of block 0. Real sensors exceed one hour by a little.
    pub fn timestamp_us(&self) -> u32 {
        u32_at(self.bytes(), TIMESTAMP)
    }

    /// The return mode byte; see [`returns_of_code`].
    pub fn return_mode_code(&self) -> u8 {
        self.bytes()[RETURN_MODE]
    }

    /// The product byte; see [`Product::from_code`].
    pub fn product_code(&self) -> u8 {
        self.bytes()[PRODUCT]
    }

    /// All bytes.
    pub fn bytes(&self) -> &[u8] {
        self.0.as_ref()
    }
}

/// A data packet without a return, of each model in each return mode.
pub fn blank_packets() -> Vec<(Model, Vec<u8>)> {
    let mut all = Vec::new();
    for model in Model::ALL {
        for mode in Returns::ALL {
            let bytes = vec![0; DATA_PACKET_LEN];
            if let Ok(packet) = DataPacket::init(bytes, model.product(), mode) {
                all.push((model, packet.into_inner()));
            }
        }
    }
    all
}

impl<T: AsRef<[u8]> + AsMut<[u8]>> DataPacket<T> {
    /// Clears the bytes and writes what every packet has: flags, product and return mode.
    pub fn init(mut bytes: T, product: Product, mode: Returns) -> Result<Self, WireError> {
        let b = bytes.as_mut();
        check_length(b, DATA_PACKET_LEN)?;
        b.fill(0);
        for block in 0..BLOCKS {
            put(b, block * BLOCK_LEN, &FLAG_UPPER.to_le_bytes());
        }
        b[RETURN_MODE] = code_of_returns(mode);
        b[PRODUCT] = product.code();
        Ok(Self(bytes))
    }

    /// Sets the encoder angle of a block; whole turns are taken off.
    pub fn set_azimuth_centideg(&mut self, block: usize, value: u16) {
        put(
            self.0.as_mut(),
            block * BLOCK_LEN + 2,
            &(value % TURN_CENTIDEG).to_le_bytes(),
        );
    }

    /// Sets distance (in the model's unit) and reflectivity of a channel.
    pub fn set_return(
        &mut self,
        block: usize,
        channel: usize,
        distance_raw: u16,
        reflectivity: u8,
    ) {
        let offset = channel_offset(block, channel);
        let b = self.0.as_mut();
        put(b, offset, &distance_raw.to_le_bytes());
        b[offset + 2] = reflectivity;
    }

    /// Sets the microseconds since the top of the hour.
    pub fn set_timestamp_us(&mut self, value: u32) {
        put(self.0.as_mut(), TIMESTAMP, &value.to_le_bytes());
    }
}

impl<T> DataPacket<T> {
    /// Gives the bytes back.
    pub fn into_inner(self) -> T {
        self.0
    }
}

const fn channel_offset(block: usize, channel: usize) -> usize {
    block * BLOCK_LEN + 4 + 3 * channel
}

/// Whether the sensor's sub-second counter follows a pulse per second (VLP-16 63-9243 Rev. D § 9.3.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PpsStatus {
    /// No pulse.
    Absent,
    /// A pulse is seen but not trusted yet.
    Synchronizing,
    /// The counter follows the pulse.
    Locked,
    /// Pulse or sentence lost or inconsistent.
    Error,
    /// A value the manual does not know.
    Unknown(u8),
}

impl PpsStatus {
    /// The byte on the wire.
    pub const fn code(self) -> u8 {
        match self {
            Self::Absent => 0,
            Self::Synchronizing => 1,
            Self::Locked => 2,
            Self::Error => 3,
            Self::Unknown(code) => code,
        }
    }

    /// Never fails: what the manual does not know is kept.
    pub const fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Absent,
            1 => Self::Synchronizing,
            2 => Self::Locked,
            3 => Self::Error,
            code => Self::Unknown(code),
        }
    }
}

const TOP_TEMPERATURE: usize = 0xBB;
const BOTTOM_TEMPERATURE: usize = 0xBC;
const CALIBRATION_TEMPERATURE: usize = 0xBD;
const CALIBRATION_CHANGE: usize = 0xBE;
const CALIBRATION_AGE: usize = 0xC0;
const CALIBRATION_REASON: usize = 0xC4;
const CALIBRATION_FLAGS: usize = 0xC5;
const TOP_OF_HOUR: usize = 0xC6;
const PPS_STATUS: usize = 0xCA;
const THERMAL_STATUS: usize = 0xCB;
const SHUTDOWN_TEMPERATURE: usize = 0xCC;
const POWER_UP_TEMPERATURE: usize = 0xCD;
const NMEA: usize = 0xCE;
/// Longest NMEA sentence that fits a position packet, with its line end.
pub const NMEA_LEN: usize = 128;

/// A view of one position (telemetry) packet (VLP-16 63-9243 Rev. D § 9.3.2, VLP-32C 63-9325 p. 66).
///
/// Old firmware fills only the clock, the PPS status and the sentence.
#[derive(Clone, Debug)]
pub struct PositionPacket<T>(T);

impl<T: AsRef<[u8]>> PositionPacket<T> {
    /// Checks the length, so that no getter can panic.
    pub fn new(bytes: T) -> Result<Self, WireError> {
        check_length(bytes.as_ref(), POSITION_PACKET_LEN)?;
        Ok(Self(bytes))
    }

    /// Temperature of the top board, °C.
    pub fn top_temperature_celsius(&self) -> i8 {
        self.byte(TOP_TEMPERATURE) as i8
    }

    /// Temperature of the bottom board, °C.
    pub fn bottom_temperature_celsius(&self) -> i8 {
        self.byte(BOTTOM_TEMPERATURE) as i8
    }

    /// Temperature at the last calibration of the converters, °C.
    pub fn calibration_temperature_celsius(&self) -> i8 {
        self.byte(CALIBRATION_TEMPERATURE) as i8
    }

    /// Temperature change since the last calibration, °C.
    pub fn calibration_change_celsius(&self) -> i16 {
        u16_at(self.bytes(), CALIBRATION_CHANGE) as i16
    }

    /// Seconds since the last calibration.
    pub fn calibration_age_secs(&self) -> u32 {
        u32_at(self.bytes(), CALIBRATION_AGE)
    }

    /// Why the last calibration ran: 0 none, 1 power-on, 2 manual, 3 temperature, 4 periodic.
    pub fn calibration_reason(&self) -> u8 {
        self.byte(CALIBRATION_REASON)
    }

    /// Bit 0 calibration running, bit 1 temperature limit met, bit 2 period elapsed.
    pub fn calibration_flags(&self) -> u8 {
        self.byte(CALIBRATION_FLAGS)
    }

    /// Microseconds since the top of the hour, on the clock of the data packets.
    pub fn timestamp_us(&self) -> u32 {
        u32_at(self.bytes(), TOP_OF_HOUR)
    }

    /// State of the pulse-per-second input.
    pub fn pps_status(&self) -> PpsStatus {
        PpsStatus::from_code(self.byte(PPS_STATUS))
    }

    /// 0 normal, 1 shut down for heat.
    pub fn thermal_status(&self) -> u8 {
        self.byte(THERMAL_STATUS)
    }

    /// Temperature at the last thermal shutdown, °C.
    pub fn shutdown_temperature_celsius(&self) -> i8 {
        self.byte(SHUTDOWN_TEMPERATURE) as i8
    }

    /// Temperature at power-up, °C.
    pub fn power_up_temperature_celsius(&self) -> i8 {
        self.byte(POWER_UP_TEMPERATURE) as i8
    }

    /// The sentence as the sensor received it, without padding and line end; empty where there is none.
    ///
    /// It belongs to an earlier second than [`Self::timestamp_us`]: never add the two.
    pub fn nmea(&self) -> &[u8] {
        let field = &self.bytes()[NMEA..NMEA + NMEA_LEN];
        let end = field
            .iter()
            .position(|b| matches!(b, 0 | b'\r' | b'\n'))
            .unwrap_or(NMEA_LEN);
        &field[..end]
    }

    /// All bytes.
    pub fn bytes(&self) -> &[u8] {
        self.0.as_ref()
    }

    fn byte(&self, offset: usize) -> u8 {
        self.bytes()[offset]
    }
}

impl<T: AsRef<[u8]> + AsMut<[u8]>> PositionPacket<T> {
    /// Clears the bytes: no pulse, no sentence.
    pub fn init(mut bytes: T) -> Result<Self, WireError> {
        check_length(bytes.as_ref(), POSITION_PACKET_LEN)?;
        bytes.as_mut().fill(0);
        Ok(Self(bytes))
    }

    /// Sets the temperatures of the two boards and at power-up, °C.
    pub fn set_temperatures_celsius(&mut self, top: i8, bottom: i8, power_up: i8) {
        let b = self.0.as_mut();
        b[TOP_TEMPERATURE] = top as u8;
        b[BOTTOM_TEMPERATURE] = bottom as u8;
        b[POWER_UP_TEMPERATURE] = power_up as u8;
    }

    /// Sets what is said about the last calibration of the converters.
    pub fn set_calibration(&mut self, value: &Calibration) {
        let b = self.0.as_mut();
        b[CALIBRATION_TEMPERATURE] = value.temperature_celsius as u8;
        put(b, CALIBRATION_CHANGE, &value.change_celsius.to_le_bytes());
        put(b, CALIBRATION_AGE, &value.age_secs.to_le_bytes());
        b[CALIBRATION_REASON] = value.reason;
        b[CALIBRATION_FLAGS] = value.flags;
    }

    /// Sets the thermal status and the temperature of the last shutdown, °C.
    pub fn set_thermal(&mut self, status: u8, shutdown_celsius: i8) {
        let b = self.0.as_mut();
        b[THERMAL_STATUS] = status;
        b[SHUTDOWN_TEMPERATURE] = shutdown_celsius as u8;
    }

    /// Sets the microseconds since the top of the hour.
    pub fn set_timestamp_us(&mut self, value: u32) {
        put(self.0.as_mut(), TOP_OF_HOUR, &value.to_le_bytes());
    }

    /// Sets the state of the pulse-per-second input.
    pub fn set_pps_status(&mut self, value: PpsStatus) {
        self.0.as_mut()[PPS_STATUS] = value.code();
    }

    /// Sets the sentence, given without its line end, which is added.
    pub fn set_nmea(&mut self, sentence: &[u8]) -> Result<(), WireError> {
        if sentence.len() + 2 > NMEA_LEN {
            return Err(WireError::Length {
                expected: NMEA_LEN - 2,
                got: sentence.len(),
            });
        }
        let field = &mut self.0.as_mut()[NMEA..NMEA + NMEA_LEN];
        field.fill(0);
        field[..sentence.len()].copy_from_slice(sentence);
        field[sentence.len()..sentence.len() + 2].copy_from_slice(b"\r\n");
        Ok(())
    }

    /// Gives the bytes back.
    pub fn into_inner(self) -> T {
        self.0
    }
}

/// What a position packet says about the last calibration of the sensor's converters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Calibration {
    /// Temperature at that time, °C.
    pub temperature_celsius: i8,
    /// Temperature change since then, °C.
    pub change_celsius: i16,
    /// Seconds since then.
    pub age_secs: u32,
    /// 0 none, 1 power-on, 2 manual, 3 temperature, 4 periodic.
    pub reason: u8,
    /// Bit 0 running, bit 1 temperature limit met, bit 2 period elapsed.
    pub flags: u8,
}

fn check_length(bytes: &[u8], expected: usize) -> Result<(), WireError> {
    if bytes.len() == expected {
        Ok(())
    } else {
        Err(WireError::Length {
            expected,
            got: bytes.len(),
        })
    }
}

fn u16_at(bytes: &[u8], offset: usize) -> u16 {
    u16::from_le_bytes([bytes[offset], bytes[offset + 1]])
}

fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes([
        bytes[offset],
        bytes[offset + 1],
        bytes[offset + 2],
        bytes[offset + 3],
    ])
}

fn put(bytes: &mut [u8], offset: usize, value: &[u8]) {
    bytes[offset..offset + value.len()].copy_from_slice(value);
}

#[cfg(test)]
mod tests;
