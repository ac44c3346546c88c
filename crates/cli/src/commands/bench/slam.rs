//! `lsfb bench slam`: programs of others on sequences with ground truth.

use std::path::PathBuf;

use lsfb_eval::report::Report;
use lsfb_eval::slam_bench::{
    Finished, RunConfig, RunResult, SlamTable, page_of, read_plan, run_plan, table_of,
};
use lsfb_recording::Provenance;
use serde::Serialize;

use crate::context::Context;
use crate::files::write;
use crate::outcome::Outcome;
use crate::pages;
use crate::standing::program_sha256;

/// Run SLAM systems on sequences, and tabulate their errors as in the paper's Tables VIII and IX.
///
/// The plan (TOML) lists sequences (a recording, its truth, the longer side of the place) and systems
/// (a command with {input}, {out}, {trajectory}, {sequence}, {run}; the layout that it reads: as_is,
/// euroc, tum_vi, kitti, images, stamped). The median of several runs counts; × means that more than
/// half of the runs failed, with the cause. Single failed runs and suspicious trajectories, such as the
/// truth itself, are named below the table.
///
/// A finished run is repeated if its command, its program, a file named by the command or the plan
/// (files = [...]), or its input has changed, or with --again. --force only replaces the tables. All
/// runs are evaluated anew each time. Writes table.txt, .csv, .tex and .html, and a page per sequence
/// (SEQUENCE.html) with the trajectories, their errors over time, and the share of poses by error.
///
/// Examples:
///   lsfb bench slam plan.toml --out bench
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Plan of sequences and systems.
    #[arg(value_name = "TOML")]
    plan: PathBuf,
    /// Folder for inputs, runs and tables.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Repeat all runs, including finished ones.
    #[arg(long)]
    again: bool,
}

#[derive(Serialize)]
struct Printed<'a> {
    table: &'a SlamTable,
    runs: &'a [RunResult],
}

/// Runs what was asked for.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let plan = read_plan(&arguments.plan)?;
    std::fs::create_dir_all(&arguments.out)?;
    let tables = ["table.txt", "table.csv", "table.tex", "table.html"];
    let tables = tables.map(|name| arguments.out.join(name));
    for table in &tables {
        context.claim(table, &[&arguments.plan])?;
    }
    let pages = plan.sequences.iter();
    let pages: Vec<PathBuf> = pages
        .map(|s| arguments.out.join(format!("{}.html", s.name)))
        .collect();
    for page in &pages {
        context.claim(page, &[&arguments.plan])?;
    }
    // The plan is the settings: whoever has only the page can run it again.
    let mut made_from = Provenance::new(&std::fs::read_to_string(&arguments.plan)?);
    made_from.add_input(&arguments.plan)?;
    for sequence in &plan.sequences {
        made_from.add_input(&sequence.truth)?;
    }
    let program_sha256 = program_sha256()?;
    let config = RunConfig {
        program_sha256: &program_sha256,
        finished: match arguments.again {
            true => Finished::Repeat,
            false => Finished::Keep,
        },
    };
    let runs = run_plan(&plan, &arguments.out, config, &|p| context.show(p))?;
    let table = table_of(&plan, &runs);
    let marked = table.marked();
    let [text, csv, latex, page] = &tables;
    write(text, marked.to_text())?;
    write(csv, marked.to_csv())?;
    write(latex, marked.to_latex())?;
    pages::write(page, marked.page(), &made_from)?;
    for (page, sequence) in pages.iter().zip(&plan.sequences) {
        if let Some(report) = page_of(&plan, &arguments.out, sequence, &runs)? {
            let provenance = pages::settings(&made_from);
            write(
                page,
                Report {
                    provenance,
                    ..report
                }
                .to_html(),
            )?;
        }
    }
    let printed = Printed {
        table: &table,
        runs: &runs,
    };
    context.print(&printed, || marked.to_text().trim_end().to_owned())?;
    Ok(Outcome::Done)
}
