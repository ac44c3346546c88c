//! What is localized: posed images, images without poses, a walk.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_geometry::{Rig, Se3};
use lsfb_pipeline::features::FeatureDetector;
use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::kept_stages::KeptStages;
use lsfb_pipeline::localization::{
    Localizer, LocalizerConfig, images_of_instants, localize_images, localize_recording_in_stages,
};
use lsfb_pipeline::posed_images::{PosedImages, QueryImage, read_image};
use lsfb_recording::{Provenance, Recording};
use lsfb_types::{Progress, Timestamp};

use super::Arguments;
use super::drawing::Shown;
use super::folder;
use super::frames::{self, Frame};
use super::matches::Inliers;
use super::unfinished::{Answer, Asked, Unfinished};
use crate::bad_argument::BadArgument;
use crate::context::Context;

/// The map's folder and the path of what is localized.
pub fn resolve(arguments: &Arguments) -> anyhow::Result<(PathBuf, PathBuf)> {
    let named = arguments.map.iter().chain(&arguments.paths);
    let named: Vec<&PathBuf> = named.chain(&arguments.posed_images).collect();
    match named[..] {
        [map, input] => Ok((map.clone(), input.clone())),
        _ => anyhow::bail!(BadArgument::new(
            "give one map and one walk or folder of images: lsfb localize MAP WALK.mcap, or lsfb localize MAP FOLDER"
        )),
    }
}

/// What is localized.
pub enum Input {
    /// Images of one rig, each alone; poses beside them where a list gives them.
    Images {
        rig: Box<Rig>,
        images: Vec<QueryImage>,
        /// As their frames are called.
        names: Vec<String>,
        listed: Option<Vec<Se3>>,
    },
    /// The instants of a walk.
    Walk { walk: Box<Recording>, rig: Box<Rig> },
}

impl Input {
    /// Reads what the arguments name.
    pub fn open(path: &Path, arguments: &Arguments, context: &Context) -> anyhow::Result<Self> {
        if arguments.posed_images.is_some() {
            crate::files::expect_file(path, "give a folder of posed images")?;
            let posed = PosedImages::read(path)?;
            for note in &posed.notes {
                context.say(&format!("warning: {}: {note}", path.display()));
            }
            return Ok(Self::of_posed(&posed.every(arguments.every as usize)));
        }
        crate::files::expect_file(path, "give a walk (MCAP) or a folder of images")?;
        if path.is_file() {
            anyhow::ensure!(
                arguments.rig.is_none() && arguments.every == 1,
                BadArgument::new(format!(
                    "{}: --rig and --every are for folders of images; a walk contains its own rig",
                    path.display()
                ))
            );
            let walk = Box::new(context.open(path)?);
            let rig = Box::new(walk.rig()?);
            return Ok(Self::Walk { walk, rig });
        }
        let found = folder::read(path, arguments, context)?;
        let names = found.images.iter();
        let names = names.map(|image| below(path, &image.path)).collect();
        Ok(Self::Images {
            rig: Box::new(found.rig),
            images: found.images,
            names,
            listed: None,
        })
    }

    fn of_posed(posed: &PosedImages) -> Self {
        let images = posed.images.iter().map(|image| QueryImage {
            path: image.path.clone(),
            camera: image.camera.clone(),
        });
        let names = posed.images.iter();
        Self::Images {
            rig: Box::new(posed.rig.clone()),
            images: images.collect(),
            names: names.map(|i| crate::files::name_of(&i.path)).collect(),
            listed: Some(posed.images.iter().map(|i| i.world_from_rig).collect()),
        }
    }

    /// Whether poses stand beside the images.
    pub fn lists_poses(&self) -> bool {
        matches!(
            self,
            Self::Images {
                listed: Some(_),
                ..
            }
        )
    }

    /// The images of some frames; an error in place of what cannot be read. `times` are those of all instants of a walk.
    pub fn shown(
        &self,
        frames: &[usize],
        times: &[Timestamp],
    ) -> anyhow::Result<Vec<anyhow::Result<Shown<'_>>>> {
        match self {
            Self::Images {
                rig, images, names, ..
            } => {
                let shown = frames.iter().map(|frame| -> anyhow::Result<Shown<'_>> {
                    let image = images.get(*frame).context("there is no such frame")?;
                    let pixels = read_image(&image.path, &image.camera, rig)?;
                    Ok(Shown {
                        name: names.get(*frame).cloned().unwrap_or_default(),
                        rig,
                        images: vec![(image.camera.clone(), pixels)],
                    })
                });
                Ok(shown.collect())
            }
            Self::Walk { walk, rig } => {
                let images = images_of_instants(walk, rig, times, frames)?;
                let shown = frames.iter().zip(images).map(|(frame, images)| {
                    let time = times.get(*frame);
                    Ok(Shown {
                        name: time.map_or_else(String::new, ToString::to_string),
                        rig,
                        images,
                    })
                });
                Ok(shown.collect())
            }
        }
    }

    /// How many frames there are; `None` of a walk, whose images are yet to be read.
    pub fn count(&self) -> Option<usize> {
        match self {
            Self::Images { images, .. } => Some(images.len()),
            Self::Walk { .. } => None,
        }
    }

    /// The rig that took the images.
    pub fn rig(&self) -> &Rig {
        match self {
            Self::Images { rig, .. } | Self::Walk { rig, .. } => rig,
        }
    }

    /// Map, rig, settings and, of a walk, its recording: what a page of it was made of.
    pub fn made_from(&self, map: &Path, config: &LocalizerConfig) -> anyhow::Result<Provenance> {
        match self {
            Self::Images { rig, .. } => made_from(map, rig, config),
            Self::Walk { walk, rig } => {
                let mut made_from = made_from(map, rig, config)?;
                made_from.add_input(walk.path())?;
                Ok(made_from)
            }
        }
    }

    /// Images that the same command localized before it was stopped; `None` of a walk, which is kept otherwise.
    pub fn unfinished(
        &self,
        result: &Path,
        map: &Path,
        config: &LocalizerConfig,
    ) -> anyhow::Result<Option<Unfinished>> {
        if let Self::Walk { .. } = self {
            return Ok(None);
        }
        let made_from = self.made_from(map, config)?;
        let program = crate::standing::program_sha256()?;
        Ok(Some(Unfinished::open(result, program, &made_from)?))
    }

    /// What the same command finished of a walk before it was stopped.
    pub fn kept_stages(
        &self,
        result: &Path,
        map: &Path,
        config: &LocalizerConfig,
        context: &Context,
    ) -> anyhow::Result<KeptStages> {
        if let Self::Images { .. } = self {
            return Ok(KeptStages::none());
        }
        context.kept_stages(result, &self.made_from(map, config)?)
    }

    /// Localizes each frame, but for those that are known from before.
    pub fn localize(
        &self,
        localizer: &Localizer,
        detector: &FeatureDetector,
        kept: Kept,
        context: &Context,
    ) -> anyhow::Result<Found> {
        match self {
            Self::Images {
                rig,
                images,
                names,
                listed,
            } => {
                let listed = listed.iter().flatten().map(Some);
                let listed = listed.chain(std::iter::repeat(None));
                let asked = images.iter().zip(names).zip(listed);
                let asked: Vec<Asked> = asked
                    .map(|((image, name), listed)| Asked {
                        name,
                        image,
                        listed,
                    })
                    .collect();
                let localize = |done: usize, part: &[Asked]| -> anyhow::Result<Vec<Answer>> {
                    let show = |p: Progress| {
                        context.show(Progress {
                            done: done as u64 + p.done,
                            total: images.len() as u64,
                            ..p
                        })
                    };
                    let queries: Vec<QueryImage> = part.iter().map(|a| a.image.clone()).collect();
                    let found = localize_images(localizer, rig, &queries, detector, &show)?;
                    let answers = part.iter().zip(&found).map(|(asked, found)| Answer {
                        frame: Frame::new(asked.name.to_owned(), found, asked.listed),
                        inliers: Inliers::new(vec![asked.image.camera.clone()], found),
                    });
                    Ok(answers.collect())
                };
                let answers = match kept.images {
                    Some(unfinished) => unfinished.complete(&asked, localize)?,
                    None => localize(0, &asked)?,
                };
                let answers = answers.into_iter().map(|a| (a.frame, a.inliers));
                let (mut frames, inliers): (Vec<Frame>, Vec<Inliers>) = answers.unzip();
                let mut of_camera: BTreeMap<&str, Vec<&mut Frame>> = BTreeMap::new();
                for (image, frame) in images.iter().zip(&mut frames) {
                    of_camera.entry(&image.camera).or_default().push(frame);
                }
                for frames in of_camera.values_mut() {
                    frames::judge_together(frames, localizer.min_probability());
                }
                Ok(Found {
                    damaged: frames.iter().filter(|f| f.unreadable).count() as u64,
                    times: Vec::new(),
                    frames,
                    inliers,
                })
            }
            Self::Walk { walk, .. } => {
                let show = |p| context.show(p);
                let found =
                    localize_recording_in_stages(localizer, walk, detector, kept.walk, &show);
                let found = kept.walk.kept_if_stopped(found)?;
                let mut answers = Found {
                    frames: Vec::with_capacity(found.instants.len()),
                    inliers: Vec::with_capacity(found.instants.len()),
                    times: found.instants.iter().map(|f| f.time).collect(),
                    damaged: found.damaged,
                };
                for instant in found.instants {
                    let frame = Frame::new(instant.time.to_string(), &instant.found, None);
                    answers.frames.push(frame);
                    let inliers = Inliers::new(instant.cameras, &instant.found);
                    answers.inliers.push(inliers);
                }
                Ok(answers)
            }
        }
    }
}

/// What is known of images, or of a walk, from before.
pub struct Kept<'a> {
    pub images: Option<&'a mut Unfinished>,
    pub walk: &'a KeptStages,
}

/// Map, rig and settings.
fn made_from(map: &Path, rig: &Rig, config: &LocalizerConfig) -> anyhow::Result<Provenance> {
    let mut made_from = Provenance::new(config);
    // The map's header has the hashes of its other files, and names the feature with its weights.
    made_from.add_input(&map.join(HdMap::HEADER))?;
    made_from.add_rig(rig);
    Ok(made_from)
}

/// The frames, and how many images or messages were damaged.
pub struct Found {
    pub frames: Vec<Frame>,
    /// Of each frame.
    pub inliers: Vec<Inliers>,
    /// Of the instants of a walk.
    pub times: Vec<Timestamp>,
    pub damaged: u64,
}

/// The path of a file below a folder.
fn below(folder: &Path, file: &Path) -> String {
    let below = file.strip_prefix(folder).unwrap_or(file);
    below.display().to_string()
}
