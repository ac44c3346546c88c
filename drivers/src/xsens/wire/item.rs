//! MTData2 items: identifier (u16), length (u8), value.

use super::UtcTime;
use super::fixed::fixed;
use crate::WireError;
use crate::xsens::model::data_id;

/// How a real number is sent: the identifier's lowest two bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit float.
    #[default]
    F32,
    /// Fixed point, 12 bits before and 20 after the point.
    Fixed1220,
    /// Fixed point, 16 bits before and 32 after the point, the fraction sent first.
    Fixed1632,
    /// 64-bit float.
    F64,
}

/// The coding nibble of an identifier: number format and the frame that orientations refer to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coding {
    /// Number format.
    pub precision: Precision,
    /// Bits 2–3 as sent: 0 east-north-up, 4 north-east-down, 8 north-west-up.
    pub frame_bits: u8,
}

impl Coding {
    fn from_id(id: u16) -> Self {
        Self {
            precision: match id & 3 {
                0 => Precision::F32,
                1 => Precision::Fixed1220,
                2 => Precision::Fixed1632,
                _ => Precision::F64,
            },
            frame_bits: (id & 0xC) as u8,
        }
    }

    /// The nibble to be added to an identifier.
    pub fn nibble(self) -> u16 {
        let precision = match self.precision {
            Precision::F32 => 0,
            Precision::Fixed1220 => 1,
            Precision::Fixed1632 => 2,
            Precision::F64 => 3,
        };
        precision | u16::from(self.frame_bits & 0xC)
    }

    fn size(self) -> usize {
        match self.precision {
            Precision::F32 | Precision::Fixed1220 => 4,
            Precision::Fixed1632 => 6,
            Precision::F64 => 8,
        }
    }

    /// Reads `N` numbers that fill `value` exactly.
    fn read<const N: usize>(self, value: &[u8]) -> Result<[f64; N], WireError> {
        let size = self.size();
        if value.len() != N * size {
            return Err(WireError::Length {
                expected: N * size,
                got: value.len(),
            });
        }
        let mut numbers = [0.0; N];
        for (number, bytes) in numbers.iter_mut().zip(value.chunks_exact(size)) {
            *number = match (self.precision, bytes) {
                (Precision::F32, &[a, b, c, d]) => f32::from_be_bytes([a, b, c, d]).into(),
                (Precision::Fixed1220, &[a, b, c, d]) => {
                    f64::from(i32::from_be_bytes([a, b, c, d])) / f64::from(1 << 20)
                }
                (Precision::Fixed1632, &[a, b, c, d, e, f]) => {
                    f64::from(i16::from_be_bytes([e, f]))
                        + f64::from(u32::from_be_bytes([a, b, c, d])) / 4_294_967_296.0
                }
                (_, bytes) => f64::from_be_bytes(fixed(bytes)?),
            };
        }
        Ok(numbers)
    }

    /// Appends numbers; fixed point rounds to the nearest step and saturates.
    fn write(self, numbers: &[f64], out: &mut Vec<u8>) {
        for &number in numbers {
            match self.precision {
                Precision::F32 => out.extend((number as f32).to_be_bytes()),
                Precision::Fixed1220 => {
                    out.extend(((number * f64::from(1 << 20)).round() as i32).to_be_bytes());
                }
                Precision::Fixed1632 => {
                    let scaled = (number * 4_294_967_296.0).round() as i64;
                    let scaled = scaled.clamp(-(1 << 47), (1 << 47) - 1);
                    out.extend((scaled as u32).to_be_bytes());
                    out.extend(((scaled >> 32) as i16).to_be_bytes());
                }
                Precision::F64 => out.extend(number.to_be_bytes()),
            }
        }
    }
}

/// Three numbers and how they were, or shall be, sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vector {
    /// x, y, z.
    pub xyz: [f64; 3],
    /// Number format and frame.
    pub coding: Coding,
}

impl Vector {
    /// Sent as 32-bit floats.
    pub fn single(xyz: [f64; 3]) -> Self {
        Self {
            xyz,
            coding: Coding::default(),
        }
    }

    /// Sent as 64-bit floats.
    pub fn double(xyz: [f64; 3]) -> Self {
        let precision = Precision::F64;
        Self {
            xyz,
            coding: Coding {
                precision,
                frame_bits: 0,
            },
        }
    }
}

/// A pulse on a SyncIn line, stamped by the unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TriggerIn {
    /// Line number.
    pub line: u8,
    /// 1 rising, 2 falling edge.
    pub polarity: u8,
    /// `SampleTimeFine` at the pulse, 100 µs ticks.
    pub sample_time_fine: u32,
    /// Counter of pulses.
    pub frame_number: u16,
}

impl TriggerIn {
    fn parse(value: &[u8]) -> Result<Self, WireError> {
        let [line, polarity, t0, t1, t2, t3, f0, f1] = fixed(value)?;
        Ok(Self {
            line,
            polarity,
            sample_time_fine: u32::from_be_bytes([t0, t1, t2, t3]),
            frame_number: u16::from_be_bytes([f0, f1]),
        })
    }

    fn emit(&self, out: &mut Vec<u8>) {
        out.extend([self.line, self.polarity]);
        out.extend(self.sample_time_fine.to_be_bytes());
        out.extend(self.frame_number.to_be_bytes());
    }
}

/// One item of an MTData2 packet.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Item<'a> {
    /// Temperature, °C.
    Temperature {
        /// °C.
        celsius: f64,
        /// Number format.
        coding: Coding,
    },
    /// Date and time.
    Utc(UtcTime),
    /// Counter of packets.
    PacketCounter(u16),
    /// Sample time, 100 µs ticks.
    SampleTimeFine(u32),
    /// Sample time, seconds.
    SampleTimeCoarse(u32),
    /// Orientation.
    Quaternion {
        /// w, x, y, z.
        wxyz: [f64; 4],
        /// Number format and frame.
        coding: Coding,
    },
    /// Roll, pitch, yaw in degrees.
    EulerAnglesDeg(Vector),
    /// Pressure, Pa.
    PressurePa(u32),
    /// Velocity increment, m/s.
    DeltaV(Vector),
    /// Specific force, m/s².
    Acceleration(Vector),
    /// Specific force at the sensor's own rate, m/s².
    AccelerationHr(Vector),
    /// Pulse on SyncIn line 1.
    TriggerIn1(TriggerIn),
    /// Pulse on SyncIn line 2.
    TriggerIn2(TriggerIn),
    /// Angular velocity, rad/s.
    RateOfTurn(Vector),
    /// Angular velocity at the sensor's own rate, rad/s.
    RateOfTurnHr(Vector),
    /// Magnetic field, 1 at the local norm.
    MagneticField(Vector),
    /// Low byte of the status.
    StatusByte(u8),
    /// Status.
    StatusWord(u32),
    /// An identifier that this version does not know.
    Other {
        /// The identifier.
        id: u16,
        /// Its value.
        value: &'a [u8],
    },
}

impl<'a> Item<'a> {
    fn parse(id: u16, value: &'a [u8]) -> Result<Self, WireError> {
        let coding = Coding::from_id(id);
        let vector = || {
            Ok::<_, WireError>(Vector {
                xyz: coding.read(value)?,
                coding,
            })
        };
        let u32_value = || Ok::<_, WireError>(u32::from_be_bytes(fixed(value)?));
        Ok(match id & 0xFFF0 {
            data_id::TEMPERATURE => {
                let [celsius] = coding.read(value)?;
                Self::Temperature { celsius, coding }
            }
            data_id::QUATERNION => Self::Quaternion {
                wxyz: coding.read(value)?,
                coding,
            },
            data_id::EULER_ANGLES => Self::EulerAnglesDeg(vector()?),
            data_id::DELTA_V => Self::DeltaV(vector()?),
            data_id::ACCELERATION => Self::Acceleration(vector()?),
            data_id::ACCELERATION_HR => Self::AccelerationHr(vector()?),
            data_id::RATE_OF_TURN => Self::RateOfTurn(vector()?),
            data_id::RATE_OF_TURN_HR => Self::RateOfTurnHr(vector()?),
            data_id::MAGNETIC_FIELD => Self::MagneticField(vector()?),
            // Integers have no coding: with another nibble they are not these.
            _ => match id {
                data_id::UTC_TIME => Self::Utc(UtcTime::parse(value)?),
                data_id::PACKET_COUNTER => Self::PacketCounter(u16::from_be_bytes(fixed(value)?)),
                data_id::SAMPLE_TIME_FINE => Self::SampleTimeFine(u32_value()?),
                data_id::SAMPLE_TIME_COARSE => Self::SampleTimeCoarse(u32_value()?),
                data_id::PRESSURE => Self::PressurePa(u32_value()?),
                data_id::TRIGGER_IN1 => Self::TriggerIn1(TriggerIn::parse(value)?),
                data_id::TRIGGER_IN2 => Self::TriggerIn2(TriggerIn::parse(value)?),
                data_id::STATUS_BYTE => Self::StatusByte(u8::from_be_bytes(fixed(value)?)),
                data_id::STATUS_WORD => Self::StatusWord(u32_value()?),
                _ => Self::Other { id, value },
            },
        })
    }

    /// Appends the item. Only an [`Item::Other`] longer than 255 bytes can fail.
    pub fn emit(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let start = out.len();
        out.extend([0; 3]);
        let id = match self {
            Self::Temperature { celsius, coding } => {
                coding.write(&[*celsius], out);
                data_id::TEMPERATURE | coding.nibble()
            }
            Self::Quaternion { wxyz, coding } => {
                coding.write(wxyz, out);
                data_id::QUATERNION | coding.nibble()
            }
            Self::EulerAnglesDeg(vector) => emit_vector(data_id::EULER_ANGLES, vector, out),
            Self::DeltaV(vector) => emit_vector(data_id::DELTA_V, vector, out),
            Self::Acceleration(vector) => emit_vector(data_id::ACCELERATION, vector, out),
            Self::AccelerationHr(vector) => emit_vector(data_id::ACCELERATION_HR, vector, out),
            Self::RateOfTurn(vector) => emit_vector(data_id::RATE_OF_TURN, vector, out),
            Self::RateOfTurnHr(vector) => emit_vector(data_id::RATE_OF_TURN_HR, vector, out),
            Self::MagneticField(vector) => emit_vector(data_id::MAGNETIC_FIELD, vector, out),
            Self::Utc(time) => {
                time.emit(out);
                data_id::UTC_TIME
            }
            Self::PacketCounter(counter) => {
                out.extend(counter.to_be_bytes());
                data_id::PACKET_COUNTER
            }
            Self::SampleTimeFine(ticks) => emit_u32(data_id::SAMPLE_TIME_FINE, *ticks, out),
            Self::SampleTimeCoarse(secs) => emit_u32(data_id::SAMPLE_TIME_COARSE, *secs, out),
            Self::PressurePa(pascal) => emit_u32(data_id::PRESSURE, *pascal, out),
            Self::TriggerIn1(trigger) => {
                trigger.emit(out);
                data_id::TRIGGER_IN1
            }
            Self::TriggerIn2(trigger) => {
                trigger.emit(out);
                data_id::TRIGGER_IN2
            }
            Self::StatusByte(status) => {
                out.push(*status);
                data_id::STATUS_BYTE
            }
            Self::StatusWord(status) => emit_u32(data_id::STATUS_WORD, *status, out),
            Self::Other { id, value } => {
                out.extend(*value);
                *id
            }
        };
        let len = out.len() - start - 3;
        let Ok(short_len) = u8::try_from(len) else {
            out.truncate(start);
            return Err(WireError::Length {
                expected: 255,
                got: len,
            });
        };
        out[start..start + 2].copy_from_slice(&id.to_be_bytes());
        out[start + 2] = short_len;
        Ok(())
    }
}

fn emit_vector(id: u16, vector: &Vector, out: &mut Vec<u8>) -> u16 {
    vector.coding.write(&vector.xyz, out);
    id | vector.coding.nibble()
}

fn emit_u32(id: u16, value: u32, out: &mut Vec<u8>) -> u16 {
    out.extend(value.to_be_bytes());
    id
}

/// The items of an MTData2 packet, in order. After an error there is no next item.
#[derive(Clone, Debug)]
pub struct Items<'a> {
    rest: &'a [u8],
}

impl<'a> Items<'a> {
    /// Of a message's data.
    pub fn new(data: &'a [u8]) -> Self {
        Self { rest: data }
    }
}

impl<'a> Iterator for Items<'a> {
    type Item = Result<Item<'a>, WireError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let rest = std::mem::take(&mut self.rest);
        let &[id_high, id_low, len, ref after @ ..] = rest else {
            return Some(Err(WireError::Length {
                expected: 3,
                got: rest.len(),
            }));
        };
        let Some((value, after)) = after.split_at_checked(len.into()) else {
            return Some(Err(WireError::Length {
                expected: 3 + usize::from(len),
                got: rest.len(),
            }));
        };
        let item = Item::parse(u16::from_be_bytes([id_high, id_low]), value);
        if item.is_ok() {
            self.rest = after;
        }
        Some(item)
    }
}
