use std::sync::atomic::{AtomicBool, Ordering};

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
