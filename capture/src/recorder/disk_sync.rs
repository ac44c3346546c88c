//! Brings what was written to the disk, all the time and from a thread of its own: otherwise the operating system keeps
//! gigabytes until it must write them at once, and makes the recorder wait meanwhile.
//!
//! What phones and glasses sent is acknowledged here, after that: they forget what is acknowledged, and a power cut must not take it from both.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::{PosixFadviseAdvice, posix_fadvise};

use super::spawn;
use crate::Error;
use crate::receipt::Receipt;

/// Pause between two rounds.
const PERIOD: Duration = Duration::from_millis(500);
/// The same while somebody waits for an acknowledgement.
const OWED_PERIOD: Duration = Duration::from_millis(100);

/// Jobs that wait while the disk is slow.
const JOBS: usize = 64;

/// The thread; when it is dropped, it brings the last to the disk and ends.
pub(crate) struct DiskSync {
    jobs: Option<SyncSender<Job>>,
    /// Of the file that is followed, while too many jobs wait.
    unsent: Vec<Receipt>,
    thread: Option<JoinHandle<()>>,
}

enum Job {
    /// From now on this file, in this folder; `None` where it has no handle of its own.
    Follow(Option<File>, PathBuf),
    /// To be acknowledged when the file is on the disk.
    Acknowledge(Vec<Receipt>),
}

impl DiskSync {
    pub(crate) fn start() -> Result<Self, Error> {
        let (jobs, arriving) = sync_channel(JOBS);
        Ok(Self {
            jobs: Some(jobs),
            unsent: Vec::new(),
            thread: Some(spawn("disk-sync", move || run(&arriving))?),
        })
    }

    /// From now on the file of this path. Waits where too much waits for the last one.
    pub(crate) fn follow(&mut self, file: std::io::Result<File>, path: &Path) {
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        self.send_all();
        if let Some(jobs) = &self.jobs {
            // A thread that is gone has panicked, which the panic hook has reported.
            let _ = jobs.send(Job::Follow(file.ok(), folder.to_owned()));
        }
    }

    /// Of messages that are in the file: they are acknowledged as soon as the file is on the disk, and given up where that fails.
    pub(crate) fn acknowledge(&mut self, receipts: Vec<Receipt>) {
        self.unsent.extend(receipts);
        if self.unsent.is_empty() {
            return;
        }
        if let Some(jobs) = &self.jobs {
            let job = Job::Acknowledge(std::mem::take(&mut self.unsent));
            // The recorder does not wait for a slow disk; those of a thread that is gone are given up.
            if let Err(TrySendError::Full(Job::Acknowledge(unsent))) = jobs.try_send(job) {
                self.unsent = unsent;
            }
        }
    }

    fn send_all(&mut self) {
        let unsent = std::mem::take(&mut self.unsent);
        if let Some(jobs) = self.jobs.as_ref().filter(|_| !unsent.is_empty()) {
            let _ = jobs.send(Job::Acknowledge(unsent));
        }
    }
}

impl Drop for DiskSync {
    fn drop(&mut self) {
        self.send_all();
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}

/// The file that is followed, and what is owed for what is in it.
#[derive(Default)]
struct Followed {
    file: Option<File>,
    owed: Vec<Receipt>,
}

impl Followed {
    fn sync(&mut self) {
        // An error here shows up in the next write too, where it is handled.
        let is_on_disk = self.file.as_ref().is_some_and(|f| f.sync_data().is_ok());
        if !is_on_disk {
            self.owed.clear();
            return;
        }
        self.owed.drain(..).for_each(Receipt::acknowledge);
        if let Some(file) = &self.file {
            // Nobody reads it again soon; the memory is better used for what comes.
            let _ = posix_fadvise(file, 0, 0, PosixFadviseAdvice::POSIX_FADV_DONTNEED);
        }
    }
}

fn run(jobs: &Receiver<Job>) {
    let mut followed = Followed::default();
    let mut synced = Instant::now();
    loop {
        let period = match followed.owed.is_empty() {
            true => PERIOD,
            false => OWED_PERIOD,
        };
        match jobs.recv_timeout(period.saturating_sub(synced.elapsed())) {
            Ok(Job::Follow(file, folder)) => {
                followed.sync();
                followed.file = file;
                // Its name must be there too. Not every file system can say so.
                let _ = File::open(folder).and_then(|folder| folder.sync_all());
            }
            Ok(Job::Acknowledge(more)) => {
                followed.owed.extend(more);
                continue;
            }
            Err(RecvTimeoutError::Timeout) => followed.sync(),
            Err(RecvTimeoutError::Disconnected) => return followed.sync(),
        }
        synced = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::OwnedFd;
    use std::sync::Arc;
    use std::sync::atomic::AtomicU64;

    use super::*;
    use crate::receipt::{Progress, Settled};

    fn receipt(progress: &Arc<Progress>, seq: u64) -> Receipt {
        let settled: Settled = Arc::new(AtomicU64::new(0));
        Receipt::new(Arc::clone(progress), settled, seq, 10)
    }

    #[test]
    fn what_is_on_the_disk_is_acknowledged() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("walk.mcap");
        let mut sync = DiskSync::start().expect("thread");
        sync.follow(File::create(&path), &path);
        let progress = Progress::stored_up_to(0);
        sync.acknowledge(vec![receipt(&progress, 1), receipt(&progress, 2)]);
        // The next file begins, and the last is brought to the disk before.
        let next = folder.path().join("walk-0002.mcap");
        sync.follow(File::create(&next), &next);
        sync.acknowledge(vec![receipt(&progress, 3)]);
        drop(sync);
        assert_eq!(progress.stored_seq(), 3);
        assert!(!progress.is_broken());
    }

    /// A pipe takes everything and keeps nothing: no disk stands behind it.
    #[test]
    fn what_does_not_reach_the_disk_is_not_acknowledged() {
        let (_reader, writer) = std::io::pipe().expect("pipe");
        let mut sync = DiskSync::start().expect("thread");
        sync.follow(
            Ok(File::from(OwnedFd::from(writer))),
            Path::new("walk.mcap"),
        );
        let progress = Progress::stored_up_to(0);
        sync.acknowledge(vec![receipt(&progress, 1)]);
        drop(sync);
        assert_eq!(progress.stored_seq(), 0);
        assert!(progress.is_broken(), "the phone must send it again");
    }
}
