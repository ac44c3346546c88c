//! What phones and glasses send to: mounted at an address of the HTTP server (`lsfb-web`), by TLS.
//!
//! Everything that a stranger can reach has a limit in size, number and time. Nothing here touches the recording but the events
//! in one bounded queue: while that is full, the apps wait.

mod conversation;
mod page;
mod push;
mod routes;
mod segments;
mod socket;
mod stream;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use lsfb_drivers::sidecar::SidecarMessage;
use lsfb_drivers::sidecar::wire::{Hello, TimeExchange};
use lsfb_types::Timestamp;
use lsfb_web::{Listener, Mount, Refusals, Server, Ticket};
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::sync::watch;

use super::pairing::PairingFolder;
use super::pseudonyms::Pseudonyms;
use super::recorded::SessionStart;
use super::sessions::{RecordingFolders, Sessions};
use super::topics::Topics;
use crate::Error;
use crate::receipt::Receipt;

/// Events that wait to be taken. When they are full, the apps wait.
const QUEUE_EVENTS: usize = 64;
/// How long a WebSocket may take to say who it is.
const INTRODUCTION: Duration = Duration::from_secs(10);
/// How long connections have to say goodbye when the recording ends.
const GOODBYE: Duration = Duration::from_millis(500);

/// What happened.
#[derive(Debug)]
pub(crate) enum SidecarEvent {
    /// A device is there and goes on with a session.
    Opened {
        /// Number of its connection.
        connection: u64,
        /// Who, without its secrets.
        hello: Hello,
        /// When it said so.
        arrival: Timestamp,
        /// What the recording must say before anything follows.
        start: Option<SessionStart>,
        /// Messages that nobody has any more.
        missing: u64,
        /// What an operator should know.
        note: Option<String>,
    },
    /// It said something.
    Message {
        /// Name of the device.
        device: String,
        /// When it arrived.
        arrival: Timestamp,
        /// What it said.
        message: SidecarMessage,
        /// For DATA: what is owed for it.
        receipt: Option<Receipt>,
    },
    /// An exchange of times is complete.
    Time {
        /// Name of the device.
        device: String,
        /// When it was told.
        arrival: Timestamp,
        /// Its clock.
        clock_id: String,
        /// The four times.
        exchange: TimeExchange,
    },
    /// What was pushed without a place in the recording, or never came.
    Pushed {
        /// Name of the device.
        device: String,
        /// Batches of its session that never came, or wait for those.
        missing: u64,
        /// The same when it was told last.
        missing_before: u64,
        /// Readings of sensors that are not recorded, by the sensors' names.
        left_out: BTreeMap<String, u64>,
        /// Readings that could not be read.
        bad: u64,
    },
    /// Its connection is over.
    Closed {
        /// Number of the connection.
        connection: u64,
        /// Name of the device.
        device: String,
        /// Repetitions that were left out.
        duplicated: u64,
        /// Why, where it did not end with BYE.
        why: Option<String>,
    },
}

/// What all connections share.
#[derive(Debug)]
struct Shared {
    pairing: PairingFolder,
    /// Where identifiers are not recorded as they are.
    pseudonyms: Option<Pseudonyms>,
    refusals: Arc<Refusals>,
    /// Set when recording begins.
    recording: watch::Receiver<Option<Arc<Recorded>>>,
    events: Sender<SidecarEvent>,
    /// Changes when the recording has ended.
    running: watch::Receiver<()>,
}

/// One connection, whoever it is.
#[derive(Clone, Debug)]
struct Visit {
    /// Its number.
    connection: u64,
    ticket: Arc<Ticket>,
    shared: Arc<Shared>,
}

/// What there is while a recording goes on.
#[derive(Debug)]
struct Recorded {
    sessions: Sessions,
    topics: Mutex<Topics>,
    pushing: push::Pushing,
}

/// The address at which phones connect, open for longer than one recording; other pages may be mounted there as well.
#[derive(Clone, Debug)]
pub struct PhonesListener(Arc<Listener>);

impl PhonesListener {
    /// Begins to listen at `address`, with the certificate that devices know this rig by, on a server of its own.
    pub fn start(address: SocketAddr, pairing: &PairingFolder) -> Result<Self, Error> {
        let server = Server::start("sidecar-net").map_err(unusable)?;
        let listener = Listener::open(&server, address, Some(pairing.tls()?)).map_err(unusable)?;
        Ok(Self(Arc::new(listener)))
    }

    /// The address, where others may mount their pages.
    pub fn listener(&self) -> &Arc<Listener> {
        &self.0
    }
}

fn unusable(error: lsfb_web::Error) -> Error {
    let device = match &error {
        lsfb_web::Error::Listen { address, .. } => address.to_string(),
        _ => "sidecar".to_owned(),
    };
    Error::Device(lsfb_drivers::Error::Open {
        device,
        action: "listen",
        cause: std::io::Error::other(error),
    })
}

/// Serves until it is dropped. Apps that come before the recording begins wait.
#[derive(Debug)]
pub(crate) struct SidecarServer {
    mounts: Vec<Mount>,
    push: Option<Listener>,
    events: Receiver<SidecarEvent>,
    refusals: Arc<Refusals>,
    sessions_folder: PathBuf,
    pseudonyms: Option<Pseudonyms>,
    recording: watch::Sender<Option<Arc<Recorded>>>,
    /// Changes when the recording has ended.
    running: watch::Sender<()>,
    phones: PhonesListener,
}

impl SidecarServer {
    /// Takes phones at `phones`, and at `push` those apps that push without TLS; with `pseudonyms` no identifier of others is recorded as
    /// it is.
    pub(crate) fn open(
        phones: PhonesListener,
        push: Option<SocketAddr>,
        pairing: PairingFolder,
        pseudonyms: Option<Pseudonyms>,
    ) -> Result<Self, Error> {
        let server = phones.0.server();
        let push = push
            .map(|address| Listener::open(server, address, None))
            .transpose()
            .map_err(unusable)?;
        let refusals = server.refusals();
        // What was refused before belongs to no recording, or to the one before.
        refusals.clear();
        let (events, arriving) = channel(QUEUE_EVENTS);
        let (recording, begun) = watch::channel(None);
        let (running, ended) = watch::channel(());
        let sessions_folder = pairing.sessions();
        let shared = Arc::new(Shared {
            pairing,
            pseudonyms: pseudonyms.clone(),
            refusals: Arc::clone(&refusals),
            recording: begun,
            events,
            running: ended,
        });
        let mut mounts = vec![
            phones
                .0
                .mount("", routes::answering(&shared, routes::answer)),
        ];
        if let Some(push) = &push {
            mounts.push(push.mount("", routes::answering(&shared, routes::answer_pushed)));
        }
        Ok(Self {
            mounts,
            push,
            events: arriving,
            refusals,
            sessions_folder,
            pseudonyms,
            recording,
            running,
            phones,
        })
    }

    /// Where it listens.
    pub(crate) fn address(&self) -> SocketAddr {
        self.phones.0.address()
    }

    /// Where apps push without TLS.
    pub(crate) fn push_address(&self) -> Option<SocketAddr> {
        self.push.as_ref().map(Listener::address)
    }

    /// By what identifiers are replaced, where they are.
    pub(crate) fn pseudonyms(&self) -> Option<&Pseudonyms> {
        self.pseudonyms.as_ref()
    }

    /// Who was refused.
    pub(crate) fn refusals(&self) -> Arc<Refusals> {
        Arc::clone(&self.refusals)
    }

    /// The recording begins, and apps may send.
    pub(crate) fn begin(&self, place: RecordingFolders) {
        let recorded = Recorded {
            sessions: Sessions::new(self.sessions_folder.clone(), place),
            topics: Mutex::default(),
            pushing: push::Pushing::default(),
        };
        self.recording.send_replace(Some(Arc::new(recorded)));
    }

    /// The next event, waiting up to `timeout`.
    pub(crate) fn recv(&mut self, timeout: Duration) -> Option<SidecarEvent> {
        let events = &mut self.events;
        let event = async { tokio::time::timeout(timeout, events.recv()).await };
        // An error: nothing came in time.
        self.phones.0.server().wait_for(event)?.unwrap_or_default()
    }
}

impl Drop for SidecarServer {
    fn drop(&mut self) {
        self.mounts.clear();
        // Whoever waits for room sees the queue closed.
        self.events.close();
        self.running.send_replace(());
        let all_gone = async { tokio::time::timeout(GOODBYE, self.running.closed()).await };
        // Who has not gone by then goes without a word, or with the server.
        let _ = self.phones.0.server().wait_for(all_gone);
    }
}
