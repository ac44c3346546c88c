//! `lsfb bench serve`: trajectories uploaded, judged by a truth that is not shown, and ranked.

mod kept;
mod page;
mod rate;
mod site;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use lsfb_web::{Listener, Server, handler};

use crate::commands::dataset;
use crate::context::Context;
use crate::outcome::Outcome;
use site::Site;

/// How often somebody may have asked for an end.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Serve a leaderboard that scores uploaded trajectories without showing the truth.
///
/// Uploads are text (TUM, EuRoC csv, or any format of `lsfb eval`), one sequence each, limited in size
/// and number. They are scored and then deleted; scores are kept in submissions.jsonl. Errors are given
/// to the millimetre after alignment; teams that cover less than 90 % of a sequence are not ranked.
/// There are no passwords: share the address only with people you trust, or put a web server with
/// accounts and TLS in front. Press Ctrl-C to stop.
///
/// Examples:
///   lsfb bench serve dataset --out board
///   lsfb bench serve dataset --out board --listen 127.0.0.1:8080 --max-mb 4
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Dataset with its truth.
    #[arg(value_name = "FOLDER")]
    dataset: PathBuf,
    /// Folder for the scores.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Address to listen on; port 0 picks a free one.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8780")]
    listen: SocketAddr,
    /// Largest upload.
    #[arg(long, value_name = "MB", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=256))]
    max_mb: u32,
}

/// Serves until it is told to end.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let (folder, description) = dataset::open(&arguments.dataset)?;
    let out = &arguments.out;
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    context.will_write(out);
    let site = Site::new(
        &folder,
        &description,
        out,
        arguments.max_mb as usize * 1_000_000,
    )?;
    if site.is_empty() {
        anyhow::bail!(
            "{}: no sequence has its truth: the folder truth was held back",
            arguments.dataset.display()
        );
    }
    let site = Arc::new(site);
    let listener = Listener::open(&Server::start("leaderboard")?, arguments.listen, None)?;
    let _mount = listener.mount(
        "",
        handler(move |request, visit| Site::answer(Arc::clone(&site), request, visit)),
    );
    context.say(&format!("leaderboard: http://{}/", listener.address()));
    if !listener.address().ip().is_loopback() {
        context.say("warning: anyone who can reach this machine can upload");
    }
    // It has no end of its own: it is stopped as every command is.
    loop {
        context.check_stop()?;
        std::thread::sleep(LOOK_EVERY);
    }
}
