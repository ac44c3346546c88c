//! What every command needs: where to print, when to stop.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use lsfb_recording::Recording;
use lsfb_types::Progress;
use serde::Serialize;

use crate::progress::Display;

/// Exit code after Ctrl-C, as shells have it: 128 and the number of SIGINT.
const INTERRUPTED: i32 = 130;

/// Shared by a command and its stages.
pub struct Context {
    json: bool,
    display: Display,
    stop: Arc<AtomicBool>,
    data_lost: AtomicBool,
}

impl Context {
    /// From now on Ctrl-C asks for an orderly end; a second one ends at once.
    pub fn new(json: bool) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        ctrlc::set_handler(move || {
            if flag.swap(true, Ordering::Relaxed) {
                std::process::exit(INTERRUPTED);
            }
        })
        .context("cannot install the Ctrl-C handler")?;
        Ok(Self {
            json,
            display: Display::new(),
            stop,
            data_lost: AtomicBool::new(false),
        })
    }

    /// Set when the user asked for an orderly end.
    pub fn stop(&self) -> &AtomicBool {
        &self.stop
    }

    /// Fails where the user asked for an end; for stages that cannot be ended half-way.
    pub fn check_stop(&self) -> anyhow::Result<()> {
        anyhow::ensure!(
            !self.stop.load(Ordering::Relaxed),
            "stopped by Ctrl-C; what was written so far is kept"
        );
        Ok(())
    }

    /// What stages that end by themselves on Ctrl-C call.
    pub fn show(&self, progress: Progress) {
        self.display.show(progress);
    }

    /// What stages call that write only when all is done: on Ctrl-C there is nothing to keep, and they end here.
    pub fn show_or_end(&self, progress: Progress) {
        if self.stop.load(Ordering::Relaxed) {
            self.note(&format!(
                "error: stopped by Ctrl-C while {}; its result is not written, earlier files are kept",
                progress.stage
            ));
            std::process::exit(INTERRUPTED);
        }
        self.display.show(progress);
    }

    /// What `lsfb scan` shows while it records: a few lines that replace those before.
    pub fn show_board(&self, lines: &str) {
        self.display.show_board(lines);
    }

    /// Prints a command's result: `value` as JSON where that was asked for, else `text`.
    pub fn print<T: Serialize>(
        &self,
        value: &T,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        self.display.finish();
        let out = if self.json {
            serde_json::to_string(value)?
        } else {
            text()
        };
        println!("{out}");
        Ok(())
    }

    /// Opens a recording; says what is missing from it, and remembers that something is.
    pub fn open(&self, path: &Path) -> anyhow::Result<Recording> {
        crate::commands::expect_file(path, "record one with `lsfb scan`")?;
        let recording = Recording::open(path)?;
        for damage in recording.damage() {
            self.note(&format!("warning: {}: {damage}", path.display()));
            self.data_lost.store(true, Ordering::Relaxed);
        }
        Ok(recording)
    }

    /// Whether something was missing from a recording that was opened.
    pub fn data_lost(&self) -> bool {
        self.data_lost.load(Ordering::Relaxed)
    }

    /// A line for the person at the terminal, on stderr.
    pub fn note(&self, line: &str) {
        self.display.finish();
        eprintln!("{line}");
    }
}

/// One sentence and, where there is more than one cause, the chain.
pub fn print_error(error: &anyhow::Error) {
    let mut message = error.to_string();
    for cause in error.chain().skip(1) {
        let cause = cause.to_string();
        // Library errors already quote their source.
        if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    eprintln!("error: {message}");
}
