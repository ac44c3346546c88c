//! `lsfb bench`: programs of others on sequences with ground truth and on growing bundle adjustment, features on pairs of images, places
//! by Wi-Fi, our own programs with less and less of a map, in the twin, and there in the wrong place.

mod ablation;
mod ba;
mod cpu_time;
mod features;
mod radio;
mod serve;
mod slam;
mod twin;
mod wrong_place;

use crate::context::Context;
use crate::outcome::Outcome;

/// Benchmark SLAM systems, solvers, features, and lsfb itself; serve a leaderboard.
///
/// Examples:
///   lsfb bench ablation walk.mcap --map map --truth truth_walk.tum --out ablation
///   lsfb bench slam plan.toml --out bench
///   lsfb bench serve dataset --out board
///   lsfb bench twin --out trial --quick
///   lsfb bench ba --out ba
///   lsfb bench features --posed-images hololens_office --out features
///   lsfb bench radio walk1.csv walk2.csv
///   lsfb bench wrong-place trial --out wrong
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    Ablation(ablation::Arguments),
    Ba(ba::Arguments),
    Features(features::Arguments),
    Radio(radio::Arguments),
    Serve(serve::Arguments),
    Slam(slam::Arguments),
    Twin(twin::Arguments),
    WrongPlace(wrong_place::Arguments),
}

/// Runs what was asked for.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.what {
        What::Ablation(arguments) => ablation::run(arguments, context),
        What::Ba(arguments) => ba::run(arguments, context),
        What::Features(arguments) => features::run(arguments, context),
        What::Radio(arguments) => radio::run(arguments, context),
        What::Serve(arguments) => serve::run(arguments, context),
        What::Slam(arguments) => slam::run(arguments, context),
        What::Twin(arguments) => twin::run(arguments, context),
        What::WrongPlace(arguments) => wrong_place::run(arguments, context),
    }
}
