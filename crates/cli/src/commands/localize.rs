//! `lsfb localize`: images with known poses against a map.

use std::path::PathBuf;

use lsfb_pipeline::features::SiftConfig;
use lsfb_pipeline::localization::{
    ImageLocalization, Localizer, LocalizerConfig, localize_posed_images,
};
use lsfb_pipeline::posed_images::PosedImages;
use serde::Serialize;

use crate::context::Context;
use crate::outcome::Outcome;

/// Localize images with known poses in an HD map, and report how many were placed correctly.
///
/// Examples:
///   lsfb localize --posed-images hololens_office --every 5 --map office-map
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder with K.txt, poses_T_world_cam_rowmajor4x4.txt and images/.
    #[arg(long, value_name = "FOLDER")]
    posed_images: PathBuf,
    /// Use only every N-th image.
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// The map, a folder.
    #[arg(long, value_name = "FOLDER")]
    map: PathBuf,
}

/// A pose counts as right within these, as in the benchmarks of the field.
const RIGHT_DISTANCE_M: f64 = 0.10;
const RIGHT_ANGLE_DEG: f64 = 5.0;

#[derive(Serialize)]
struct Summary {
    images: usize,
    localized: usize,
    right: usize,
    median_distance_m: Option<f64>,
    median_angle_deg: Option<f64>,
}

/// Localizes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    anyhow::ensure!(
        arguments.every > 0,
        "--every 0 uses no image: give 1 or more"
    );
    let localizer = Localizer::new(
        &super::open_map(&arguments.map)?,
        &LocalizerConfig::default(),
    )?;
    super::expect_file(&arguments.posed_images, "name a folder of posed images")?;
    let posed = PosedImages::read(&arguments.posed_images)?.every(arguments.every);
    let found = localize_posed_images(&localizer, &posed, &SiftConfig::default(), &|p| {
        context.show(p)
    })?;
    let summary = summary(&found);
    context.print(&summary, || text(&summary))?;
    Ok(Outcome::Done)
}

fn summary(found: &[ImageLocalization]) -> Summary {
    let median = |value: fn(&ImageLocalization) -> Option<f64>| {
        let mut values: Vec<f64> = found.iter().filter_map(value).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let right = |image: &&ImageLocalization| {
        image.distance_m().is_some_and(|d| d <= RIGHT_DISTANCE_M)
            && image.angle_deg().is_some_and(|a| a <= RIGHT_ANGLE_DEG)
    };
    Summary {
        images: found.len(),
        localized: found.iter().filter(|image| image.found.is_ok()).count(),
        right: found.iter().filter(right).count(),
        median_distance_m: median(ImageLocalization::distance_m),
        median_angle_deg: median(ImageLocalization::angle_deg),
    }
}

fn text(s: &Summary) -> String {
    let share = 100.0 * s.right as f64 / s.images.max(1) as f64;
    let mut text = format!(
        "{} of {} images right within 10 cm and 5° ({share:.1} %), {} localized",
        s.right, s.images, s.localized
    );
    if let (Some(m), Some(deg)) = (s.median_distance_m, s.median_angle_deg) {
        text += &format!("; median {:.1} mm, {deg:.2}°", m * 1e3);
    }
    text
}
