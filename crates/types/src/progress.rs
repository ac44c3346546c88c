use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// How far a stage has come. The command line turns it into a bar with an ETA.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// What is being done, in two or three words.
    pub stage: &'static str,
    /// Units done.
    pub done: u64,
    /// Units in all; 0 while unknown.
    pub total: u64,
}

/// What a long-running function calls as it advances: `progress(Progress { .. })?`.
///
/// It is the one way to stop: where the caller answers [`Stopped`], the function returns that error at once and leaves no
/// result. Live recordings and simulated devices have no end of their own: for them it is the end, in order and no error.
pub type ProgressFn<'a> = &'a (dyn Fn(Progress) -> Result<(), Stopped> + Sync);

/// The caller asked for an early end, by the answer of its [`ProgressFn`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped;

impl std::fmt::Display for Stopped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("stopped before it was done")
    }
}

impl std::error::Error for Stopped {}

/// The [`Progress`] of units that threads finish side by side.
pub struct SharedProgress<'a> {
    stage: &'static str,
    done: AtomicU64,
    total: u64,
    progress: ProgressFn<'a>,
}

impl<'a> SharedProgress<'a> {
    /// None of so many is done.
    pub fn new(stage: &'static str, total: usize, progress: ProgressFn<'a>) -> Self {
        Self {
            stage,
            done: AtomicU64::new(0),
            total: total as u64,
            progress,
        }
    }

    /// So many are done already.
    pub fn after(self, done: usize) -> Self {
        Self {
            done: AtomicU64::new(done as u64),
            ..self
        }
    }

    /// One more is done, by whichever thread.
    pub fn one_more(&self) -> Result<(), Stopped> {
        (self.progress)(Progress {
            stage: self.stage,
            done: self.done.fetch_add(1, Ordering::Relaxed) + 1,
            total: self.total,
        })
    }
}

/// The callback of callers who stop by a flag, from another thread.
pub fn until(stop: &AtomicBool) -> impl Fn(Progress) -> Result<(), Stopped> + Sync {
    |_| match stop.load(Ordering::Relaxed) {
        true => Err(Stopped),
        false => Ok(()),
    }
}

/// The callback of callers who neither look nor stop.
pub fn no_progress(_: Progress) -> Result<(), Stopped> {
    Ok(())
}
