use lsfb_types::{LidarScan, Timestamp};

use crate::cdr::{CdrError, CdrReader, CdrWriter, Layout};
use crate::cloud::{
    ByteOrder, Cloud, CloudError, NumberKind, OWN_FIELDS, PackedCloud, PackedField,
};

/// Kinds of numbers by their codes in `sensor_msgs/msg/PointField`, which begin with one.
const KINDS: [NumberKind; 8] = [
    NumberKind::I8,
    NumberKind::U8,
    NumberKind::I16,
    NumberKind::U16,
    NumberKind::I32,
    NumberKind::U32,
    NumberKind::F32,
    NumberKind::F64,
];
const POINT_STEP: usize = 24;

/// `sensor_msgs/msg/PointCloud2`, one row, in firing order.
pub fn encode_points(time: Timestamp, frame: &str, scan: &LidarScan) -> Vec<u8> {
    let data_bytes = scan.points.len() * POINT_STEP;
    let mut w = CdrWriter::with_capacity(data_bytes + 256);
    w.header(time, frame);
    w.u32(1);
    w.u32(scan.points.len() as u32);
    w.u32(OWN_FIELDS.len() as u32);
    for (name, offset, kind) in OWN_FIELDS {
        w.string(name);
        w.u32(offset as u32);
        let code = KINDS.iter().position(|k| *k == kind).map_or(0, |k| k + 1);
        w.u8(code as u8);
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

/// A `sensor_msgs/msg/PointCloud2`.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudMessage {
    /// Stamp of its header.
    pub stamp: Timestamp,
    /// Frame of its header.
    pub frame: String,
    /// Its points and their times.
    pub cloud: Cloud,
}

impl CloudMessage {
    /// When the offsets of its points are zero.
    pub fn begins(&self) -> Timestamp {
        self.cloud.times.begins(self.stamp)
    }

    /// Whether the points have times of another clock than the stamp.
    pub fn has_two_clocks(&self) -> bool {
        self.cloud.times.has_two_clocks(self.stamp)
    }
}

/// The cloud of a `PointCloud2` with `x y z` of floating-point numbers, as either ROS lays it out.
pub fn decode_cloud(layout: Layout, bytes: &[u8]) -> Result<CloudMessage, CdrError> {
    let mut r = CdrReader::with_layout(layout, bytes)?;
    let header = r.header()?;
    let rows = r.u32("height")? as usize;
    let columns = r.u32("width")? as usize;
    let mut fields = Vec::new();
    for _ in 0..r.u32("fields")? {
        let name = r.string("fields.name")?.to_owned();
        let offset = r.u32("fields.offset")? as usize;
        let kind = KINDS.get(usize::from(r.u8("fields.datatype")?).wrapping_sub(1));
        r.u32("fields.count")?;
        // Kinds of other versions may be skipped: their offsets are not needed.
        fields.extend(kind.map(|kind| PackedField {
            name,
            kind: *kind,
            offset,
        }));
    }
    let order = match r.u8("is_bigendian")? {
        0 => ByteOrder::Little,
        _ => ByteOrder::Big,
    };
    let point_bytes = r.u32("point_step")? as usize;
    let row_bytes = r.u32("row_step")? as usize;
    let data = r.byte_sequence("data")?;
    r.u8("is_dense")?;
    let packed = PackedCloud {
        fields,
        order,
        point_bytes,
        columns,
        row_bytes,
        rows,
        data,
    };
    let cloud = packed.unpack().map_err(|error| CdrError::Value {
        field: match error {
            CloudError::NoCoordinates { .. } => "fields",
            CloudError::FieldOutside { .. } => "fields.offset",
            CloudError::RowTooShort { .. } => "row_step",
            _ => "data",
        },
    })?;
    Ok(CloudMessage {
        stamp: header.stamp,
        frame: header.frame_id.to_owned(),
        cloud,
    })
}
