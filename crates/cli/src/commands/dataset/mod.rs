//! `lsfb dataset`: sequences planned, made, packed, checked, measured and exported.

mod check;
mod contents;
mod export;
mod make;
mod plan;
mod radio;
mod readme;
mod seal;
mod stats;

use std::path::Path;

use lsfb_eval::dataset::{DatasetFolder, DatasetPlan, Description};

use crate::context::Context;
use crate::files::expect_file;
use crate::outcome::Outcome;

/// Plan, make, check, measure and export datasets.
///
/// Covers the 75 sequences of the paper's Tables VI and VII, or your own. A dataset is a folder of
/// recordings with rigs, hashes and a licence: scans in map, walks in query, true trajectories in
/// truth, which can be held back for `lsfb bench serve`.
///
/// Examples:
///   lsfb dataset plan
///   lsfb dataset make --out dataset --scale-percent 10 --small-images
///   lsfb dataset check dataset
///   lsfb dataset stats dataset
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    Plan(plan::Arguments),
    Make(make::Arguments),
    Seal(seal::Arguments),
    Check(check::Arguments),
    Stats(stats::Arguments),
    Export(export::Arguments),
    Radio(radio::Arguments),
}

/// Runs what was asked for.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.what {
        What::Plan(arguments) => plan::run(arguments, context),
        What::Make(arguments) => make::run(arguments, context),
        What::Seal(arguments) => seal::run(arguments, context),
        What::Check(arguments) => check::run(arguments, context),
        What::Stats(arguments) => stats::run(arguments, context),
        What::Export(arguments) => export::run(arguments, context),
        What::Radio(arguments) => radio::run(arguments, context),
    }
}

/// The plan of Tables VI and VII.
fn paper() -> anyhow::Result<DatasetPlan> {
    Ok(DatasetPlan::paper()?)
}

/// A dataset that is there, and what it says it holds.
pub fn open(path: &Path) -> anyhow::Result<(DatasetFolder, Description)> {
    let folder = DatasetFolder::new(path);
    expect_file(&folder.description(), "make one with `lsfb dataset make`")?;
    let description = Description::read(&folder)?;
    Ok((folder, description))
}
