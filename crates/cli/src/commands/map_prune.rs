//! `lsfb map prune`: a map that is to fit into so many megabytes.

use std::path::PathBuf;

use lsfb_pipeline::hd_map::PruneConfig;

use super::map_folder::{bytes_in, print_made, written};
use crate::context::Context;
use crate::outcome::Outcome;

/// Bytes of a megabyte, as `lsfb map info` counts them.
const MB: f64 = 1e6;

/// Prune a map to a given size.
///
/// Removes the least informative descriptors first, then the least useful points. A size that would
/// leave a keyframe with too few points to be localized is refused; the message gives the smallest
/// possible size. To see what pruning costs, run `lsfb localize` in both maps with images that are not
/// part of them.
///
/// Examples:
///   lsfb map prune map --size-mb 20 --out small-map
#[derive(clap::Args)]
#[command(verbatim_doc_comment, after_long_help = settings())]
pub struct PruneArguments {
    /// The map.
    #[arg(value_name = "MAP")]
    map: PathBuf,
    /// Maximum size of the pruned map, in megabytes (1 000 000 bytes).
    #[arg(long, value_name = "MB", value_parser = megabytes)]
    size_mb: f64,
    /// Map to write (folder).
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Settings instead of the defaults; `lsfb map prune --help` lists them.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

fn settings() -> String {
    let settings = toml::to_string(&PruneConfig::default()).unwrap_or_default();
    format!("Settings of --config and their defaults:\n\n{settings}")
}

fn megabytes(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(mb) if mb.is_finite() && mb > 0.0 => Ok(mb),
        _ => Err("expected a number of megabytes above 0".to_owned()),
    }
}

/// Does it.
pub fn prune(arguments: &PruneArguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: PruneConfig = super::config_or_default(arguments.config.as_deref())?;
    context.claim(&arguments.out, &[&arguments.map])?;
    let map = super::open_map(&arguments.map)?;
    let (left, report) = super::about(
        &arguments.map,
        map.prune((arguments.size_mb * MB) as usize, &config, &|p| {
            context.show(p)
        }),
    )?;
    left.write(&arguments.out)?;
    written(&left, &arguments.out, &[&arguments.map], &config)?;
    let [before, after] = [&arguments.map, &arguments.out].map(|folder| bytes_in(folder));
    let [before_mb, after_mb] = [before? as f64 / MB, after? as f64 / MB];
    let summary = serde_json::json!({
        "size_mb": [before_mb, after_mb],
        "report": &report,
    });
    let text = || {
        format!(
            "{}: {after_mb:.2} of {before_mb:.2} MB; {} of {} points, {} of {} descriptors (at most {} per point)\n  points per view: median {} of {}, minimum {} of {}",
            arguments.out.display(),
            report.points[1],
            report.points[0],
            report.descriptors[1],
            report.descriptors[0],
            report.most_descriptors_per_point,
            report.median_points_per_view[1],
            report.median_points_per_view[0],
            report.fewest_points_per_view[1],
            report.fewest_points_per_view[0]
        )
    };
    anyhow::ensure!(
        after_mb <= arguments.size_mb,
        "{}: the map became {after_mb:.2} MB: ask for a smaller size",
        arguments.out.display()
    );
    print_made(&left, &arguments.out, &summary, text, context)
}
