//! The unit's own IMU: polled through selectors 3 (request) and 4 (answer).

use super::{TimeSource, Version};
use crate::WireError;
use crate::mynt_s::model::{IMU_REQUEST_HEADER, IMU_RESPONSE_HEADER};
use crate::transport::uvc::LARGE_TRANSFER_BYTES;

/// First spec version whose IMU sends floats.
const FIRST_FLOAT_SPEC: Version = Version { major: 1, minor: 3 };
/// Bytes before the payload: header, state, length.
const ENVELOPE_BYTES: usize = 4;

/// Which layout the segments have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuProtocol {
    /// Protocol 1: raw 16-bit values, firmware with spec version below 1.3.
    Integer,
    /// Protocol 2: floats, one sensor per segment, spec 1.3 and later.
    Float,
    /// Protocol 2 with both sensors in each segment.
    FloatPaired,
}

impl ImuProtocol {
    /// What units of that spec version speak, unless asked for paired segments.
    pub fn of_spec(spec: Version) -> Self {
        if spec < FIRST_FLOAT_SPEC {
            Self::Integer
        } else {
            Self::Float
        }
    }

    fn segment_bytes(self) -> usize {
        match self {
            Self::Integer => 21,
            Self::Float => 29,
            Self::FloatPaired => 41,
        }
    }
}

/// What the host writes before it reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuRequest {
    /// Protocol 1: everything after this segment counter.
    After(u32),
    /// Protocol 2: everything new, one sensor per segment.
    Single,
    /// Protocol 2: everything new, both sensors in each segment.
    Paired,
}

impl ImuRequest {
    /// The five bytes.
    pub fn emit(self) -> [u8; 5] {
        let [a, b, c, d] = match self {
            Self::After(serial) => serial.to_be_bytes(),
            Self::Single => [0; 4],
            Self::Paired => [1, 0, 0, 0],
        };
        [IMU_REQUEST_HEADER, a, b, c, d]
    }

    /// Layout of the segments it asks for.
    pub fn protocol(self) -> ImuProtocol {
        match self {
            Self::After(_) => ImuProtocol::Integer,
            Self::Single => ImuProtocol::Float,
            Self::Paired => ImuProtocol::FloatPaired,
        }
    }

    /// Reads the five bytes of a host that speaks `protocol`.
    pub fn parse(protocol: ImuProtocol, bytes: &[u8]) -> Result<Self, WireError> {
        let &[header, a, b, c, d] = bytes else {
            return Err(WireError::Length {
                expected: 5,
                got: bytes.len(),
            });
        };
        if header != IMU_REQUEST_HEADER {
            return Err(WireError::Constant {
                offset: 0,
                expected: IMU_REQUEST_HEADER.into(),
                got: header.into(),
            });
        }
        match (protocol, a) {
            (ImuProtocol::Integer, _) => Ok(Self::After(u32::from_be_bytes([a, b, c, d]))),
            (_, 0) => Ok(Self::Single),
            (_, 1) => Ok(Self::Paired),
            (_, got) => Err(WireError::Value {
                field: "correspondence flag",
                offset: 1,
                got: got.into(),
            }),
        }
    }
}

/// What a segment holds, in the unit's own scale and axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ImuValues {
    /// Raw accelerometer values; the span option covers 65 536 steps.
    RawAccelerometer([i16; 3]),
    /// Raw gyroscope values; the span option covers 65 536 steps.
    RawGyroscope([i16; 3]),
    /// Specific force, g.
    AccelerometerG([f32; 3]),
    /// Angular velocity, °/s.
    GyroscopeDegS([f32; 3]),
    /// Both at one instant.
    Paired {
        /// Angular velocity, °/s.
        gyroscope_deg_s: [f32; 3],
        /// Specific force, g.
        accelerometer_g: [f32; 3],
    },
}

/// One sample of the unit's IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSegment {
    /// Counter of segments.
    pub serial: u32,
    /// Stamp, microseconds.
    pub timestamp_us: u64,
    /// Whose clock the stamp is of.
    pub time_source: TimeSource,
    /// Temperature: °C with protocol 2, the raw value with protocol 1.
    pub temperature: f32,
    /// The measurement.
    pub values: ImuValues,
}

const FLAG_ACCELEROMETER: u8 = 1;
const FLAG_GYROSCOPE: u8 = 2;
const FLAG_SENSORS: u8 = 3;
const FLAG_EXTERNAL_TIME: u8 = 4;

impl ImuSegment {
    /// Which layout its values need.
    pub fn protocol(&self) -> ImuProtocol {
        match self.values {
            ImuValues::RawAccelerometer(_) | ImuValues::RawGyroscope(_) => ImuProtocol::Integer,
            ImuValues::AccelerometerG(_) | ImuValues::GyroscopeDegS(_) => ImuProtocol::Float,
            ImuValues::Paired { .. } => ImuProtocol::FloatPaired,
        }
    }

    fn parse(protocol: ImuProtocol, bytes: &[u8], offset: usize) -> Result<Self, WireError> {
        let length_error = WireError::Length {
            expected: protocol.segment_bytes(),
            got: bytes.len(),
        };
        let (head, values) = bytes.split_first_chunk::<13>().ok_or(length_error)?;
        let &[s0, s1, s2, s3, t0, t1, t2, t3, t4, t5, t6, t7, flag] = head;
        let sensors = flag & FLAG_SENSORS;
        let bad_flag = WireError::Value {
            field: "sensor flag",
            offset: offset + 12,
            got: flag.into(),
        };
        let (temperature, values) = match protocol {
            ImuProtocol::Integer => {
                let [raw_temperature, x, y, z] = integers(values).ok_or(length_error)?;
                let values = match sensors {
                    FLAG_ACCELEROMETER => ImuValues::RawAccelerometer([x, y, z]),
                    FLAG_GYROSCOPE => ImuValues::RawGyroscope([x, y, z]),
                    _ => return Err(bad_flag),
                };
                (f32::from(raw_temperature), values)
            }
            ImuProtocol::Float => {
                let [temperature, x, y, z] = floats(values).ok_or(length_error)?;
                let values = match sensors {
                    FLAG_ACCELEROMETER => ImuValues::AccelerometerG([x, y, z]),
                    FLAG_GYROSCOPE => ImuValues::GyroscopeDegS([x, y, z]),
                    _ => return Err(bad_flag),
                };
                (temperature, values)
            }
            ImuProtocol::FloatPaired => {
                let [temperature, gx, gy, gz, ax, ay, az] = floats(values).ok_or(length_error)?;
                if sensors != 0 && sensors != FLAG_SENSORS {
                    return Err(bad_flag);
                }
                let values = ImuValues::Paired {
                    gyroscope_deg_s: [gx, gy, gz],
                    accelerometer_g: [ax, ay, az],
                };
                (temperature, values)
            }
        };
        Ok(Self {
            serial: u32::from_be_bytes([s0, s1, s2, s3]),
            timestamp_us: u64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            time_source: if flag & FLAG_EXTERNAL_TIME == 0 {
                TimeSource::Device
            } else {
                TimeSource::External
            },
            temperature,
            values,
        })
    }

    fn emit(&self, out: &mut Vec<u8>) {
        out.extend(self.serial.to_be_bytes());
        out.extend(self.timestamp_us.to_be_bytes());
        let sensors = match self.values {
            ImuValues::RawAccelerometer(_) | ImuValues::AccelerometerG(_) => FLAG_ACCELEROMETER,
            ImuValues::RawGyroscope(_) | ImuValues::GyroscopeDegS(_) => FLAG_GYROSCOPE,
            ImuValues::Paired { .. } => FLAG_SENSORS,
        };
        out.push(match self.time_source {
            TimeSource::Device => sensors,
            TimeSource::External => sensors | FLAG_EXTERNAL_TIME,
        });
        match self.values {
            ImuValues::RawAccelerometer(xyz) | ImuValues::RawGyroscope(xyz) => {
                out.extend((self.temperature as i16).to_be_bytes());
                out.extend(xyz.iter().flat_map(|value| value.to_be_bytes()));
            }
            ImuValues::AccelerometerG(xyz) | ImuValues::GyroscopeDegS(xyz) => {
                out.extend(self.temperature.to_le_bytes());
                out.extend(xyz.iter().flat_map(|value| value.to_le_bytes()));
            }
            ImuValues::Paired {
                gyroscope_deg_s,
                accelerometer_g,
            } => {
                out.extend(self.temperature.to_le_bytes());
                let values = gyroscope_deg_s.iter().chain(&accelerometer_g);
                out.extend(values.flat_map(|value| value.to_le_bytes()));
            }
        }
    }
}

fn integers<const N: usize>(bytes: &[u8]) -> Option<[i16; N]> {
    let (chunks, rest) = bytes.as_chunks::<2>();
    let chunks: &[[u8; 2]; N] = chunks.try_into().ok()?;
    rest.is_empty().then(|| chunks.map(i16::from_be_bytes))
}

fn floats<const N: usize>(bytes: &[u8]) -> Option<[f32; N]> {
    let (chunks, rest) = bytes.as_chunks::<4>();
    let chunks: &[[u8; 4]; N] = chunks.try_into().ok()?;
    rest.is_empty().then(|| chunks.map(f32::from_le_bytes))
}

/// An answer: the segments since the last one. None at all is a valid answer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuResponse {
    /// The segments, in order.
    pub segments: Vec<ImuSegment>,
}

impl ImuResponse {
    /// Segments of `protocol` that fit into one answer.
    pub fn capacity(protocol: ImuProtocol) -> usize {
        (LARGE_TRANSFER_BYTES - ENVELOPE_BYTES - 1) / protocol.segment_bytes()
    }

    /// Reads an answer, checking its state and checksum. Bytes behind the checksum mean nothing.
    pub fn parse(protocol: ImuProtocol, bytes: &[u8]) -> Result<Self, WireError> {
        let Some((&[header, state, high, low], rest)) = bytes.split_first_chunk() else {
            return Err(WireError::Length {
                expected: ENVELOPE_BYTES + 1,
                got: bytes.len(),
            });
        };
        if header != IMU_RESPONSE_HEADER {
            return Err(WireError::Constant {
                offset: 0,
                expected: IMU_RESPONSE_HEADER.into(),
                got: header.into(),
            });
        }
        if state != 0 {
            return Err(WireError::Value {
                field: "state",
                offset: 1,
                got: state.into(),
            });
        }
        let len = usize::from(u16::from_be_bytes([high, low]));
        let (Some(payload), Some(&got)) = (rest.get(..len), rest.get(len)) else {
            return Err(WireError::Length {
                expected: ENVELOPE_BYTES + len + 1,
                got: bytes.len(),
            });
        };
        let expected = payload.iter().fold(0, |sum, byte| sum ^ byte);
        if got != expected {
            return Err(WireError::Checksum {
                expected: expected.into(),
                got: got.into(),
            });
        }
        let segment_bytes = protocol.segment_bytes();
        if !len.is_multiple_of(segment_bytes) {
            return Err(WireError::Length {
                expected: len - len % segment_bytes,
                got: len,
            });
        }
        let segments = payload
            .chunks_exact(segment_bytes)
            .enumerate()
            .map(|(i, segment)| {
                ImuSegment::parse(protocol, segment, ENVELOPE_BYTES + i * segment_bytes)
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { segments })
    }

    /// The answer's bytes, without the don't-care bytes up to 2000. All segments must be of one layout and fit.
    pub fn emit(&self, protocol: ImuProtocol) -> Result<Vec<u8>, WireError> {
        if self.segments.len() > Self::capacity(protocol) {
            return Err(WireError::Length {
                expected: Self::capacity(protocol) * protocol.segment_bytes(),
                got: self.segments.len() * protocol.segment_bytes(),
            });
        }
        let len = self.segments.len() * protocol.segment_bytes();
        let mut out = vec![IMU_RESPONSE_HEADER, 0];
        out.extend((len as u16).to_be_bytes());
        for segment in &self.segments {
            if segment.protocol() != protocol {
                return Err(WireError::Length {
                    expected: protocol.segment_bytes(),
                    got: segment.protocol().segment_bytes(),
                });
            }
            segment.emit(&mut out);
        }
        let checksum = out
            .iter()
            .skip(ENVELOPE_BYTES)
            .fold(0, |sum, byte| sum ^ byte);
        out.push(checksum);
        Ok(out)
    }
}
