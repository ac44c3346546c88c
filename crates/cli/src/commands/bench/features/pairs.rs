//! The images that are compared, and how they belong together.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_geometry::{Camera, Matrix3, Se3};
use lsfb_pipeline::features::{FeatureDetector, SiftConfig};
use lsfb_pipeline::posed_images::PosedImages;
use lsfb_types::{Image, Progress};
use rayon::prelude::*;

use super::Arguments;
use super::posed_pairs::{Placed, choose};
use super::warps::{Kind, Warped, warp};
use crate::context::Context;
use crate::files::{image_files, name_of};

/// Two images with a known homography.
pub struct PlanarPair {
    pub kind: Kind,
    pub images: [usize; 2],
    pub target_from_source: Matrix3<f64>,
}

/// Two images with a known motion.
pub struct PosedPair {
    /// Name of the folder.
    pub place: String,
    pub images: [usize; 2],
    pub cameras: [Camera; 2],
    pub second_from_first: Se3,
}

/// All that is compared.
#[derive(Default)]
pub struct Pairs {
    pub images: Vec<Image>,
    pub planar: Vec<PlanarPair>,
    pub posed: Vec<PosedPair>,
}

/// Images of a folder with poses among which pairs are looked for, at most, evenly over all.
const POSED_IMAGES: usize = 60;

impl Pairs {
    /// Reads images and makes pairs of them.
    pub fn read(arguments: &Arguments, context: &Context) -> anyhow::Result<Self> {
        let mut pairs = Self::default();
        let posed: Vec<(&Path, PosedImages)> = arguments
            .posed_images
            .iter()
            .map(|folder| Ok((folder.as_path(), PosedImages::read(folder)?)))
            .collect::<anyhow::Result<_>>()?;
        let mut sources: Vec<PathBuf> = Vec::new();
        for folder in &arguments.images {
            crate::files::expect_file(folder, "give a folder of images")?;
            sources.extend(image_files(folder)?);
        }
        if arguments.images.is_empty() {
            sources.extend(
                posed
                    .iter()
                    .flat_map(|(_, p)| &p.images)
                    .map(|i| i.path.clone()),
            );
        }
        anyhow::ensure!(
            !sources.is_empty(),
            "no images: give folders with .png, .jpg or .jpeg files by --images or --posed-images"
        );
        pairs.add_planar(
            &evenly(&sources, arguments.homography_images),
            arguments.seed,
            context,
        )?;
        for (folder, posed) in posed.iter().filter(|_| arguments.pose_pairs > 0) {
            pairs.add_posed(&name_of(folder), posed, arguments.pose_pairs, context)?;
        }
        anyhow::ensure!(
            !pairs.images.is_empty(),
            "no pairs to compare features on: give more than 0 --homography-images, or folders of posed images that overlap and more than 0 --pose-pairs"
        );
        Ok(pairs)
    }

    /// Each image and what it would look like otherwise.
    fn add_planar(
        &mut self,
        sources: &[PathBuf],
        seed: u64,
        context: &Context,
    ) -> anyhow::Result<()> {
        for (number, path) in sources.iter().enumerate() {
            context.show(Progress {
                stage: "warping images",
                done: number as u64,
                total: sources.len() as u64,
            })?;
            let source = lsfb_perception::image::read(path)?;
            anyhow::ensure!(
                source.width.min(source.height) >= 64,
                "{}: {} × {} px: too small to compare features on; at least 64 px per side are needed",
                path.display(),
                source.width,
                source.height
            );
            let first_seed = seed.wrapping_add(1000 * number as u64);
            let warped: Vec<(Kind, Warped)> = Kind::ALL
                .into_par_iter()
                .enumerate()
                .map(|(k, kind)| (kind, warp(&source, kind, first_seed.wrapping_add(k as u64))))
                .collect();
            let source_index = self.add(source);
            for (kind, warped) in warped {
                let images = [source_index, self.add(warped.image)];
                self.planar.push(PlanarPair {
                    kind,
                    images,
                    target_from_source: warped.target_from_source,
                });
            }
        }
        Ok(())
    }

    /// Pairs of a folder's images.
    fn add_posed(
        &mut self,
        place: &str,
        posed: &PosedImages,
        limit: usize,
        context: &Context,
    ) -> anyhow::Result<()> {
        let chosen = evenly(&posed.images, POSED_IMAGES);
        let images: Vec<Image> = chosen
            .iter()
            .map(|i| Ok(i.read(&posed.rig)?))
            .collect::<anyhow::Result<_>>()?;
        let detector = FeatureDetector::sift(&SiftConfig::default())?;
        let features = detector.detect_all(&images.iter().collect::<Vec<_>>(), &|progress| {
            context.show(Progress {
                stage: "estimating scene depth",
                ..progress
            })
        })?;
        let placed: Vec<Placed> = chosen
            .iter()
            .zip(&features)
            .map(|(image, features)| {
                let mounted = posed.rig.cameras.get(&image.camera);
                let mounted =
                    mounted.with_context(|| format!("{place}: no camera {}", image.camera))?;
                Ok(Placed {
                    camera: &mounted.camera,
                    world_from_camera: image.world_from_rig * mounted.rig_from_camera,
                    features,
                })
            })
            .collect::<anyhow::Result<_>>()?;
        let pairs = choose(&placed, limit);
        if pairs.is_empty() {
            context.say(&format!(
                "{place}: no two of {} images overlap from viewpoints far enough apart",
                chosen.len()
            ));
        }
        // Those alone that are in a pair.
        let mut numbers: Vec<Option<usize>> = vec![None; images.len()];
        for (first, second) in pairs {
            let images = [first, second]
                .map(|k| *numbers[k].get_or_insert_with(|| self.add(images[k].clone())));
            let [a, b] = [&placed[first], &placed[second]];
            self.posed.push(PosedPair {
                place: place.to_owned(),
                images,
                cameras: [*a.camera, *b.camera],
                second_from_first: b.world_from_camera.inverse() * a.world_from_camera,
            });
        }
        Ok(())
    }

    fn add(&mut self, image: Image) -> usize {
        self.images.push(image);
        self.images.len() - 1
    }
}

/// At most so many, evenly over all.
fn evenly<T: Clone>(all: &[T], limit: usize) -> Vec<T> {
    let count = all.len().min(limit);
    (0..count)
        .map(|k| all[(2 * k + 1) * all.len() / (2 * count)].clone())
        .collect()
}
