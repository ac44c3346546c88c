//! How far a phone's session has got to the disk, and what is owed for each message: between whoever receives and whoever writes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use tokio::sync::Notify;

/// How far a session is stored. What it received in one piece: after something could not be stored, the session goes on with a
/// new one.
#[derive(Debug, Default)]
pub(crate) struct Progress {
    stored_seq: AtomicU64,
    is_broken: AtomicBool,
    changed: Notify,
}

impl Progress {
    pub(crate) fn stored_up_to(seq: u64) -> Arc<Self> {
        let progress = Self::default();
        progress.stored_seq.store(seq, Ordering::Release);
        Arc::new(progress)
    }

    /// Number of the last message that is stored, and all before it.
    pub(crate) fn stored_seq(&self) -> u64 {
        self.stored_seq.load(Ordering::Acquire)
    }

    /// Whether a message was given up.
    pub(crate) fn is_broken(&self) -> bool {
        self.is_broken.load(Ordering::Acquire)
    }

    /// Until one of the two has changed.
    pub(crate) async fn changed(&self) {
        self.changed.notified().await;
    }
}

/// Bytes of one connection that are stored, or need not be.
pub(crate) type Settled = Arc<AtomicU64>;

/// Stands for a message that the app keeps until it is stored here. Dropped without a word, the app keeps it, and the session is
/// broken: what follows must not be stored before it.
#[derive(Debug)]
pub(crate) struct Receipt {
    progress: Arc<Progress>,
    settled: Settled,
    seq: u64,
    bytes: u64,
    is_settled: bool,
    is_given_back: bool,
}

impl Receipt {
    pub(crate) fn new(progress: Arc<Progress>, settled: Settled, seq: u64, bytes: u64) -> Self {
        Self {
            progress,
            settled,
            seq,
            bytes,
            is_settled: false,
            is_given_back: false,
        }
    }

    /// The message is in the file, if not yet on the disk: it takes no memory here any more, and the app may send others.
    pub(crate) fn settle(&mut self) {
        if !std::mem::replace(&mut self.is_settled, true) {
            self.settled.fetch_add(self.bytes, Ordering::AcqRel);
            self.progress.changed.notify_one();
        }
    }

    /// The message, and all before it of its session, are on the disk: the app is told and may forget them.
    pub(crate) fn acknowledge(mut self) {
        self.settle();
        self.is_given_back = true;
        self.progress
            .stored_seq
            .fetch_max(self.seq, Ordering::AcqRel);
        self.progress.changed.notify_one();
    }

    /// Whether a message before it was given up: then it comes again after that one, and must not be stored now.
    pub(crate) fn comes_again(&self) -> bool {
        self.progress.is_broken()
    }
}

impl Drop for Receipt {
    fn drop(&mut self) {
        if !self.is_given_back {
            self.progress.is_broken.store(true, Ordering::Release);
            self.progress.changed.notify_one();
        }
    }
}
