//! Clouds of points as files and messages pack them: a row of named numbers per point.

mod number;
mod point_times;

use lsfb_types::{Echo, LidarPoint, LidarScan};

pub use number::{ByteOrder, NumberKind};
pub use point_times::{PointTimes, TimesBegin};

use point_times::{is_time, point_times};

/// Points in one cloud; more is a map, not a scan.
pub const MAX_POINTS: usize = 20_000_000;
/// Farther than this from the origin no LiDAR measures, metres: such coordinates are those of a map.
const MAX_RANGE_M: f32 = 10_000.0;

/// A cloud of points, and where their times come from.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Its points; where there are no times their offsets are zero.
    pub scan: LidarScan,
    /// Where their times come from.
    pub times: PointTimes,
}

/// One of the numbers of each point.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PackedField {
    /// Its name.
    pub name: String,
    /// How it is written.
    pub kind: NumberKind,
    /// Where in the bytes of a point.
    pub offset: usize,
}

/// A cloud as it lies in a file or a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PackedCloud<'a> {
    /// The numbers of a point.
    pub fields: Vec<PackedField>,
    /// Which byte of a number comes first.
    pub order: ByteOrder,
    /// Bytes from point to point.
    pub point_bytes: usize,
    /// Points of a row.
    pub columns: usize,
    /// Bytes from row to row.
    pub row_bytes: usize,
    /// Rows.
    pub rows: usize,
    /// The rows, one after the other.
    pub data: &'a [u8],
}

/// Why packed bytes are no cloud.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CloudError {
    /// The points have no place.
    #[error("it has no floating-point fields x, y and z; available: {fields}")]
    NoCoordinates {
        /// The fields.
        fields: String,
    },
    /// A field lies outside its point.
    #[error("field {name} ends at byte {end} of points of {point_bytes} bytes")]
    FieldOutside {
        /// The field.
        name: String,
        /// Where it ends.
        end: usize,
        /// Bytes of a point.
        point_bytes: usize,
    },
    /// Points do not fit into their row.
    #[error("rows of {row_bytes} bytes cannot hold {columns} points of {point_bytes} bytes")]
    RowTooShort {
        /// Bytes of a row.
        row_bytes: usize,
        /// Points of a row.
        columns: usize,
        /// Bytes of a point.
        point_bytes: usize,
    },
    /// There is more or less than was announced.
    #[error("{got} bytes of points, but {needed} are announced: truncated or damaged")]
    Size {
        /// Bytes announced.
        needed: usize,
        /// Bytes there.
        got: usize,
    },
    /// More points than any scan has.
    #[error("{points} points; a scan has at most {MAX_POINTS}")]
    TooMany {
        /// Points announced.
        points: usize,
    },
    /// The coordinates are not those of a sensor.
    #[error(
        "the nearest point is {nearest_km:.0} km from the origin: coordinates of a map, but those of the sensor are needed"
    )]
    NotOfASensor {
        /// Distance of the nearest point, kilometres.
        nearest_km: f64,
    },
}

impl PackedCloud<'_> {
    /// The points. Those whose coordinates are not finite are left out.
    pub fn unpack(&self) -> Result<Cloud, CloudError> {
        self.check_size()?;
        let place = [
            self.coordinate("x")?,
            self.coordinate("y")?,
            self.coordinate("z")?,
        ];
        let named = |names: &[&str]| {
            let names = names.iter();
            names.filter_map(|name| self.field(name)).next()
        };
        let intensity = named(&["intensity", "reflectivity", "i", "scalar_intensity"]);
        let ring = named(&["ring", "channel", "laser_id", "laser_number", "line"]);
        let return_type = self
            .field("return_type")
            .filter(|f| f.kind == NumberKind::U8);
        let read = |field: &PackedField, point: &[u8]| {
            let bytes = point.get(field.offset..).unwrap_or_default();
            field.kind.read(bytes, self.order)
        };
        let is_ours = self.is_ours();
        let or_zero = |field: Option<&PackedField>, point: &[u8]| {
            field.map_or(0.0, |field| read(field, point))
        };
        let mut kept: Vec<&[u8]> = Vec::with_capacity(self.columns.saturating_mul(self.rows));
        let mut points = Vec::with_capacity(kept.capacity());
        for row in self.data.chunks_exact(self.row_bytes.max(1)) {
            for bytes in row.chunks_exact(self.point_bytes).take(self.columns) {
                let position_m = place.map(|field| read(field, bytes) as f32);
                if !position_m.iter().all(|c| c.is_finite()) {
                    continue;
                }
                kept.push(bytes);
                points.push(LidarPoint {
                    position_m,
                    // Float casts saturate: what does not fit becomes the nearest that does.
                    intensity: or_zero(intensity, bytes) as u8,
                    ring: or_zero(ring, bytes) as u16,
                    // Programs number the kinds of returns differently: only a cloud of ours says which one wrote it.
                    echo: match return_type {
                        Some(field) if is_ours => Echo::from_code(read(field, bytes) as u8),
                        _ => Echo::Unknown,
                    },
                    time_offset_ns: 0,
                });
            }
        }
        check_places(&points)?;
        let times = self.put_times(&mut points, |field, k| {
            kept.get(k).map_or(f64::NAN, |bytes| read(field, bytes))
        });
        Ok(Cloud {
            scan: LidarScan { points },
            times,
        })
    }

    fn check_size(&self) -> Result<(), CloudError> {
        for field in &self.fields {
            let end = field.offset.saturating_add(field.kind.bytes());
            if end > self.point_bytes {
                return Err(CloudError::FieldOutside {
                    name: field.name.clone(),
                    end,
                    point_bytes: self.point_bytes,
                });
            }
        }
        let fits = self.columns.checked_mul(self.point_bytes);
        if self.point_bytes == 0 || fits.is_none_or(|bytes| bytes > self.row_bytes) {
            return Err(CloudError::RowTooShort {
                row_bytes: self.row_bytes,
                columns: self.columns,
                point_bytes: self.point_bytes,
            });
        }
        let points = self.columns.saturating_mul(self.rows);
        if points > MAX_POINTS {
            return Err(CloudError::TooMany { points });
        }
        let needed = self.row_bytes.saturating_mul(self.rows);
        if needed != self.data.len() {
            return Err(CloudError::Size {
                needed,
                got: self.data.len(),
            });
        }
        Ok(())
    }

    fn field(&self, name: &str) -> Option<&PackedField> {
        self.fields.iter().find(|f| f.name == name)
    }

    fn coordinate(&self, name: &str) -> Result<&PackedField, CloudError> {
        let field = self.field(name).filter(|f| !f.kind.is_whole());
        field.ok_or_else(|| {
            let names: Vec<&str> = self.fields.iter().map(|f| f.name.as_str()).collect();
            CloudError::NoCoordinates {
                fields: names.join(" "),
            }
        })
    }

    /// Whether it is laid out as our own recordings are, whose times are nanoseconds after the stamp, however few.
    fn is_ours(&self) -> bool {
        let own = OWN_FIELDS.iter();
        self.fields.len() == OWN_FIELDS.len()
            && own
                .zip(&self.fields)
                .all(|(own, f)| (f.name.as_str(), f.offset, f.kind) == *own)
    }

    /// Gives the points their times, from the first field of times that can be used.
    fn put_times(
        &self,
        points: &mut [LidarPoint],
        value: impl Fn(&PackedField, usize) -> f64,
    ) -> PointTimes {
        let is_ours = self.is_ours();
        let mut found = PointTimes::Absent;
        for field in self.fields.iter().filter(|f| is_time(&f.name)) {
            let values: Vec<f64> = (0..points.len()).map(|k| value(field, k)).collect();
            let (offsets_ns, times) = if is_ours {
                let name = field.name.clone();
                let begins = TimesBegin::AfterStamp { nanos: 0 };
                let any = values.iter().any(|v| *v > 0.0);
                (
                    values.iter().map(|v| *v as u32).collect(),
                    match any {
                        true => PointTimes::Field { name, begins },
                        false => PointTimes::Unusable { name },
                    },
                )
            } else {
                let is_return = |k: usize| points.get(k).is_some_and(|p| p.position_m != [0.0; 3]);
                point_times(&field.name, &values, is_return)
            };
            for (point, offset_ns) in points.iter_mut().zip(offsets_ns) {
                point.time_offset_ns = offset_ns;
            }
            if matches!(times, PointTimes::Field { .. }) {
                return times;
            }
            if found == PointTimes::Absent {
                found = times;
            }
        }
        found
    }
}

/// Name, offset and kind of the fields of our own clouds: each aligned to its size, `t` in nanoseconds after the stamp.
pub(crate) const OWN_FIELDS: [(&str, usize, NumberKind); 7] = [
    ("x", 0, NumberKind::F32),
    ("y", 4, NumberKind::F32),
    ("z", 8, NumberKind::F32),
    ("intensity", 12, NumberKind::F32),
    ("ring", 16, NumberKind::U16),
    ("return_type", 18, NumberKind::U8),
    ("t", 20, NumberKind::U32),
];

/// Refuses coordinates that no sensor measures, of which single precision keeps no millimetres either.
fn check_places(points: &[LidarPoint]) -> Result<(), CloudError> {
    let range_m = |p: &LidarPoint| p.position_m.iter().map(|c| c * c).sum::<f32>().sqrt();
    let nearest_m = points.iter().map(range_m).fold(f32::INFINITY, f32::min);
    if nearest_m.is_finite() && nearest_m > MAX_RANGE_M {
        return Err(CloudError::NotOfASensor {
            nearest_km: f64::from(nearest_m) * 1e-3,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests;
