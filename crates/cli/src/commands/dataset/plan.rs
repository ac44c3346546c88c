//! `lsfb dataset plan`: what is to be recorded.

use lsfb_eval::dataset::{DatasetPlan, judge_planned};
use lsfb_types::Judgement;
use serde::Serialize;

use crate::context::Context;
use crate::judged::Judged;
use crate::outcome::Outcome;

/// Print the plan of the paper's Tables VI and VII as TOML.
///
/// It lists environments, motions, devices, frames and lengths. --json lists its 75 sequences and
/// checks their numbers: one whose length cannot be walked in its time fails.
///
/// Examples:
///   lsfb dataset plan
///   lsfb --json dataset plan
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {}

#[derive(Serialize)]
struct Planned<'a> {
    sequences: Vec<lsfb_eval::dataset::PlannedSequence<'a>>,
}

/// Prints.
pub fn run(_: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let plan = super::paper()?;
    let judgement = Judgement::new(judge_planned(&plan));
    let planned = Planned {
        sequences: plan.sequences(),
    };
    let what = format!("{} sequences", planned.sequences.len());
    let judged = Judged::new(&judgement, &what, &planned);
    context.print(&judged, || DatasetPlan::paper_toml().trim_end().to_owned())?;
    Ok(Outcome::of(judgement.verdict()))
}
