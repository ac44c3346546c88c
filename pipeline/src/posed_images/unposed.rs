//! Images in a folder with the intrinsics of their cameras: what is localized. Poses that stand beside them are not looked at.

use std::path::{Path, PathBuf};

use lsfb_geometry::Rig;

use super::{PosedImages, layouts};
use crate::Error;

/// Endings of image files, in small letters.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

/// An image file to be localized.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct QueryImage {
    /// The file: PNG or JPEG.
    pub path: PathBuf,
    /// Name of the camera on the rig.
    pub camera: String,
}

/// Images in the order of their list, or of their names where nothing lists them, and their cameras.
#[derive(Clone, Debug, PartialEq)]
pub struct UnposedImages {
    /// The cameras, each its own rig.
    pub rig: Rig,
    /// The images.
    pub images: Vec<QueryImage>,
    /// What is not in it that the folder holds, a sentence each.
    pub notes: Vec<String>,
}

impl UnposedImages {
    /// Images of the only camera of a rig.
    pub(super) fn of_one_camera(rig: Rig, paths: Vec<PathBuf>) -> Self {
        let camera = rig.cameras.keys().next().cloned().unwrap_or_default();
        let images = paths.into_iter().map(|path| QueryImage {
            path,
            camera: camera.clone(),
        });
        Self {
            images: images.collect(),
            rig,
            notes: Vec::new(),
        }
    }

    pub(super) fn without_poses(posed: PosedImages) -> Self {
        let images = posed.images.into_iter().map(|image| QueryImage {
            path: image.path,
            camera: image.camera,
        });
        Self {
            rig: posed.rig,
            images: images.collect(),
            notes: posed.notes,
        }
    }
}

fn is_image(path: &Path) -> bool {
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    ENDINGS.iter().any(|known| ending == *known) && !path.is_dir()
}

/// The image files of a folder, by name.
pub(super) fn image_files(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut found = layouts::entries(folder)?;
    found.retain(|path| is_image(path));
    Ok(found)
}

/// The same with those of the folders in it.
pub(super) fn image_files_below(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let (mut found, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in layouts::entries(&folder)? {
            // A link to a folder above would go round in a circle.
            if entry.is_dir() && !entry.is_symlink() {
                folders.push(entry);
            } else if is_image(&entry) {
                found.push(entry);
            }
        }
    }
    found.sort();
    Ok(found)
}
