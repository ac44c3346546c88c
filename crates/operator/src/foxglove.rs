//! Live messages for the Foxglove app, by its WebSocket protocol: the recording's own CDR with its `ros2msg` schemas.
//!
//! A topic is advertised when its first message comes; its bytes are made only while somebody has subscribed. Each client has
//! a bounded queue: one that is slow misses messages, and is told how many.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use futures_util::StreamExt as _;
use lsfb_types::Timestamp;
use lsfb_web::{
    Listener, Mount, Server, Socket, StatusCode, Visit, handler, offered, said, upgrade,
};
use serde::Deserialize;
use serde_json::json;
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::time::sleep;
use tokio_tungstenite::tungstenite::{self, Bytes, Message};

use crate::error::Error;
use crate::socket::{Gone, MAX_MESSAGE_BYTES, Presence, close, send};

/// Names of the protocol, the newer first; the messages used here are the same in both.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Opcode of a message in binary.
const MESSAGE_DATA: u8 = 1;
/// Messages that wait for one client: half a second of the whole rig.
const QUEUE_MESSAGES: usize = 128;
/// Missed messages are told in steps of this many.
const MISSED_STEP: u64 = 500;
/// Apps at a time.
const MAX_CLIENTS: usize = 16;
/// How often it is looked whether there is something to tell.
const LOOK_EVERY: Duration = Duration::from_millis(25);

/// What a message is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LiveMessage<'a> {
    /// Topic.
    pub topic: &'a str,
    /// `package/msg/Type`.
    pub schema_name: &'a str,
    /// The `ros2msg` definition.
    pub schema_text: &'a str,
    /// Host receive time.
    pub arrival: Timestamp,
}

/// The server. Dropping it disconnects everybody.
#[derive(Debug)]
pub struct Foxglove {
    // Before the address that it is mounted at.
    _mount: Mount,
    listener: Listener,
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    session: String,
    state: Mutex<Connections>,
}

#[derive(Debug, Default)]
struct Connections {
    channels: BTreeMap<String, Channel>,
    clients: BTreeMap<u64, ClientEntry>,
    next_client: u64,
}

#[derive(Debug)]
struct Channel {
    id: u32,
    /// The entry of the `advertise` message.
    advertised: serde_json::Value,
    /// The last message of a topic that says something once and for all.
    latched: Option<(Timestamp, Bytes)>,
}

#[derive(Debug)]
struct ClientEntry {
    queue: Sender<Message>,
    /// Subscription by channel.
    subscriptions: BTreeMap<u32, u32>,
    missed: Arc<AtomicU64>,
}

impl Foxglove {
    /// Begins to serve at `address`; port 0 takes a free one. `session` names the recording session.
    pub fn open(address: SocketAddr, session: &str) -> Result<Self, Error> {
        let shared = Arc::new(Shared {
            session: session.to_owned(),
            state: Mutex::new(Connections::default()),
        });
        let listener = Listener::open(&Server::start("foxglove")?, address, None)?;
        let served = Arc::clone(&shared);
        let serve = handler(move |request, visit| {
            let shared = Arc::clone(&served);
            async move {
                let Some(protocol) = offered(&request, &PROTOCOLS) else {
                    let problem =
                        "open this address in Foxglove: Open connection, Foxglove WebSocket";
                    return said(StatusCode::BAD_REQUEST, problem);
                };
                upgrade(request, Some(protocol), MAX_MESSAGE_BYTES, |socket| {
                    serve(socket, visit, shared)
                })
            }
        });
        Ok(Self {
            _mount: listener.mount("", serve),
            listener,
            shared,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.listener.address()
    }

    /// Sends a message to whoever has subscribed; `bytes` is not asked where nobody has. Never waits.
    pub fn publish(&self, message: &LiveMessage<'_>, bytes: impl FnOnce() -> Vec<u8>) {
        let mut state = self.shared.lock();
        let channel = state.channel(message).id;
        let wanted = |client: &ClientEntry| client.subscriptions.contains_key(&channel);
        if state.clients.values().any(wanted) {
            let bytes = bytes();
            for client in state.clients.values() {
                client.deliver(channel, message.arrival, &bytes);
            }
        }
    }

    /// Like [`Foxglove::publish`], for what is said once: who subscribes later gets it then.
    pub fn publish_latched(&self, message: &LiveMessage<'_>, bytes: Vec<u8>) {
        let mut state = self.shared.lock();
        let channel = state.channel(message);
        channel.latched = Some((message.arrival, Bytes::from(bytes.clone())));
        let id = channel.id;
        for client in state.clients.values() {
            client.deliver(id, message.arrival, &bytes);
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Connections> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Connections {
    /// The channel of a topic.
    fn channel(&mut self, message: &LiveMessage<'_>) -> &mut Channel {
        let id = self.channels.len() as u32 + 1;
        self.channels
            .entry(message.topic.to_owned())
            .or_insert_with(|| Channel {
                id,
                advertised: json!({
                    "id": id,
                    "topic": message.topic,
                    "encoding": "cdr",
                    "schemaName": message.schema_name,
                    "schema": message.schema_text,
                    "schemaEncoding": "ros2msg",
                }),
                latched: None,
            })
    }
}

impl ClientEntry {
    fn deliver(&self, channel: u32, arrival: Timestamp, bytes: &[u8]) {
        if let Some(subscription) = self.subscriptions.get(&channel) {
            self.put(message_data(*subscription, arrival, bytes));
        }
    }

    fn put(&self, message: Message) {
        if let Err(TrySendError::Full(_)) = self.queue.try_send(message) {
            self.missed.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Opcode, subscription, time of receipt, bytes.
fn message_data(subscription: u32, arrival: Timestamp, bytes: &[u8]) -> Message {
    let mut data = Vec::with_capacity(13 + bytes.len());
    data.push(MESSAGE_DATA);
    data.extend(subscription.to_le_bytes());
    data.extend(arrival.nanos().cast_unsigned().to_le_bytes());
    data.extend(bytes);
    Message::binary(data)
}

/// What an app sends, as far as it matters here.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum ClientMessage {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u32,
}

async fn serve(mut socket: Socket, visit: Visit, shared: Arc<Shared>) {
    let info = json!({
        "op": "serverInfo",
        "name": "lsfb",
        "capabilities": [],
        "supportedEncodings": ["cdr"],
        "metadata": {},
        "sessionId": shared.session,
    });
    if shared.lock().clients.len() >= MAX_CLIENTS
        || send(&mut socket, Message::text(info.to_string()))
            .await
            .is_err()
    {
        return;
    }
    visit.ticket.enter();
    let (queue, waiting) = channel(QUEUE_MESSAGES);
    let missed = Arc::new(AtomicU64::new(0));
    let number = {
        let mut state = shared.lock();
        let number = state.next_client;
        state.next_client += 1;
        state.clients.insert(
            number,
            ClientEntry {
                queue,
                subscriptions: BTreeMap::new(),
                missed: Arc::clone(&missed),
            },
        );
        number
    };
    let mut client = Client {
        socket,
        shared: &shared,
        number,
        waiting,
        missed,
        missed_told: 0,
        advertised: 0,
        presence: Presence::new(),
    };
    let mut running = visit.running.clone();
    // Whatever ends a connection, the app connects anew.
    tokio::select! {
        _ = client.run() => {}
        _ = running.changed() => {}
    }
    shared.lock().clients.remove(&number);
    close(client.socket).await;
}

/// One app.
struct Client<'a> {
    socket: Socket,
    shared: &'a Shared,
    number: u64,
    waiting: Receiver<Message>,
    missed: Arc<AtomicU64>,
    missed_told: u64,
    /// Channels up to this one are known there.
    advertised: u32,
    presence: Presence,
}

/// What an app or the recording has.
enum News {
    Heard(Option<Result<Message, tungstenite::Error>>),
    Recorded(Message),
    Nothing,
}

impl Client<'_> {
    async fn run(&mut self) -> Result<(), Gone> {
        loop {
            self.advertise().await?;
            let news = tokio::select! {
                heard = self.socket.next() => News::Heard(heard),
                Some(message) = self.waiting.recv() => News::Recorded(message),
                () = sleep(LOOK_EVERY) => News::Nothing,
            };
            match news {
                News::Heard(Some(Ok(Message::Text(text)))) => {
                    self.presence.heard();
                    self.take(&text).await?;
                }
                News::Heard(None | Some(Err(_) | Ok(Message::Close(_)))) => return Err(Gone),
                News::Heard(Some(Ok(_))) => self.presence.heard(),
                News::Recorded(message) => send(&mut self.socket, message).await?,
                News::Nothing => {}
            }
            self.tell_missed().await?;
            self.presence.check(&mut self.socket).await?;
        }
    }

    async fn advertise(&mut self) -> Result<(), Gone> {
        let channels: Vec<serde_json::Value> = {
            let state = self.shared.lock();
            let known = state.channels.len() as u32;
            if known == self.advertised {
                return Ok(());
            }
            let new = state.channels.values().filter(|c| c.id > self.advertised);
            let new = new.map(|c| c.advertised.clone()).collect();
            self.advertised = known;
            new
        };
        let advertise = json!({ "op": "advertise", "channels": channels });
        send(&mut self.socket, Message::text(advertise.to_string())).await
    }

    async fn take(&mut self, text: &str) -> Result<(), Gone> {
        let message = match serde_json::from_str::<ClientMessage>(text) {
            Ok(message) => message,
            Err(error) => return self.status(1, &format!("invalid message: {error}")).await,
        };
        let mut unknown = Vec::new();
        {
            let mut state = self.shared.lock();
            let Connections {
                channels, clients, ..
            } = &mut *state;
            let Some(client) = clients.get_mut(&self.number) else {
                return Ok(());
            };
            match message {
                ClientMessage::Subscribe { subscriptions } => {
                    for Subscription { id, channel_id } in subscriptions {
                        match channels.values().find(|c| c.id == channel_id) {
                            Some(channel) => {
                                client.subscriptions.insert(channel_id, id);
                                if let Some((arrival, bytes)) = &channel.latched {
                                    client.deliver(channel_id, *arrival, bytes);
                                }
                            }
                            None => unknown.push(channel_id),
                        }
                    }
                }
                ClientMessage::Unsubscribe { subscription_ids } => client
                    .subscriptions
                    .retain(|_, id| !subscription_ids.contains(id)),
                ClientMessage::Other => {}
            }
        }
        for channel in unknown {
            self.status(1, &format!("there is no channel {channel}"))
                .await?;
        }
        Ok(())
    }

    async fn tell_missed(&mut self) -> Result<(), Gone> {
        let missed = self.missed.load(Ordering::Relaxed);
        if missed < self.missed_told + MISSED_STEP {
            return Ok(());
        }
        self.missed_told = missed;
        self.status(
            1,
            &format!("{missed} messages were left out here because the connection is slow; the recording has them"),
        )
        .await
    }

    /// Level 1 is a warning.
    async fn status(&mut self, level: u8, words: &str) -> Result<(), Gone> {
        let status = json!({ "op": "status", "level": level, "message": words });
        send(&mut self.socket, Message::text(status.to_string())).await
    }
}
