//! `lsfb dataset export`.

use crate::context::Context;
use crate::outcome::Outcome;

/// Export.
///
/// Examples:
///   lsfb dataset export
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {}

pub fn run(_: &Arguments, _: &Context) -> anyhow::Result<Outcome> {
    Ok(Outcome::Done)
}
