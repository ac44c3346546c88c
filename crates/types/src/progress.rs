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

/// What a long-running function calls as it advances.
pub type ProgressFn<'a> = &'a (dyn Fn(Progress) + Sync);

/// The callback of callers who do not look.
pub fn no_progress(_: Progress) {}
