//! What every command needs: where to print, when to stop.

use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use lsfb_recording::Recording;
use lsfb_types::{Progress, Stopped};
use serde::Serialize;

use crate::progress::Display;
use crate::stop::StopSignal;

/// Shared by a command and its stages.
pub struct Context {
    json: bool,
    display: Display,
    stop: StopSignal,
    data_lost: AtomicBool,
}

impl Context {
    /// One per process: from now on signals only ask for an end.
    pub fn new(json: bool) -> anyhow::Result<Self> {
        Ok(Self {
            json,
            display: Display::new(),
            stop: StopSignal::install()?,
            data_lost: AtomicBool::new(false),
        })
    }

    /// Fails where the user asked for an end.
    pub fn check_stop(&self) -> Result<(), Stopped> {
        self.stop.check()
    }

    /// What stages call: shows how far they are, and tells them where the user asked for an end.
    pub fn show(&self, progress: Progress) -> Result<(), Stopped> {
        self.stop.check()?;
        self.display.show(progress);
        Ok(())
    }

    /// Says why a command failed, or what stopped it; the exit code that goes with it.
    pub fn failed(&self, error: &anyhow::Error) -> ExitCode {
        let stopped = error.chain().any(|cause| cause.is::<Stopped>());
        let Some(signal) = self.stop.name().filter(|_| stopped) else {
            print_error(error);
            return ExitCode::FAILURE;
        };
        let stage = self.display.stage();
        self.display.finish();
        let during = match stage {
            "" => String::new(),
            stage => format!(" during: {stage}"),
        };
        eprintln!(
            "stopped by {signal}{during}; what was not finished is not written, earlier files are kept"
        );
        ExitCode::from(self.stop.exit_code())
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
pub fn sentence(error: &anyhow::Error) -> String {
    let mut message = error.to_string();
    for cause in error.chain().skip(1) {
        let cause = cause.to_string();
        // Library errors already quote their source.
        if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}

/// For the person at the terminal.
pub fn print_error(error: &anyhow::Error) {
    eprintln!("error: {}", sentence(error));
}
