//! `lsfb dataset stats`: what the sequences of a dataset measure, and whether that can be true.

use std::path::PathBuf;

use lsfb_eval::dataset::{
    Description, SequenceFigures, cameras_table, environments_table, judge_measured, measure,
    motion_classes_table, motions_table,
};
use lsfb_types::{Finding, Judgement, Verdict};
use serde::Serialize;

use crate::context::Context;
use crate::judged::{Judged, printable, problem_lines};
use crate::outcome::Outcome;

/// Measure the sequences of a dataset (Tables III, VI and VII), and check their plausibility.
///
/// Images, rates, gaps and fields of view come from the recordings; speed, turning, parallax, motion
/// classes, and blur if exposure times were recorded, from the true trajectories if present. Exit code
/// 4: a sequence is implausible (too fast for a pedestrian, cut short, or at another rate).
///
/// Examples:
///   lsfb dataset stats dataset
///   lsfb --json dataset stats dataset --sequence C3-android
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The dataset.
    #[arg(value_name = "FOLDER")]
    dataset: PathBuf,
    /// Sequences, separated by commas; without it all.
    #[arg(long = "sequence", value_name = "NAME", value_delimiter = ',')]
    sequences: Vec<String>,
}

#[derive(Serialize)]
struct Measured<'a> {
    description: &'a Description,
    sequences: Vec<SequenceFigures>,
}

/// Measures, judges, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let (folder, mut description) = super::open(&arguments.dataset)?;
    for name in &arguments.sequences {
        let is_known = description.query(name).is_some();
        anyhow::ensure!(is_known, "the dataset has no sequence {name:?}");
    }
    if !arguments.sequences.is_empty() {
        let is_wanted = |name: &String| arguments.sequences.contains(name);
        description.queries.retain(|q| is_wanted(&q.name));
    }
    let mut findings = Vec::new();
    let mut sequences = Vec::new();
    for planned in &description.queries {
        let path = folder.walk(&planned.name);
        if !path.is_file() {
            let what = "has no recording";
            findings.push(Finding::new("absent", Verdict::Fail, &planned.name, what));
            continue;
        }
        let recording = context.open(&path)?;
        for damage in recording.damage() {
            let what = damage.to_string();
            findings.push(Finding::new("damage", Verdict::Fail, &planned.name, what));
        }
        let own = measure(&folder, planned, &recording, &|p| context.show(p))?;
        findings.extend(judge_measured(&own, description.rate_hz));
        sequences.push(own);
    }
    if description.queries.is_empty() {
        findings.push(Finding::new(
            "sequences",
            Verdict::Fail,
            "",
            "there is no sequence",
        ));
    }
    let judgement = Judgement::new(findings);
    let measured = Measured {
        description: &description,
        sequences,
    };
    let what = format!("{} sequences", measured.sequences.len());
    let judged = Judged::new(&judgement, &what, &measured);
    context.print(&judged, || {
        let own = &measured.sequences;
        let tables = [
            cameras_table(own),
            environments_table(&description),
            motions_table(&description, own),
            motion_classes_table(own),
        ];
        let tables: Vec<String> = tables.into_iter().filter(|t| !t.is_empty()).collect();
        let problems = problem_lines(&judgement);
        let text = format!("{}\n{}\n\n{problems}", tables.join("\n"), judged.summary);
        printable(text.trim_end())
    })?;
    Ok(Outcome::of(judgement.verdict()))
}
