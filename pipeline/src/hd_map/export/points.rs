//! The points alone.

use std::io::Cursor;

use las::{Builder, Point, Transform, Vector, Writer};
use lsfb_geometry::Vector3;

use super::{ExportedFile, file};
use crate::Error;
use crate::hd_map::HdMap;

/// Steps of the coordinates in LAS files, metres.
const LAS_STEP_M: f64 = 1e-4;

/// A binary PLY file.
pub(super) fn ply(map: &HdMap) -> ExportedFile {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres; sigma: in the direction in which the point is known worst\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nproperty float sigma\nproperty float error_px\nproperty uint observations\nend_header\n",
        map.point_count()
    )
    .into_bytes();
    for (point, position) in (0..).zip(map.positions()) {
        bytes.extend(position.iter().flat_map(|v| v.to_le_bytes()));
        let quality = map.quality(point);
        let sigma = quality.map_or(f64::INFINITY, |q| q.worst_sigma_m());
        let error_px = quality.map_or(0.0, |q| q.reprojection_rms_px);
        bytes.extend(
            [sigma, error_px]
                .map(|v| (v as f32).to_le_bytes())
                .as_flattened(),
        );
        bytes.extend((map.observations(point).count() as u32).to_le_bytes());
    }
    file("points.ply", bytes)
}

/// A LAS or LAZ file.
pub(super) fn las(map: &HdMap, is_compressed: bool) -> Result<Vec<ExportedFile>, Error> {
    let bytes = las_bytes(map, is_compressed).map_err(|e| Error::Las {
        reason: e.to_string(),
    })?;
    let name = if is_compressed {
        "points.laz"
    } else {
        "points.las"
    };
    Ok(vec![file(name, bytes)])
}

fn las_bytes(map: &HdMap, is_compressed: bool) -> Result<Vec<u8>, las::Error> {
    let region = map.region();
    let middle = region.map_or_else(Vector3::zeros, |r| (r.min + r.max) / 2.0);
    let axis = |i: usize| Transform {
        scale: LAS_STEP_M,
        offset: middle[i].round(),
    };
    let mut header = Builder::from((1, 4));
    header.point_format.is_compressed = is_compressed;
    header.generating_software = "lsfb".to_owned();
    header.transforms = Vector {
        x: axis(0),
        y: axis(1),
        z: axis(2),
    };
    let mut writer = Writer::new(Cursor::new(Vec::new()), header.into_header()?)?;
    for position in map.positions() {
        writer.write_point(Point {
            x: position.x,
            y: position.y,
            z: position.z,
            ..Point::default()
        })?;
    }
    writer.close()?;
    Ok(writer.into_inner()?.into_inner())
}
