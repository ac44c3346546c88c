//! The built binary while it runs.

use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tempfile::NamedTempFile;

/// Whatever takes this long has failed.
const PATIENCE: Duration = Duration::from_secs(240);

/// A process, and what it says on stderr.
pub struct Running {
    process: Child,
    errors: NamedTempFile,
}

impl Running {
    /// Starts `lsfb` in `folder`.
    pub fn lsfb(folder: &Path, arguments: impl IntoIterator<Item = String>) -> Self {
        Self::command(folder, arguments, |lsfb| lsfb)
    }

    /// The same, with what else is to be said of the process.
    pub fn command(
        folder: &Path,
        arguments: impl IntoIterator<Item = String>,
        prepare: impl FnOnce(&mut Command) -> &mut Command,
    ) -> Self {
        let errors = NamedTempFile::new().expect("file");
        let log = File::options()
            .append(true)
            .open(errors.path())
            .expect("file");
        let mut lsfb = Command::new(env!("CARGO_BIN_EXE_lsfb"));
        lsfb.args(arguments)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log);
        let process = prepare(&mut lsfb).spawn().expect("the built binary");
        Self { process, errors }
    }

    /// What it has said so far.
    pub fn said(&self) -> String {
        std::fs::read_to_string(self.errors.path()).expect("what it says")
    }

    /// Waits until it has said something.
    pub fn wait_for(&mut self, words: &str) {
        let log = self.errors.path().to_owned();
        let said = move || std::fs::read_to_string(&log).expect("what it says");
        self.wait_until(words, || said().contains(words));
    }

    /// Waits until something holds that it brings about.
    pub fn wait_until(&mut self, what: &str, mut holds: impl FnMut() -> bool) {
        wait_until(what, || {
            // In this order: what a process did before it ended is not missed.
            let ended = self.process.try_wait().expect("status");
            let holds = holds();
            assert!(
                holds || ended.is_none(),
                "ended before {what:?}: {}",
                self.said()
            );
            holds
        });
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> ExitStatus {
        let mut status = None;
        wait_until("the process ends", || {
            status = self.process.try_wait().expect("status");
            status.is_some()
        });
        status.expect("status")
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        let id = i32::try_from(self.process.id()).expect("process id");
        kill(Pid::from_raw(id), signal).expect("signal");
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A test that failed must leave nothing behind; a process that ended is gone already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Waits until something holds.
pub fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < PATIENCE, "in vain: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}
