use lsfb_types::{Echo, LidarPoint, LidarScan, Timestamp};

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// Datatype codes of `sensor_msgs/msg/PointField`.
const UINT8: u8 = 2;
const UINT16: u8 = 4;
const UINT32: u8 = 6;
const FLOAT32: u8 = 7;

/// Name, offset and datatype of the fields we write: each aligned to its size, `t` in nanoseconds after the header stamp.
const FIELDS: [(&str, u32, u8); 7] = [
    ("x", 0, FLOAT32),
    ("y", 4, FLOAT32),
    ("z", 8, FLOAT32),
    ("intensity", 12, FLOAT32),
    ("ring", 16, UINT16),
    ("return_type", 18, UINT8),
    ("t", 20, UINT32),
];
const POINT_STEP: usize = 24;

/// `sensor_msgs/msg/PointCloud2`, one row, in firing order.
pub fn encode_points(time: Timestamp, frame: &str, scan: &LidarScan) -> Vec<u8> {
    let data_bytes = scan.points.len() * POINT_STEP;
    let mut w = CdrWriter::with_capacity(data_bytes + 256);
    w.header(time, frame);
    w.u32(1);
    w.u32(scan.points.len() as u32);
    w.u32(FIELDS.len() as u32);
    for (name, offset, datatype) in FIELDS {
        w.string(name);
        w.u32(offset);
        w.u8(datatype);
        w.u32(1);
    }
    w.u8(0);
    w.u32(POINT_STEP as u32);
    w.u32(data_bytes as u32);
    w.u32(data_bytes as u32);
    for point in &scan.points {
        for coordinate in point.position_m {
            w.raw(&coordinate.to_le_bytes());
        }
        w.raw(&f32::from(point.intensity).to_le_bytes());
        w.raw(&point.ring.to_le_bytes());
        w.raw(&[point.echo.code(), 0]);
        w.raw(&point.time_offset_ns.to_le_bytes());
    }
    w.u8(1);
    w.finish()
}

/// The scan of a `sensor_msgs/msg/PointCloud2` with `x y z` (f32); `intensity` (f32), `ring` (u16), `return_type` (u8) and `t`
/// (u32) are zero where the cloud lacks them.
pub fn decode_points(bytes: &[u8]) -> Result<LidarScan, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    let height = r.u32("height")? as usize;
    let width = r.u32("width")? as usize;
    let mut offsets = [None; FIELDS.len()];
    for _ in 0..r.u32("fields")? {
        let name = r.string("fields.name")?;
        let offset = r.u32("fields.offset")? as usize;
        let datatype = r.u8("fields.datatype")?;
        r.u32("fields.count")?;
        if let Some(index) = FIELDS.iter().position(|f| f.0 == name && f.2 == datatype) {
            offsets[index] = Some(offset);
        }
    }
    if r.u8("is_bigendian")? != 0 {
        return Err(CdrError::Value {
            field: "is_bigendian",
        });
    }
    let point_step = r.u32("point_step")? as usize;
    let row_step = r.u32("row_step")? as usize;
    let data = r.byte_sequence("data")?;
    r.u8("is_dense")?;
    let [Some(x), Some(y), Some(z), intensity, ring, echo, t] = offsets else {
        return Err(CdrError::Value { field: "fields" });
    };
    if point_step == 0
        || width
            .checked_mul(point_step)
            .is_none_or(|row| row > row_step)
    {
        return Err(CdrError::Value { field: "row_step" });
    }
    if row_step.checked_mul(height) != Some(data.len()) {
        return Err(CdrError::Value { field: "data" });
    }
    let mut points = Vec::with_capacity(data.len() / point_step);
    for row in data.chunks_exact(row_step.max(1)) {
        for bytes in row.chunks_exact(point_step).take(width) {
            points.push(LidarPoint {
                position_m: [f32_at(bytes, x)?, f32_at(bytes, y)?, f32_at(bytes, z)?],
                intensity: intensity.map_or(Ok(0.0), |at| f32_at(bytes, at))? as u8,
                ring: ring
                    .map_or(Ok([0; 2]), |at| field_at(bytes, at))
                    .map(u16::from_le_bytes)?,
                echo: echo
                    .map_or(Ok([0; 1]), |at| field_at(bytes, at))
                    .map(|[code]| Echo::from_code(code))?,
                time_offset_ns: t
                    .map_or(Ok([0; 4]), |at| field_at(bytes, at))
                    .map(u32::from_le_bytes)?,
            });
        }
    }
    Ok(LidarScan { points })
}

fn field_at<const N: usize>(point: &[u8], offset: usize) -> Result<[u8; N], CdrError> {
    point
        .get(offset..)
        .and_then(|rest| rest.first_chunk::<N>())
        .copied()
        .ok_or(CdrError::Value {
            field: "fields.offset",
        })
}

fn f32_at(point: &[u8], offset: usize) -> Result<f32, CdrError> {
    field_at(point, offset).map(f32::from_le_bytes)
}
