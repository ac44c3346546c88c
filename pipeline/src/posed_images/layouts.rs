//! Folders of posed images as well-known data sets have them.

use std::fs;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Camera, Se3};
use lsfb_perception::image;

use super::{
    CAMERA, INTRINSICS, PosedImage, PosedImages, fitting, numbers, read_pinhole, rig_with, rigid,
};
use crate::Error;

/// Images of 7-Scenes end so, and the pose of each, `world_from_camera`, in a file of its own.
const COLOUR: &str = ".color.";
const POSE: &str = ".pose.txt";
/// Focal length that fits the colour images of 7-Scenes, pixels: the 585 px of its description are the depth camera's.
const SEVEN_SCENES_FOCAL_PX: f64 = 525.0;
/// A scene of Strecha's has a file for each image in this folder or one whose name begins so, else beside the images.
const STRECHA_CAMERAS: &str = "gt_dense_cameras";
const STRECHA_IMAGES: &str = "images";
const STRECHA_FILE: &str = ".camera";

/// The images of a folder in one of these layouts; `None` of any other.
pub(super) fn read(folder: &Path) -> Result<Option<PosedImages>, Error> {
    if !colour_images(folder)?.is_empty() {
        return seven_scenes(folder).map(Some);
    }
    match strecha_cameras(folder)? {
        Some(cameras) => strecha(folder, &cameras).map(Some),
        None => Ok(None),
    }
}

/// The colour images of a sequence of 7-Scenes.
pub(super) fn colour_images(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut found = entries(folder)?;
    found.retain(|path| named(path).contains(COLOUR));
    Ok(found)
}

/// The folder of the cameras of a scene of Strecha's; `None` where there is none.
pub(super) fn strecha_cameras(folder: &Path) -> Result<Option<PathBuf>, Error> {
    if !folder.join(STRECHA_IMAGES).is_dir() {
        return Ok(None);
    }
    let is_of_cameras = |p: &PathBuf| p.is_dir() && named(p).starts_with(STRECHA_CAMERAS);
    Ok(entries(folder)?.into_iter().find(is_of_cameras))
}

fn named(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// What is in a folder, by name.
pub(super) fn entries(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        found.push(entry.map_err(Error::io(folder))?.path());
    }
    found.sort();
    Ok(found)
}

/// The numbers of a file.
fn numbers_of<const N: usize>(path: &Path, reason: &'static str) -> Result<[f64; N], Error> {
    let text = fs::read_to_string(path).map_err(Error::io(path))?;
    numbers(&text).ok_or(Error::PosedImages {
        path: path.to_owned(),
        line: 1,
        reason,
    })
}

fn posed(path: &Path, file: &Path, rows: &[f64; 16]) -> Result<PosedImage, Error> {
    let world_from_rig: Se3 = rigid(rows).ok_or(Error::PosedImages {
        path: file.to_owned(),
        line: 1,
        reason: "the pose is not a rigid transform",
    })?;
    Ok(PosedImage {
        path: path.to_owned(),
        camera: CAMERA.to_owned(),
        world_from_rig,
        instant: None,
    })
}

/// `frame-NNNNNN.color.png` (or .jpg) with `frame-NNNNNN.pose.txt`.
fn seven_scenes(folder: &Path) -> Result<PosedImages, Error> {
    let colour = colour_images(folder)?;
    let images = colour.iter().map(|path| {
        let name = named(path);
        let stem = name.split(COLOUR).next().unwrap_or_default();
        let file = folder.join(format!("{stem}{POSE}"));
        posed(
            path,
            &file,
            &numbers_of(&file, "the pose needs 16 numbers")?,
        )
    });
    let images = images.collect::<Result<Vec<_>, Error>>()?;
    let first = images.first().map(|image| image.path.as_path());
    Ok(PosedImages {
        rig: rig_with(
            folder,
            seven_scenes_camera(folder, first.unwrap_or(folder))?,
        ),
        images,
        notes: Vec::new(),
    })
}

/// The camera of `K.txt` where there is one, else the one that fits the colour images of the data set.
pub(super) fn seven_scenes_camera(folder: &Path, image: &Path) -> Result<Camera, Error> {
    let size = image::read(image)?;
    let intrinsics = folder.join(INTRINSICS);
    if intrinsics.exists() {
        return read_pinhole(&intrinsics, size.width, size.height);
    }
    // Of images of another size the focal length changes with the width.
    let focal_px = SEVEN_SCENES_FOCAL_PX * f64::from(size.width) / 640.0;
    let principal_px = [size.width, size.height].map(|side| (f64::from(side) - 1.0) / 2.0);
    Ok(Camera::pinhole(
        size.width,
        size.height,
        [focal_px; 2],
        principal_px,
    ))
}

/// `images/NAME` with `NAME.camera`: `K`, three numbers that are not used, rows of the rotation and position of `world_from_camera`,
/// and the size of the images that `K` is for. All images are of the first one's camera.
fn strecha(folder: &Path, cameras: &Path) -> Result<PosedImages, Error> {
    let mut images = Vec::new();
    let mut camera = None;
    for path in entries(&folder.join(STRECHA_IMAGES))? {
        let name = named(&path);
        let file = cameras.join(format!("{name}{STRECHA_FILE}"));
        if !file.exists() {
            continue;
        }
        let v: [f64; 26] = numbers_of(&file, "a camera needs 26 numbers")?;
        let (r, c) = (&v[12..21], &v[21..24]);
        let rows = [
            r[0], r[1], r[2], c[0], r[3], r[4], r[5], c[1], r[6], r[7], r[8], c[2], 0.0, 0.0, 0.0,
            1.0,
        ];
        images.push(posed(&path, &file, &rows)?);
        if camera.is_none() {
            let size = image::read(&path)?;
            let scale = [
                f64::from(size.width) / v[24],
                f64::from(size.height) / v[25],
            ];
            let moved = |pixel: f64, scale: f64| (pixel + 0.5) * scale - 0.5;
            let focal_px = [v[0] * scale[0], v[4] * scale[1]];
            let principal_px = [moved(v[2], scale[0]), moved(v[5], scale[1])];
            let found = Camera::pinhole(size.width, size.height, focal_px, principal_px);
            camera = Some(fitting(&file, found)?);
        }
    }
    let Some(camera) = camera else {
        return Err(Error::PosedImages {
            path: cameras.to_owned(),
            line: 1,
            reason: "no file for an image",
        });
    };
    Ok(PosedImages {
        rig: rig_with(folder, camera),
        images,
        notes: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector3;

    use super::*;

    /// A grey bitmap.
    fn write_image(path: &Path, width: u32, height: u32) {
        let mut bytes = b"BM".to_vec();
        let row = (3 * width).next_multiple_of(4);
        let header = [
            54 + row * height,
            0,
            54,
            40,
            width,
            height,
            0x0018_0001,
            0,
            0,
            0,
            0,
            0,
            0,
        ];
        header
            .iter()
            .for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend(vec![128; (row * height) as usize]);
        fs::write(path, bytes).expect("image");
    }

    const TURNED: &str = "0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n";

    #[test]
    fn sequences_of_seven_scenes_are_read() {
        let scratch = tempfile::tempdir().expect("scratch folder");
        let folder = scratch.path();
        for number in [20, 0] {
            write_image(
                &folder.join(format!("frame-{number:06}.color.bmp")),
                320,
                240,
            );
            fs::write(folder.join(format!("frame-{number:06}.pose.txt")), TURNED).expect("pose");
        }
        let found = PosedImages::read(folder).expect("reads");
        assert_eq!(found.images.len(), 2);
        assert!(found.images[0].path.ends_with("frame-000000.color.bmp"));
        let moved = found.images[1].world_from_rig * Vector3::new(1.0, 0.0, 0.0);
        assert!((moved - Vector3::new(1.0, 3.0, 3.0)).norm() < 1e-12);
        let camera = found.rig.cameras[CAMERA].camera;
        assert_eq!(
            (camera.focal_px(), camera.principal_px()),
            ([262.5; 2], [159.5, 119.5])
        );
        // Whoever knows better says so.
        fs::write(folder.join(INTRINSICS), "300 0 159.5 0 301 119.5 0 0 1").expect("intrinsics");
        let found = PosedImages::read(folder).expect("reads");
        assert_eq!(found.rig.cameras[CAMERA].camera.focal_px(), [300.0, 301.0]);
        fs::write(folder.join("frame-000020.pose.txt"), "1 2 3").expect("pose");
        let error = PosedImages::read(folder).expect_err("no pose").to_string();
        assert!(error.contains("frame-000020.pose.txt"), "{error}");
    }

    #[test]
    fn scenes_of_strecha_are_read_at_the_size_of_their_images() {
        let scratch = tempfile::tempdir().expect("scratch folder");
        let folder = scratch.path();
        let cameras = folder.join("gt_dense_cameras_fullres");
        for inner in [&folder.join("images"), &cameras] {
            fs::create_dir(inner).expect("folder");
        }
        let file = "600 0 319.5\n0 610 239.5\n0 0 1\n0 0 0\n0 -1 0\n1 0 0\n0 0 1\n1 2 3\n640 480\n";
        let missing = PosedImages::read(folder).expect_err("empty").to_string();
        assert!(missing.contains("no file for an image"), "{missing}");
        for name in ["0000.bmp", "0001.bmp"] {
            write_image(&folder.join("images").join(name), 320, 240);
            fs::write(cameras.join(format!("{name}.camera")), file).expect("camera");
        }
        write_image(&folder.join("images/without.bmp"), 320, 240);
        let found = PosedImages::read(folder).expect("reads");
        assert_eq!(found.images.len(), 2);
        let moved = found.images[0].world_from_rig * Vector3::new(1.0, 0.0, 0.0);
        assert!((moved - Vector3::new(1.0, 3.0, 3.0)).norm() < 1e-12);
        let camera = found.rig.cameras[CAMERA].camera;
        assert_eq!(
            (camera.focal_px(), camera.principal_px()),
            ([300.0, 305.0], [159.5, 119.5])
        );
        fs::write(cameras.join("0001.bmp.camera"), file.replace("600", "x")).expect("camera");
        let error = PosedImages::read(folder)
            .expect_err("no number")
            .to_string();
        assert!(error.contains("0001.bmp.camera"), "{error}");
    }
}
