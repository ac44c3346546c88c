//! What an app sends once it is known, and what it is told.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use lsfb_drivers::sidecar::credentials::DeviceKey;
use lsfb_drivers::sidecar::model::INITIAL_CREDIT_BYTES;
use lsfb_drivers::sidecar::wire::{
    Advertise, Envelope, EnvelopeKind, Hello, Refusal, TimeExchange, TimeRequest, TimeResponse,
};
use lsfb_drivers::sidecar::{Decoder, SidecarMessage};
use lsfb_types::Timestamp;
use lsfb_web::Socket;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, timeout};
use tokio_tungstenite::tungstenite::{Bytes, Message};

use super::super::pseudonyms::Pseudonyms;
use super::socket::{End, in_time, send};
use super::{Recorded, SidecarEvent, Visit};
use crate::health::arrival_now;
use crate::receipt::{Receipt, Settled};
use crate::sidecar::sessions::{Opened, Refused};

/// How often it is looked whether an app is still there.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// Who has been silent for this long is asked; every WebSocket answers by itself.
const ASK_AFTER: Duration = Duration::from_secs(3);
/// Who has been silent for this long has gone.
const GONE_AFTER: Duration = Duration::from_secs(15);
/// How long after BYE the last acknowledgement may take: until the recorder has stored everything.
const BYE_TIMEOUT: Duration = Duration::from_secs(60);

/// What an app sends on one connection.
pub(super) struct Conversation<'a> {
    visit: &'a Visit,
    recorded: &'a Recorded,
    device: String,
    session: String,
    opened: Opened,
    settled: Settled,
    /// Bytes of DATA that came, and that may.
    received_bytes: u64,
    granted_bytes: u64,
    acknowledged_seq: u64,
    last_answered: TimeExchange,
}

impl<'a> Conversation<'a> {
    /// Opens the session.
    pub(super) async fn open(
        visit: &'a Visit,
        hello: Hello,
        recorded: &'a Arc<Recorded>,
    ) -> Result<Self, End> {
        let arrival = arrival_now();
        let room = visit.shared.events.clone().reserve_owned().await;
        let room = room.map_err(|_| End::from(Refusal::Ended))?;
        let (number, looking) = (visit.connection, Arc::clone(recorded));
        let (device, session) = (hello.device.clone(), hello.session.clone());
        // Its secrets stay here.
        let hello = Hello {
            device_key: DeviceKey([0; 32]),
            pairing_token: None,
            ..hello
        };
        let opened = spawn_blocking(move || {
            let (device, session) = (hello.device.clone(), hello.session.clone());
            let first_unacked = hello.first_unacked;
            let announce = |opened: &Opened| {
                room.send(SidecarEvent::Opened {
                    connection: number,
                    hello,
                    arrival,
                    start: opened.start.clone(),
                    missing: opened.missing,
                    note: opened.note.clone(),
                });
            };
            looking
                .sessions
                .open(number, &device, &session, first_unacked, announce)
        });
        let opened = match opened.await {
            Ok(Ok(opened)) => opened,
            Ok(Err(Refused::Protocol(refusal))) => return Err(refusal.into()),
            Ok(Err(Refused::Store(error))) => {
                return Err(End::Refused(Refusal::NotStored, error.to_string()));
            }
            Err(_) => return Err(Refusal::NotStored.into()),
        };
        Ok(Self {
            visit,
            recorded,
            device,
            session,
            acknowledged_seq: opened.progress.stored_seq(),
            opened,
            settled: Arc::new(AtomicU64::new(0)),
            received_bytes: 0,
            granted_bytes: INITIAL_CREDIT_BYTES,
            last_answered: TimeExchange::default(),
        })
    }

    /// Number of the last DATA that came on earlier connections.
    pub(super) fn received(&self) -> u64 {
        self.opened.received
    }

    /// Until BYE.
    pub(super) async fn run(
        &mut self,
        socket: &mut Socket,
        decoder: &mut Decoder,
    ) -> Result<(), End> {
        let mut running = self.visit.shared.running.clone();
        self.send_ack(socket).await?;
        self.send_credit(socket).await?;
        let (mut heard, mut asked) = (Instant::now(), Instant::now());
        loop {
            let next = tokio::select! {
                _ = running.changed() => return Err(Refusal::Ended.into()),
                () = self.opened.replaced.notified() => return Err(Refusal::Replaced.into()),
                () = self.opened.progress.changed() => None,
                next = timeout(LOOK_EVERY, socket.next()) => next.ok(),
            };
            match next {
                None => {}
                Some(None | Some(Err(_) | Ok(Message::Close(_)))) => {
                    return Err(End::Gone("its connection was lost"));
                }
                Some(Some(Ok(Message::Binary(bytes)))) => {
                    heard = Instant::now();
                    if self.take(socket, decoder, &bytes, arrival_now()).await? {
                        return self.finish(socket, decoder).await;
                    }
                }
                Some(Some(Ok(Message::Text(_)))) => return Err(Refusal::BadMessage.into()),
                Some(Some(Ok(_))) => heard = Instant::now(),
            }
            if heard.elapsed() >= GONE_AFTER {
                return Err(Refusal::Silent.into());
            }
            if heard.elapsed() >= ASK_AFTER && asked.elapsed() >= ASK_AFTER {
                asked = Instant::now();
                let ping = socket.send(Message::Ping(Bytes::new()));
                in_time(ping).await?;
            }
            self.tell(socket).await?;
        }
    }

    /// Takes one message. True: it was BYE.
    async fn take(
        &mut self,
        socket: &mut Socket,
        decoder: &mut Decoder,
        bytes: &[u8],
        arrival: Timestamp,
    ) -> Result<bool, End> {
        let is_data = matches!(
            Envelope::parse(bytes),
            Ok(Envelope {
                kind: EnvelopeKind::Data,
                ..
            })
        );
        let cost = if is_data { bytes.len() as u64 } else { 0 };
        self.received_bytes += cost;
        if self.received_bytes > self.granted_bytes {
            return Err(Refusal::BeyondCredit.into());
        }
        match decoder.push(bytes)? {
            None => {
                // A repetition takes no room.
                self.settled.fetch_add(cost, Ordering::AcqRel);
            }
            Some(SidecarMessage::Advertise(described)) => {
                self.describe(described, arrival).await?;
            }
            Some(data @ SidecarMessage::Data { .. }) => {
                self.hand_on(data, decoder.last_seq(), cost, arrival)
                    .await?;
            }
            Some(SidecarMessage::TimeRequest(request)) => {
                self.answer_time(socket, request, arrival).await?;
            }
            Some(SidecarMessage::Bye { .. }) => return Ok(true),
            Some(SidecarMessage::Hello(_)) => return Err(Refusal::BadMessage.into()),
        }
        Ok(false)
    }

    async fn describe(&self, described: Advertise, arrival: Timestamp) -> Result<(), End> {
        if self.visit.shared.pseudonyms.is_some() {
            Pseudonyms::admit(&described.schema_name)
                .map_err(|why| End::Refused(Refusal::BadTopic, why))?;
        }
        let admitted = {
            let topics = self.recorded.topics.lock();
            topics
                .unwrap_or_else(PoisonError::into_inner)
                .admit(&self.device, &described)
        };
        admitted.map_err(|why| End::Refused(Refusal::BadTopic, why))?;
        let event = self.event(SidecarMessage::Advertise(described), arrival, None);
        let sent = self.visit.shared.events.send(event).await;
        sent.map_err(|_| Refusal::Ended.into())
    }

    /// Hands a message on to be recorded, once there is room.
    async fn hand_on(
        &self,
        data: SidecarMessage,
        seq: u64,
        cost: u64,
        arrival: Timestamp,
    ) -> Result<(), End> {
        let room = self.visit.shared.events.reserve().await;
        let room = room.map_err(|_| End::from(Refusal::Ended))?;
        let (device, session) = (&self.device, &self.session);
        let number = self.visit.connection;
        let mut room = Some((room, data));
        let sessions = &self.recorded.sessions;
        let is_ours = sessions.hand_on(number, device, session, seq, || {
            if let Some((room, data)) = room.take() {
                let progress = Arc::clone(&self.opened.progress);
                let receipt = Receipt::new(progress, Arc::clone(&self.settled), seq, cost);
                room.send(self.event(data, arrival, Some(receipt)));
            }
        });
        match is_ours {
            true => Ok(()),
            false if self.opened.progress.is_broken() => Err(Refusal::NotStored.into()),
            false => Err(Refusal::Replaced.into()),
        }
    }

    fn event(
        &self,
        message: SidecarMessage,
        arrival: Timestamp,
        receipt: Option<Receipt>,
    ) -> SidecarEvent {
        SidecarEvent::Message {
            device: self.device.clone(),
            arrival,
            message,
            receipt,
        }
    }

    /// Answers with the host's time, and passes the exchange before on where it is one of ours.
    async fn answer_time(
        &mut self,
        socket: &mut Socket,
        request: TimeRequest,
        arrival: Timestamp,
    ) -> Result<(), End> {
        let response = TimeResponse {
            t1_ns: request.t1_ns,
            t2_ns: arrival.nanos(),
            t3_ns: arrival_now().nanos(),
        };
        let emitted = response.emit();
        send(
            socket,
            &Envelope::around(EnvelopeKind::TimeResponse, &emitted),
        )
        .await?;
        let told = request.last;
        let answered = std::mem::replace(
            &mut self.last_answered,
            TimeExchange {
                t1_ns: response.t1_ns,
                t2_ns: response.t2_ns,
                t3_ns: response.t3_ns,
                t4_ns: 0,
            },
        );
        let is_ours = answered.t2_ns != 0
            && (told.t1_ns, told.t2_ns, told.t3_ns)
                == (answered.t1_ns, answered.t2_ns, answered.t3_ns)
            && told.t4_ns > told.t1_ns;
        if is_ours {
            let event = SidecarEvent::Time {
                device: self.device.clone(),
                arrival,
                clock_id: request.clock_id,
                exchange: told,
            };
            let sent = self.visit.shared.events.send(event).await;
            sent.map_err(|_| End::from(Refusal::Ended))?;
        }
        Ok(())
    }

    /// Tells what is stored, and how much more may come.
    async fn tell(&mut self, socket: &mut Socket) -> Result<(), End> {
        if self.opened.progress.stored_seq() > self.acknowledged_seq {
            self.send_ack(socket).await?;
        }
        let granted = INITIAL_CREDIT_BYTES + self.settled.load(Ordering::Acquire);
        if granted > self.granted_bytes {
            self.granted_bytes = granted;
            self.send_credit(socket).await?;
        }
        match self.opened.progress.is_broken() {
            true => Err(Refusal::NotStored.into()),
            false => Ok(()),
        }
    }

    async fn send_ack(&mut self, socket: &mut Socket) -> Result<(), End> {
        self.acknowledged_seq = self.opened.progress.stored_seq();
        send(
            socket,
            &Envelope::bare(EnvelopeKind::Ack, self.acknowledged_seq),
        )
        .await
    }

    async fn send_credit(&self, socket: &mut Socket) -> Result<(), End> {
        send(
            socket,
            &Envelope::bare(EnvelopeKind::Credit, self.granted_bytes),
        )
        .await
    }

    /// After BYE: waits until everything that came is stored, and says so.
    async fn finish(&mut self, socket: &mut Socket, decoder: &Decoder) -> Result<(), End> {
        let began = Instant::now();
        while self.opened.progress.stored_seq() < decoder.last_seq() {
            if self.opened.progress.is_broken() || began.elapsed() >= BYE_TIMEOUT {
                return Err(Refusal::NotStored.into());
            }
            // Whether it has changed or not.
            let _ = timeout(LOOK_EVERY, self.opened.progress.changed()).await;
        }
        self.send_ack(socket).await
    }
}
