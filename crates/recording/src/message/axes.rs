//! What one sensor of a device measures alone: three numbers in its axes, or how it is turned.

use lsfb_types::Timestamp;

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// `geometry_msgs/msg/Vector3Stamped`: a gyroscope's rad/s, an accelerometer's m/s², or what the device takes off them.
pub fn encode_vector(time: Timestamp, frame: &str, vector: &[f64; 3]) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(48 + frame.len());
    w.header(time, frame);
    w.f64s(vector);
    w.finish()
}

/// A `geometry_msgs/msg/Vector3Stamped`.
pub fn decode_vector(bytes: &[u8]) -> Result<[f64; 3], CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    r.f64_array("vector")
}

/// `geometry_msgs/msg/QuaternionStamped`: x y z w of the device in a world of its own.
pub fn encode_orientation(time: Timestamp, frame: &str, xyzw: &[f64; 4]) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(56 + frame.len());
    w.header(time, frame);
    w.f64s(xyzw);
    w.finish()
}

/// A `geometry_msgs/msg/QuaternionStamped`: x y z w.
pub fn decode_orientation(bytes: &[u8]) -> Result<[f64; 4], CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    r.f64_array("quaternion")
}
