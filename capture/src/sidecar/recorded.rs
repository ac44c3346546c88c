//! How much of a session earlier recordings hold: what a rig that was killed, or stopped, says to a device that comes back.
//!
//! A session's messages are recorded in order and without a gap. Where a session begins in a recording, a message on
//! `/sidecar/<id>/session` says with which number, and how many messages of that device the recording had before. So the number
//! of the last one follows from how many the recording has, whatever ended it: a chunk of it is there whole or not at all.

use std::path::{Path, PathBuf};

use lsfb_recording::Recording;
use lsfb_recording::message::{self, Remark, Schema};
use lsfb_types::Timestamp;
use serde::{Deserialize, Serialize};

use super::pairing;
use super::topics::{SESSION, is_recorders_own, prefix_of};
use crate::Error;
use crate::recorder::{OwnMessage, parts_of};

/// Recordings of a device that are remembered; a session that was left off longer ago begins anew.
const MAX_REMEMBERED: usize = 64;

/// Where a session begins in a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct SessionStart {
    /// Name of the session.
    pub(crate) session: String,
    /// Number of its next message.
    pub(crate) next_seq: u64,
    /// Messages of the device that the recording has before it.
    pub(crate) recorded_before: u64,
}

impl SessionStart {
    /// The schema of its message: words, as the operator's.
    const SCHEMA: Schema = message::REMARK;

    pub(crate) fn message(&self, device: &str, arrival: Timestamp) -> OwnMessage {
        // Numbers and names always serialise.
        let text = serde_json::to_string(self).unwrap_or_default();
        let remark = Remark {
            kind: "session".to_owned(),
            text,
            position_in_world_m: None,
        };
        OwnMessage {
            topic: topic_of(device),
            schema: Self::SCHEMA,
            time: arrival,
            arrival,
            bytes: message::encode_remark(arrival, &remark),
        }
    }
}

fn topic_of(device: &str) -> String {
    format!("/sidecar/{device}{SESSION}")
}

/// The recordings that hold a device's sessions, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Remembered {
    entries: Vec<Entry>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Entry {
    session: String,
    recording: PathBuf,
    /// Where the recording was to go on when its disk was full.
    second_folder: Option<PathBuf>,
}

/// What earlier recordings say of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// Nothing: it is new here.
    Nothing,
    /// Everything up to this number is recorded.
    UpTo(u64),
    /// One that should hold it cannot be read, so that this is not known.
    Unreadable(PathBuf),
}

impl Remembered {
    pub(super) fn read(folder: &Path, device: &str) -> Self {
        let bytes = std::fs::read(folder.join(device)).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }

    /// Adds a recording: before the first message of the session is in it.
    pub(super) fn add(
        &mut self,
        folder: &Path,
        device: &str,
        session: &str,
        recording: &Path,
        second_folder: Option<&Path>,
    ) -> Result<(), Error> {
        let entry = Entry {
            session: session.to_owned(),
            recording: recording.to_owned(),
            second_folder: second_folder.map(Path::to_owned),
        };
        self.entries.retain(|known| *known != entry);
        self.entries.push(entry);
        let excess = self.entries.len().saturating_sub(MAX_REMEMBERED);
        self.entries.drain(..excess);
        // Paths that are no text are not remembered.
        let bytes = serde_json::to_vec_pretty(self).unwrap_or_default();
        pairing::replace(&folder.join(device), &bytes)
    }

    /// Looks a session up in the recordings, the newest first.
    pub(super) fn find(&self, device: &str, session: &str) -> Found {
        let mut unreadable = None;
        for entry in self.entries.iter().rev() {
            if entry.session != session {
                continue;
            }
            match stored_in(entry, device, session) {
                Ok(Some(seq)) => return Found::UpTo(seq),
                // It was remembered, and ended before the session began in it; or another has its name now.
                Ok(None) => {}
                Err(_) => unreadable = unreadable.or(Some(entry.recording.clone())),
            }
        }
        unreadable.map_or(Found::Nothing, Found::Unreadable)
    }
}

/// Number of the session's last message in a recording; `None`: the session does not begin in it.
fn stored_in(
    entry: &Entry,
    device: &str,
    session: &str,
) -> Result<Option<u64>, lsfb_recording::Error> {
    let mut starts: Vec<SessionStart> = Vec::new();
    let mut recorded = 0;
    for (number, part) in (1..).zip(parts_of(&entry.recording, entry.second_folder.as_deref())) {
        let recording = match Recording::open(&part) {
            Ok(recording) => recording,
            // The last part of a recording that was killed as it began.
            Err(_) if number > 1 => break,
            Err(error) => return Err(error),
        };
        for topic in recording.topics() {
            let is_devices = topic.topic.starts_with(&prefix_of(device));
            if is_devices && !is_recorders_own(&topic.topic) {
                recorded += topic.messages;
            }
        }
        for message in recording.messages(&topic_of(device))? {
            // One that is damaged was not stored.
            let Ok(message) = message else { continue };
            let start = message::decode_remark(&message.bytes)
                .ok()
                .and_then(|remark| serde_json::from_str(&remark.text).ok());
            starts.extend(start);
        }
    }
    let Some(last) = starts.iter().rposition(|start| start.session == session) else {
        return Ok(None);
    };
    let until = starts
        .get(last + 1)
        .map_or(recorded, |next| next.recorded_before);
    let stored = starts.get(last).map(|start| {
        let messages = until.saturating_sub(start.recorded_before);
        start.next_seq.saturating_sub(1) + messages
    });
    Ok(stored)
}
