//! `lsfb`: one binary, one file per subcommand.
//!
//! Exit codes: see [`outcome::EXIT_CODES`].

#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "the one crate that talks to people"
)]

mod bad_argument;
mod clock_page;
mod commands;
mod context;
mod existing;
mod files;
mod full_disk;
mod judged;
mod live;
mod memory;
mod one_of;
mod outcome;
mod pages;
mod phones;
mod progress;
mod qr_code;
mod refused;
mod simulated;
mod standing;
mod stop;
mod terminal;
#[cfg(test)]
mod tests;
mod twin_session;
mod twin_truth;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::context::Context;
use crate::outcome::Outcome;

/// What all commands have in common, behind the exit codes.
const NOTES: &str = "Existing results are not replaced without --force. Ctrl-C stops a command cleanly and leaves no
half-written file (when recording devices it ends the recording, with 0 or 3); a second Ctrl-C stops
it at once. Output is coloured on terminals, unless NO_COLOR is set.

Examples:
  lsfb demo --out demo-out                               # all of the below, simulated; open demo-out/report.html
  lsfb scan --devices devices.toml --out scan.mcap       # record the backpack
  lsfb map scan.mcap --out map                           # build the HD map
  lsfb groundtruth walk.mcap --map map --out walk.tum    # ground truth of a walk
  lsfb eval slam.tum --truth walk.tum                    # evaluate a SLAM system";

/// Heading, in every command's help, of the options that all commands have.
const COMMON_OPTIONS: &str = "Options of all commands";

/// Ground truth for AR: from a backpack scan to centimetre-accurate trajectories of every walk.
#[derive(Parser)]
#[command(name = "lsfb", version, arg_required_else_help = true, after_help = format!("{}\n{NOTES}", outcome::exit_codes()))]
struct Arguments {
    #[command(flatten)]
    global: GlobalArguments,
    #[command(subcommand)]
    command: Command,
}

/// What every subcommand takes.
#[derive(clap::Args, Clone, Copy)]
struct GlobalArguments {
    /// Print one JSON object on stdout instead of text.
    #[arg(long, global = true, help_heading = COMMON_OPTIONS)]
    json: bool,
    /// Print nothing on stderr except warnings and errors.
    #[arg(long, short, global = true, help_heading = COMMON_OPTIONS)]
    quiet: bool,
    /// Replace existing results.
    #[arg(long, global = true, help_heading = COMMON_OPTIONS)]
    force: bool,
    /// Number of threads; 0 uses all cores. Results do not depend on it.
    #[arg(long, global = true, help_heading = COMMON_OPTIONS, default_value_t = 0, value_name = "N", value_parser = threads)]
    threads: usize,
}

/// More cores than any machine has; each thread takes memory before it does anything.
const MOST_THREADS: usize = 1024;

fn threads(text: &str) -> Result<usize, String> {
    let number: Option<usize> = text.parse().ok();
    let within = number.filter(|threads| *threads <= MOST_THREADS);
    within.ok_or_else(|| format!("expected a whole number from 0 (all cores) to {MOST_THREADS}"))
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::Arguments),
    Calib(commands::calib::Arguments),
    Sim(commands::sim::Arguments),
    Mock(commands::mock::Arguments),
    Scan(commands::scan::Arguments),
    Import(commands::import::Arguments),
    Sidecar(commands::sidecar::Arguments),
    Doctor(commands::doctor::Arguments),
    Clock(commands::clock::Arguments),
    Recover(commands::recover::Arguments),
    Odometry(commands::odometry::Arguments),
    Map(commands::map::Arguments),
    Localize(commands::localize::Arguments),
    Models(commands::models::Arguments),
    Groundtruth(commands::groundtruth::Arguments),
    Vio(commands::vio::Arguments),
    Eval(commands::eval::Arguments),
    Convert(commands::convert::Arguments),
    Survey(commands::survey::Arguments),
    Align(commands::align::Arguments),
    Bench(commands::bench::Arguments),
    Dataset(commands::dataset::Arguments),
    Report(commands::report::Arguments),
    #[cfg(feature = "view")]
    View(commands::view::Arguments),
    Completions(commands::completions::Arguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let context = match Context::new(&arguments.global) {
        Ok(context) => context,
        Err(error) => {
            return context::say_failed(&error, &[], arguments.global.json).into();
        }
    };
    match run(arguments, &context) {
        Ok(outcome) => outcome.into(),
        Err(error) => context.failed(&error),
    }
}

fn run(arguments: Arguments, context: &Context) -> anyhow::Result<Outcome> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.global.threads)
        .build_global()?;
    let outcome = match arguments.command {
        Command::Demo(a) => commands::demo::run(&a, context),
        Command::Calib(a) => commands::calib::run(&a, context),
        Command::Sim(a) => commands::sim::run(&a, context),
        Command::Mock(a) => commands::mock::run(&a, context),
        Command::Scan(a) => commands::scan::run(&a, context),
        Command::Import(a) => commands::import::run(&a, context),
        Command::Sidecar(a) => commands::sidecar::run(&a, context),
        Command::Doctor(a) => commands::doctor::run(&a, context),
        Command::Clock(a) => commands::clock::run(&a, context),
        Command::Recover(a) => commands::recover::run(&a, context),
        Command::Odometry(a) => commands::odometry::run(&a, context),
        Command::Map(a) => commands::map::run(&a, context),
        Command::Localize(a) => commands::localize::run(&a, context),
        Command::Models(a) => commands::models::run(&a, context),
        Command::Groundtruth(a) => commands::groundtruth::run(&a, context),
        Command::Vio(a) => commands::vio::run(&a, context),
        Command::Eval(a) => commands::eval::run(&a, context),
        Command::Convert(a) => commands::convert::run(&a, context),
        Command::Survey(a) => commands::survey::run(&a, context),
        Command::Align(a) => commands::align::run(&a, context),
        Command::Bench(a) => commands::bench::run(&a, context),
        Command::Dataset(a) => commands::dataset::run(&a, context),
        Command::Report(a) => commands::report::run(&a, context),
        #[cfg(feature = "view")]
        Command::View(a) => commands::view::run(&a, context),
        Command::Completions(a) => commands::completions::run(&a),
    }?;
    // A judgement that failed says more than that some of what it rests on is missing.
    Ok(match outcome {
        Outcome::Done if context.data_lost() => Outcome::DataLost,
        outcome => outcome,
    })
}
