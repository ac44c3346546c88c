//! What every command needs: where to print, when to stop.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use lsfb_pipeline::kept_stages::KeptStages;
use lsfb_recording::{Provenance, Recording};
use lsfb_types::{Progress, Stopped};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::GlobalArguments;
use crate::outcome::Outcome;
use crate::progress::Display;
use crate::refused::Failed;
use crate::stop::StopSignal;
use crate::{full_disk, standing, terminal};

/// Shared by a command and its stages.
pub struct Context {
    json: bool,
    quiet: bool,
    force: bool,
    display: Display,
    stop: StopSignal,
    data_lost: Arc<AtomicBool>,
    /// Whether the result was printed: there is one JSON object.
    printed: Arc<AtomicBool>,
    /// Where is written.
    places: Arc<Mutex<Vec<PathBuf>>>,
    /// Results that were claimed.
    claimed: Arc<Mutex<Vec<PathBuf>>>,
}

impl Context {
    /// One per process: from now on signals only ask for an end.
    pub fn new(global: &GlobalArguments) -> anyhow::Result<Self> {
        Ok(Self {
            json: global.json,
            quiet: global.quiet,
            force: global.force,
            display: Display::new(global.quiet),
            stop: StopSignal::install()?,
            data_lost: Arc::default(),
            printed: Arc::default(),
            places: Arc::default(),
            claimed: Arc::default(),
        })
    }

    /// For a part of the command that runs beside other parts: what it shows begins with its name.
    pub fn part(&self, name: &str) -> Self {
        Self {
            json: self.json,
            quiet: self.quiet,
            force: self.force,
            display: self.display.part(name),
            stop: self.stop.clone(),
            data_lost: Arc::clone(&self.data_lost),
            printed: Arc::clone(&self.printed),
            places: Arc::clone(&self.places),
            claimed: Arc::clone(&self.claimed),
        }
    }

    /// Whether results of the same name may be replaced.
    pub fn force(&self) -> bool {
        self.force
    }

    /// Fails before the work is done where its result must not or cannot be written, by [`crate::existing`]'s rule, or was claimed already;
    /// `read` is what it is made from.
    pub fn claim(&self, result: &Path, read: &[&Path]) -> anyhow::Result<()> {
        self.will_write(result);
        if let Ok(mut claimed) = self.claimed.lock() {
            crate::existing::expect_another(result, &claimed)?;
            claimed.push(result.to_owned());
        }
        crate::existing::expect_free(result, read, self.force)?;
        crate::files::expect_writable(result)
    }

    /// The same of a folder that is a result as a whole, whatever is in it.
    pub fn claim_folder(&self, result: &Path, read: &[&Path]) -> anyhow::Result<()> {
        crate::existing::expect_free_folder(result, self.force)?;
        self.claim(result, read)
    }

    /// What was said about results that stand, made from the same by this program; `None` where they are to be made.
    pub fn standing<R: DeserializeOwned>(
        &self,
        outputs: &[&Path],
        made_from: &Provenance,
    ) -> Option<R> {
        if self.force {
            return None;
        }
        let said = standing::report(outputs, made_from)?;
        let names: Vec<String> = outputs.iter().map(|o| o.display().to_string()).collect();
        self.note(&format!(
            "{}: up to date; use --force to recompute",
            names.join(", ")
        ));
        Some(said)
    }

    /// What was finished of a result before its making was stopped, in `RESULT.unfinished`; says so where there is something.
    pub fn kept_stages(&self, result: &Path, made_from: &Provenance) -> anyhow::Result<KeptStages> {
        if !standing::can_stand(made_from) {
            return Ok(KeptStages::none());
        }
        let mut name = result.file_name().unwrap_or_default().to_os_string();
        name.push(".unfinished");
        let made_from = serde_json::to_string(&(standing::program_sha256()?, made_from))?;
        let stages = KeptStages::in_folder(&result.with_file_name(name), &made_from)?;
        if stages.has_any() {
            self.note(&format!("{}: resuming where it stopped", result.display()));
        }
        Ok(stages)
    }

    /// Remembers where is written, so that a full disk can be named.
    pub fn will_write(&self, place: &Path) {
        if let Ok(mut places) = self.places.lock() {
            places.push(place.to_owned());
        }
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
            self.display.finish();
            let places = self.places.lock().map(|places| places.clone());
            let in_json = self.json && !self.printed.load(Ordering::Relaxed);
            return say_failed(error, &places.unwrap_or_default(), in_json).into();
        };
        let stage = self.display.stage();
        self.display.finish();
        let during = match stage {
            "" => String::new(),
            stage => format!(" during: {stage}"),
        };
        terminal::say(&format!(
            "stopped by {signal}{during}; unfinished results are not written, earlier files are kept"
        ));
        ExitCode::from(self.stop.exit_code())
    }

    /// What `lsfb scan` shows while it records: a few lines that replace those before.
    pub fn show_board(&self, lines: &str) {
        self.display.show_board(lines);
    }

    /// Prints a command's result: `value` as JSON where that was asked for, else `text`. A command that writes nothing else and was told
    /// to stop prints nothing either.
    pub fn print<T: Serialize>(
        &self,
        value: &T,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        self.expect_wanted()?;
        self.print_ended(value, text)
    }

    /// The same of what a stop ends in order (a live recording, devices that are simulated or played), and of what is done already.
    pub fn print_ended<T: Serialize>(
        &self,
        value: &T,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        self.display.finish();
        self.printed.store(true, Ordering::Relaxed);
        if self.json {
            terminal::print_plain(&serde_json::to_string(value)?)
        } else {
            terminal::print(&text())
        }
    }

    /// Fails where the user asked for an end and nothing is written that the result belongs to.
    fn expect_wanted(&self) -> Result<(), Stopped> {
        match self.places.lock().is_ok_and(|places| places.is_empty()) {
            true => self.stop.check(),
            false => Ok(()),
        }
    }

    /// What [`Context::print`] would have printed, kept from when it was.
    pub fn print_kept(&self, json: &str, text: &str) -> anyhow::Result<()> {
        self.display.finish();
        self.printed.store(true, Ordering::Relaxed);
        terminal::print(if self.json { json } else { text })
    }

    /// Opens a recording; says what is missing from it, and remembers that something is.
    pub fn open(&self, path: &Path) -> anyhow::Result<Recording> {
        crate::files::expect_file(path, "record one with `lsfb scan`")?;
        let recording = Recording::open(path)?;
        for damage in recording.damage() {
            self.say(&format!("warning: {}: {damage}", path.display()));
            self.lose_data();
        }
        Ok(recording)
    }

    /// Remembers that something is missing from what was read: a command that is done otherwise ends with the code for that.
    pub fn lose_data(&self) {
        self.data_lost.store(true, Ordering::Relaxed);
    }

    /// Whether something was missing from a recording that was opened.
    pub fn data_lost(&self) -> bool {
        self.data_lost.load(Ordering::Relaxed)
    }

    /// A line for the person at the terminal, on stderr.
    pub fn say(&self, line: &str) {
        self.display.say(line);
    }

    /// The same, for what `--quiet` leaves out.
    pub fn note(&self, line: &str) {
        if !self.quiet {
            self.say(line);
        }
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

/// Says why a command failed, for the person at the terminal and, where that was asked for, in JSON; a disk that is full is named.
pub fn say_failed(error: &anyhow::Error, places: &[PathBuf], in_json: bool) -> Outcome {
    let mut message = sentence(error);
    if let Some(full) = full_disk::named(error, places) {
        message = format!("{message}: {full}");
    }
    let failed = Failed::new(error, &message);
    if in_json && let Ok(json) = serde_json::to_string(&failed) {
        // Where stdout is full or closed, stderr says why all the same.
        let _ = terminal::print_plain(&json);
    }
    // It quotes names and texts of files.
    terminal::say(&terminal::printable(&format!("error: {message}")));
    failed.outcome()
}
