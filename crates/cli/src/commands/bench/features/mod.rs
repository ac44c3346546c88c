//! `lsfb bench features`: features side by side, on pairs of images with known homographies and with known motions.

mod contestants;
mod exported;
mod pairs;
mod posed_pairs;
mod scores;
mod table;
mod warps;

use std::path::PathBuf;

use anyhow::Context as _;
use lsfb_pipeline::features::{DESCRIPTOR_LEN, Features};
use lsfb_recording::Provenance;
use lsfb_types::{Image, Progress};
use rayon::prelude::*;
use serde::Serialize;

use crate::commands::models::ModelFolder;
use crate::context::Context;
use crate::files::{name_of, named_path, write};
use crate::outcome::Outcome;
use crate::pages;
use contestants::Contestant;
use pairs::Pairs;
use scores::{PlanarScore, areas, matched, matchings, planar, pose_error_deg};
use table::{Planar, Posed, Row};
use warps::Kind;

/// Compare features on image pairs: repeatability, correct matches and motions, cost.
///
/// Homographies are simulated (viewpoint, scale, rotation, light, blur) from real images; motions are
/// those of overlapping images with known poses. Compares SIFT and all weights that were added (lsfb
/// models). A peer is a program that reads the images written by --keep-images (benches/features has
/// one for OpenCV's SIFT). Writes features.json and features.html.
///
/// Examples:
///   lsfb bench features --posed-images hololens_office --out features
///   lsfb bench features --images photos --feature sift --feature xfeat --out features
///   lsfb bench features --posed-images hololens_office --out features --force --peer-features OpenCV=opencv-sift
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of images for homographies; may be repeated. By default the posed images are used.
    #[arg(long, value_name = "FOLDER")]
    images: Vec<PathBuf>,
    /// Folder of images with poses; may be repeated.
    #[arg(long, value_name = "FOLDER")]
    posed_images: Vec<PathBuf>,
    /// Folder for the tables.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Feature to compare; may be repeated. By default SIFT and all weights that were added.
    #[arg(long, value_name = "NAME")]
    feature: Vec<String>,
    #[command(flatten)]
    models: ModelFolder,
    /// Number of images for homographies, spread evenly over all; each is used in five pairs.
    #[arg(long, value_name = "N", default_value_t = 24)]
    homography_images: usize,
    /// Largest number of pairs from each folder of posed images.
    #[arg(long, value_name = "N", default_value_t = 60)]
    pose_pairs: usize,
    /// Seed of the homographies.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Folder with the features that another program found in the images; may be repeated.
    #[arg(long, value_name = "NAME=FOLDER", value_parser = named_path)]
    peer_features: Vec<(String, PathBuf)>,
    /// Keep the images, and the matches of pairs with known motion, in the folder for other programs.
    #[arg(long)]
    keep_images: bool,
}

#[derive(Serialize)]
struct Printed {
    homography_pairs: usize,
    pose_pairs: usize,
    seed: u64,
    features: Vec<Row>,
}

/// Runs what was asked for.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    context.will_write(&arguments.out);
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    let [json, page] = ["features.json", "features.html"].map(|name| arguments.out.join(name));
    for result in [&json, &page] {
        context.claim(result, &[])?;
    }
    let mut contestants = Vec::new();
    let names = match arguments.feature.is_empty() {
        true => arguments.models.names()?,
        false => arguments.feature.clone(),
    };
    for name in &names {
        contestants.push(Contestant::ours(name, &arguments.models)?);
    }
    contestants.extend(
        arguments
            .peer_features
            .iter()
            .map(|(name, folder)| Contestant::peer(name, folder)),
    );
    let pairs = Pairs::read(arguments, context)?;
    if arguments.keep_images {
        exported::write_images(&arguments.out, &pairs)?;
    }
    let mut printed = Printed {
        homography_pairs: pairs.planar.len(),
        pose_pairs: pairs.posed.len(),
        seed: arguments.seed,
        features: Vec::new(),
    };
    for (number, contestant) in contestants.iter().enumerate() {
        let images: Vec<(usize, &Image)> = pairs.images.iter().enumerate().collect();
        let found = contestant.find(&images, &|progress| {
            context.show(Progress {
                stage: "features",
                done: number as u64 * images.len() as u64 + progress.done,
                total: (contestants.len() * images.len()) as u64,
            })
        })?;
        if arguments.keep_images {
            exported::write_matches(&arguments.out, &contestant.name, &pairs, &found.features)?;
        }
        let mut row = row(contestant, &pairs, &found.features, context)?;
        row.cpu_ms_per_image = found.cpu_ms;
        printed.features.push(row);
    }
    let about = about(&printed);
    write(&json, serde_json::to_vec_pretty(&printed)?)?;
    let folders = |named: &[PathBuf]| named.iter().map(|path| name_of(path)).collect::<Vec<_>>();
    let made_from = Provenance::new(&serde_json::json!({
        "images": folders(&arguments.images),
        "posed_images": folders(&arguments.posed_images),
        "feature": names,
        "homography_images": arguments.homography_images,
        "pose_pairs": arguments.pose_pairs,
        "seed": arguments.seed,
    }));
    pages::write(&page, table::page(&printed.features, &about), &made_from)?;
    context.print(&printed, || table::text(&printed.features, &about))?;
    Ok(Outcome::Done)
}

fn about(printed: &Printed) -> String {
    format!(
        "{} pairs with a homography, {} pairs with a motion; seed {}",
        printed.homography_pairs, printed.pose_pairs, printed.seed
    )
}

/// How the features of all images compare.
fn row(
    contestant: &Contestant,
    pairs: &Pairs,
    features: &[Features],
    context: &Context,
) -> anyhow::Result<Row> {
    let total = features.iter().map(Features::len).sum::<usize>();
    let planar_scores: Vec<(Kind, PlanarScore)> = pairs
        .planar
        .par_iter()
        .map(|pair| {
            context.check_stop()?;
            let image = &pairs.images[pair.images[0]];
            let found = pair.images.map(|k| &features[k]);
            let score = planar(found, &pair.target_from_source, [image.width, image.height]);
            Ok((pair.kind, score))
        })
        .collect::<anyhow::Result<_>>()?;
    let of = |kind: Option<Kind>| {
        let chosen = planar_scores
            .iter()
            .filter(|(k, _)| kind.is_none_or(|kind| kind == *k));
        Planar::mean(&chosen.map(|(_, score)| *score).collect::<Vec<_>>())
    };
    let by_kind = Kind::ALL
        .into_iter()
        .filter_map(|kind| Some((kind.name(), of(Some(kind))?)));
    let motions: Vec<MotionScore> = pairs
        .posed
        .par_iter()
        .map(|pair| {
            context.check_stop()?;
            let matches = matchings().map(|m| matched(pair.images.map(|k| &features[k]), &m));
            let cameras = [&pair.cameras[0], &pair.cameras[1]];
            Ok(MotionScore {
                place: &pair.place,
                matches: matches[0].len(),
                errors_deg: matches.map(|m| pose_error_deg(&m, cameras, &pair.second_from_first)),
            })
        })
        .collect::<anyhow::Result<_>>()?;
    let mut places: Vec<&str> = motions.iter().map(|m| m.place).collect();
    places.dedup();
    let by_place = places.iter().filter_map(|place| {
        let chosen: Vec<&MotionScore> = motions.iter().filter(|m| m.place == *place).collect();
        Some(((*place).to_owned(), posed(&chosen)?))
    });
    Ok(Row {
        feature: contestant.name.clone(),
        features_per_image: total as f64 / features.len().max(1) as f64,
        homographies: of(None),
        by_kind: by_kind.collect(),
        poses: posed(&motions.iter().collect::<Vec<_>>()),
        by_place: by_place.collect(),
        cpu_ms_per_image: None,
        values_per_descriptor: contestant.values,
        bytes_per_descriptor: DESCRIPTOR_LEN,
    })
}

/// A pair with a motion.
struct MotionScore<'a> {
    place: &'a str,
    matches: usize,
    /// Of matches as the toolkit makes them, and of mutual nearest neighbours.
    errors_deg: [f64; 2],
}

fn posed(motions: &[&MotionScore]) -> Option<Posed> {
    let errors = |k: usize| {
        motions
            .iter()
            .map(|m| m.errors_deg[k])
            .collect::<Vec<f64>>()
    };
    let matches = motions.iter().map(|m| m.matches).sum::<usize>();
    (!motions.is_empty()).then(|| Posed {
        pairs: motions.len(),
        auc: areas(&errors(0)),
        auc_mutual: areas(&errors(1)),
        matches: matches as f64 / motions.len() as f64,
    })
}
