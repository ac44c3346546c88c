//! The rig's side: receives from any number of apps.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use lsfb_types::Timestamp;

use super::decode::{Decoder, SidecarCounters, SidecarMessage};
use super::model::{MAX_CONNECTIONS, MAX_ENVELOPE_BYTES, STREAM_PATH, SUBPROTOCOL};
use super::wire::{Envelope, EnvelopeKind};
use crate::Error;
use crate::transport::websocket::{
    Endpoint, PendingWebSocket, WebSocketConnection, WebSocketListener,
};

/// Where the stream is, for both sides.
pub(super) const ENDPOINT: Endpoint = Endpoint {
    path: STREAM_PATH,
    subprotocol: SUBPROTOCOL,
    max_message_bytes: MAX_ENVELOPE_BYTES,
};

/// How long a connection waits for a message before it looks whether there is something to acknowledge.
const POLL: Duration = Duration::from_millis(10);
/// How long the acceptor waits before it looks whether it shall stop.
const ACCEPT_POLL: Duration = Duration::from_millis(50);
/// Messages after which an acknowledgement does not wait.
const ACK_EVERY: u64 = 32;
/// How long after BYE the last acknowledgement may take: until the recorder has stored everything.
const BYE_TIMEOUT: Duration = Duration::from_secs(60);

/// Where to listen, and how much to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SidecarConfig {
    /// Address and port; port 0 picks a free one.
    pub address: SocketAddr,
    /// Messages that wait for [`SidecarServer::recv`]. When they are full, the apps wait.
    pub queue_messages: usize,
}

impl Default for SidecarConfig {
    /// All networks, port 8790, 64 messages.
    fn default() -> Self {
        Self {
            address: SocketAddr::from(([0, 0, 0, 0], 8790)),
            queue_messages: 64,
        }
    }
}

/// What happened on a connection.
#[derive(Debug)]
pub enum SidecarEvent {
    /// The app said something.
    Message {
        /// Number of the connection, from 1.
        connection: u64,
        /// When it arrived.
        arrival: Timestamp,
        /// What it said.
        message: SidecarMessage,
    },
    /// The connection is over.
    Closed {
        /// Number of the connection.
        connection: u64,
        /// What it met.
        counters: SidecarCounters,
        /// Why, where it did not end with BYE.
        error: Option<Error>,
    },
}

/// Serves `ws://address/v1/stream`: one named thread per connection, one bounded queue to the caller.
#[derive(Debug)]
pub struct SidecarServer {
    address: SocketAddr,
    events: Receiver<QueuedEvent>,
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
    /// What the caller got last, to be acknowledged when it comes back.
    delivered: Option<Delivered>,
}

#[derive(Debug)]
struct QueuedEvent {
    event: SidecarEvent,
    /// The connection's stored number, for DATA.
    delivered: Option<Delivered>,
}

#[derive(Debug)]
struct Delivered {
    stored_seq: Arc<AtomicU64>,
    seq: u64,
}

/// An event, and what is owed for it.
#[derive(Debug)]
pub struct Delivery {
    /// What happened.
    pub event: SidecarEvent,
    /// For DATA: to be given back when the message is stored.
    pub receipt: Option<Receipt>,
}

/// Stands for a message that the app keeps until it is stored here. Dropped without a word, the app keeps it.
#[derive(Debug)]
pub struct Receipt(Delivered);

impl Receipt {
    /// The message, and all before it on its connection, are stored: the app is told and may forget them.
    pub fn acknowledge(&self) {
        self.0.stored_seq.fetch_max(self.0.seq, Ordering::AcqRel);
    }
}

#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    connections: AtomicUsize,
    threads: Mutex<VecDeque<JoinHandle<()>>>,
}

impl SidecarServer {
    /// Starts listening.
    pub fn bind(config: &SidecarConfig) -> Result<Self, Error> {
        let listener = WebSocketListener::bind(config.address)?;
        let address = listener.address();
        let (sender, events) = sync_channel(config.queue_messages);
        let shared = Arc::new(Shared::default());
        let acceptor = {
            let shared = Arc::clone(&shared);
            thread::Builder::new()
                .name("sidecar-accept".to_owned())
                .spawn(move || accept_all(&listener, &shared, &sender))
        };
        let acceptor = acceptor.map_err(|cause| Error::Open {
            device: address.to_string(),
            action: "start a thread",
            cause,
        })?;
        Ok(Self {
            address,
            events,
            shared,
            acceptor: Some(acceptor),
            delivered: None,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// [`SidecarServer::recv`] for a caller that stores later: nothing is acknowledged before its receipt is given back.
    pub fn recv_unacknowledged(&mut self, timeout: Duration) -> Result<Option<Delivery>, Error> {
        let event = self.recv(timeout)?;
        let receipt = self.delivered.take().map(Receipt);
        Ok(event.map(|event| Delivery { event, receipt }))
    }

    /// The next event of any connection, waiting up to `timeout`.
    ///
    /// Calling again says that what was returned before is stored: only then is it acknowledged to the app.
    pub fn recv(&mut self, timeout: Duration) -> Result<Option<SidecarEvent>, Error> {
        if let Some(delivered) = self.delivered.take() {
            delivered.stored_seq.store(delivered.seq, Ordering::Release);
        }
        match self.events.recv_timeout(timeout) {
            Ok(queued) => {
                self.delivered = queued.delivered;
                Ok(Some(queued.event))
            }
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(Error::EndOfStream {
                device: self.address.to_string(),
            }),
        }
    }
}

impl Drop for SidecarServer {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        // Threads that wait for room in the queue see it closed.
        let (_, closed) = sync_channel(0);
        self.events = closed;
        if let Some(acceptor) = self.acceptor.take() {
            // A panic there has been reported by the panic hook already.
            let _ = acceptor.join();
        }
        loop {
            let thread = lock(&self.shared.threads).pop_front();
            let Some(thread) = thread else { break };
            let _ = thread.join();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn accept_all(
    listener: &WebSocketListener,
    shared: &Arc<Shared>,
    events: &SyncSender<QueuedEvent>,
) {
    let mut connection = 0;
    while !shared.stop.load(Ordering::Acquire) {
        let pending = match listener.accept(ACCEPT_POLL) {
            Ok(Some(pending)) => pending,
            Ok(None) => continue,
            Err(_) => {
                // A failed accept, for want of file descriptors say, concerns one app; the listener stays.
                thread::sleep(ACCEPT_POLL);
                continue;
            }
        };
        if shared.connections.load(Ordering::Acquire) >= MAX_CONNECTIONS {
            continue;
        }
        connection += 1;
        shared.connections.fetch_add(1, Ordering::AcqRel);
        let serve = {
            let shared = Arc::clone(shared);
            let events = events.clone();
            move || {
                Connection::new(connection, &shared.stop, &events).serve(pending);
                shared.connections.fetch_sub(1, Ordering::AcqRel);
            }
        };
        let spawned = thread::Builder::new()
            .name(format!("sidecar-{connection}"))
            .spawn(serve);
        let mut threads = lock(&shared.threads);
        threads.retain(|thread| !thread.is_finished());
        match spawned {
            Ok(thread) => threads.push_back(thread),
            Err(_) => {
                shared.connections.fetch_sub(1, Ordering::AcqRel);
            }
        }
    }
}

/// One app's connection, on its own thread.
struct Connection<'a> {
    number: u64,
    stop: &'a AtomicBool,
    events: &'a SyncSender<QueuedEvent>,
    decoder: Decoder,
    stored_seq: Arc<AtomicU64>,
    acknowledged_seq: u64,
}

/// Why a connection's loop ends.
enum Ending {
    /// The app said BYE.
    Bye,
    /// Nobody listens to us any more.
    Stopped,
    /// Something went wrong.
    Failed(Error),
}

impl<'a> Connection<'a> {
    fn new(number: u64, stop: &'a AtomicBool, events: &'a SyncSender<QueuedEvent>) -> Self {
        Self {
            number,
            stop,
            events,
            decoder: Decoder::new(),
            stored_seq: Arc::new(AtomicU64::new(0)),
            acknowledged_seq: 0,
        }
    }

    fn serve(mut self, pending: PendingWebSocket) {
        let mut socket = match pending.handshake(ENDPOINT) {
            Ok(socket) => socket,
            Err(error) => return self.pass_on_closed(Some(error)),
        };
        match self.receive(&mut socket) {
            Ending::Bye => {
                self.pass_on_closed(None);
                // The app has its last acknowledgement; how it leaves does not matter.
                let _ = socket.close();
            }
            Ending::Failed(error) => self.pass_on_closed(Some(error)),
            Ending::Stopped => {}
        }
    }

    fn pass_on_closed(&self, error: Option<Error>) {
        let closed = SidecarEvent::Closed {
            connection: self.number,
            counters: self.decoder.counters(),
            error,
        };
        self.pass_on(closed, None);
    }

    fn receive(&mut self, socket: &mut WebSocketConnection) -> Ending {
        loop {
            if self.stop.load(Ordering::Acquire) {
                return Ending::Stopped;
            }
            let packet = match socket.recv(POLL) {
                Ok(packet) => packet,
                Err(error) => return Ending::Failed(error),
            };
            let waited = packet.is_none();
            if let Some(packet) = packet
                // A bad envelope is counted, and the gap it leaves too.
                && let Ok(Some(message)) = self.decoder.push(&packet.bytes)
            {
                if let SidecarMessage::Hello(_) = message {
                    let stored = self.decoder.last_seq();
                    self.stored_seq.store(stored, Ordering::Release);
                    self.acknowledged_seq = stored;
                }
                let is_bye = matches!(message, SidecarMessage::Bye { .. });
                let seq = match message {
                    SidecarMessage::Data { seq, .. } => Some(seq),
                    _ => None,
                };
                let event = SidecarEvent::Message {
                    connection: self.number,
                    arrival: packet.arrival,
                    message,
                };
                if !self.pass_on(event, seq) {
                    return Ending::Stopped;
                }
                if is_bye {
                    return self.acknowledge_rest(socket);
                }
            }
            if let Err(error) = self.acknowledge(socket, if waited { 1 } else { ACK_EVERY }) {
                return Ending::Failed(error);
            }
        }
    }

    /// False: nobody listens any more.
    fn pass_on(&self, event: SidecarEvent, seq: Option<u64>) -> bool {
        let delivered = seq.map(|seq| Delivered {
            stored_seq: Arc::clone(&self.stored_seq),
            seq,
        });
        self.events.send(QueuedEvent { event, delivered }).is_ok()
    }

    /// Acknowledges what has been stored, where that is at least `at_least` messages.
    fn acknowledge(
        &mut self,
        socket: &mut WebSocketConnection,
        at_least: u64,
    ) -> Result<(), Error> {
        let stored = self.stored_seq.load(Ordering::Acquire);
        if stored.saturating_sub(self.acknowledged_seq) < at_least {
            return Ok(());
        }
        self.acknowledged_seq = stored;
        self.send_ack(socket)
    }

    fn send_ack(&self, socket: &mut WebSocketConnection) -> Result<(), Error> {
        let ack = Envelope::bare(EnvelopeKind::Ack, self.acknowledged_seq);
        let bytes = ack.emit().map_err(|e| Error::Protocol {
            device: socket.device().to_owned(),
            problem: format!("acknowledgement: {e}"),
        })?;
        socket.send(bytes)
    }

    /// After BYE: waits until everything that arrived is stored, and says so.
    fn acknowledge_rest(&mut self, socket: &mut WebSocketConnection) -> Ending {
        let deadline = Instant::now() + BYE_TIMEOUT;
        let last = self.decoder.last_seq();
        while self.stored_seq.load(Ordering::Acquire) < last {
            if self.stop.load(Ordering::Acquire) || Instant::now() >= deadline {
                return Ending::Stopped;
            }
            thread::sleep(Duration::from_millis(1));
        }
        self.acknowledged_seq = last;
        match self.send_ack(socket) {
            Ok(()) => Ending::Bye,
            Err(error) => Ending::Failed(error),
        }
    }
}

#[cfg(test)]
mod tests;
