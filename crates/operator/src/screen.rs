//! The page's server: files by HTTP, state and map by WebSocket, and what the operator presses.
//!
//! The WebSocket at `/live` speaks subprotocol `lsfb.operator.v1`. The server sends the [`ScreenState`] as JSON text when it
//! has changed, and map and previews as binary messages (laid out in `map.rs` and `preview.rs`). The client sends JSON objects with a `command`:
//! `pin` (with `pin`, before everything else where one is set), `start`, `stop`, `note` (with `text`), `control-point` (with
//! `name`); each but the first is answered by `{"answer": <command>, "error": null | <why>, "said": <words>}`.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::Deserialize;
use serde_json::json;
use tungstenite::{Message, WebSocket};

use crate::error::Error;
use crate::http::{self, Status};
use crate::map::{MapSnapshot, Shown};
use crate::names::Names;
use crate::page;
use crate::presence::Presence;
use crate::preview::Preview;
use crate::server::{Server, Stop};
use crate::state::ScreenState;

const PROTOCOL: &str = "lsfb.operator.v1";
/// Requests that wait to be taken.
const QUEUE_REQUESTS: usize = 16;
/// How long a client waits for the answer to a request.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(10);
/// Shortest time between two states.
const STATE_EVERY: Duration = Duration::from_millis(200);
/// Shortest time between two pieces of the map.
const MAP_EVERY: Duration = Duration::from_millis(400);
/// A state is sent this often at least, so that a page knows that it is still connected.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// How long a wrong PIN is thought about; this many and more wrong ones, longer.
const WRONG_PIN_PAUSE: Duration = Duration::from_secs(1);
const WRONG_PINS: u32 = 10;
const MANY_WRONG_PINS_PAUSE: Duration = Duration::from_secs(10);
/// Who has not typed the PIN by then makes room for others; the page connects anew.
const ADMISSION_TIMEOUT: Duration = Duration::from_secs(60);
/// Shortest PIN.
const MIN_PIN_CHARS: usize = 4;

/// Who can see the screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScreenConfig {
    /// Where the page is served; port 0 takes a free one.
    pub address: SocketAddr,
    /// What must be typed before anything is shown or taken. Needed where other machines can reach the address.
    pub pin: Option<String>,
    /// Names by which this machine is reached, beside its own and its addresses. Asked under another, the server refuses.
    pub names: Vec<String>,
}

impl Default for ScreenConfig {
    /// This machine only, port 8700.
    fn default() -> Self {
        Self {
            address: SocketAddr::from(([127, 0, 0, 1], 8700)),
            pin: None,
            names: Vec::new(),
        }
    }
}

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
    answer: SyncSender<Result<String, String>>,
}

impl Request {
    /// Says what was done, or why it was not. A client that has gone does not hear it.
    pub fn answer(self, outcome: Result<String, String>) {
        let _ = self.answer.try_send(outcome);
    }
}

/// The served page. Dropping it disconnects everybody.
#[derive(Debug)]
pub struct Screen {
    server: Server,
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    names: Names,
    pin: Option<String>,
    wrong_pins: AtomicU32,
    shown: Mutex<Published>,
    requests: SyncSender<Request>,
}

/// What clients are to see.
#[derive(Clone, Debug, Default)]
struct Published {
    state: Arc<str>,
    map: Arc<MapSnapshot>,
    previews: BTreeMap<String, Arc<Preview>>,
}

impl Screen {
    /// Begins to serve.
    pub fn open(config: &ScreenConfig) -> Result<(Self, Receiver<Request>), Error> {
        let pin = config.pin.clone().filter(|pin| !pin.is_empty());
        let long_enough = |pin: &String| pin.chars().count() >= MIN_PIN_CHARS;
        if !config.address.ip().is_loopback() && !pin.as_ref().is_some_and(long_enough) {
            return Err(Error::Pin {
                address: config.address,
            });
        }
        let (requests, taken) = sync_channel(QUEUE_REQUESTS);
        let shared = Arc::new(Shared {
            names: Names::new(&config.names),
            pin,
            wrong_pins: AtomicU32::new(0),
            shown: Mutex::new(Published {
                state: to_json(&ScreenState::default()),
                ..Published::default()
            }),
            requests,
        });
        let served = Arc::clone(&shared);
        let server = Server::start("screen", config.address, move |stream, stop| {
            // Whatever ends a connection, the page connects anew.
            let _ = serve(stream, &served, stop);
        })?;
        Ok((Self { server, shared }, taken))
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// What to open in a browser, from another machine where that is possible.
    pub fn url(&self) -> String {
        let address = self.address();
        let host = match address.ip() {
            ip if ip.is_unspecified() => own_address().unwrap_or(ip),
            ip => ip,
        };
        format!("http://{}/", SocketAddr::new(host, address.port()))
    }

    /// Shows a state from now on.
    pub fn publish(&self, state: &ScreenState) {
        let state = to_json(state);
        self.shared.lock().state = state;
    }

    /// Shows a map from now on.
    pub fn publish_map(&self, map: MapSnapshot) {
        let map = Arc::new(map);
        self.shared.lock().map = map;
    }

    /// Shows what a camera sees from now on.
    pub fn publish_preview(&self, camera: &str, preview: Preview) {
        let mut shown = self.shared.lock();
        shown.previews.insert(camera.to_owned(), Arc::new(preview));
    }

    /// Shows no camera any more: another recording begins.
    pub fn clear_previews(&self) {
        self.shared.lock().previews.clear();
    }
}

impl Shared {
    fn lock(&self) -> std::sync::MutexGuard<'_, Published> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn to_json(state: &ScreenState) -> Arc<str> {
    // Numbers and strings always serialise.
    serde_json::to_string(state).unwrap_or_default().into()
}

/// The address by which the local network knows this machine: that of the route to anywhere. Nothing is sent.
fn own_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect("192.0.2.1:9").ok()?;
    Some(socket.local_addr().ok()?.ip())
}

fn serve(mut stream: TcpStream, shared: &Shared, stop: &Stop) -> Result<(), tungstenite::Error> {
    let request = http::read(&mut stream)?;
    if !request
        .host
        .as_deref()
        .is_some_and(|host| shared.names.include(host))
    {
        let problem = b"this screen is not known by that name: open it by the address on the scanner's terminal, or start the \
            scanner with --screen-name";
        http::answer(&mut stream, Status::Misdirected, "text/plain", problem)?;
        return Ok(());
    }
    if request.path != "/live" {
        match page::file(&request.path) {
            Some(file) => http::answer(
                &mut stream,
                Status::Ok,
                file.media_type,
                file.body.as_bytes(),
            )?,
            None => http::answer(
                &mut stream,
                Status::NotFound,
                "text/plain",
                b"there is nothing here",
            )?,
        }
        return Ok(());
    }
    if !request.is_ours() {
        http::answer(
            &mut stream,
            Status::Forbidden,
            "text/plain",
            b"not from this page",
        )?;
        return Ok(());
    }
    let offered = request.protocols.iter().any(|name| name == PROTOCOL);
    let socket = http::upgrade(stream, request, offered.then_some(PROTOCOL))?;
    Client {
        socket,
        shared,
        admitted: shared.pin.is_none(),
        presence: Presence::new(),
        opened: Instant::now(),
        previews: BTreeMap::new(),
        state: Arc::default(),
        state_sent: None,
        map: Shown::default(),
        map_sent: None,
        waiting: Vec::new(),
    }
    .run(stop)
}

/// One browser.
struct Client<'a> {
    socket: WebSocket<TcpStream>,
    shared: &'a Shared,
    admitted: bool,
    presence: Presence,
    opened: Instant,
    /// What was sent last of each camera.
    previews: BTreeMap<String, Arc<Preview>>,
    state: Arc<str>,
    state_sent: Option<Instant>,
    map: Shown,
    map_sent: Option<Instant>,
    waiting: Vec<Waiting>,
}

/// A request that is not answered yet.
struct Waiting {
    command: String,
    answer: Receiver<Result<String, String>>,
    since: Instant,
}

impl Client<'_> {
    fn run(mut self, stop: &Stop) -> Result<(), tungstenite::Error> {
        if !self.admitted {
            self.send(&json!({ "pin": "needed" }))?;
        }
        while !stop.is_set() {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    self.presence.heard();
                    self.take(&text)?;
                }
                Ok(Message::Close(_)) => return Ok(()),
                Ok(_) => self.presence.heard(),
                Err(error) if http::is_quiet(&error) => {}
                Err(error) => return Err(error),
            }
            self.presence.check(&mut self.socket)?;
            if self.admitted {
                self.show()?;
                self.give_answers()?;
            } else if self.opened.elapsed() > ADMISSION_TIMEOUT {
                break;
            }
        }
        self.socket.close(None)
    }

    fn take(&mut self, text: &str) -> Result<(), tungstenite::Error> {
        #[derive(Deserialize)]
        struct Pin {
            pin: String,
        }
        if !self.admitted {
            let typed = serde_json::from_str::<Pin>(text);
            let right = typed.is_ok_and(|typed| Some(typed.pin) == self.shared.pin);
            return self.admit(right);
        }
        let command = match serde_json::from_str::<Command>(text) {
            Ok(command) => command,
            Err(error) => {
                return self.answer("unknown", &Err(format!("not understood: {error}")));
            }
        };
        let name = match &command {
            Command::Start => "start",
            Command::Stop => "stop",
            Command::Note { .. } => "note",
            Command::ControlPoint { .. } => "control-point",
        };
        let (answer, answered) = sync_channel(1);
        match self.shared.requests.try_send(Request { command, answer }) {
            Ok(()) => {
                self.waiting.push(Waiting {
                    command: name.to_owned(),
                    answer: answered,
                    since: Instant::now(),
                });
                Ok(())
            }
            Err(TrySendError::Full(_)) => self.answer(name, &Err("busy; try again".to_owned())),
            Err(TrySendError::Disconnected(_)) => {
                self.answer(name, &Err("the recorder has ended".to_owned()))
            }
        }
    }

    fn admit(&mut self, right: bool) -> Result<(), tungstenite::Error> {
        let wrong = &self.shared.wrong_pins;
        if right {
            wrong.store(0, Ordering::Relaxed);
            self.admitted = true;
            return self.send(&json!({ "pin": "right" }));
        }
        // Slow enough that nobody tries them all.
        let many = wrong.fetch_add(1, Ordering::Relaxed) >= WRONG_PINS;
        std::thread::sleep(if many {
            MANY_WRONG_PINS_PAUSE
        } else {
            WRONG_PIN_PAUSE
        });
        self.send(&json!({ "pin": "wrong" }))
    }

    /// Sends what has changed.
    fn show(&mut self) -> Result<(), tungstenite::Error> {
        let elapsed = |sent: Option<Instant>| sent.map_or(Duration::MAX, |sent| sent.elapsed());
        let published = self.shared.lock().clone();
        let since = elapsed(self.state_sent);
        let changed = !Arc::ptr_eq(&published.state, &self.state);
        if (changed && since >= STATE_EVERY) || since >= HEARTBEAT {
            self.state = published.state;
            self.state_sent = Some(Instant::now());
            self.socket.send(Message::text(&*self.state))?;
        }
        if elapsed(self.map_sent) >= MAP_EVERY {
            self.map_sent = Some(Instant::now());
            if let Some(news) = published.map.news(&mut self.map) {
                self.socket.send(Message::binary(news))?;
            }
        }
        for (camera, preview) in published.previews {
            let known = self.previews.get(&camera);
            if !known.is_some_and(|known| Arc::ptr_eq(known, &preview)) {
                self.socket
                    .send(Message::binary(preview.message(&camera)))?;
                self.previews.insert(camera, preview);
            }
        }
        Ok(())
    }

    fn give_answers(&mut self) -> Result<(), tungstenite::Error> {
        let mut answered = Vec::new();
        self.waiting
            .retain(|waiting| match waiting.answer.try_recv() {
                Ok(outcome) => {
                    answered.push((waiting.command.clone(), outcome));
                    false
                }
                Err(_) if waiting.since.elapsed() > ANSWER_TIMEOUT => {
                    let outcome = Err("the recorder does not answer".to_owned());
                    answered.push((waiting.command.clone(), outcome));
                    false
                }
                Err(_) => true,
            });
        for (command, outcome) in answered {
            self.answer(&command, &outcome)?;
        }
        Ok(())
    }

    fn answer(
        &mut self,
        command: &str,
        outcome: &Result<String, String>,
    ) -> Result<(), tungstenite::Error> {
        self.send(&json!({
            "answer": command,
            "error": outcome.as_ref().err(),
            "said": outcome.as_ref().ok(),
        }))
    }

    fn send(&mut self, value: &serde_json::Value) -> Result<(), tungstenite::Error> {
        self.socket.send(Message::text(value.to_string()))
    }
}
