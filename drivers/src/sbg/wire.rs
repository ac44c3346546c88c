//! The messages: CAN frames to plain structs and back. Numbers are little-endian.

use super::model::id;
use crate::WireError;
use crate::transport::can::CanFrame;

/// One message of the unit, in its own steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SbgMessage {
    /// 0x110: which GPS time a time of the unit is.
    UtcTime {
        /// Time of the unit, microseconds.
        time_us: u32,
        /// GPS time of week, milliseconds.
        time_of_week_ms: u32,
    },
    /// 0x111: the date and time of day that belong to the 0x110 before.
    UtcDate(UtcDate),
    /// 0x120: begins a sample.
    ImuInfo {
        /// Time of the unit, microseconds, wraps after 71.6 minutes.
        time_us: u32,
        /// Status bits of the inertial sensors.
        status: u16,
        /// Temperature, 0.01 °C.
        temperature: i16,
    },
    /// 0x121: specific force, 0.01 m/s².
    Accelerometer([i16; 3]),
    /// 0x122: angular velocity, 0.001 rad/s.
    Gyroscope([i16; 3]),
}

/// UTC as the unit sends it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UtcDate {
    /// Years since 2000.
    pub year: u8,
    /// Month, from 1.
    pub month: u8,
    /// Day, from 1.
    pub day: u8,
    /// Hour.
    pub hour: u8,
    /// Minute.
    pub minute: u8,
    /// Second, 60 in a leap second.
    pub second: u8,
    /// Fraction of the second, 100 µs.
    pub ten_thousandths: u16,
}

impl SbgMessage {
    /// Gives a frame its meaning; `None` for one that is not of an SBG unit, or not known to this version.
    pub fn parse(frame: &CanFrame) -> Result<Option<Self>, WireError> {
        let data = frame.data();
        Ok(Some(match frame.standard_id() {
            Some(id::UTC_TIME) => {
                let [t0, t1, t2, t3, w0, w1, w2, w3] = fixed(data)?;
                Self::UtcTime {
                    time_us: u32::from_le_bytes([t0, t1, t2, t3]),
                    time_of_week_ms: u32::from_le_bytes([w0, w1, w2, w3]),
                }
            }
            Some(id::UTC_DATE) => {
                let [year, month, day, hour, minute, second, f0, f1] = fixed(data)?;
                Self::UtcDate(UtcDate {
                    year,
                    month,
                    day,
                    hour,
                    minute,
                    second,
                    ten_thousandths: u16::from_le_bytes([f0, f1]),
                })
            }
            Some(id::IMU_INFO) => {
                let [t0, t1, t2, t3, s0, s1, c0, c1] = fixed(data)?;
                Self::ImuInfo {
                    time_us: u32::from_le_bytes([t0, t1, t2, t3]),
                    status: u16::from_le_bytes([s0, s1]),
                    temperature: i16::from_le_bytes([c0, c1]),
                }
            }
            Some(id::IMU_ACCELEROMETER) => Self::Accelerometer(vector(data)?),
            Some(id::IMU_GYROSCOPE) => Self::Gyroscope(vector(data)?),
            _ => return Ok(None),
        }))
    }

    /// The frame of the message.
    pub fn emit(&self) -> CanFrame {
        let mut data = Vec::with_capacity(8);
        let id = match self {
            Self::UtcTime {
                time_us,
                time_of_week_ms,
            } => {
                data.extend(time_us.to_le_bytes());
                data.extend(time_of_week_ms.to_le_bytes());
                id::UTC_TIME
            }
            Self::UtcDate(utc) => {
                data.extend([
                    utc.year, utc.month, utc.day, utc.hour, utc.minute, utc.second,
                ]);
                data.extend(utc.ten_thousandths.to_le_bytes());
                id::UTC_DATE
            }
            Self::ImuInfo {
                time_us,
                status,
                temperature,
            } => {
                data.extend(time_us.to_le_bytes());
                data.extend(status.to_le_bytes());
                data.extend(temperature.to_le_bytes());
                id::IMU_INFO
            }
            Self::Accelerometer(xyz) => {
                data.extend(xyz.iter().flat_map(|value| value.to_le_bytes()));
                id::IMU_ACCELEROMETER
            }
            Self::Gyroscope(xyz) => {
                data.extend(xyz.iter().flat_map(|value| value.to_le_bytes()));
                id::IMU_GYROSCOPE
            }
        };
        CanFrame::standard(id, &data)
    }
}

fn fixed<const N: usize>(data: &[u8]) -> Result<[u8; N], WireError> {
    data.try_into().map_err(|_| WireError::Length {
        expected: N,
        got: data.len(),
    })
}

fn vector(data: &[u8]) -> Result<[i16; 3], WireError> {
    let [x0, x1, y0, y1, z0, z1] = fixed(data)?;
    Ok([[x0, x1], [y0, y1], [z0, z1]].map(i16::from_le_bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_has_the_documented_bytes() {
        let utc = UtcDate {
            year: 26,
            month: 5,
            day: 17,
            hour: 12,
            minute: 34,
            second: 56,
            ten_thousandths: 5000,
        };
        for (message, id, data) in [
            (
                SbgMessage::UtcTime {
                    time_us: 123_456_789,
                    time_of_week_ms: 345_678_000,
                },
                0x110,
                &[0x15, 0xCD, 0x5B, 0x07, 0xB0, 0xA0, 0x9A, 0x14][..],
            ),
            (
                SbgMessage::UtcDate(utc),
                0x111,
                &[0x1A, 0x05, 0x11, 0x0C, 0x22, 0x38, 0x88, 0x13],
            ),
            (
                SbgMessage::ImuInfo {
                    time_us: 123_456_789,
                    status: 1023,
                    temperature: 2550,
                },
                0x120,
                &[0x15, 0xCD, 0x5B, 0x07, 0xFF, 0x03, 0xF6, 0x09],
            ),
            (
                SbgMessage::Accelerometer([50, -25, 981]),
                0x121,
                &[0x32, 0x00, 0xE7, 0xFF, 0xD5, 0x03],
            ),
            (
                SbgMessage::Gyroscope([125, -500, 1000]),
                0x122,
                &[0x7D, 0x00, 0x0C, 0xFE, 0xE8, 0x03],
            ),
        ] {
            let frame = message.emit();
            assert_eq!((frame.standard_id(), frame.data()), (Some(id), data));
            assert_eq!(SbgMessage::parse(&frame), Ok(Some(message)));
            let short = CanFrame::standard(id, &data[1..]);
            assert!(matches!(
                SbgMessage::parse(&short),
                Err(WireError::Length { .. })
            ));
        }
        let strange = CanFrame::standard(0x321, &[1]);
        assert_eq!(SbgMessage::parse(&strange), Ok(None));
    }

    #[test]
    fn a_frame_lies_in_memory_as_the_kernel_has_it() {
        let bytes = SbgMessage::Accelerometer([50, -25, 981]).emit().emit();
        let expected = [
            0x21, 0x01, 0, 0, 6, 0, 0, 0, 0x32, 0, 0xE7, 0xFF, 0xD5, 0x03, 0, 0,
        ];
        assert_eq!(bytes, expected);
    }
}
