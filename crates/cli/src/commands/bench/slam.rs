//! `lsfb bench slam`: programs of others on sequences with ground truth.

use std::path::PathBuf;

use lsfb_eval::slam_bench::{RunResult, SlamTable, read_plan, run_plan, table_of};
use serde::Serialize;

use crate::context::Context;
use crate::files::write;
use crate::outcome::Outcome;

/// Run SLAM systems on sequences, and tabulate their errors as in the paper's Tables VIII and IX.
///
/// The plan (TOML) names sequences (a recording, its truth, the longer side of the place) and systems (a command with {input}, {out},
/// {trajectory}, {sequence}, {run}; the layout that it reads: as_is, euroc, tum_vi, kitti, images). The median of several runs counts; ×
/// stands where all failed, with the cause. Runs that are there are not run again. Written are table.txt, .csv, .tex and .html.
///
/// Examples:
///   lsfb bench slam plan.toml --out bench
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The plan.
    #[arg(value_name = "TOML")]
    plan: PathBuf,
    /// Folder for inputs, runs and tables.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
}

#[derive(Serialize)]
struct Printed<'a> {
    table: &'a SlamTable,
    runs: &'a [RunResult],
}

/// Runs what was asked for.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let plan = read_plan(&arguments.plan)?;
    context.will_write(&arguments.out);
    std::fs::create_dir_all(&arguments.out)?;
    let runs = run_plan(&plan, &arguments.out, &|p| context.show(p))?;
    let table = table_of(&plan, &runs);
    let marked = table.marked();
    for (name, text) in [
        ("table.txt", marked.to_text()),
        ("table.csv", marked.to_csv()),
        ("table.tex", marked.to_latex()),
        ("table.html", marked.to_html()),
    ] {
        write(&arguments.out.join(name), text)?;
    }
    let printed = Printed {
        table: &table,
        runs: &runs,
    };
    context.print(&printed, || marked.to_text().trim_end().to_owned())?;
    Ok(Outcome::Done)
}
