//! COLMAP's sparse model, text or binary (COLMAP's documentation, "Output Format"): poses take points of the world into the camera. The images
//! lie in `images` beside the model's folder, as COLMAP's own tools place them.

use std::path::{Path, PathBuf};

use lsfb_geometry::Se3;
use lsfb_geometry::camera::ColmapModel;

use super::lens::camera;
use super::listed::{Listed, pose};
use super::unposed::{UnposedImages, image_files_below};
use crate::Error;

/// Where a project has its model.
const MODELS: [&str; 3] = [".", "sparse/0", "sparse"];
/// Bytes of one image point: two coordinates and the number of its 3D point.
const POINT_BYTES: usize = 24;
/// Longest name of an image that is believed.
const MAX_NAME_BYTES: usize = 4_096;
const KINDS: [&str; 2] = ["txt", "bin"];
/// The folder of the model of a project; `None` where there is none.
pub(super) fn model_in(folder: &Path) -> Option<PathBuf> {
    let mut models = MODELS.iter().map(|model| folder.join(model));
    models.find(|model| KINDS.iter().any(|kind| is_model(model, kind)))
}

/// The same where images need not be listed.
pub(super) fn cameras_in(folder: &Path) -> Option<PathBuf> {
    let mut models = MODELS.iter().map(|model| folder.join(model));
    let has_cameras = |model: &PathBuf| KINDS.iter().any(|kind| has(model, "cameras", kind));
    model_in(folder).or_else(|| models.find(has_cameras))
}

fn has(model: &Path, name: &str, kind: &str) -> bool {
    model.join(format!("{name}.{kind}")).is_file()
}

fn is_model(model: &Path, kind: &str) -> bool {
    has(model, "cameras", kind) && has(model, "images", kind)
}

/// The images that a model lists.
pub(super) fn read(folder: &Path, model: &Path) -> Result<Listed, Error> {
    let is_text = is_model(model, "txt");
    let kind = if is_text { "txt" } else { "bin" };
    let images = model.join(format!("images.{kind}"));
    let mut listed = Listed::new(folder, &images);
    add_cameras(model, is_text, &mut listed)?;
    let bytes = std::fs::read(&images).map_err(Error::io(&images))?;
    let found = match is_text {
        true => text::images(&bytes),
        false => binary::images(&bytes),
    };
    let beside = images_of(folder, model);
    for image in found.map_err(|problem| listed.refuse(problem))? {
        let camera = name_of(image.camera);
        let fail = |why: &str| listed.refuse(format!("image {}: {why}", image.name));
        if !listed.has_camera(&camera) {
            return Err(fail("its camera is missing"));
        }
        let camera_from_world = image.camera_from_world;
        let pose = camera_from_world.ok_or_else(|| fail("its pose is not a rigid transform"))?;
        listed.add_image(beside.join(&image.name), &camera, Some(pose.inverse()));
    }
    Ok(listed)
}

/// All images of a project: COLMAP lists those alone that it could place.
pub(super) fn read_all(folder: &Path, model: &Path) -> Result<UnposedImages, Error> {
    let is_listed = KINDS.iter().any(|kind| is_model(model, kind));
    let mut listed = match is_listed {
        true => read(folder, model)?,
        false => {
            let mut listed = Listed::new(folder, model);
            add_cameras(model, has(model, "cameras", "txt"), &mut listed)?;
            listed
        }
    };
    let beside = images_of(folder, model);
    // A project without a folder of images may have others than those in it: depths, masks.
    let is_searched = beside != folder || !is_listed;
    let mut others = match is_searched {
        true => image_files_below(&beside)?,
        false => Vec::new(),
    };
    let known = listed.files();
    others.retain(|path| !known.contains(path));
    match listed.only_camera() {
        Some(camera) => {
            for path in others {
                listed.add_image(path, &camera, None);
            }
            listed.unposed()
        }
        None if is_listed => {
            let mut found = listed.unposed()?;
            if !others.is_empty() {
                found.notes.push(format!(
                    "{} images that the model does not list are left out: the model does not say which of its cameras took them",
                    others.len()
                ));
            }
            Ok(found)
        }
        None => Err(listed.refuse(
            "it has several cameras, and no list of images that says which camera took which: name the folder of one camera's images and pass --rig",
        )),
    }
}

fn add_cameras(model: &Path, is_text: bool, listed: &mut Listed) -> Result<(), Error> {
    let kind = if is_text { "txt" } else { "bin" };
    let path = model.join(format!("cameras.{kind}"));
    let of_cameras = |problem: String| Error::PosedLayout {
        path: path.clone(),
        reason: problem,
    };
    let bytes = std::fs::read(&path).map_err(Error::io(&path))?;
    let found = match is_text {
        true => text::cameras(&bytes),
        false => binary::cameras(&bytes),
    };
    for found in found.map_err(of_cameras)? {
        let lens = camera(&found.model, found.size, &found.parameters);
        let lens = lens.map_err(|why| of_cameras(format!("camera {}: {why}", found.number)))?;
        listed.add_camera(&name_of(found.number), lens)?;
    }
    Ok(())
}

/// The folder that the names of images are in.
fn images_of(folder: &Path, model: &Path) -> PathBuf {
    let above = [
        Some(folder),
        model.parent(),
        model.parent().and_then(Path::parent),
    ];
    let mut beside = above.into_iter().flatten().map(|f| f.join("images"));
    beside
        .find(|images| images.is_dir())
        .unwrap_or_else(|| folder.to_owned())
}

fn name_of(camera: u32) -> String {
    format!("cam{camera}")
}

struct FoundCamera {
    number: u32,
    model: String,
    size: [u32; 2],
    parameters: Vec<f64>,
}

struct FoundImage {
    name: String,
    camera: u32,
    camera_from_world: Option<Se3>,
}

mod text {
    use super::*;

    fn lines(bytes: &[u8]) -> Result<impl Iterator<Item = (usize, &str)>, String> {
        let text = std::str::from_utf8(bytes).map_err(|_| "it is not text".to_owned())?;
        let lines = text
            .lines()
            .enumerate()
            .map(|(k, line)| (k + 1, line.trim()));
        Ok(lines.filter(|(_, line)| !line.starts_with('#')))
    }

    pub(super) fn cameras(bytes: &[u8]) -> Result<Vec<FoundCamera>, String> {
        let filled = lines(bytes)?.filter(|(_, line)| !line.is_empty());
        let found = filled.map(|(number, line)| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let fail = || format!("line {number}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS");
            let [id, model, width, height, parameters @ ..] = &words[..] else {
                return Err(fail());
            };
            let count = |word: &str| word.parse::<u32>().map_err(|_| fail());
            let parameters = parameters.iter().map(|w| w.parse().map_err(|_| fail()));
            Ok(FoundCamera {
                number: count(id)?,
                model: (*model).to_owned(),
                size: [count(width)?, count(height)?],
                parameters: parameters.collect::<Result<_, String>>()?,
            })
        });
        found.collect()
    }

    /// Every other line is of an image's points, and empty where it has none.
    pub(super) fn images(bytes: &[u8]) -> Result<Vec<FoundImage>, String> {
        let mut found = Vec::new();
        let mut all = lines(bytes)?;
        while let Some((number, line)) = all.next() {
            if line.is_empty() {
                continue;
            }
            let fail = || format!("line {number}: expected IMAGE_ID, a pose, CAMERA_ID and NAME");
            let mut words = line.splitn(10, ' ');
            let mut word = || words.next().ok_or_else(fail);
            word()?;
            let mut numbers = [0.0; 7];
            for number in &mut numbers {
                *number = word()?.parse().map_err(|_| fail())?;
            }
            let camera = word()?.parse().map_err(|_| fail())?;
            let [w, x, y, z, t @ ..] = numbers;
            found.push(FoundImage {
                name: word()?.to_owned(),
                camera,
                camera_from_world: pose([w, x, y, z], t),
            });
            // Its points.
            all.next();
        }
        Ok(found)
    }
}

mod binary {
    use super::*;

    pub(super) fn cameras(bytes: &[u8]) -> Result<Vec<FoundCamera>, String> {
        let mut rest = Rest(bytes);
        let count = rest.u64()?;
        let mut found = Vec::new();
        for _ in 0..count {
            let number = rest.u32()?;
            let model = rest.u32()?;
            let model = ColmapModel::from_number(model)
                .ok_or_else(|| format!("camera model {model} is not supported"))?;
            let side = |v: u64| {
                u32::try_from(v).map_err(|_| "the image size of a camera is invalid".to_owned())
            };
            found.push(FoundCamera {
                number,
                model: model.name().to_owned(),
                size: [side(rest.u64()?)?, side(rest.u64()?)?],
                parameters: (0..model.parameter_count())
                    .map(|_| rest.f64())
                    .collect::<Result<_, _>>()?,
            });
        }
        rest.end(found)
    }

    pub(super) fn images(bytes: &[u8]) -> Result<Vec<FoundImage>, String> {
        let mut rest = Rest(bytes);
        let count = rest.u64()?;
        let mut found = Vec::new();
        for _ in 0..count {
            rest.u32()?;
            let mut numbers = [0.0; 7];
            for number in &mut numbers {
                *number = rest.f64()?;
            }
            let camera = rest.u32()?;
            let name = rest.name()?;
            let points = usize::try_from(rest.u64()?).ok();
            let length = points.and_then(|points| points.checked_mul(POINT_BYTES));
            rest.take(length.ok_or_else(cut)?)?;
            let [w, x, y, z, t @ ..] = numbers;
            found.push(FoundImage {
                name,
                camera,
                camera_from_world: pose([w, x, y, z], t),
            });
        }
        rest.end(found)
    }

    fn cut() -> String {
        "the file is truncated".to_owned()
    }

    /// What is not read yet.
    struct Rest<'a>(&'a [u8]);

    impl<'a> Rest<'a> {
        fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
            let (taken, rest) = self.0.split_at_checked(length).ok_or_else(cut)?;
            self.0 = rest;
            Ok(taken)
        }

        fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
            self.take(N)?.try_into().map_err(|_| cut())
        }

        fn u64(&mut self) -> Result<u64, String> {
            self.array().map(u64::from_le_bytes)
        }

        fn u32(&mut self) -> Result<u32, String> {
            self.array().map(u32::from_le_bytes)
        }

        fn f64(&mut self) -> Result<f64, String> {
            self.array().map(f64::from_le_bytes)
        }

        /// Up to a zero byte.
        fn name(&mut self) -> Result<String, String> {
            let length = self.0.iter().take(MAX_NAME_BYTES).position(|b| *b == 0);
            let length = length.ok_or("the name of an image is not terminated")?;
            let name = String::from_utf8_lossy(self.take(length)?).into_owned();
            self.take(1)?;
            Ok(name)
        }

        /// What was found, where nothing is left.
        fn end<T>(&self, found: T) -> Result<T, String> {
            match self.0.len() {
                0 => Ok(found),
                more => Err(format!("{more} bytes too many")),
            }
        }
    }
}
