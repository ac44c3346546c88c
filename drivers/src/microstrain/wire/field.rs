//! Fields of data packets.

use super::{RawField, fixed};
use crate::WireError;
use crate::microstrain::model::{field, set};

/// GPS time of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GpsTime {
    /// Seconds of the week.
    pub time_of_week_secs: f64,
    /// Weeks since 1980-01-06.
    pub week: u16,
    /// Which of the two can be trusted; the meaning of the bits is the unit's.
    pub flags: u16,
}

impl GpsTime {
    fn parse(data: &[u8]) -> Result<Self, WireError> {
        let bytes: [u8; 12] = fixed(data)?;
        let [t0, t1, t2, t3, t4, t5, t6, t7, w0, w1, f0, f1] = bytes;
        Ok(Self {
            time_of_week_secs: f64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            week: u16::from_be_bytes([w0, w1]),
            flags: u16::from_be_bytes([f0, f1]),
        })
    }

    fn emit(&self, out: &mut Vec<u8>) {
        out.extend(self.time_of_week_secs.to_be_bytes());
        out.extend(self.week.to_be_bytes());
        out.extend(self.flags.to_be_bytes());
    }
}

/// A field of a data packet.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Field<'a> {
    /// Specific force, g.
    AccelerometerG([f32; 3]),
    /// Angular velocity, rad/s.
    GyroscopeRadS([f32; 3]),
    /// Magnetic field, Gauss.
    MagnetometerGauss([f32; 3]),
    /// Rotation since the last sample, rad.
    DeltaThetaRad([f32; 3]),
    /// Velocity since the last sample, g s.
    DeltaVelocityGS([f32; 3]),
    /// Air pressure, mbar.
    PressureMbar(f32),
    /// GPS time, as older units send it.
    GpsTimestamp(GpsTime),
    /// Counter of the unit.
    Ticks(u32),
    /// GPS time.
    GpsTime(GpsTime),
    /// Time since power-up, nanoseconds.
    ReferenceTimeNs(u64),
    /// Reference time since the packet before, nanoseconds.
    ReferenceDeltaNs(u64),
    /// Time fed in from outside.
    ExternalTime {
        /// Nanoseconds.
        time_ns: u64,
        /// Whether it can be trusted; the meaning of the bits is the unit's.
        valid: u16,
    },
    /// A field that this version does not know.
    Other(RawField<'a>),
}

impl<'a> Field<'a> {
    /// Gives a field of `descriptor_set` its meaning.
    pub fn parse(descriptor_set: u8, raw: RawField<'a>) -> Result<Self, WireError> {
        let RawField { descriptor, data } = raw;
        let known = descriptor_set == set::SENSOR
            || (descriptor_set > set::SENSOR && descriptor >= field::SHARED);
        if !known {
            return Ok(Self::Other(raw));
        }
        Ok(match descriptor {
            field::ACCELEROMETER => Self::AccelerometerG(vector(data)?),
            field::GYROSCOPE => Self::GyroscopeRadS(vector(data)?),
            field::MAGNETOMETER => Self::MagnetometerGauss(vector(data)?),
            field::DELTA_THETA => Self::DeltaThetaRad(vector(data)?),
            field::DELTA_VELOCITY => Self::DeltaVelocityGS(vector(data)?),
            field::PRESSURE => Self::PressureMbar(f32::from_be_bytes(fixed(data)?)),
            field::GPS_TIMESTAMP => Self::GpsTimestamp(GpsTime::parse(data)?),
            field::TICKS => Self::Ticks(u32::from_be_bytes(fixed(data)?)),
            field::GPS_TIME => Self::GpsTime(GpsTime::parse(data)?),
            field::REFERENCE_TIME => Self::ReferenceTimeNs(u64::from_be_bytes(fixed(data)?)),
            field::REFERENCE_DELTA => Self::ReferenceDeltaNs(u64::from_be_bytes(fixed(data)?)),
            field::EXTERNAL_TIME => {
                let [t0, t1, t2, t3, t4, t5, t6, t7, v0, v1] = fixed(data)?;
                Self::ExternalTime {
                    time_ns: u64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
                    valid: u16::from_be_bytes([v0, v1]),
                }
            }
            _ => Self::Other(raw),
        })
    }

    /// Appends the field. Only an [`Field::Other`] beyond 253 bytes can fail.
    pub fn emit(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let mut data = Vec::new();
        let descriptor = match self {
            Self::AccelerometerG(xyz) => emit_vector(field::ACCELEROMETER, xyz, &mut data),
            Self::GyroscopeRadS(xyz) => emit_vector(field::GYROSCOPE, xyz, &mut data),
            Self::MagnetometerGauss(xyz) => emit_vector(field::MAGNETOMETER, xyz, &mut data),
            Self::DeltaThetaRad(xyz) => emit_vector(field::DELTA_THETA, xyz, &mut data),
            Self::DeltaVelocityGS(xyz) => emit_vector(field::DELTA_VELOCITY, xyz, &mut data),
            Self::PressureMbar(pressure) => {
                data.extend(pressure.to_be_bytes());
                field::PRESSURE
            }
            Self::GpsTimestamp(time) => {
                time.emit(&mut data);
                field::GPS_TIMESTAMP
            }
            Self::Ticks(ticks) => {
                data.extend(ticks.to_be_bytes());
                field::TICKS
            }
            Self::GpsTime(time) => {
                time.emit(&mut data);
                field::GPS_TIME
            }
            Self::ReferenceTimeNs(time_ns) => {
                data.extend(time_ns.to_be_bytes());
                field::REFERENCE_TIME
            }
            Self::ReferenceDeltaNs(delta_ns) => {
                data.extend(delta_ns.to_be_bytes());
                field::REFERENCE_DELTA
            }
            Self::ExternalTime { time_ns, valid } => {
                data.extend(time_ns.to_be_bytes());
                data.extend(valid.to_be_bytes());
                field::EXTERNAL_TIME
            }
            Self::Other(raw) => return raw.emit(out),
        };
        RawField {
            descriptor,
            data: &data,
        }
        .emit(out)
    }
}

fn vector(data: &[u8]) -> Result<[f32; 3], WireError> {
    let bytes: [u8; 12] = fixed(data)?;
    let [x0, x1, x2, x3, y0, y1, y2, y3, z0, z1, z2, z3] = bytes;
    Ok([[x0, x1, x2, x3], [y0, y1, y2, y3], [z0, z1, z2, z3]].map(f32::from_be_bytes))
}

fn emit_vector(descriptor: u8, xyz: &[f32; 3], out: &mut Vec<u8>) -> u8 {
    out.extend(xyz.iter().flat_map(|value| value.to_be_bytes()));
    descriptor
}
