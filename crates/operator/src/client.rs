//! One browser that shows the screen.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use futures_util::StreamExt as _;
use lsfb_web::{Socket, Visit};
use serde::Deserialize;
use serde_json::json;
use subtle::ConstantTimeEq as _;
use tokio::time::sleep;
use tokio_tungstenite::tungstenite::Message;

use crate::map::Shown;
use crate::preview::Preview;
use crate::shared::{Command, Request, Shared};
use crate::socket::{Gone, Presence, close, send};

/// Clients at a time: a phone, a tablet, a laptop, and what they left hanging.
const MAX_CLIENTS: usize = 16;
/// How often it is looked whether there is something to send.
const LOOK_EVERY: Duration = Duration::from_millis(25);
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

/// Shows the screen to one browser until it goes: to who has a seat already, or has said the PIN.
pub(crate) async fn serve(
    mut socket: Socket,
    visit: Visit,
    admission: Admission,
    shared: Arc<Shared>,
) {
    let ticket = Arc::clone(&visit.ticket);
    let seat = match admission {
        Admission::Given(seat) => Some(seat),
        Admission::ByPin(pin) => {
            let admitted = tokio::select! {
                admitted = admit(&mut socket, &visit, &pin, &shared) => admitted.is_ok(),
                () = ticket.sent_away() => {
                    visit.refusals.count("disconnected to make room for others");
                    false
                }
            };
            admitted.then(|| Seat::take(&shared)).flatten()
        }
    };
    let Some(_seat) = seat else {
        return close(socket).await;
    };
    ticket.enter();
    let client = Client {
        socket: &mut socket,
        shared: &shared,
        presence: Presence::new(),
        previews: BTreeMap::new(),
        state: Arc::default(),
        state_sent: None,
        map: Shown::default(),
        map_sent: None,
        waiting: Vec::new(),
    };
    let mut running = visit.running.clone();
    // However it ends, the page connects anew.
    tokio::select! {
        _ = client.run() => {}
        _ = running.changed() => {}
    }
    close(socket).await;
}

/// How a browser is let in.
#[derive(Debug)]
pub(crate) enum Admission {
    /// It is, whoever it is.
    Given(Seat),
    /// Once it has said this.
    ByPin(Arc<str>),
}

/// A place among those who are let in, until it is dropped.
#[derive(Debug)]
pub(crate) struct Seat(Arc<Shared>);

impl Seat {
    /// Takes one; `None`: there is none left.
    pub fn take(shared: &Arc<Shared>) -> Option<Self> {
        let free = |taken: usize| (taken < MAX_CLIENTS).then_some(taken + 1);
        let clients = &shared.clients;
        let taken = clients.fetch_update(Ordering::AcqRel, Ordering::Acquire, free);
        taken.is_ok().then(|| Self(Arc::clone(shared)))
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.clients.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Until the PIN was said.
async fn admit(socket: &mut Socket, visit: &Visit, pin: &str, shared: &Shared) -> Result<(), Gone> {
    #[derive(Deserialize)]
    struct Pin {
        pin: String,
    }
    let say = |words: &str| Message::text(json!({ "pin": words }).to_string());
    send(socket, say("needed")).await?;
    let (opened, mut presence) = (Instant::now(), Presence::new());
    while opened.elapsed() <= ADMISSION_TIMEOUT {
        let heard = tokio::select! {
            heard = socket.next() => Some(heard),
            () = sleep(LOOK_EVERY) => None,
        };
        presence.check(socket).await?;
        let text = match heard {
            None => continue,
            Some(Some(Ok(Message::Text(text)))) => text,
            Some(None | Some(Err(_) | Ok(Message::Close(_)))) => return Err(Gone),
            Some(Some(Ok(_))) => {
                presence.heard();
                continue;
            }
        };
        presence.heard();
        // Where too many failed, the right one is not looked at either: nobody tries them all from one address.
        if visit.ticket.is_barred() {
            visit.refusals.count("too many wrong PINs of the screen");
            sleep(WRONG_PIN_PAUSE).await;
            send(socket, say("barred")).await?;
            continue;
        }
        let typed = serde_json::from_str::<Pin>(&text).map(|typed| typed.pin);
        let is_right = typed.is_ok_and(|typed| typed.as_bytes().ct_eq(pin.as_bytes()).into());
        if is_right {
            shared.wrong_pins.store(0, Ordering::Relaxed);
            return send(socket, say("right")).await;
        }
        visit.ticket.fail();
        visit.refusals.count("wrong PIN of the screen");
        let many = shared.wrong_pins.fetch_add(1, Ordering::Relaxed) >= WRONG_PINS;
        sleep(match many {
            true => MANY_WRONG_PINS_PAUSE,
            false => WRONG_PIN_PAUSE,
        })
        .await;
        presence.heard();
        send(socket, say("wrong")).await?;
    }
    Err(Gone)
}

struct Client<'a> {
    socket: &'a mut Socket,
    shared: &'a Shared,
    presence: Presence,
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
    command: &'static str,
    answer: Receiver<Result<String, String>>,
    since: Instant,
}

impl Client<'_> {
    async fn run(mut self) -> Result<(), Gone> {
        loop {
            let heard = tokio::select! {
                heard = self.socket.next() => Some(heard),
                () = sleep(LOOK_EVERY) => None,
            };
            match heard {
                None => {}
                Some(Some(Ok(Message::Text(text)))) => {
                    self.presence.heard();
                    self.take(&text).await?;
                }
                Some(None | Some(Err(_) | Ok(Message::Close(_)))) => return Err(Gone),
                Some(Some(Ok(_))) => self.presence.heard(),
            }
            self.presence.check(self.socket).await?;
            self.show().await?;
            self.give_answers().await?;
        }
    }

    async fn take(&mut self, text: &str) -> Result<(), Gone> {
        let command = match serde_json::from_str::<Command>(text) {
            Ok(command) => command,
            Err(error) => {
                let why = format!("invalid message: {error}");
                return self.answer("unknown", &Err(why)).await;
            }
        };
        let name = match &command {
            Command::Start => "start",
            Command::Stop => "stop",
            Command::Note { .. } => "note",
            Command::ControlPoint { .. } => "control-point",
        };
        let (answer, answered) = sync_channel(1);
        let why = match self.shared.requests.try_send(Request { command, answer }) {
            Ok(()) => {
                self.waiting.push(Waiting {
                    command: name,
                    answer: answered,
                    since: Instant::now(),
                });
                return Ok(());
            }
            Err(TrySendError::Full(_)) => "busy; try again",
            Err(TrySendError::Disconnected(_)) => "the recorder has ended",
        };
        self.answer(name, &Err(why.to_owned())).await
    }

    /// Sends what has changed.
    async fn show(&mut self) -> Result<(), Gone> {
        let elapsed = |sent: Option<Instant>| sent.map_or(Duration::MAX, |sent| sent.elapsed());
        let published = self.shared.published();
        let since = elapsed(self.state_sent);
        let changed = !Arc::ptr_eq(&published.state, &self.state);
        if (changed && since >= STATE_EVERY) || since >= HEARTBEAT {
            self.state = published.state;
            self.state_sent = Some(Instant::now());
            send(self.socket, Message::text(&*self.state)).await?;
        }
        if elapsed(self.map_sent) >= MAP_EVERY {
            self.map_sent = Some(Instant::now());
            if let Some(news) = published.map.news(&mut self.map) {
                send(self.socket, Message::binary(news)).await?;
            }
        }
        for (camera, preview) in published.previews {
            let known = self.previews.get(&camera);
            if !known.is_some_and(|known| Arc::ptr_eq(known, &preview)) {
                send(self.socket, Message::binary(preview.message(&camera))).await?;
                self.previews.insert(camera, preview);
            }
        }
        Ok(())
    }

    async fn give_answers(&mut self) -> Result<(), Gone> {
        let mut answered = Vec::new();
        self.waiting
            .retain(|waiting| match waiting.answer.try_recv() {
                Ok(outcome) => {
                    answered.push((waiting.command, outcome));
                    false
                }
                Err(_) if waiting.since.elapsed() > ANSWER_TIMEOUT => {
                    let outcome = Err("the recorder does not answer".to_owned());
                    answered.push((waiting.command, outcome));
                    false
                }
                Err(_) => true,
            });
        for (command, outcome) in answered {
            self.answer(command, &outcome).await?;
        }
        Ok(())
    }

    async fn answer(
        &mut self,
        command: &str,
        outcome: &Result<String, String>,
    ) -> Result<(), Gone> {
        let answer = json!({
            "answer": command,
            "error": outcome.as_ref().err(),
            "said": outcome.as_ref().ok(),
        });
        send(self.socket, Message::text(answer.to_string())).await
    }
}
