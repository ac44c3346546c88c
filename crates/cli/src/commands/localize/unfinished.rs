//! Images that were localized before the command was stopped: kept in `OUT.unfinished` until the result is there, so that the same
//! command goes on behind them.
//!
//! The file is TOML: its numbers come back bit for bit, infinite ones too, so that the result is the same as without a stop.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_geometry::Se3;
use lsfb_pipeline::posed_images::QueryImage;
use lsfb_recording::{Provenance, sha256_of};
use serde::{Deserialize, Serialize};

use super::frames::Frame;
use super::matches::{self, Inliers};

/// Images localized between two looks at what is kept.
const PART: usize = 64;
/// What begins an image in the file.
const IMAGE: &str = "[[image]]";

/// An image that is to be localized, and the pose that a list gives it.
#[derive(Clone, Copy)]
pub struct Asked<'a> {
    /// As its frame is called: no other image of the command is called so, where its folder lists it.
    pub name: &'a str,
    pub image: &'a QueryImage,
    pub listed: Option<&'a Se3>,
}

/// What became of an image.
pub struct Answer {
    pub frame: Frame,
    pub inliers: Inliers,
}

/// What is known of images by their names.
pub struct Unfinished {
    path: PathBuf,
    head: Head,
    known: BTreeMap<String, KeptImage>,
    /// Open once something was kept by this process.
    file: Option<File>,
}

/// What all images of a file have in common.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
struct Head {
    /// Another build may find other poses.
    program_sha256: String,
    /// Map, rig and settings.
    made_from: String,
}

#[derive(Clone, PartialEq, Serialize, Deserialize)]
struct KeptImage {
    /// Of the image file.
    sha256: String,
    camera: String,
    /// Rotation x y z w and translation of the pose that the list gave, which the frame is compared with.
    listed: Option<[f64; 7]>,
    /// A word of [`matches::kept`].
    inliers: String,
    frame: Frame,
}

#[derive(Deserialize)]
struct Kept {
    #[serde(flatten)]
    head: Head,
    #[serde(default)]
    image: Vec<KeptImage>,
}

#[derive(Serialize)]
struct Images<'a> {
    image: &'a [KeptImage],
}

impl Unfinished {
    /// What was kept beside a result that was to be made of the same; nothing where that cannot be read or is of something else.
    pub fn open(
        result: &Path,
        program_sha256: String,
        made_from: &Provenance,
    ) -> anyhow::Result<Self> {
        let mut name = result.file_name().unwrap_or_default().to_os_string();
        name.push(".unfinished");
        let path = result.with_file_name(name);
        let head = Head {
            program_sha256,
            made_from: serde_json::to_string(made_from)?,
        };
        let known = std::fs::read_to_string(&path)
            .ok()
            .and_then(|text| read(&text));
        let known = known.filter(|kept| kept.head == head);
        let images = known.into_iter().flat_map(|kept| kept.image);
        Ok(Self {
            path,
            head,
            known: images
                .map(|kept| (kept.frame.frame.clone(), kept))
                .collect(),
            file: None,
        })
    }

    /// How many images are known.
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// What became of each image, in their order: of those that are known what was found, of the others what `localize` finds, which
    /// is kept before more of them are asked for. `localize` is told how many are done.
    pub fn complete(
        &mut self,
        images: &[Asked],
        mut localize: impl FnMut(usize, &[Asked]) -> anyhow::Result<Vec<Answer>>,
    ) -> anyhow::Result<Vec<Answer>> {
        let known = images.iter().map(|asked| self.known_of(asked));
        let mut answers: Vec<Option<Answer>> = known.collect::<anyhow::Result<_>>()?;
        let missing: Vec<usize> = (0..images.len())
            .filter(|k| answers[*k].is_none())
            .collect();
        for part in missing.chunks(PART) {
            let asked: Vec<Asked> = part.iter().map(|k| images[*k]).collect();
            let done = answers.iter().flatten().count();
            let found = localize(done, &asked)?;
            self.keep(&asked, &found)?;
            for (k, answer) in part.iter().zip(found) {
                answers[*k] = Some(answer);
            }
        }
        Ok(answers.into_iter().flatten().collect())
    }

    /// Takes away what was kept: the result is there.
    pub fn remove(self) -> anyhow::Result<()> {
        match self.path.exists() {
            true => {
                std::fs::remove_file(&self.path).with_context(|| self.path.display().to_string())
            }
            false => Ok(()),
        }
    }

    fn known_of(&self, asked: &Asked) -> anyhow::Result<Option<Answer>> {
        let Some(kept) = self.known.get(asked.name) else {
            return Ok(None);
        };
        let is_same = kept.camera == asked.image.camera
            && kept.listed == asked.listed.map(numbers)
            && kept.sha256 == sha256_of(&asked.image.path)?;
        let inliers = matches::of_kept(&kept.inliers).filter(|_| is_same);
        Ok(inliers.map(|inliers| Answer {
            frame: kept.frame.clone(),
            inliers: Inliers {
                cameras: vec![kept.camera.clone()],
                inliers,
            },
        }))
    }

    fn keep(&mut self, asked: &[Asked], found: &[Answer]) -> anyhow::Result<()> {
        let kept = asked.iter().zip(found).map(|(asked, found)| {
            anyhow::Ok(KeptImage {
                sha256: sha256_of(&asked.image.path)?,
                camera: asked.image.camera.clone(),
                listed: asked.listed.map(numbers),
                inliers: matches::kept(&found.inliers.inliers),
                frame: found.frame.clone(),
            })
        });
        let kept: Vec<KeptImage> = kept.collect::<anyhow::Result<_>>()?;
        let written = self.append(&kept);
        written.with_context(|| self.path.display().to_string())
    }

    fn append(&mut self, kept: &[KeptImage]) -> anyhow::Result<()> {
        let text = toml::to_string(&Images { image: kept })?;
        let mut file = match self.file.take() {
            Some(file) => file,
            None => {
                // What was cut off or is of something else goes; what is known stays, also if this is stopped at once.
                let mut before = toml::to_string(&self.head)?;
                let known: Vec<KeptImage> = self.known.values().cloned().collect();
                if !known.is_empty() {
                    before = format!("{before}\n{}", toml::to_string(&Images { image: &known })?);
                }
                let part = self.path.with_extension("part");
                std::fs::write(&part, before)?;
                std::fs::rename(&part, &self.path)?;
                File::options().append(true).open(&self.path)?
            }
        };
        // In one piece: whoever stops the process leaves whole images and at most one that is cut.
        file.write_all(format!("\n{text}").as_bytes())?;
        self.file = Some(file);
        Ok(())
    }
}

/// What stands in a file; the image at its end may be cut off.
fn read(text: &str) -> Option<Kept> {
    let whole = toml::from_str(text).ok();
    whole.or_else(|| toml::from_str(text.get(..text.rfind(IMAGE)?)?).ok())
}

fn numbers(pose: &Se3) -> [f64; 7] {
    let (rotation, translation) = (pose.rotation.coords, pose.translation);
    let both = rotation.iter().chain(translation.iter());
    let mut numbers = [0.0; 7];
    numbers
        .iter_mut()
        .zip(both)
        .for_each(|(to, from)| *to = *from);
    numbers
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use lsfb_pipeline::localization::FeatureMatch;
    use lsfb_types::Stopped;

    use super::super::frames::tests::{frame, not_found};
    use super::*;

    fn images(folder: &Path, count: usize) -> Vec<QueryImage> {
        let image = |k: usize| {
            let path = folder.join(format!("{k:04}.png"));
            std::fs::write(&path, format!("image {k}")).expect("image");
            QueryImage {
                path,
                camera: "cam0".to_owned(),
            }
        };
        (0..count).map(image).collect()
    }

    /// As it would be without a stop: every third image shows another place.
    fn found(asked: &[Asked]) -> Vec<Answer> {
        let each = asked.iter().map(|asked| {
            let name = crate::files::name_of(&asked.image.path);
            let k: u32 = name[..4].parse().expect("a number");
            let inliers = (0..k % 3).map(|i| FeatureMatch {
                point: u32::MAX - k,
                frame: 0,
                keypoint: i,
                pixel: [k as f32 / 7.0, -0.5],
            });
            Answer {
                inliers: Inliers {
                    cameras: vec![asked.image.camera.clone()],
                    inliers: inliers.collect(),
                },
                frame: match k % 3 {
                    0 => not_found(name),
                    _ => frame(name, 0.1 * f64::from(k) + 1e-17, asked.listed),
                },
            }
        });
        each.collect()
    }

    #[test]
    fn what_was_localized_before_a_stop_is_taken_bit_for_bit() {
        let folder = tempfile::tempdir().expect("folder");
        let out = folder.path().join("found.csv");
        let images = images(folder.path(), 3 * PART + 5);
        let names: Vec<String> = images
            .iter()
            .map(|i| crate::files::name_of(&i.path))
            .collect();
        let listed = Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 1.0 / 3.0, 2.0, 1e-9));
        let asked: Vec<Asked> = images
            .iter()
            .zip(&names)
            .map(|(image, name)| Asked {
                name,
                image,
                listed: Some(&listed),
            })
            .collect();
        let made_from = Provenance::new(&1);
        let open = |made_from: &Provenance| {
            Unfinished::open(&out, "program".to_owned(), made_from).expect("opened")
        };
        let unzipped = |answers: Vec<Answer>| -> (Vec<Frame>, Vec<Inliers>) {
            answers.into_iter().map(|a| (a.frame, a.inliers)).unzip()
        };
        let csv = |frames: &[Frame]| super::super::frames::csv(frames);
        let (whole, whole_inliers) = unzipped(found(&asked));

        let mut parts = 0;
        let stopped = open(&made_from).complete(&asked, |_, part| {
            parts += 1;
            match parts {
                3 => Err(Stopped.into()),
                _ => Ok(found(part)),
            }
        });
        assert!(stopped.is_err_and(|e| e.is::<Stopped>()));
        assert_eq!(open(&made_from).len(), 2 * PART);
        // Of other settings nothing is taken, and of a file that was cut in an image all before it.
        assert_eq!(open(&Provenance::new(&2)).len(), 0);
        let path = folder.path().join("found.csv.unfinished");
        let text = std::fs::read_to_string(&path).expect("text");
        std::fs::write(&path, &text[..text.len() - 7]).expect("cut");
        assert_eq!(open(&made_from).len(), 2 * PART - 1);

        // An image that has changed is localized again.
        std::fs::write(&images[5].path, "another image").expect("image");
        let (mut again, mut stops) = (Vec::new(), 0);
        for _ in 0..2 {
            let result = open(&made_from).complete(&asked, |_, part| {
                stops += 1;
                if stops == 2 {
                    return Err(Stopped.into());
                }
                again.extend(
                    part.iter()
                        .map(|asked| crate::files::name_of(&asked.image.path)),
                );
                Ok(found(part))
            });
            if let Ok(answers) = result {
                let (frames, inliers) = unzipped(answers);
                assert_eq!(inliers, whole_inliers);
                assert_eq!(csv(&frames), csv(&whole));
                let json = |frames: &[Frame]| serde_json::to_string(frames).expect("JSON");
                assert_eq!(json(&frames), json(&whole));
            }
        }
        let expected: Vec<String> = [5, 2 * PART - 1]
            .into_iter()
            .chain(2 * PART..images.len())
            .map(|k| format!("{k:04}.png"))
            .collect();
        assert_eq!(again, expected);
        open(&made_from).remove().expect("removed");
        assert!(!path.exists());
        open(&made_from).remove().expect("nothing to remove");
    }
}
