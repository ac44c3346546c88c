//! Which layout a folder of images has, and its images by that.

use std::path::{Path, PathBuf};

use super::unposed::{UnposedImages, image_files};
use super::{
    IMAGES, INTRINSICS, PosedImages, colmap, kapture, layouts, nerfstudio, rig_of, rig_with,
};
use crate::Error;

/// How a folder keeps images with the intrinsics of their cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageLayout {
    /// `transforms.json`.
    Nerfstudio,
    /// `sensors/sensors.txt` and `sensors/records_camera.txt`.
    Kapture,
    /// A model, text or binary, in the folder or in `sparse/0` or `sparse`.
    Colmap,
    /// `NAME.color.png`, and `K.txt` where the camera is not the data set's.
    SevenScenes,
    /// `images/` and `gt_dense_cameras`.
    Strecha,
    /// Images of one undistorted pinhole camera beside its `K.txt`, or in `images/` there.
    Pinhole,
}

impl ImageLayout {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Nerfstudio,
        Self::Kapture,
        Self::Colmap,
        Self::SevenScenes,
        Self::Strecha,
        Self::Pinhole,
    ];

    /// As messages call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nerfstudio => "nerfstudio (transforms.json)",
            Self::Kapture => "kapture (sensors/sensors.txt)",
            Self::Colmap => "COLMAP (cameras.txt or cameras.bin)",
            Self::SevenScenes => "7-Scenes (NAME.color.png)",
            Self::Strecha => "Strecha (gt_dense_cameras)",
            Self::Pinhole => "images with K.txt",
        }
    }

    /// Whether the layout's own names of cameras may be those of a rig.
    pub fn names_cameras(self) -> bool {
        self == Self::Kapture
    }

    /// All layouts that a folder has. More than one is a question to who named it.
    pub fn found_in(folder: &Path) -> Result<Vec<Self>, Error> {
        let is_seven_scenes = !layouts::colour_images(folder)?.is_empty();
        let is_there = |layout: Self| -> Result<bool, Error> {
            Ok(match layout {
                Self::Nerfstudio => folder.join(nerfstudio::FILE).is_file(),
                Self::Kapture => folder.join(kapture::SENSORS).is_file(),
                Self::Colmap => colmap::cameras_in(folder).is_some(),
                Self::SevenScenes => is_seven_scenes,
                Self::Strecha => layouts::strecha_cameras(folder)?.is_some(),
                // Of 7-Scenes the file is a part.
                Self::Pinhole => folder.join(INTRINSICS).is_file() && !is_seven_scenes,
            })
        };
        let mut found = Vec::new();
        for layout in Self::ALL {
            if is_there(layout)? {
                found.push(layout);
            }
        }
        Ok(found)
    }
}

impl UnposedImages {
    /// Reads a folder in a layout.
    pub fn read(folder: &Path, layout: ImageLayout) -> Result<Self, Error> {
        match layout {
            ImageLayout::Nerfstudio => nerfstudio::read(folder)?.unposed(),
            ImageLayout::Kapture => kapture::read(folder)?.unposed(),
            ImageLayout::Colmap => {
                let model = colmap::cameras_in(folder).unwrap_or_else(|| folder.to_owned());
                colmap::read_all(folder, &model)
            }
            ImageLayout::SevenScenes => {
                let images = layouts::colour_images(folder)?;
                let first = images.first().map_or(folder, PathBuf::as_path);
                let camera = layouts::seven_scenes_camera(folder, first)?;
                Ok(Self::of_one_camera(rig_with(folder, camera), images))
            }
            ImageLayout::Strecha => Ok(Self::without_poses(PosedImages::read(folder)?)),
            ImageLayout::Pinhole => pinhole(folder),
        }
    }
}

/// All image files are of one camera; those beside `K.txt`, or those in `images/`, and where there are both nobody knows which are meant.
fn pinhole(folder: &Path) -> Result<UnposedImages, Error> {
    let refuse = |reason: &str| Error::PosedLayout {
        path: folder.to_owned(),
        reason: reason.to_owned(),
    };
    let beside = image_files(folder)?;
    let inside = match folder.join(IMAGES) {
        inside if inside.is_dir() => image_files(&inside)?,
        _ => Vec::new(),
    };
    let paths = match (beside.is_empty(), inside.is_empty()) {
        (false, true) => beside,
        (true, false) => inside,
        (true, true) => {
            return Err(refuse(
                "no .png, .jpg or .jpeg file here: name the folder that holds the images",
            ));
        }
        (false, false) => {
            return Err(refuse(
                "images are both here and in images/: name the folder to use and pass --rig",
            ));
        }
    };
    let first = paths.first().map_or(folder, PathBuf::as_path);
    let rig = rig_of(folder, first)?;
    Ok(UnposedImages::of_one_camera(rig, paths))
}
