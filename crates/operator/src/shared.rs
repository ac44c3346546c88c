//! What clients of the screen are to see, and what they ask for.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, AtomicUsize};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lsfb_web::Names;
use serde::Deserialize;

use crate::map::MapSnapshot;
use crate::preview::Preview;

/// What the operator wants.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "command", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Begin a recording.
    Start,
    /// End it.
    Stop,
    /// Write something down.
    Note {
        /// The words.
        text: String,
    },
    /// Mark where the rig is.
    ControlPoint {
        /// Name of the point.
        name: String,
    },
}

/// A command, and whom to answer.
#[derive(Debug)]
pub struct Request {
    /// What is wanted.
    pub command: Command,
    pub(crate) answer: SyncSender<Result<String, String>>,
}

impl Request {
    /// Says what was done, or why it was not. A client that has gone does not hear it.
    pub fn answer(self, outcome: Result<String, String>) {
        let _ = self.answer.try_send(outcome);
    }
}

/// What all clients share.
#[derive(Debug)]
pub(crate) struct Shared {
    pub names: Names,
    pub wrong_pins: AtomicU32,
    /// Clients that have been let in.
    pub clients: AtomicUsize,
    pub shown: Mutex<Published>,
    pub requests: SyncSender<Request>,
}

/// What clients are to see.
#[derive(Clone, Debug, Default)]
pub(crate) struct Published {
    pub state: Arc<str>,
    pub map: Arc<MapSnapshot>,
    pub previews: BTreeMap<String, Arc<Preview>>,
}

impl Shared {
    pub fn lock(&self) -> MutexGuard<'_, Published> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What clients are to see now.
    pub fn published(&self) -> Published {
        self.lock().clone()
    }
}
