//! `lsfb models codebook`: words by which images of one place are found among many.

use std::path::{Path, PathBuf};

use lsfb_pipeline::features::{Descriptor, SiftConfig, SiftDetector};
use lsfb_pipeline::vlad::Codebook;
use lsfb_types::Progress;
use serde::Serialize;

use crate::commands::about;
use crate::context::Context;
use crate::files;
use crate::outcome::Outcome;

/// Train a codebook for place recognition in `lsfb vio`, on the images of recordings.
///
/// The built-in codebook was trained on simulated places and needs no replacement; this is how it was
/// made. Set `revisits.codebook` of `lsfb vio` to use your own. Its format:
/// pipeline/src/vlad/FORMAT.md.
///
/// Examples:
///   lsfb models codebook office.mcap street.mcap --out own.codebook
///   lsfb models codebook walks/*.mcap --words 64 --seed 2 --out own.codebook
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct CodebookArguments {
    /// Recordings with images.
    #[arg(value_name = "MCAP", required = true)]
    recordings: Vec<PathBuf>,
    /// Codebook to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Number of words.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=4096))]
    words: u32,
    /// Seed of the training.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Time between the images used, per camera.
    #[arg(long, value_name = "SECS", default_value_t = 1.0)]
    every_secs: f64,
}

#[derive(Serialize)]
struct Trained {
    images: u64,
    /// Images that could not be read.
    damaged: u64,
    descriptors: u64,
    words: usize,
}

/// Reads images, trains, writes.
pub fn codebook(arguments: &CodebookArguments, context: &Context) -> anyhow::Result<Outcome> {
    let read: Vec<&Path> = arguments.recordings.iter().map(PathBuf::as_path).collect();
    context.claim(&arguments.out, &read)?;
    let mut detector = SiftDetector::new(&SiftConfig::default())?;
    let mut descriptors: Vec<Descriptor> = Vec::new();
    let (mut images, mut damaged) = (0, 0);
    for (done, path) in arguments.recordings.iter().enumerate() {
        let recording = context.open(path)?;
        let rig = about(path, recording.rig())?;
        let names: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
        let mut last = vec![None; names.len()];
        for item in about(path, recording.images_of(&names))? {
            context.show(Progress {
                stage: "images",
                done: done as u64,
                total: arguments.recordings.len() as u64,
            })?;
            let Ok(item) = item else {
                damaged += 1;
                continue;
            };
            let (time, last) = (item.image.time, &mut last[item.camera]);
            if last.is_some_and(|last| time.secs_since(last) < arguments.every_secs) {
                continue;
            }
            *last = Some(time);
            images += 1;
            descriptors.extend(detector.detect(&item.image.sample).descriptors);
        }
    }
    let words = arguments.words as usize;
    let trained = Codebook::train(&descriptors, words, arguments.seed, &|p| context.show(p))?;
    files::write(&arguments.out, trained.to_bytes())?;
    let report = Trained {
        images,
        damaged,
        descriptors: descriptors.len() as u64,
        words: trained.len(),
    };
    context.print(&report, || {
        format!(
            "{}: {} words of {} descriptors in {} images",
            arguments.out.display(),
            report.words,
            report.descriptors,
            report.images
        )
    })?;
    if damaged > 0 {
        context.say(&format!("{damaged} damaged images were left out"));
        return Ok(Outcome::DataLost);
    }
    Ok(Outcome::Done)
}
