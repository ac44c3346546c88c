//! Reports and their items: bytes to plain structs and back. Numbers are little-endian.

use super::model::{REPORT_LEN, item};
use crate::WireError;

/// Serial number and length.
const HEADER_LEN: usize = 3;
/// The last byte is the checksum.
const MAX_ITEMS_LEN: usize = REPORT_LEN - HEADER_LEN - 1;

/// One report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report<'a> {
    /// Counter of reports, wraps at 65 536.
    pub serial: u16,
    /// Its items as bytes, see [`Report::items`].
    pub payload: &'a [u8],
}

impl<'a> Report<'a> {
    /// Reads the 64 bytes, checking length and checksum.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, WireError> {
        let bytes: &[u8; REPORT_LEN] = bytes.try_into().map_err(|_| WireError::Length {
            expected: REPORT_LEN,
            got: bytes.len(),
        })?;
        let &[s0, s1, len, ref body @ .., got] = bytes;
        let expected = body.iter().fold(0, |sum, byte| sum ^ byte);
        if got != expected {
            return Err(WireError::Checksum {
                expected: u32::from(expected),
                got: got.into(),
            });
        }
        let payload = body.get(..len.into()).ok_or(WireError::Value {
            field: "length",
            offset: 2,
            got: len.into(),
        })?;
        Ok(Self {
            serial: u16::from_le_bytes([s0, s1]),
            payload,
        })
    }

    /// The 64 bytes of a report with these items. More than fit is an error.
    pub fn emit(serial: u16, items: &[Item<'_>]) -> Result<[u8; REPORT_LEN], WireError> {
        let mut payload = Vec::new();
        for item in items {
            item.emit(&mut payload)?;
        }
        let mut bytes = [0; REPORT_LEN];
        let too_long = WireError::Length {
            expected: MAX_ITEMS_LEN,
            got: payload.len(),
        };
        let body = bytes.get_mut(HEADER_LEN..HEADER_LEN + payload.len().min(MAX_ITEMS_LEN));
        match body {
            Some(body) if body.len() == payload.len() => body.copy_from_slice(&payload),
            _ => return Err(too_long),
        }
        bytes[..2].copy_from_slice(&serial.to_le_bytes());
        bytes[2] = payload.len() as u8;
        bytes[REPORT_LEN - 1] = payload.iter().fold(0, |sum, byte| sum ^ byte);
        Ok(bytes)
    }

    /// Its items, in order.
    pub fn items(&self) -> Items<'a> {
        Items { rest: self.payload }
    }
}

/// A reading of one sensor, in the unit's steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawReading {
    /// The unit's stamp; the vendor does not say what it counts.
    pub ticks: u32,
    /// x, y, z.
    pub xyz: [i16; 3],
    /// Temperature.
    pub temperature: u16,
}

/// One item of a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Item<'a> {
    /// Accelerometer.
    Accelerometer(RawReading),
    /// Gyroscope.
    Gyroscope(RawReading),
    /// The camera took a frame.
    Frame {
        /// The unit's stamp.
        ticks: u32,
        /// Counter of frames.
        frame_id: u16,
        /// Exposure, in steps of the unit.
        exposure: u16,
    },
    /// An item that this version does not know: distance, GPS, temperature and others.
    Other {
        /// Its number.
        id: u8,
        /// Its data.
        data: &'a [u8],
    },
}

impl<'a> Item<'a> {
    fn parse(id: u8, data: &'a [u8]) -> Result<Self, WireError> {
        let reading = || {
            let [t0, t1, t2, t3, x0, x1, y0, y1, z0, z1, c0, c1] = fixed(data)?;
            Ok::<_, WireError>(RawReading {
                ticks: u32::from_le_bytes([t0, t1, t2, t3]),
                xyz: [[x0, x1], [y0, y1], [z0, z1]].map(i16::from_le_bytes),
                temperature: u16::from_le_bytes([c0, c1]),
            })
        };
        Ok(match id {
            item::ACCELEROMETER => Self::Accelerometer(reading()?),
            item::GYROSCOPE => Self::Gyroscope(reading()?),
            item::FRAME => {
                let [t0, t1, t2, t3, f0, f1, e0, e1] = fixed(data)?;
                Self::Frame {
                    ticks: u32::from_le_bytes([t0, t1, t2, t3]),
                    frame_id: u16::from_le_bytes([f0, f1]),
                    exposure: u16::from_le_bytes([e0, e1]),
                }
            }
            _ => Self::Other { id, data },
        })
    }

    fn emit(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let mut data = Vec::new();
        let id = match self {
            Self::Accelerometer(reading) => {
                emit_reading(reading, &mut data);
                item::ACCELEROMETER
            }
            Self::Gyroscope(reading) => {
                emit_reading(reading, &mut data);
                item::GYROSCOPE
            }
            Self::Frame {
                ticks,
                frame_id,
                exposure,
            } => {
                data.extend(ticks.to_le_bytes());
                data.extend(frame_id.to_le_bytes());
                data.extend(exposure.to_le_bytes());
                item::FRAME
            }
            Self::Other { id, data: given } => {
                data.extend(*given);
                *id
            }
        };
        let len = u8::try_from(data.len()).map_err(|_| WireError::Length {
            expected: 255,
            got: data.len(),
        })?;
        out.extend([id, len]);
        out.extend(data);
        Ok(())
    }
}

fn emit_reading(reading: &RawReading, out: &mut Vec<u8>) {
    out.extend(reading.ticks.to_le_bytes());
    out.extend(reading.xyz.iter().flat_map(|value| value.to_le_bytes()));
    out.extend(reading.temperature.to_le_bytes());
}

fn fixed<const N: usize>(data: &[u8]) -> Result<[u8; N], WireError> {
    data.try_into().map_err(|_| WireError::Length {
        expected: N,
        got: data.len(),
    })
}

/// The items of a report, in order. After an error there is no next one.
#[derive(Clone, Debug)]
pub struct Items<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for Items<'a> {
    type Item = Result<Item<'a>, WireError>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = std::mem::take(&mut self.rest);
        let &[id, len, ref after @ ..] = rest else {
            return (!rest.is_empty()).then_some(Err(WireError::Length {
                expected: 2,
                got: rest.len(),
            }));
        };
        let Some((data, after)) = after.split_at_checked(len.into()) else {
            return Some(Err(WireError::Length {
                expected: len.into(),
                got: after.len(),
            }));
        };
        let item = Item::parse(id, data);
        if item.is_ok() {
            self.rest = after;
        }
        Some(item)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `protocols/mynt.md`, section 10, computed from the vendor's layout.
    const REPORT: [u8; 38] = [
        5, 0, 0x18, 0x00, 0x0C, 0x5F, 0x69, 0x05, 0x01, 0, 0, 0, 0, 0x55, 0x15, 0x40, 0x00, 0x02,
        0x08, 0x11, 0x6B, 0x05, 0x01, 0x34, 0x12, 0xF0, 0x00, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x9C,
    ];

    fn report() -> [u8; REPORT_LEN] {
        let mut bytes = [0; REPORT_LEN];
        bytes[..37].copy_from_slice(&REPORT[..37]);
        bytes[63] = REPORT[37];
        bytes
    }

    #[test]
    fn a_report_with_a_reading_and_a_frame() {
        let bytes = report();
        let parsed = Report::parse(&bytes).unwrap();
        let items: Vec<_> = parsed.items().map(Result::unwrap).collect();
        let expected = [
            Item::Accelerometer(RawReading {
                ticks: 0x0105_695F,
                xyz: [0, 0, 0x1555],
                temperature: 0x40,
            }),
            Item::Frame {
                ticks: 0x0105_6B11,
                frame_id: 0x1234,
                exposure: 240,
            },
        ];
        assert_eq!((parsed.serial, &items[..]), (5, &expected[..]));
        assert_eq!(Report::emit(5, &items), Ok(bytes));
    }

    #[test]
    fn damage_is_named() {
        let good = report();
        assert!(Report::parse(&good[..63]).is_err());
        for at in 3..64 {
            let mut bad = good;
            bad[at] ^= 1;
            assert!(matches!(
                Report::parse(&bad),
                Err(WireError::Checksum { .. })
            ));
        }
        let mut long = good;
        long[2] = 61;
        assert!(matches!(Report::parse(&long), Err(WireError::Value { .. })));
        let mut cut = good;
        cut[2] = 23;
        let items = Report::parse(&cut).unwrap().items();
        assert!(items.last().unwrap().is_err());
        let big = Item::Other {
            id: 9,
            data: &[0; 59],
        };
        assert!(Report::emit(0, &[big]).is_err());
        let all = Item::Other {
            id: 9,
            data: &[0; 58],
        };
        assert!(Report::emit(0, &[all]).is_ok());
    }
}
