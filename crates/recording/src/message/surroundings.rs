//! What a phone measures of its surroundings: magnetic field, air pressure, position by satellites.

use lsfb_types::Timestamp;

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// `sensor_msgs/msg/MagneticField`: the raw field, without the device's own correction of its iron.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MagneticSample {
    /// The field in the sensor's axes, tesla.
    pub field_t: [f64; 3],
    /// Variance of each axis, tesla²; 0 where it is not known.
    pub variance_t2: [f64; 3],
}

/// `sensor_msgs/msg/MagneticField`.
pub fn encode_magnetic(time: Timestamp, frame: &str, sample: &MagneticSample) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(128 + frame.len());
    w.header(time, frame);
    w.f64s(&sample.field_t);
    w.f64s(&diagonal(sample.variance_t2));
    w.finish()
}

/// A `sensor_msgs/msg/MagneticField`.
pub fn decode_magnetic(bytes: &[u8]) -> Result<MagneticSample, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    let field_t = r.f64_array("magnetic_field")?;
    let [x, _, _, _, y, _, _, _, z] = r.f64_array("magnetic_field_covariance")?;
    Ok(MagneticSample {
        field_t,
        variance_t2: [x, y, z],
    })
}

fn diagonal([x, y, z]: [f64; 3]) -> [f64; 9] {
    [x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z]
}

/// `sensor_msgs/msg/FluidPressure`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PressureSample {
    /// Pressure of the air, pascal.
    pub pressure_pa: f64,
    /// Its variance, pascal²; 0 where it is not known.
    pub variance_pa2: f64,
}

/// `sensor_msgs/msg/FluidPressure`.
pub fn encode_pressure(time: Timestamp, frame: &str, sample: &PressureSample) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(64 + frame.len());
    w.header(time, frame);
    w.f64s(&[sample.pressure_pa, sample.variance_pa2]);
    w.finish()
}

/// A `sensor_msgs/msg/FluidPressure`.
pub fn decode_pressure(bytes: &[u8]) -> Result<PressureSample, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    Ok(PressureSample {
        pressure_pa: r.f64("fluid_pressure")?,
        variance_pa2: r.f64("variance")?,
    })
}

/// `sensor_msgs/msg/NavSatFix`: what a receiver says once a second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GnssReading {
    /// The position; `None` where too few satellites are seen.
    pub fix: Option<GnssFix>,
}

/// A position on the WGS 84 ellipsoid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GnssFix {
    /// Latitude, degrees north.
    pub latitude_deg: f64,
    /// Longitude, degrees east.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, metres.
    pub altitude_m: f64,
    /// Covariance of east, north, up, metres², row by row.
    pub covariance_enu_m2: [f64; 9],
}

const STATUS_NO_FIX: i8 = -1;
const STATUS_FIX: i8 = 0;
const SERVICE_GPS: u16 = 1;
const COVARIANCE_UNKNOWN: u8 = 0;
const COVARIANCE_KNOWN: u8 = 3;

/// `sensor_msgs/msg/NavSatFix`; without a fix its numbers are NaN.
pub fn encode_gnss(time: Timestamp, frame: &str, reading: &GnssReading) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(160 + frame.len());
    w.header(time, frame);
    let status = match reading.fix {
        Some(_) => STATUS_FIX,
        None => STATUS_NO_FIX,
    };
    w.u8(status.cast_unsigned());
    w.u16(SERVICE_GPS);
    let nowhere = GnssFix {
        latitude_deg: f64::NAN,
        longitude_deg: f64::NAN,
        altitude_m: f64::NAN,
        ..GnssFix::default()
    };
    let fix = reading.fix.unwrap_or(nowhere);
    w.f64s(&[fix.latitude_deg, fix.longitude_deg, fix.altitude_m]);
    w.f64s(&fix.covariance_enu_m2);
    w.u8(match reading.fix {
        Some(_) => COVARIANCE_KNOWN,
        None => COVARIANCE_UNKNOWN,
    });
    w.finish()
}

/// A `sensor_msgs/msg/NavSatFix`.
pub fn decode_gnss(bytes: &[u8]) -> Result<GnssReading, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    let status = r.u8("status.status")?.cast_signed();
    r.u16("status.service")?;
    let fix = GnssFix {
        latitude_deg: r.f64("latitude")?,
        longitude_deg: r.f64("longitude")?,
        altitude_m: r.f64("altitude")?,
        covariance_enu_m2: r.f64_array("position_covariance")?,
    };
    r.u8("position_covariance_type")?;
    Ok(GnssReading {
        fix: (status >= STATUS_FIX).then_some(fix),
    })
}
