//! Maps in the files of other programs.
//!
//! | format | files | what it holds |
//! | --- | --- | --- |
//! | COLMAP, text or binary | `cameras`, `images`, `points3D` | all but descriptors; images are named `CAMERA/NANOSECONDS.png` |
//! | kapture 1.1 | `sensors/…`, `reconstruction/…` | all but descriptors |
//! | nerfstudio | `transforms.json`, `points.ply` | cameras, poses, points |
//! | PLY | `points.ply` | points with σ, error and number of observations |
//! | LAS, LAZ | `points.las`, `points.laz` | points |

mod colmap;
mod kapture;
mod nerfstudio;
mod points;

use std::collections::BTreeMap;

use lsfb_geometry::{Rig, Se3};

use super::HdMap;
use crate::Error;

/// A format that a map is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapFormat {
    /// COLMAP's text files.
    ColmapText,
    /// COLMAP's binary files.
    ColmapBinary,
    /// kapture 1.1.
    Kapture,
    /// nerfstudio's `transforms.json`.
    Nerfstudio,
    /// A PLY file.
    Ply,
    /// A LAS file.
    Las,
    /// A LAZ file: LAS compressed.
    Laz,
}

/// A file of a format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportedFile {
    /// Its path below the folder of the export.
    pub path: String,
    /// What is in it.
    pub bytes: Vec<u8>,
}

/// A camera as COLMAP describes it: one line of `cameras.txt`.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapCamera {
    /// `PINHOLE`, `OPENCV`, `FULL_OPENCV`, `FOV` or `OPENCV_FISHEYE`.
    pub model: String,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// The model's parameters; the corner of the first pixel is (0, 0).
    pub parameters: Vec<f64>,
}

/// From our pixels, whose (0, 0) is the centre of the first, to those of the formats here, where it is its corner.
const HALF_PIXEL: f64 = 0.5;

impl HdMap {
    /// The map as files of `format`. `cameras` are those of [`HdMap::cameras`], in the same order.
    ///
    /// Fails where the format cannot describe a camera, or coordinates do not fit in it.
    pub fn export(
        &self,
        format: MapFormat,
        cameras: &[ColmapCamera],
    ) -> Result<Vec<ExportedFile>, Error> {
        check_names(self.cameras())?;
        let model = Model {
            map: Some(self),
            names: self.cameras(),
            cameras,
            mounted: mounted(self.rig(), self.cameras()),
            images: images(self),
        };
        match format {
            MapFormat::ColmapText => Ok(colmap::text(&model)),
            MapFormat::ColmapBinary => colmap::binary(&model),
            MapFormat::Kapture => Ok(kapture::files(&model)),
            MapFormat::Nerfstudio => {
                let mut files = nerfstudio::files(&model)?;
                files.push(points::ply(self));
                Ok(files)
            }
            MapFormat::Ply => Ok(vec![points::ply(self)]),
            MapFormat::Las => points::las(self, false),
            MapFormat::Laz => points::las(self, true),
        }
    }
}

/// Where an image was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagePose {
    /// Place of its camera among the cameras.
    pub camera: usize,
    /// Its stamp, nanoseconds.
    pub time_ns: i64,
    /// Where the world is, seen from the camera.
    pub camera_from_world: Se3,
}

/// Poses of images without a map, as files of `format`: a COLMAP model without points, or the sensors of a kapture. Images are named
/// `CAMERA/NANOSECONDS.png`; `cameras` are those of `rig`, in the same order. `None` where the format holds a map or nothing.
pub fn export_image_poses(
    format: MapFormat,
    rig: &Rig,
    cameras: &[ColmapCamera],
    poses: &[ImagePose],
) -> Result<Option<Vec<ExportedFile>>, Error> {
    let names: Vec<String> = rig.cameras.keys().cloned().collect();
    check_names(&names)?;
    let images = poses.iter().filter_map(|pose| {
        let name = names.get(pose.camera)?;
        Some(Image {
            camera: pose.camera,
            time_ns: pose.time_ns,
            camera_from_world: pose.camera_from_world,
            name: image_name(name, pose.time_ns),
            seen: Vec::new(),
        })
    });
    let model = Model {
        map: None,
        names: &names,
        cameras,
        mounted: mounted(rig, &names),
        images: images.collect(),
    };
    Ok(match format {
        MapFormat::ColmapText => Some(colmap::text(&model)),
        MapFormat::ColmapBinary => Some(colmap::binary(&model)?),
        MapFormat::Kapture => Some(kapture::sensors(&model)),
        MapFormat::Nerfstudio | MapFormat::Ply | MapFormat::Las | MapFormat::Laz => None,
    })
}

/// As images lie beside a model; refused are names of cameras that would lead elsewhere.
fn check_names(cameras: &[String]) -> Result<(), Error> {
    let leads_away = |name: &&String| {
        let is_path = name.contains(['/', '\\']) || name.as_str() == "..";
        name.is_empty() || is_path || name.contains(',') || name.chars().any(char::is_control)
    };
    match cameras.iter().find(leads_away) {
        Some(name) => Err(Error::CameraName { name: name.clone() }),
        None => Ok(()),
    }
}

/// As images lie beside a model.
fn image_name(camera: &str, time_ns: i64) -> String {
    format!("{camera}/{time_ns}.png")
}

/// Images with what they saw of a map, where there is one.
struct Model<'a> {
    map: Option<&'a HdMap>,
    /// Of the cameras.
    names: &'a [String],
    cameras: &'a [ColmapCamera],
    /// `rig_from_camera` of each camera; `None` for one that the rig does not have.
    mounted: Vec<Option<Se3>>,
    images: Vec<Image>,
}

fn mounted(rig: &Rig, names: &[String]) -> Vec<Option<Se3>> {
    let of = |name: &String| rig.cameras.get(name).map(|camera| camera.rig_from_camera);
    names.iter().map(of).collect()
}

/// A point and where it was seen, pixels of the formats here.
type Sight = (u32, [f64; 2]);

/// An image that saw points.
struct Image {
    /// Place of its camera among the cameras.
    camera: usize,
    /// Nanoseconds.
    time_ns: i64,
    camera_from_world: Se3,
    /// `CAMERA/NANOSECONDS.png`.
    name: String,
    seen: Vec<Sight>,
}

fn images(map: &HdMap) -> Vec<Image> {
    let mut found: BTreeMap<(u32, u16), Vec<Sight>> = BTreeMap::new();
    for o in (0..map.point_count() as u32).flat_map(|p| map.observations(p)) {
        let pixel = o.pixel.map(|v| f64::from(v) + HALF_PIXEL);
        found
            .entry((o.keyframe, o.camera))
            .or_default()
            .push((o.point, pixel));
    }
    let images = found.into_iter().filter_map(|((keyframe, camera), seen)| {
        let camera = usize::from(camera);
        let name = map.cameras().get(camera)?;
        let pose = map.keyframe(keyframe)?;
        let mounted = map.rig().cameras.get(name)?;
        let time_ns = pose.time.nanos();
        Some(Image {
            camera,
            time_ns,
            camera_from_world: (pose.world_from_rig * mounted.rig_from_camera).inverse(),
            name: image_name(name, time_ns),
            seen,
        })
    });
    images.collect()
}

/// `w x y z`.
fn quaternion(pose: &Se3) -> [f64; 4] {
    let q = pose.rotation.quaternion();
    [q.w, q.i, q.j, q.k]
}

fn file(path: &str, bytes: impl Into<Vec<u8>>) -> ExportedFile {
    ExportedFile {
        path: path.to_owned(),
        bytes: bytes.into(),
    }
}

#[cfg(test)]
mod tests;
