//! The sessions of all devices in one recording: nothing twice, nothing missing, whoever connects how often.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lsfb_drivers::sidecar::wire::Refusal;
use tokio::sync::Notify;

use super::recorded::{Found, Remembered, SessionStart};
use crate::Error;
use crate::receipt::Progress;

/// Sessions of one device in one recording at most.
const MAX_SESSIONS: usize = 256;

/// Where the recording is, and what its devices are remembered in.
#[derive(Clone, Debug)]
pub(crate) struct RecordingFolders {
    /// The recording.
    pub(crate) recording: PathBuf,
    /// Where it goes on when its disk is full.
    pub(crate) second_folder: Option<PathBuf>,
}

/// All sessions.
#[derive(Debug)]
pub(super) struct Sessions {
    folder: PathBuf,
    place: RecordingFolders,
    devices: Mutex<BTreeMap<String, Device>>,
}

#[derive(Debug, Default)]
struct Device {
    sessions: BTreeMap<String, Session>,
    /// The session that goes on.
    current: Option<String>,
    /// Messages that were handed on, of all sessions.
    recorded: u64,
    /// The connection that may send, and how it is told to end.
    connection: Option<(u64, Arc<Notify>)>,
}

#[derive(Debug)]
struct Session {
    progress: Arc<Progress>,
    /// Number of the last message that was handed on.
    received: u64,
}

/// A session that goes on.
#[derive(Debug)]
pub(super) struct Opened {
    pub(super) progress: Arc<Progress>,
    pub(super) received: u64,
    /// Said in the recording before anything follows, where that is not clear.
    pub(super) start: Option<SessionStart>,
    /// Messages that neither side has.
    pub(super) missing: u64,
    /// What an operator should know.
    pub(super) note: Option<String>,
    /// Told when the same device has connected again.
    pub(super) replaced: Arc<Notify>,
}

impl Sessions {
    pub(super) fn new(folder: PathBuf, place: RecordingFolders) -> Self {
        Self {
            folder,
            place,
            devices: Mutex::default(),
        }
    }

    /// Where the recording is.
    pub(super) fn place(&self) -> &RecordingFolders {
        &self.place
    }

    /// Opens a session for a connection, and has `announce` say so before anything of it follows; an older connection of the
    /// device may send no more. Reads recordings: not for threads that must not wait.
    pub(super) fn open(
        &self,
        connection: u64,
        device: &str,
        session: &str,
        first_unacked: u64,
        announce: impl FnOnce(&Opened),
    ) -> Result<Opened, Refused> {
        let replaced = Arc::new(Notify::new());
        let is_known = {
            let mut devices = self.lock();
            let known = devices.entry(device.to_owned()).or_default();
            let old = known
                .connection
                .replace((connection, Arc::clone(&replaced)));
            if let Some((_, told)) = old {
                told.notify_one();
            }
            if known.sessions.len() >= MAX_SESSIONS && !known.sessions.contains_key(session) {
                return Err(Refused::Protocol(Refusal::Full));
            }
            known.sessions.contains_key(session)
        };
        let mut found = Found::Nothing;
        if !is_known {
            let mut remembered = Remembered::read(&self.folder, device);
            found = remembered.find(device, session);
            let place = &self.place;
            let second = place.second_folder.as_deref();
            remembered
                .add(&self.folder, device, session, &place.recording, second)
                .map_err(Refused::Store)?;
        }
        let held_from = first_unacked.saturating_sub(1);
        let mut note = None;
        let stored = match &found {
            Found::UpTo(stored) => *stored,
            Found::Nothing => held_from,
            Found::Unreadable(path) => {
                note = Some(format!(
                    "{device}: {} cannot be read, so messages from {first_unacked} of session {session} may be in both recordings",
                    path.display()
                ));
                held_from
            }
        };
        let mut devices = self.lock();
        let known = devices.entry(device.to_owned()).or_default();
        if known
            .connection
            .as_ref()
            .is_none_or(|(own, _)| *own != connection)
        {
            return Err(Refused::Protocol(Refusal::Replaced));
        }
        let mut is_new = !known.sessions.contains_key(session);
        let entry = known
            .sessions
            .entry(session.to_owned())
            .or_insert_with(|| Session {
                progress: Progress::stored_up_to(stored.max(held_from)),
                received: stored.max(held_from),
            });
        // Between what is stored here and what the device still holds.
        let mut missing = match is_new {
            true => held_from.saturating_sub(stored),
            false => 0,
        };
        if entry.progress.is_broken() {
            let stored = entry.progress.stored_seq();
            known.recorded = known
                .recorded
                .saturating_sub(entry.received.saturating_sub(stored));
            missing = held_from.saturating_sub(stored);
            entry.received = stored.max(held_from);
            entry.progress = Progress::stored_up_to(entry.received);
            is_new = true;
        }
        let goes_on = known.current.as_deref() == Some(session) && !is_new;
        let start = (!goes_on).then(|| SessionStart {
            session: session.to_owned(),
            next_seq: entry.received + 1,
            recorded_before: known.recorded,
        });
        known.current = Some(session.to_owned());
        let opened = Opened {
            progress: Arc::clone(&entry.progress),
            received: entry.received,
            start,
            missing,
            note,
            replaced,
        };
        announce(&opened);
        Ok(opened)
    }

    /// Hands a message on, by `hand_on`, where the connection is still the device's. False: it is not, or the session is broken.
    pub(super) fn hand_on(
        &self,
        connection: u64,
        device: &str,
        session: &str,
        seq: u64,
        hand_on: impl FnOnce(),
    ) -> bool {
        let mut devices = self.lock();
        let Some(known) = devices.get_mut(device) else {
            return false;
        };
        if known
            .connection
            .as_ref()
            .is_none_or(|(own, _)| *own != connection)
        {
            return false;
        }
        let Some(session) = known.sessions.get_mut(session) else {
            return false;
        };
        if session.progress.is_broken() || seq != session.received + 1 {
            return false;
        }
        session.received = seq;
        known.recorded += 1;
        hand_on();
        true
    }

    /// Number of the last message of a session that is stored here, and of the last that came.
    pub(super) fn stored(&self, device: &str, session: &str) -> Option<u64> {
        let devices = self.lock();
        let session = devices.get(device)?.sessions.get(session)?;
        Some(session.progress.stored_seq())
    }

    /// A connection has ended. Whether it was the device's.
    pub(super) fn close(&self, connection: u64, device: &str) -> bool {
        let mut devices = self.lock();
        let Some(known) = devices.get_mut(device) else {
            return false;
        };
        let is_own = known
            .connection
            .as_ref()
            .is_some_and(|(own, _)| *own == connection);
        if is_own {
            known.connection = None;
        }
        is_own
    }

    /// Devices that are connected.
    pub(super) fn connected(&self) -> usize {
        let devices = self.lock();
        devices.values().filter(|d| d.connection.is_some()).count()
    }

    /// Whether a device is connected.
    pub(super) fn is_connected(&self, device: &str) -> bool {
        let devices = self.lock();
        devices.get(device).is_some_and(|d| d.connection.is_some())
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Device>> {
        self.devices.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why a session was not opened.
#[derive(Debug)]
pub(super) enum Refused {
    /// By the rules.
    Protocol(Refusal),
    /// What must be remembered could not be written.
    Store(Error),
}
