//! Cameras and images of a list, put together: whatever program wrote it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use lsfb_geometry::{Camera, Quaternion, Rig, RigCamera, Se3, UnitQuaternion, Vector3};

use super::unposed::{QueryImage, UnposedImages};
use super::{PosedImage, PosedImages, fitting};
use crate::Error;

/// Cameras and images: what is known of an image is where its camera was. Each camera is its own rig, but for those that are mounted on one.
pub(super) struct Listed {
    /// The list, for errors.
    path: PathBuf,
    rig: Rig,
    images: Vec<ListedImage>,
}

/// An image of a list.
struct ListedImage {
    path: PathBuf,
    camera: String,
    /// `None` where it is not known.
    world_from_camera: Option<Se3>,
    /// The rig that took it and when, as the list has them; `None` of a camera on no rig.
    taken: Option<(String, String)>,
}

impl Listed {
    pub(super) fn new(folder: &Path, path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            rig: Rig::empty(&folder.file_name().unwrap_or_default().to_string_lossy()),
            images: Vec::new(),
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
            sigmas: Default::default(),
        };
        self.rig.cameras.insert(name.to_owned(), mounted);
        Ok(())
    }

    /// Mounts a camera on a rig.
    pub(super) fn mount(&mut self, camera: &str, rig_from_camera: Se3) {
        if let Some(mounted) = self.rig.cameras.get_mut(camera) {
            mounted.rig_from_camera = rig_from_camera;
        }
    }

    /// Takes an image, with its pose where that is known.
    pub(super) fn add_image(
        &mut self,
        path: PathBuf,
        camera: &str,
        world_from_camera: Option<Se3>,
    ) {
        self.images.push(ListedImage {
            path,
            camera: camera.to_owned(),
            world_from_camera,
            taken: None,
        });
    }

    /// The same of a camera on a rig: images that the rig took at the same time are of one instant.
    pub(super) fn add_image_of_rig(
        &mut self,
        path: PathBuf,
        camera: &str,
        world_from_camera: Option<Se3>,
        taken: (String, String),
    ) {
        self.add_image(path, camera, world_from_camera);
        if let Some(image) = self.images.last_mut() {
            image.taken = Some(taken);
        }
    }

    /// The files of the images.
    pub(super) fn files(&self) -> BTreeSet<PathBuf> {
        self.images.iter().map(|image| image.path.clone()).collect()
    }

    /// The one camera; `None` where there are several.
    pub(super) fn only_camera(&self) -> Option<String> {
        let mut names = self.rig.cameras.keys();
        names
            .next()
            .filter(|_| self.rig.cameras.len() == 1)
            .cloned()
    }

    /// What is wrong with the list.
    pub(super) fn refuse(&self, reason: impl Into<String>) -> Error {
        Error::PosedLayout {
            path: self.path.clone(),
            reason: reason.into(),
        }
    }

    /// The images that have a pose; a list without one is an error.
    pub(super) fn posed(mut self) -> Result<PosedImages, Error> {
        let count = self.images.len();
        let mut instants: BTreeMap<(String, String), usize> = BTreeMap::new();
        let posed = std::mem::take(&mut self.images).into_iter();
        let posed = posed.filter_map(|image| {
            let mounted = self.rig.cameras.get(&image.camera)?;
            let instant = image.taken.map(|taken| {
                let next = instants.len();
                *instants.entry(taken).or_insert(next)
            });
            Some(PosedImage {
                path: image.path,
                camera: image.camera,
                world_from_rig: image.world_from_camera? * mounted.rig_from_camera.inverse(),
                instant,
            })
        });
        let images: Vec<PosedImage> = posed.collect();
        if images.is_empty() {
            return Err(self.refuse(format!("none of its {count} images has a pose")));
        }
        let unposed = count - images.len();
        let notes = match unposed {
            0 => Vec::new(),
            _ => vec![format!(
                "{unposed} of {count} images have no pose and are left out"
            )],
        };
        self.keep_cameras(|name| images.iter().any(|image| image.camera == *name));
        Ok(PosedImages {
            rig: self.rig,
            images,
            notes,
        })
    }

    /// All images, whatever is known of their poses, each camera its own rig; a list without one is an error.
    pub(super) fn unposed(mut self) -> Result<UnposedImages, Error> {
        if self.images.is_empty() {
            return Err(self.refuse("it lists no image"));
        }
        let images = std::mem::take(&mut self.images).into_iter();
        let images: Vec<QueryImage> = images
            .map(|image| QueryImage {
                path: image.path,
                camera: image.camera,
            })
            .collect();
        self.keep_cameras(|name| images.iter().any(|image| image.camera == *name));
        for mounted in self.rig.cameras.values_mut() {
            mounted.rig_from_camera = Se3::identity();
        }
        Ok(UnposedImages {
            rig: self.rig,
            images,
            notes: Vec::new(),
        })
    }

    fn keep_cameras(&mut self, is_used: impl Fn(&String) -> bool) {
        self.rig.cameras.retain(|name, _| is_used(name));
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
