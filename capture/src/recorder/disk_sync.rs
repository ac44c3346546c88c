//! Brings what was written to the disk, all the time and from a thread of its own: otherwise the operating system keeps
//! gigabytes until it must write them at once, and makes the recorder wait meanwhile.

use std::fs::File;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use nix::fcntl::{PosixFadviseAdvice, posix_fadvise};

use super::spawn;
use crate::Error;

/// Pause between two rounds.
const PERIOD: Duration = Duration::from_millis(500);

/// The thread; it ends when it is dropped.
pub(crate) struct DiskSync {
    files: Option<SyncSender<File>>,
    thread: Option<JoinHandle<()>>,
}

impl DiskSync {
    pub(crate) fn start() -> Result<Self, Error> {
        let (files, arriving) = sync_channel(4);
        Ok(Self {
            files: Some(files),
            thread: Some(spawn("disk-sync", move || run(&arriving))?),
        })
    }

    /// From now on this file.
    pub(crate) fn follow(&self, file: std::io::Result<File>) {
        if let (Some(files), Ok(file)) = (&self.files, file) {
            // When four files wait already, this one is brought to the disk by the operating system.
            let _ = files.try_send(file);
        }
    }
}

impl Drop for DiskSync {
    fn drop(&mut self) {
        self.files = None;
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}

fn run(files: &Receiver<File>) {
    let mut current: Option<File> = None;
    loop {
        match files.recv_timeout(PERIOD) {
            Ok(next) => {
                if let Some(last) = current.replace(next) {
                    bring(&last);
                }
            }
            Err(RecvTimeoutError::Timeout) => current.iter().for_each(bring),
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

fn bring(file: &File) {
    // An error here shows up in the next write too, where it is handled.
    if file.sync_data().is_ok() {
        // Nobody reads it again soon; the memory is better used for what comes.
        let _ = posix_fadvise(file, 0, 0, PosixFadviseAdvice::POSIX_FADV_DONTNEED);
    }
}
