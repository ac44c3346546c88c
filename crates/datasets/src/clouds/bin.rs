//! Bare single-precision numbers: `x y z intensity` of KITTI, and a ring behind them of nuScenes.

use lsfb_recording::cloud::{ByteOrder, NumberKind, PackedField};

use super::Packed;

/// Fields of the files of KITTI.
pub(super) const KITTI: [&str; 4] = ["x", "y", "z", "intensity"];
/// Fields of the files of nuScenes.
pub(super) const NUSCENES: [&str; 5] = ["x", "y", "z", "intensity", "ring"];
/// No sensor measures coordinates or intensities beyond these: metres, and steps of eight bits.
const MAX_COORDINATE_M: f32 = 1_000.0;
const MAX_INTENSITY: f32 = 255.0;

pub(super) fn parse(bytes: &[u8], names: &[&str]) -> Result<Packed, String> {
    let point_bytes = 4 * names.len();
    if !bytes.len().is_multiple_of(point_bytes) {
        return Err(format!(
            "{} bytes are not a whole number of points {}, single precision",
            bytes.len(),
            names.join(" ")
        ));
    }
    // Nothing in the file says what it holds.
    let number = |b: &[u8]| b.first_chunk().map_or(f32::NAN, |b| f32::from_le_bytes(*b));
    let strange = bytes.chunks_exact(point_bytes).find_map(|point| {
        let values = point.chunks_exact(4).map(number).enumerate();
        let mut strange = values.filter(|(i, v)| match i {
            0..3 => v.abs() > MAX_COORDINATE_M,
            _ => !(0.0..=MAX_INTENSITY).contains(v),
        });
        strange.next()
    });
    if let Some((i, value)) = strange {
        let name = names.get(i).copied().unwrap_or_default();
        return Err(format!(
            "{name} = {value}: its numbers are not {}, single precision",
            names.join(" ")
        ));
    }
    let fields = names.iter().enumerate().map(|(i, name)| PackedField {
        name: (*name).to_owned(),
        kind: NumberKind::F32,
        offset: 4 * i,
    });
    Ok(Packed {
        fields: fields.collect(),
        order: ByteOrder::Little,
        point_bytes,
        points: bytes.len() / point_bytes,
        data: bytes.to_vec(),
    })
}
