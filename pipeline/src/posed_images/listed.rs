//! Cameras and images of a list, put together: whatever program wrote it.

use std::path::{Path, PathBuf};

use lsfb_geometry::{Camera, Quaternion, Rig, RigCamera, Se3, UnitQuaternion, Vector3};

use super::{PosedImage, PosedImages, fitting};
use crate::Error;

/// Cameras and images, each camera its own rig: what is known of an image is where its camera was.
pub(super) struct Listed {
    /// The list, for errors.
    path: PathBuf,
    rig: Rig,
    images: Vec<PosedImage>,
    /// Images without a pose.
    unposed: usize,
}

impl Listed {
    pub(super) fn new(folder: &Path, path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            rig: Rig::empty(&folder.file_name().unwrap_or_default().to_string_lossy()),
            images: Vec::new(),
            unposed: 0,
        }
    }

    pub(super) fn has_camera(&self, name: &str) -> bool {
        self.rig.cameras.contains_key(name)
    }

    /// The name of a camera that is there already.
    pub(super) fn same_camera(&self, camera: &Camera) -> Option<String> {
        let mut cameras = self.rig.cameras.iter();
        let found = cameras.find(|(_, known)| known.camera == *camera);
        found.map(|(name, _)| name.clone())
    }

    /// Takes a camera; refuses one whose principal point is far from the middle of its images.
    pub(super) fn add_camera(&mut self, name: &str, camera: Camera) -> Result<(), Error> {
        let mounted = RigCamera {
            camera: fitting(&self.path, camera)?,
            rig_from_camera: Se3::identity(),
            timing: Default::default(),
        };
        self.rig.cameras.insert(name.to_owned(), mounted);
        Ok(())
    }

    pub(super) fn add_image(&mut self, path: PathBuf, camera: &str, world_from_camera: Se3) {
        self.images.push(PosedImage {
            path,
            camera: camera.to_owned(),
            world_from_rig: world_from_camera,
        });
    }

    /// Counts an image whose pose is not known.
    pub(super) fn add_unposed(&mut self) {
        self.unposed += 1;
    }

    pub(super) fn image_count(&self) -> usize {
        self.images.len() + self.unposed
    }

    /// What is wrong with the list.
    pub(super) fn refuse(&self, reason: impl Into<String>) -> Error {
        Error::PosedLayout {
            path: self.path.clone(),
            reason: reason.into(),
        }
    }

    /// The images; a list without one is an error.
    pub(super) fn finish(mut self) -> Result<PosedImages, Error> {
        if self.images.is_empty() {
            return Err(self.refuse(format!(
                "none of its {} images has a pose",
                self.image_count()
            )));
        }
        let mut notes = Vec::new();
        if self.unposed > 0 {
            notes.push(format!(
                "{} of {} images have no pose and are left out",
                self.unposed,
                self.image_count()
            ));
        }
        let images = &self.images;
        let is_used = |name: &String| images.iter().any(|image| image.camera == *name);
        self.rig.cameras.retain(|name, _| is_used(name));
        Ok(PosedImages {
            rig: self.rig,
            images: self.images,
            notes,
        })
    }
}

/// A pose from a quaternion w x y z and a translation; `None` where the quaternion is no rotation.
pub(super) fn pose(q: [f64; 4], t: [f64; 3]) -> Option<Se3> {
    let [w, x, y, z] = q;
    let quaternion = Quaternion::new(w, x, y, z);
    let is_rotation = (quaternion.norm() - 1.0).abs() < 1e-2;
    let is_finite = t.iter().all(|v| v.is_finite());
    (is_rotation && is_finite)
        .then(|| Se3::new(UnitQuaternion::new_normalize(quaternion), Vector3::from(t)))
}
