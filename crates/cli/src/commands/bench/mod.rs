//! `lsfb bench`: programs of others on sequences with ground truth, and our own in the twin.

mod slam;
mod twin;

use crate::context::Context;
use crate::outcome::Outcome;

/// Benchmark SLAM systems on sequences with ground truth, and lsfb itself in simulated places.
///
/// Examples:
///   lsfb bench slam plan.toml --out bench
///   lsfb bench twin --out trial --quick
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    Slam(slam::Arguments),
    Twin(twin::Arguments),
}

/// Runs what was asked for.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.what {
        What::Slam(arguments) => slam::run(arguments, context),
        What::Twin(arguments) => twin::run(arguments, context),
    }
}
