//! The server that phones and glasses send to: HTTPS and WebSockets, on threads of its own.
//!
//! Everything that a stranger can reach has a limit in size, number and time. Nothing here touches the recording but the events
//! in one bounded queue: while that is full, the apps wait.

mod accept;
mod answers;
mod connection_limits;
mod conversation;
mod page;
mod push;
mod refusals;
mod routes;
mod segments;
mod socket;
mod stream;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use lsfb_drivers::sidecar::SidecarMessage;
use lsfb_drivers::sidecar::wire::{Hello, TimeExchange};
use lsfb_types::Timestamp;
use tokio::net::TcpListener;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::sync::watch;

use super::pairing::PairingFolder;
use super::pseudonyms::Pseudonyms;
use super::recorded::SessionStart;
use super::sessions::{RecordingFolders, Sessions};
use super::topics::Topics;
use crate::Error;
use crate::receipt::Receipt;
use connection_limits::{ConnectionLimits, Ticket};
pub(crate) use refusals::Refusals;

/// Threads of the network side.
const THREADS: usize = 2;
/// Events that wait to be taken. When they are full, the apps wait.
const QUEUE_EVENTS: usize = 64;
/// How long a connection may take to say who it is.
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
    limits: Arc<ConnectionLimits>,
    refusals: Arc<Refusals>,
    /// Set when recording begins.
    recording: watch::Receiver<Option<Arc<Recorded>>>,
    events: Sender<SidecarEvent>,
    /// Connections so far, whoever came by them.
    connections: AtomicU64,
}

/// One connection, whoever it is.
#[derive(Clone, Debug)]
struct Visit {
    /// Its number.
    connection: u64,
    ticket: Arc<Ticket>,
    shared: Arc<Shared>,
    running: watch::Receiver<()>,
}

/// What there is while a recording goes on.
#[derive(Debug)]
struct Recorded {
    sessions: Sessions,
    topics: Mutex<Topics>,
    pushing: push::Pushing,
}

/// Serves until it is dropped. Apps that come before the recording begins wait.
#[derive(Debug)]
pub(crate) struct SidecarServer {
    address: SocketAddr,
    push_address: Option<SocketAddr>,
    runtime: Option<Runtime>,
    events: Receiver<SidecarEvent>,
    refusals: Arc<Refusals>,
    sessions_folder: PathBuf,
    pseudonyms: Option<Pseudonyms>,
    recording: watch::Sender<Option<Arc<Recorded>>>,
    /// Changes when the recording has ended.
    running: watch::Sender<()>,
}

impl SidecarServer {
    /// Starts listening, and at `push` to apps that push without TLS; with `pseudonyms` no identifier of others is recorded as it is.
    pub(crate) fn bind(
        address: SocketAddr,
        push: Option<SocketAddr>,
        pairing: PairingFolder,
        pseudonyms: Option<Pseudonyms>,
    ) -> Result<Self, Error> {
        let unusable_at = |address: SocketAddr, action| {
            move |cause| {
                Error::Device(lsfb_drivers::Error::Open {
                    device: address.to_string(),
                    action,
                    cause,
                })
            }
        };
        let unusable = |action| unusable_at(address, action);
        let tls = pairing.tls()?;
        let runtime = Builder::new_multi_thread()
            .worker_threads(THREADS)
            .thread_name("sidecar-net")
            .enable_io()
            .enable_time()
            .build()
            .map_err(unusable("start threads"))?;
        let listener = runtime
            .block_on(TcpListener::bind(address))
            .map_err(unusable("listen"))?;
        let bound = listener.local_addr().map_err(unusable("listen"))?;
        let pushed_at = push
            .map(|address| {
                runtime
                    .block_on(TcpListener::bind(address))
                    .map_err(unusable_at(address, "listen"))
            })
            .transpose()?;
        let push_address = pushed_at.as_ref().and_then(|l| l.local_addr().ok());
        let (events, arriving) = channel(QUEUE_EVENTS);
        let (recording, begun) = watch::channel(None);
        let (running, ended) = watch::channel(());
        let refusals = Arc::new(Refusals::default());
        let sessions_folder = pairing.sessions();
        let shared = Arc::new(Shared {
            pairing,
            pseudonyms: pseudonyms.clone(),
            limits: Arc::default(),
            refusals: Arc::clone(&refusals),
            recording: begun,
            events,
            connections: AtomicU64::new(0),
        });
        if let Some(pushed_at) = pushed_at {
            let (shared, ended) = (Arc::clone(&shared), ended.clone());
            runtime.spawn(accept::accept_all(pushed_at, None, shared, ended));
        }
        runtime.spawn(accept::accept_all(listener, Some(tls), shared, ended));
        Ok(Self {
            address: bound,
            push_address,
            runtime: Some(runtime),
            events: arriving,
            refusals,
            sessions_folder,
            pseudonyms,
            recording,
            running,
        })
    }

    /// Where it listens.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Where apps push without TLS.
    pub(crate) fn push_address(&self) -> Option<SocketAddr> {
        self.push_address
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
        let runtime = self.runtime.as_ref()?;
        let events = &mut self.events;
        // An error: nothing came in time.
        runtime
            .block_on(async { tokio::time::timeout(timeout, events.recv()).await })
            .unwrap_or_default()
    }
}

impl Drop for SidecarServer {
    fn drop(&mut self) {
        // Whoever waits for room sees the queue closed.
        self.events.close();
        self.running.send_replace(());
        if let Some(runtime) = self.runtime.take() {
            let all_gone = async { tokio::time::timeout(GOODBYE, self.running.closed()).await };
            // Who has not gone by then is cut off.
            let _ = runtime.block_on(all_gone);
            runtime.shutdown_timeout(GOODBYE);
        }
    }
}
