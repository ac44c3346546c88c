//! Folders of images whose poses are known: the input of a map without a backpack, and queries with an answer; and of images with cameras
//! and without poses, which are queries alone.

mod colmap;
mod image_layout;
mod kapture;
mod layouts;
mod lens;
mod listed;
mod nerfstudio;
mod unposed;

use std::fs;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Camera, Matrix3, Rig, RigCamera, Se3, Vector3, so3};
use lsfb_perception::image;
use lsfb_types::Image;
use sha2::{Digest, Sha256};

use crate::Error;
use crate::camera_fit::principal_point_fits;

pub use image_layout::ImageLayout;
pub use unposed::{QueryImage, UnposedImages};

/// By how much a matrix of a list may miss being a rotation: some print three digits.
const ROTATION_ROUNDING: f64 = 1e-2;

/// An image file with the pose at which it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedImage {
    /// The file: PNG or JPEG.
    pub path: PathBuf,
    /// Name of the camera on the rig.
    pub camera: String,
    /// Pose of the rig.
    pub world_from_rig: Se3,
    /// Images with the same number were taken by one rig at one instant; `None` of an image that is alone.
    pub instant: Option<usize>,
}

/// Images with poses, in the order of their list, and the rig that took them.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedImages {
    /// The rig.
    pub rig: Rig,
    /// The images.
    pub images: Vec<PosedImage>,
    /// What is not in it that the folder lists, a sentence each.
    pub notes: Vec<String>,
}

/// Intrinsics of the one camera: a 3 × 3 matrix.
const INTRINSICS: &str = "K.txt";
/// Folder of the images.
const IMAGES: &str = "images";
/// Name of the one camera.
const CAMERA: &str = "cam0";
/// One line per image: file name and the rows of `world_from_camera`, 4 × 4.
const POSES: &str = "poses_T_world_cam_rowmajor4x4.txt";

impl PosedImages {
    /// Reads a folder of images of one undistorted pinhole camera (OpenCV axes) that is its own rig: with `K.txt`,
    /// `poses_T_world_cam_rowmajor4x4.txt` and `images/`; a sequence of 7-Scenes; or a scene of Strecha's. Or images of any cameras, each its
    /// own rig: nerfstudio's `transforms.json`, a project or model of COLMAP, or a kapture, whose rigs stay rigs.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let poses_path = folder.join(POSES);
        if !poses_path.exists() {
            if folder.join(nerfstudio::FILE).is_file() {
                return nerfstudio::read(folder)?.posed();
            }
            if folder.join(kapture::SENSORS).is_file() {
                return kapture::read(folder)?.posed();
            }
            if let Some(found) = layouts::read(folder)? {
                return Ok(found);
            }
            if let Some(model) = colmap::model_in(folder) {
                return colmap::read(folder, &model)?.posed();
            }
        }
        let text = fs::read_to_string(&poses_path).map_err(Error::io(&poses_path))?;
        let mut images = Vec::new();
        for (index, line) in text
            .lines()
            .enumerate()
            .filter(|(_, l)| !l.trim().is_empty())
        {
            let refuse = |reason| Error::PosedImages {
                path: poses_path.clone(),
                line: index + 1,
                reason,
            };
            let (name, rest) = line.trim().split_once(' ').ok_or(refuse("no pose"))?;
            let rows: [f64; 16] = numbers(rest).ok_or(refuse("the pose needs 16 numbers"))?;
            images.push(PosedImage {
                path: folder.join(IMAGES).join(name),
                camera: CAMERA.to_owned(),
                world_from_rig: rigid(&rows).ok_or(refuse("the pose is not a rigid transform"))?,
                instant: None,
            });
        }
        let Some(first) = images.first() else {
            return Err(Error::PosedImages {
                path: poses_path,
                line: 1,
                reason: "the list is empty",
            });
        };
        Ok(Self {
            rig: rig_of(folder, &first.path)?,
            images,
            notes: Vec::new(),
        })
    }
}

/// The rig of a folder of images that one undistorted pinhole camera took: its `K.txt`, and the size of `image`.
fn rig_of(folder: &Path, image: &Path) -> Result<Rig, Error> {
    let size = image::read(image)?;
    let camera = read_pinhole(&folder.join(INTRINSICS), size.width, size.height)?;
    Ok(rig_with(folder, camera))
}

/// A rig that is one camera, by the name of a folder.
fn rig_with(folder: &Path, camera: Camera) -> Rig {
    let mounted = RigCamera {
        camera,
        rig_from_camera: Se3::identity(),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    Rig {
        cameras: [(CAMERA.to_owned(), mounted)].into(),
        ..Rig::empty(&folder.file_name().unwrap_or_default().to_string_lossy())
    }
}

impl PosedImage {
    /// The pixels; refuses an image that is not as large as its camera's images are.
    pub fn read(&self, rig: &Rig) -> Result<Image, Error> {
        read_image(&self.path, &self.camera, rig)
    }
}

/// The pixels of an image of a camera of the rig; refuses an image that is not as large as that camera's images are.
pub fn read_image(path: &Path, camera: &str, rig: &Rig) -> Result<Image, Error> {
    let image = image::read(path)?;
    let mounted = rig.cameras.get(camera).ok_or(Error::UnknownCamera {
        camera: camera.to_owned(),
        rig: rig.name.clone(),
    })?;
    let expected_px = [mounted.camera.width, mounted.camera.height];
    let found_px = [image.width, image.height];
    if found_px == expected_px {
        return Ok(image);
    }
    Err(Error::ImageSize {
        path: path.to_owned(),
        camera: camera.to_owned(),
        expected_px,
        found_px,
    })
}

impl PosedImages {
    /// Every `nth` image: the fifth, the tenth … for 5. None for 0.
    pub fn every(&self, nth: usize) -> Self {
        self.filtered(|position| nth > 0 && position.is_multiple_of(nth))
    }

    /// All images but every `nth`: what a map is built from when the others are to test it.
    pub fn without_every(&self, nth: usize) -> Self {
        self.filtered(|position| nth == 0 || !position.is_multiple_of(nth))
    }

    /// The images whose position in the list, from 1, is wanted.
    fn filtered(&self, wanted: impl Fn(usize) -> bool) -> Self {
        let images = self.images.iter().enumerate();
        Self {
            rig: self.rig.clone(),
            notes: self.notes.clone(),
            images: images
                .filter(|(index, _)| wanted(index + 1))
                .map(|(_, image)| image.clone())
                .collect(),
        }
    }

    /// SHA-256 of rig, poses and image files, as hexadecimal digits: the same for a copy of the folder.
    pub fn content_hash(&self) -> Result<String, Error> {
        let mut hash = Sha256::new();
        hash.update(self.rig.to_toml());
        for image in &self.images {
            let pose = &image.world_from_rig;
            let numbers = pose.rotation.coords.iter().chain(pose.translation.iter());
            numbers.for_each(|v| hash.update(v.to_le_bytes()));
            hash.update(&image.camera);
            hash.update(fs::read(&image.path).map_err(Error::io(&image.path))?);
        }
        Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
    }
}

fn read_pinhole(path: &Path, width: u32, height: u32) -> Result<Camera, Error> {
    let text = fs::read_to_string(path).map_err(Error::io(path))?;
    let k: [f64; 9] = numbers(&text).ok_or(Error::PosedImages {
        path: path.to_owned(),
        line: 1,
        reason: "the intrinsics need 9 numbers",
    })?;
    let camera = Camera::pinhole(width, height, [k[0], k[4]], [k[2], k[5]]);
    fitting(path, camera)
}

/// The camera, unless no lens has its focal lengths, or its principal point is far from the middle of its images.
fn fitting(path: &Path, camera: Camera) -> Result<Camera, Error> {
    if camera.focal_px().iter().any(|focal_px| !(*focal_px > 0.0)) {
        return Err(Error::PosedImages {
            path: path.to_owned(),
            line: 1,
            reason: "the focal lengths must be larger than zero",
        });
    }
    if !principal_point_fits(&camera) {
        return Err(Error::PrincipalPointOffCentre {
            camera: path.display().to_string(),
            size_px: [camera.width, camera.height],
            principal_px: camera.principal_px(),
        });
    }
    Ok(camera)
}

/// Exactly `N` finite numbers.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let values: Vec<f64> = text
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
        .collect::<Option<_>>()?;
    values.try_into().ok()
}

fn rigid(rows: &[f64; 16]) -> Option<Se3> {
    let matrix = Matrix3::new(
        rows[0], rows[1], rows[2], rows[4], rows[5], rows[6], rows[8], rows[9], rows[10],
    );
    if rows[12..] != [0.0, 0.0, 0.0, 1.0] {
        return None;
    }
    let rotation = so3::from_rounded(&matrix, ROTATION_ROUNDING)?;
    Some(Se3::new(rotation, Vector3::new(rows[3], rows[7], rows[11])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_folders_are_named_with_the_line() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let message = |folder: &Path| PosedImages::read(folder).expect_err("unusable").to_string();
        assert!(message(folder.path()).contains(POSES));
        let poses = folder.path().join(POSES);
        fs::write(&poses, "").expect("write");
        assert!(message(folder.path()).contains("list is empty"));
        fs::write(
            &poses,
            "a.png 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\nb.png 1 0 0\n",
        )
        .expect("write");
        assert!(message(folder.path()).contains("line 2"));
        fs::write(&poses, "a.png 2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n").expect("write");
        assert!(message(folder.path()).contains("not a rigid transform"));
    }

    #[test]
    fn intrinsics_and_images_of_different_sizes_are_refused() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let images = folder.path().join("images");
        fs::create_dir(&images).expect("folder");
        let write = |name: &str, side: u32| {
            // A bitmap of one grey: header, then rows of three bytes per pixel.
            let mut bytes = b"BM".to_vec();
            for value in [
                54 + 3 * side * side,
                0,
                54,
                40,
                side,
                side,
                0x0018_0001,
                0,
                0,
                0,
                0,
                0,
                0,
            ] {
                bytes.extend(value.to_le_bytes());
            }
            bytes.extend(vec![128; (3 * side * side) as usize]);
            fs::write(images.join(name), bytes).expect("image");
        };
        write("a.bmp", 64);
        write("b.bmp", 32);
        let pose = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1";
        fs::write(
            folder.path().join(POSES),
            format!("a.bmp {pose}\nb.bmp {pose}\n"),
        )
        .expect("poses");
        let intrinsics = |c: f64| {
            let text = format!("60 0 {c} 0 60 {c} 0 0 1");
            fs::write(folder.path().join(INTRINSICS), text).expect("intrinsics");
        };
        intrinsics(63.5);
        let refused = PosedImages::read(folder.path()).expect_err("twice as large");
        assert!(
            matches!(refused, Error::PrincipalPointOffCentre { .. }),
            "{refused}"
        );
        intrinsics(31.5);
        let posed = PosedImages::read(folder.path()).expect("a rig");
        assert!(posed.images[0].read(&posed.rig).is_ok());
        let refused = posed.images[1].read(&posed.rig).expect_err("half as large");
        assert!(matches!(refused, Error::ImageSize { .. }), "{refused}");
    }
}
