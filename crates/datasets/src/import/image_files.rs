//! The image files of a recording where they lie, for who wants images and no recording.

use std::path::{Path, PathBuf};

use lsfb_geometry::Rig;
use lsfb_types::{ProgressFn, Timestamp};

use super::collected::Collected;
use super::format::euroc_folder;
use super::payload::{Payload, Pixels};
use super::{Format, ImportConfig, readers};
use crate::Error;

/// An image file of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageFile {
    /// When it was taken.
    pub time: Timestamp,
    /// The folder of its camera, which is its name in the rig: `cam0`.
    pub camera: String,
    /// The file.
    pub path: PathBuf,
}

/// The images of a recording of EuRoC or TUM-VI.
#[derive(Clone, Debug, PartialEq)]
pub struct EurocImages {
    /// Of `sensor.yaml`; `None` where there is none.
    pub rig: Option<Rig>,
    /// In order of time, those of one instant by their cameras.
    pub images: Vec<ImageFile>,
    /// Lines of the lists that name no image, a sentence for each list.
    pub notes: Vec<String>,
}

/// The image files of a folder of EuRoC or TUM-VI (`mav0`, or the folder that has it); `None` of any other folder.
pub fn euroc_images(folder: &Path, progress: ProgressFn<'_>) -> Result<Option<EurocImages>, Error> {
    if euroc_folder(folder).is_none() {
        return Ok(None);
    }
    let mut found = Collected::default();
    readers::read(
        Format::Euroc,
        folder,
        &ImportConfig::default(),
        &mut found,
        progress,
    )?;
    let (mut images, mut notes) = (Vec::new(), Vec::new());
    for stream in found.streams {
        let Some(camera) = stream.topic.strip_suffix("/image") else {
            continue;
        };
        if let Some(problem) = &stream.counts.first_problem {
            notes.push(format!(
                "{} lines of {} do not name an image; the first: {problem}",
                stream.counts.unreadable, stream.what
            ));
        }
        let files = stream.records.into_iter().filter_map(|record| {
            let Payload::Image(image) = record.payload else {
                return None;
            };
            let Pixels::File(path) = image.pixels else {
                return None;
            };
            Some(ImageFile {
                time: record.time,
                camera: camera.to_owned(),
                path,
            })
        });
        images.extend(files);
    }
    images.sort_by(|a, b| (a.time, &a.camera).cmp(&(b.time, &b.camera)));
    Ok(Some(EurocImages {
        rig: found.rig,
        images,
        notes,
    }))
}
