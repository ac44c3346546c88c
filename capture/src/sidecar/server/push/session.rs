//! The session of an app that pushes: its batches in order, into the recording, until nothing comes any more.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::mem::take;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use lsfb_drivers::sidecar::SidecarMessage;
use lsfb_drivers::sidecar::credentials::{DeviceKey, to_hex};
use lsfb_drivers::sidecar::sensor_logger::PushedBody;
use lsfb_drivers::sidecar::wire::{Hello, is_name};
use lsfb_types::Timestamp;
use sha2::{Digest as _, Sha256};
use tokio::task::spawn_blocking;

use super::super::{Recorded, SidecarEvent, Visit};
use super::channels::{Channels, Outgoing, describe};
use super::order::{Order, Taken};
use crate::health::arrival_now;
use crate::receipt::{Progress, Receipt};
use crate::sidecar::pseudonyms::Pseudonyms;
use crate::sidecar::sessions::Opened;

/// Who pushes nothing for this long has gone: the app says no goodbye.
pub(super) const SILENT: Duration = Duration::from_secs(10);

/// What an app pushes in one of its recordings.
pub(super) struct PushSession {
    visit: Visit,
    recorded: Arc<Recorded>,
    device: String,
    /// As the app calls it.
    pub(super) session_id: String,
    /// As recordings do.
    session: String,
    opened: Opened,
    order: Order,
    channels: Channels,
    described: BTreeSet<u32>,
    seq: u64,
    told_missing: u64,
    /// Batches that came twice, and readings.
    repeated: u64,
    pub(super) heard: Instant,
}

impl fmt::Debug for PushSession {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PushSession({} {})", self.device, self.session)
    }
}

/// A session that nothing was heard of for a while: the app may be out of reach, and goes on counting.
#[derive(Debug)]
pub(super) struct Paused {
    session_id: String,
    order: Order,
    channels: Channels,
}

/// Why a batch was not recorded.
#[derive(Clone, Copy, Debug)]
pub(super) struct NotStored;

/// Where a batch is.
pub(super) enum BatchState {
    /// In the recording when so much is stored.
    Recorded(Arc<Progress>, u64),
    /// Waits for earlier ones.
    Held,
    /// Was recorded before.
    Repeated,
    /// Came too late.
    Late,
}

impl PushSession {
    /// Begins one, or goes on with it: after a pause, or in another recording.
    pub(super) async fn open(
        visit: &Visit,
        recorded: &Arc<Recorded>,
        device: &str,
        body: &PushedBody,
        paused: Option<Paused>,
    ) -> Result<Self, NotStored> {
        let session = match is_name(&body.session_id) {
            true => body.session_id.clone(),
            // It becomes a part of names of files.
            false => to_hex(&Sha256::digest(&body.session_id)[..16]),
        };
        let hello = Hello {
            session: session.clone(),
            first_unacked: 1,
            device: device.to_owned(),
            device_key: DeviceKey([0; 32]),
            pairing_token: None,
        };
        let arrival = arrival_now();
        let paused = paused.filter(|paused| paused.session_id == body.session_id);
        let (order, channels) = match paused {
            Some(paused) => (paused.order, paused.channels),
            None => Default::default(),
        };
        let joined = order.joined_at(body.message_id).map(|first| {
            format!("{device}: joined at batch {first}; earlier batches are not in this recording")
        });
        let room = visit.shared.events.clone().reserve_owned().await;
        let room = room.map_err(|_| NotStored)?;
        let (number, looking) = (visit.connection, Arc::clone(recorded));
        let opened = spawn_blocking(move || {
            let (device, session) = (hello.device.clone(), hello.session.clone());
            let announce = |opened: &Opened| {
                room.send(SidecarEvent::Opened {
                    connection: number,
                    hello,
                    arrival,
                    start: opened.start.clone(),
                    missing: 0,
                    note: opened.note.clone().or(joined),
                });
            };
            looking
                .sessions
                .open(number, &device, &session, 1, announce)
        });
        let opened = opened.await.ok().and_then(Result::ok).ok_or(NotStored)?;
        Ok(Self {
            visit: visit.clone(),
            recorded: Arc::clone(recorded),
            device: device.to_owned(),
            session_id: body.session_id.clone(),
            session,
            seq: opened.received,
            opened,
            told_missing: order.missing(),
            order,
            channels,
            described: BTreeSet::new(),
            repeated: 0,
            heard: Instant::now(),
        })
    }

    /// Takes a batch.
    pub(super) async fn take(&mut self, body: PushedBody) -> Result<BatchState, NotStored> {
        self.heard = Instant::now();
        let taken = self.order.take(body, self.heard);
        let place = match taken {
            Taken::Next(bodies) => {
                self.record(bodies).await?;
                BatchState::Recorded(Arc::clone(&self.opened.progress), self.seq)
            }
            Taken::Held => BatchState::Held,
            Taken::Late => BatchState::Late,
            Taken::Repeated => {
                self.repeated += 1;
                BatchState::Repeated
            }
        };
        self.tell(BTreeMap::new(), 0).await?;
        Ok(place)
    }

    /// Gives up batches that do not come.
    pub(super) async fn look(&mut self) -> Result<(), NotStored> {
        let bodies = self.order.overdue(Instant::now());
        if !bodies.is_empty() {
            self.record(bodies).await?;
            self.tell(BTreeMap::new(), 0).await?;
        }
        Ok(())
    }

    /// Nothing comes any more. The app may be heard again, and what it numbered meanwhile is missing then.
    pub(super) async fn pause(mut self, why: &str) -> Paused {
        let mut paused = Paused {
            session_id: take(&mut self.session_id),
            order: take(&mut self.order),
            channels: take(&mut self.channels),
        };
        // Told when this one closes, and not again.
        self.repeated += take(&mut paused.channels.repeated);
        self.close(why).await;
        paused
    }

    /// It is over.
    pub(super) async fn close(self, why: &str) {
        if self
            .recorded
            .sessions
            .close(self.visit.connection, &self.device)
        {
            let closed = SidecarEvent::Closed {
                connection: self.visit.connection,
                device: self.device,
                duplicated: self.repeated + self.channels.repeated,
                why: Some(why.to_owned()),
            };
            // An error: nobody records any more.
            let _ = self.visit.shared.events.send(closed).await;
        }
    }

    async fn record(&mut self, bodies: Vec<PushedBody>) -> Result<(), NotStored> {
        let arrival = arrival_now();
        for mut body in bodies {
            let unknown = take(&mut body.unknown);
            let unreadable = body.unreadable;
            if !unknown.is_empty() || unreadable > 0 {
                self.tell(unknown, unreadable).await?;
            }
            for message in self.channels.messages(&self.device, body) {
                self.describe(message.channel, arrival).await?;
                self.hand_on(message, arrival).await?;
            }
        }
        Ok(())
    }

    async fn describe(&mut self, channel: u32, arrival: Timestamp) -> Result<(), NotStored> {
        if !self.described.insert(channel) {
            return Ok(());
        }
        let described = describe(&self.device, channel).ok_or(NotStored)?;
        if self.visit.shared.pseudonyms.is_some() {
            Pseudonyms::admit(&described.schema_name).map_err(|_| NotStored)?;
        }
        {
            let topics = self.recorded.topics.lock();
            topics
                .unwrap_or_else(PoisonError::into_inner)
                .admit(&self.device, &described)
                .map_err(|_| NotStored)?;
        }
        self.send(SidecarEvent::Message {
            device: self.device.clone(),
            arrival,
            message: SidecarMessage::Advertise(described),
            receipt: None,
        })
        .await
    }

    async fn hand_on(&mut self, message: Outgoing, arrival: Timestamp) -> Result<(), NotStored> {
        let room = self.visit.shared.events.reserve().await;
        let room = room.map_err(|_| NotStored)?;
        let seq = self.seq + 1;
        let mut room = Some((room, message));
        let sessions = &self.recorded.sessions;
        let is_ours = sessions.hand_on(
            self.visit.connection,
            &self.device,
            &self.session,
            seq,
            || {
                if let Some((room, message)) = room.take() {
                    let progress = Arc::clone(&self.opened.progress);
                    let settled = Arc::new(AtomicU64::new(0));
                    room.send(SidecarEvent::Message {
                        device: self.device.clone(),
                        arrival,
                        message: SidecarMessage::Data {
                            channel: message.channel,
                            seq,
                            device_time_ns: message.time_ns,
                            payload: message.payload,
                        },
                        receipt: Some(Receipt::new(progress, settled, seq, 0)),
                    });
                }
            },
        );
        if !is_ours {
            return Err(NotStored);
        }
        self.seq = seq;
        Ok(())
    }

    /// Tells what is missing, where that has changed, and what has no place in a recording.
    async fn tell(&mut self, left_out: BTreeMap<String, u64>, bad: u64) -> Result<(), NotStored> {
        let missing = self.order.missing();
        let told = std::mem::replace(&mut self.told_missing, missing);
        if missing == told && left_out.is_empty() && bad == 0 {
            return Ok(());
        }
        self.send(SidecarEvent::Pushed {
            device: self.device.clone(),
            missing,
            missing_before: told,
            left_out,
            bad,
        })
        .await
    }

    async fn send(&self, event: SidecarEvent) -> Result<(), NotStored> {
        let sent = self.visit.shared.events.send(event).await;
        sent.map_err(|_| NotStored)
    }
}
