//! Point clouds in files: PCD, PLY, LAS and LAZ, and the bare numbers of KITTI and nuScenes.

mod bin;
mod folder;
mod graph;
mod las;
mod lzf;
mod pcd;
mod ply;
mod text;

use std::path::Path;

use lsfb_recording::cloud::{ByteOrder, Cloud, NumberKind, PackedCloud, PackedField};

use crate::Error;
pub use folder::{CloudFolder, FileScan, ScanTimes};
pub use graph::{GraphCloud, is_graph_folder, read_graph_folder};

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Pcd,
    Ply,
    Kitti,
    NuScenes,
    Las,
}

/// Endings of names and what they stand for; a longer one stands before the one it ends with.
const ENDINGS: [(&str, Format); 6] = [
    (".pcd.bin", Format::NuScenes),
    (".pcd", Format::Pcd),
    (".ply", Format::Ply),
    (".bin", Format::Kitti),
    (".las", Format::Las),
    (".laz", Format::Las),
];

/// By the name of a file: its kind, and the name without the ending.
fn format_of(path: &Path) -> Option<(Format, String)> {
    let name = path.file_name()?.to_string_lossy().to_lowercase();
    ENDINGS.iter().find_map(|(ending, format)| {
        let stem = name.strip_suffix(ending)?;
        Some((*format, stem.to_owned()))
    })
}

fn endings() -> String {
    ENDINGS.map(|(ending, _)| ending).join(" ")
}

/// Reads a cloud from a file of any kind that is known. Points whose coordinates are not finite are left out.
pub fn read_cloud(path: &Path) -> Result<Cloud, Error> {
    let (format, _) = format_of(path).ok_or_else(|| Error::UnknownEnding {
        path: path.to_owned(),
        endings: endings(),
    })?;
    let bytes = std::fs::read(path).map_err(|source| Error::Io {
        path: path.to_owned(),
        source,
    })?;
    let parsed = match format {
        Format::Pcd => pcd::parse(&bytes),
        Format::Ply => ply::parse(&bytes),
        Format::Kitti => bin::parse(&bytes, &bin::KITTI),
        Format::NuScenes => bin::parse(&bytes, &bin::NUSCENES),
        Format::Las => las::parse(bytes),
    };
    let packed = parsed.map_err(|problem| Error::CloudFile {
        path: path.to_owned(),
        problem,
    })?;
    packed.cloud().unpack().map_err(|source| Error::Cloud {
        path: path.to_owned(),
        source,
    })
}

/// The points of a file, one after the other.
struct Packed {
    fields: Vec<PackedField>,
    order: ByteOrder,
    point_bytes: usize,
    points: usize,
    data: Vec<u8>,
}

impl Packed {
    /// Points of doubles, of which each field takes one.
    fn of_doubles<'a>(names: impl IntoIterator<Item = &'a str>, data: Vec<u8>) -> Self {
        let names = names.into_iter().enumerate();
        let fields: Vec<PackedField> = names
            .map(|(i, name)| PackedField {
                name: name.to_owned(),
                kind: NumberKind::F64,
                offset: 8 * i,
            })
            .collect();
        let point_bytes = 8 * fields.len();
        Self {
            points: data.len() / point_bytes.max(1),
            fields,
            order: ByteOrder::Little,
            point_bytes,
            data,
        }
    }

    fn cloud(&self) -> PackedCloud<'_> {
        PackedCloud {
            fields: self.fields.clone(),
            order: self.order,
            point_bytes: self.point_bytes,
            columns: self.points,
            row_bytes: self.points.saturating_mul(self.point_bytes),
            rows: 1,
            data: &self.data,
        }
    }
}

#[cfg(test)]
mod tests;
