//! Views of a board from folders of images and from recordings.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_datasets::RosBag;
use lsfb_perception::image;
use lsfb_recording::{Recording, sort_naturally};
use lsfb_types::{Image, Progress, ProgressFn, SharedProgress, Stopped};
use rayon::prelude::*;

use super::CameraViews;
use crate::board::Target;
use crate::detect::{Corner, Instead, detect, seen_instead};
use crate::{Error, SeenInstead};

/// The JPEG, PNG and BMP files of a folder in the order of their names; numbers in names count as numbers.
pub fn image_files(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let io = |source| Error::Io {
        path: folder.display().to_string(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let extension = path.extension().map(|e| e.to_ascii_lowercase());
        if extension.is_some_and(|e| {
            ["jpg", "jpeg", "png", "bmp"]
                .iter()
                .any(|known| e == *known)
        }) {
            files.push(path);
        }
    }
    sort_naturally(&mut files);
    Ok(files)
}

/// One image's part in a [`CameraViews`].
struct Looked {
    instant: i64,
    width: u32,
    height: u32,
    corners: Vec<Corner>,
    /// Where there are none.
    instead: Option<Instead>,
}

/// Finds the target in all images of a folder whose names begin with `prefix` (all of them if it is empty). The number in a
/// file's name is its instant, so that `left07.png` and `right07.png` belong together.
pub fn views_from_folder(
    name: &str,
    folder: &Path,
    prefix: &str,
    target: &Target,
    progress: ProgressFn,
) -> Result<CameraViews, Error> {
    let files = numbered(folder, prefix)?;
    let done = SharedProgress::new("corners", files.len(), progress);
    let looked: Result<Vec<Looked>, Error> = files
        .par_iter()
        .map(|(instant, file)| {
            let looked = look(*instant, &image::read(file)?, target);
            done.one_more()?;
            Ok(looked)
        })
        .collect();
    gather(name, target, looked?)
}

/// The image of a folder that has an instant in [`views_from_folder`]; `None` where there is none.
pub fn image_from_folder(
    folder: &Path,
    prefix: &str,
    instant: i64,
) -> Result<Option<Image>, Error> {
    let files = numbered(folder, prefix)?;
    let file = files.iter().find(|(own, _)| *own == instant);
    Ok(file.map(|(_, file)| image::read(file)).transpose()?)
}

/// Images of a folder whose names begin with `prefix`, each with its instant.
fn numbered(folder: &Path, prefix: &str) -> Result<Vec<(i64, PathBuf)>, Error> {
    let all = image_files(folder)?;
    let in_folder = all.len();
    let files: Vec<PathBuf> = all
        .into_iter()
        .filter(|f| {
            f.file_name()
                .is_some_and(|n| n.to_string_lossy().starts_with(prefix))
        })
        .collect();
    if files.is_empty() {
        return Err(Error::Parse {
            path: folder.display().to_string(),
            problem: match in_folder {
                0 => "no image in this folder: expected JPEG, PNG or BMP files".to_owned(),
                n => format!("no name of its {n} images begins with {prefix}"),
            },
        });
    }
    let numbers: Option<Vec<i64>> = files.iter().map(|f| last_number(f)).collect();
    // Names without numbers count in their order.
    let distinct = |n: &Vec<i64>| n.windows(2).all(|w| w[0] < w[1]);
    let instants = numbers
        .filter(distinct)
        .unwrap_or_else(|| (0..files.len() as i64).collect());
    Ok(instants.into_iter().zip(files).collect())
}

/// Finds the target in the images of a recording's camera; the synchronized time is the instant.
pub fn views_from_recording(
    name: &str,
    recording: &Recording,
    target: &Target,
    progress: ProgressFn,
) -> Result<CameraViews, Error> {
    let unreadable = |e: lsfb_recording::Error| Error::Parse {
        path: format!("camera {name}"),
        problem: e.to_string(),
    };
    let mut looking = Looking::new(target, progress);
    for image in recording.images(name).map_err(unreadable)? {
        let image = image.map_err(unreadable)?;
        looking.push(image.time.nanos(), image.sample)?;
    }
    gather(name, target, looking.finish()?)
}

/// Finds the target in the images of a topic of a ROS bag; the stamp in the message's header is the instant.
pub fn views_from_bag(
    name: &str,
    bag: &RosBag,
    topic: &str,
    target: &Target,
    progress: ProgressFn,
) -> Result<CameraViews, Error> {
    let mut looking = Looking::new(target, progress);
    bag.images(topic, &mut |stamp, image| {
        Ok::<(), Error>(looking.push(stamp, image)?)
    })?;
    gather(name, target, looking.finish()?)
}

/// Images that are read one after the other and looked at in parallel, a few dozen at a time: an hour does not fit in memory.
struct Looking<'a> {
    target: &'a Target,
    progress: ProgressFn<'a>,
    batch: Vec<(i64, Image)>,
    looked: Vec<Looked>,
}

impl<'a> Looking<'a> {
    const AT_ONCE: usize = 32;

    fn new(target: &'a Target, progress: ProgressFn<'a>) -> Self {
        Self {
            target,
            progress,
            batch: Vec::with_capacity(Self::AT_ONCE),
            looked: Vec::new(),
        }
    }

    fn push(&mut self, instant: i64, image: Image) -> Result<(), Stopped> {
        self.batch.push((instant, image));
        if self.batch.len() == Self::AT_ONCE {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Stopped> {
        let found: Vec<Looked> = self
            .batch
            .par_iter()
            .map(|(instant, image)| look(*instant, image, self.target))
            .collect();
        self.looked.extend(found);
        self.batch.clear();
        (self.progress)(Progress {
            stage: "corners",
            done: self.looked.len() as u64,
            total: 0,
        })
    }

    fn finish(mut self) -> Result<Vec<Looked>, Stopped> {
        self.flush()?;
        Ok(self.looked)
    }
}

fn look(instant: i64, image: &Image, target: &Target) -> Looked {
    let corners = detect(image, target);
    Looked {
        instant,
        width: image.width,
        height: image.height,
        instead: if corners.is_empty() {
            seen_instead(image, target)
        } else {
            None
        },
        corners,
    }
}

/// Fails where the target is never seen, but something that tells why.
fn gather(name: &str, target: &Target, looked: Vec<Looked>) -> Result<CameraViews, Error> {
    let images = looked.len();
    let count = |what| looked.iter().filter(|l| l.instead == Some(what)).count();
    let [mirrored, others] = [Instead::Mirrored, Instead::OtherTags].map(count);
    if looked.iter().all(|l| l.corners.is_empty()) && mirrored + others > 0 {
        return Err(Error::OtherTarget {
            camera: name.to_owned(),
            target: target.describe(),
            images,
            instead: match mirrored >= others {
                true => SeenInstead::Mirrored { images: mirrored },
                false => SeenInstead::OtherTags { images: others },
            },
        });
    }
    let (width, height) = looked.first().map_or((0, 0), |l| (l.width, l.height));
    let mut views = BTreeMap::new();
    for l in looked {
        if (l.width, l.height) != (width, height) {
            return Err(Error::Parse {
                path: format!("camera {name}"),
                problem: format!(
                    "image {} is {} × {} pixels, but earlier ones are {width} × {height}: all images of a camera must have the same size",
                    l.instant, l.width, l.height
                ),
            });
        }
        if !l.corners.is_empty() {
            views.insert(l.instant, l.corners);
        }
    }
    Ok(CameraViews {
        name: name.to_owned(),
        width,
        height,
        images,
        views,
    })
}

/// The last number in the name of a file.
pub(crate) fn last_number(file: &Path) -> Option<i64> {
    let stem = file.file_stem()?.to_string_lossy().into_owned();
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |k| k + 1);
    stem.get(start..end)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_number_of_a_name_is_its_instant() {
        let number = |name: &str| last_number(Path::new(name));
        assert_eq!(number("a/left07.png"), Some(7));
        assert_eq!(
            number("1520527975564013167.jpg"),
            Some(1_520_527_975_564_013_167)
        );
        assert_eq!(number("cam2_image12b.png"), Some(12));
        assert_eq!(number("board.png"), None);
        assert_eq!(number("99999999999999999999.png"), None);
    }
}
