//! The page's server: files by HTTP, state and map by WebSocket, and what the operator presses.
//!
//! The WebSocket `live` speaks subprotocol `lsfb.operator.v1`. The server sends the [`ScreenState`] as JSON text when it
//! has changed, and map and previews as binary messages (laid out in `map.rs` and `preview.rs`). The client sends JSON objects with a `command`:
//! `pin` (with `pin`, before everything else where one is set), `start`, `stop`, `note` (with `text`), `control-point` (with
//! `name`); each but the first is answered by `{"answer": <command>, "error": null | <why>, "said": <words>}`.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU32, AtomicUsize};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};

use lsfb_web::{
    Answer, Incoming, Listener, Method, Mount, Names, Server, StatusCode, Visit, file_of, handler,
    is_own_page, offered, said, under, upgrade,
};

use crate::client::{self, Admission, Seat};
use crate::error::Error;
use crate::map::MapSnapshot;
use crate::page;
use crate::preview::Preview;
use crate::shared::{Published, Request, Shared};
use crate::socket::MAX_MESSAGE_BYTES;
use crate::state::ScreenState;

const PROTOCOL: &str = "lsfb.operator.v1";
/// Where the page lies at an address that phones send to as well.
const PATH: &str = "operator";
/// Requests that wait to be taken.
const QUEUE_REQUESTS: usize = 16;
/// Shortest PIN.
const MIN_PIN_CHARS: usize = 4;
/// Nothing but what is served here may be loaded or asked.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
     manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Who can see the screen.
#[derive(Clone, Debug, Default)]
pub struct ScreenConfig {
    /// Where the page is served to browsers on this machine, without TLS; port 0 takes a free one. Addresses that other machines can
    /// reach are refused.
    pub address: Option<SocketAddr>,
    /// What must be typed on this machine before anything is shown or taken.
    pub pin: Option<String>,
    /// Where the page is served to other machines.
    pub secure: Option<SecureScreen>,
    /// Names by which this machine is reached, beside its own and its addresses. Asked under another, the server refuses.
    pub names: Vec<String>,
}

/// Where other machines see the screen: by TLS, below `/operator/`.
#[derive(Clone, Debug)]
pub struct SecureScreen {
    /// The addresses.
    pub listeners: Vec<Arc<Listener>>,
    /// What must be typed there before anything is shown or taken.
    pub pin: String,
}

/// The served page. Dropping it disconnects everybody.
#[derive(Debug)]
pub struct Screen {
    // Before the addresses that they are mounted at.
    _mounts: Vec<Mount>,
    links: Vec<String>,
    local: Option<Listener>,
    shared: Arc<Shared>,
}

impl Screen {
    /// Begins to serve; the receiver has what operators press.
    pub fn open(config: &ScreenConfig) -> Result<(Self, Receiver<Request>), Error> {
        let is_pin = |pin: &str| pin.chars().count() >= MIN_PIN_CHARS;
        let (requests, taken) = sync_channel(QUEUE_REQUESTS);
        let shared = Arc::new(Shared {
            names: Names::new(&config.names),
            wrong_pins: AtomicU32::new(0),
            clients: AtomicUsize::new(0),
            shown: Mutex::new(Published {
                state: to_json(&ScreenState::default()),
                ..Published::default()
            }),
            requests,
        });
        let (mut mounts, mut links) = (Vec::new(), Vec::new());
        let mut local = None;
        if let Some(address) = config.address {
            if !address.ip().is_loopback() {
                return Err(Error::Plain { address });
            }
            if config.pin.as_deref().is_some_and(|pin| !is_pin(pin)) {
                return Err(Error::Pin { address });
            }
            let listener = Listener::open(&Server::start("screen")?, address, None)?;
            mounts.push(mount(&listener, "", config.pin.clone(), &shared));
            links.push(format!("{}/", listener.url()));
            local = Some(listener);
        }
        if let Some(secure) = &config.secure {
            for listener in &secure.listeners {
                let address = listener.address();
                if !listener.is_secure() {
                    return Err(Error::Plain { address });
                }
                if !is_pin(&secure.pin) {
                    return Err(Error::Pin { address });
                }
                mounts.push(mount(listener, PATH, Some(secure.pin.clone()), &shared));
                links.push(format!("{}/{PATH}/", listener.url()));
            }
        }
        let screen = Self {
            _mounts: mounts,
            links,
            local,
            shared,
        };
        Ok((screen, taken))
    }

    /// Where it listens without TLS.
    pub fn address(&self) -> Option<SocketAddr> {
        self.local.as_ref().map(Listener::address)
    }

    /// What to open in a browser: on this machine, where it is served to it, then from others.
    pub fn links(&self) -> &[String] {
        &self.links
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

fn to_json(state: &ScreenState) -> Arc<str> {
    // Numbers and strings always serialise.
    serde_json::to_string(state).unwrap_or_default().into()
}

/// Serves the page below a word of the path, to whoever knows the PIN where there is one.
fn mount(
    listener: &Listener,
    word: &'static str,
    pin: Option<String>,
    shared: &Arc<Shared>,
) -> Mount {
    let pin = pin.map(Arc::<str>::from);
    let shared = Arc::clone(shared);
    let serve = handler(move |request, visit| {
        let answer = answer(&request, word, &visit, &shared);
        let (shared, pin) = (Arc::clone(&shared), pin.clone());
        async move {
            if let Some(answer) = answer {
                return answer;
            }
            let admission = match pin {
                Some(pin) => Some(Admission::ByPin(pin)),
                None => Seat::take(&shared).map(Admission::Given),
            };
            let Some(admission) = admission else {
                let full = "too many browsers show this screen; close one of them";
                return under(POLICY, said(StatusCode::SERVICE_UNAVAILABLE, full));
            };
            let protocol = offered(&request, &[PROTOCOL]);
            upgrade(request, protocol, MAX_MESSAGE_BYTES, move |socket| {
                client::serve(socket, visit, admission, shared)
            })
        }
    });
    listener.mount(word, serve)
}

/// What is answered; `None`: it becomes a WebSocket.
fn answer(
    request: &lsfb_web::Request<Incoming>,
    word: &str,
    visit: &Visit,
    shared: &Shared,
) -> Option<Answer> {
    let refuse = |status, words| Some(under(POLICY, said(status, words)));
    if *request.method() != Method::GET {
        return refuse(StatusCode::METHOD_NOT_ALLOWED, "method not allowed");
    }
    if !shared.names.are_asked(request) {
        let problem = "this screen is not known by that name: open it at the address on the \
            scanner's terminal, or start the scanner with --screen-name";
        return refuse(StatusCode::MISDIRECTED_REQUEST, problem);
    }
    let path = request.uri().path().trim_start_matches('/');
    let name = match word {
        "" => path,
        word => match path.strip_prefix(word) {
            Some(rest) if rest.starts_with('/') => rest.trim_start_matches('/'),
            // Its files lie below.
            _ => return refuse(StatusCode::NOT_FOUND, "open /operator/"),
        },
    };
    if name != "live" {
        return match page::file(name) {
            Some(file) => Some(under(
                POLICY,
                file_of(StatusCode::OK, file.media_type, file.body),
            )),
            None => refuse(StatusCode::NOT_FOUND, "not found"),
        };
    }
    if !is_own_page(request, visit.is_secure) {
        return refuse(StatusCode::FORBIDDEN, "not from this page");
    }
    None
}
