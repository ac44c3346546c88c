//! `lsfb bench ba`: what a keyframe costs while a problem grows, ours and that of other solvers, as in the paper's Fig. 4.

mod page;
mod peer;
mod problem;
mod runs;

use std::path::PathBuf;

use anyhow::Context as _;
use lsfb_recording::Provenance;
use serde::Serialize;

use crate::context::Context;
use crate::files::{named_path, write};
use crate::outcome::Outcome;
use crate::pages;
use page::page_of;
use peer::{Program, program};
use problem::Grown;
use runs::{Run, Summary, read_run};

/// Benchmark bundle adjustment keyframe by keyframe: incremental, from scratch, other solvers.
///
/// The problem is a simulated walk with a stereo camera that closes a loop at its end; it is written to
/// problem.txt. A peer is a program that reads that file and writes one line per keyframe: its number
/// from 1, CPU milliseconds of the update, cost after it (benches/solver/README.md has one for GTSAM).
/// With --run it is run in the same run as ours, with the names of both files behind its other arguments.
/// Writes problem.txt, incremental.csv, batch.csv and ba.html, and peer-NAME.csv and .log of what was run.
///
/// Examples:
///   lsfb bench ba --out ba
///   lsfb bench ba --out ba --force --peer ISAM2=isam2.csv
///   lsfb bench ba --out ba --run ISAM2=./isam2_walk.sh
///   lsfb bench ba --out ba --keyframes 2000 --map-percent 20 --batch-every 100
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder for the problem, the results and the page.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Keyframes of the walk, half a metre apart; at least 60, so that the walk can go around the points
    /// inside the loop.
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(60..=10_000))]
    keyframes: u32,
    /// Points per keyframe of the walk; each keyframe sees about half as many.
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(20..=1000))]
    points: u32,
    /// Points whose places are known, as those of an HD map are (Eq. 5 of the paper), in percent; each is up to a centimetre off.
    #[arg(long, value_name = "PERCENT", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=100))]
    map_percent: u32,
    /// Seed of the walk.
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,
    /// Solve from scratch every N keyframes.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    batch_every: u32,
    /// Result of another solver on the same problem; may be repeated.
    #[arg(long, value_name = "NAME=FILE", value_parser = named_path)]
    peer: Vec<(String, PathBuf)>,
    /// Another solver to run on the problem after ours, with its arguments, split at spaces; may be
    /// repeated.
    #[arg(long, value_name = "NAME=COMMAND", value_parser = program)]
    run: Vec<Program>,
}

#[derive(Serialize)]
struct Printed {
    keyframes: u32,
    points: usize,
    observations: usize,
    map_percent: u32,
    /// Largest distance of a pose of the incremental solution from the optimum's.
    poses_apart_m: f64,
    solvers: Vec<Summary>,
}

/// Runs what was asked for.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    let inputs: Vec<_> = arguments.peer.iter().map(|p| p.1.as_path()).collect();
    let [problem, incremental, batch, page] =
        ["problem.txt", "incremental.csv", "batch.csv", "ba.html"]
            .map(|name| arguments.out.join(name));
    for result in [&problem, &incremental, &batch, &page] {
        context.claim(result, &inputs)?;
    }
    for program in &arguments.run {
        context.claim(&program.result(&arguments.out), &inputs)?;
        context.claim(&program.log(&arguments.out), &inputs)?;
    }
    let peers = arguments.peer.iter();
    let peers: Vec<Run> = peers
        .map(|(name, path)| read_run(name, path, arguments.keyframes))
        .collect::<Result<_, _>>()?;
    let grown = Grown::solve(arguments, context)?;
    write(&problem, &grown.problem)?;
    write(&incremental, grown.incremental.to_csv())?;
    write(&batch, grown.batch.to_csv())?;
    let (points, observations) = (grown.points, grown.observations);
    let poses_apart_m = grown.poses_apart_m;
    let mut runs = vec![grown.incremental, grown.batch];
    runs.extend(peers);
    for program in &arguments.run {
        runs.push(program.run(&problem, &arguments.out, arguments.keyframes, context)?);
    }
    let printed = Printed {
        keyframes: arguments.keyframes,
        points,
        observations,
        map_percent: arguments.map_percent,
        poses_apart_m,
        solvers: runs.iter().map(|run| run.summary(&runs[1])).collect(),
    };
    let mut made_from = Provenance::new(&serde_json::json!({
        "keyframes": arguments.keyframes,
        "points": arguments.points,
        "map_percent": arguments.map_percent,
        "seed": arguments.seed,
        "batch_every": arguments.batch_every,
    }));
    inputs
        .iter()
        .chain([&problem.as_path()])
        .try_for_each(|path| made_from.add_input(path))?;
    let content = page_of(&runs, &printed.solvers, &about(&printed));
    pages::write(&page, content, &made_from)?;
    context.print(&printed, || {
        let lines = printed.solvers.iter().map(Summary::line);
        let lines: Vec<String> = lines.collect();
        format!("{}\n{}", about(&printed), lines.join("\n"))
    })?;
    Ok(Outcome::Done)
}

fn about(printed: &Printed) -> String {
    format!(
        "{} keyframes, {} points, {} % of them of a map, {} observations; one thread, loop at the end; poses of the incremental \
         solution at most {:.1e} m from the optimum",
        printed.keyframes,
        printed.points,
        printed.map_percent,
        printed.observations,
        printed.poses_apart_m
    )
}
