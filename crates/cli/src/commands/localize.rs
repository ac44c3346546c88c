//! `lsfb localize`: images with known poses against a map.

use std::path::PathBuf;

use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::localization::{PosedQueryConfig, localize_posed_images};
use lsfb_pipeline::posed_images::PosedImages;

use crate::context::Context;
use crate::outcome::Outcome;

/// Localize images with known poses in an HD map, and say how many were found where they are.
///
/// Example:
///   lsfb localize --posed-images hololens_office --every 5 --map office-map
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder with K.txt, poses_T_world_cam_rowmajor4x4.txt and images/.
    #[arg(long, value_name = "DIR")]
    posed_images: PathBuf,
    /// Take every N-th image only.
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// The map: a folder.
    #[arg(long, value_name = "DIR")]
    map: PathBuf,
}

/// Localizes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    anyhow::ensure!(arguments.every > 0, "--every 0 takes no image");
    let map = HdMap::open(&arguments.map)?;
    let mut posed = PosedImages::read(&arguments.posed_images)?;
    let mut index = 0;
    posed.images.retain(|_| {
        index += 1;
        (index - 1) % arguments.every == 0
    });
    let report = localize_posed_images(&posed, &map, &PosedQueryConfig::default(), &|p| context.show(p))?;
    context.print(&report, || report.to_string())?;
    Ok(Outcome::Done)
}
