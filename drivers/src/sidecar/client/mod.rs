//! The app's side: a session that outlives its connections.

mod config;
mod faults;
mod link;

use std::collections::VecDeque;
use std::thread;
use std::time::{Duration, Instant};

use faults::Faults;
use link::{Link, Said};

use super::wire::{
    Advertise, Envelope, EnvelopeKind, Hello, TimeExchange, TimeRequest, TimeResponse,
};
use crate::Error;

pub use config::{ClientClock, ClientConfig};

/// Between two attempts to find a rig that was lost.
const RECONNECT_EVERY: Duration = Duration::from_millis(50);
/// Exchanges of times when a connection begins …
const FIRST_EXCHANGES: u32 = 10;
/// … and between two of them later.
const EXCHANGE_EVERY: Duration = Duration::from_secs(1);

/// What became of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClientCounts {
    /// Connections that were opened.
    pub connections: u64,
    /// DATA messages, each once.
    pub messages: u64,
    /// DATA messages that were sent again.
    pub resent: u64,
}

/// A session with a rig. What is sent is kept until the rig has acknowledged it; a connection that is lost is opened again,
/// and the session goes on where the rig has got to.
#[derive(Debug)]
pub struct SidecarClient {
    config: ClientConfig,
    link: Option<Link>,
    channels: Vec<Advertise>,
    last_seq: u64,
    spool: VecDeque<Spooled>,
    spooled_bytes: usize,
    /// Number of the last DATA that went out on this connection.
    sent_seq: u64,
    /// Bytes of DATA that went out on this connection, and may.
    sent_bytes: u64,
    credit_bytes: u64,
    exchanges: Exchanges,
    faults: Option<Faults>,
    counts: ClientCounts,
}

/// A DATA envelope that is not acknowledged.
#[derive(Debug)]
struct Spooled {
    seq: u64,
    bytes: Vec<u8>,
}

/// Questions for the time.
#[derive(Debug, Default)]
struct Exchanges {
    asked: Option<Instant>,
    done: u32,
    last: TimeExchange,
}

impl SidecarClient {
    /// Connects and opens the session.
    pub fn connect(config: ClientConfig) -> Result<Self, Error> {
        let mut client = Self {
            faults: config.faults.map(Faults::new),
            config,
            link: None,
            channels: Vec::new(),
            last_seq: 0,
            spool: VecDeque::new(),
            spooled_bytes: 0,
            sent_seq: 0,
            sent_bytes: 0,
            credit_bytes: 0,
            exchanges: Exchanges::default(),
            counts: ClientCounts::default(),
        };
        client.open()?;
        Ok(client)
    }

    /// Describes a channel; its DATA may follow.
    pub fn advertise(&mut self, channel: &Advertise) -> Result<(), Error> {
        self.channels.push(channel.clone());
        let payload = channel.emit();
        self.persist(|client| {
            // One that connected again has said it already.
            let link = client.link()?;
            link.send_around(EnvelopeKind::Advertise, &payload)
        })
    }

    /// Sends a message of a described channel, waiting while the window is full.
    pub fn send(&mut self, channel: u32, device_time_ns: i64, payload: &[u8]) -> Result<(), Error> {
        let envelope = Envelope {
            kind: EnvelopeKind::Data,
            channel,
            seq: self.last_seq + 1,
            device_time_ns,
            payload,
        };
        let bytes = envelope.emit().map_err(|e| Error::Protocol {
            device: self.config.device.clone(),
            problem: format!("the message cannot be sent: {e}"),
        })?;
        self.persist(|client| client.wait_for_room(bytes.len()))?;
        self.last_seq += 1;
        self.counts.messages += 1;
        self.spooled_bytes += bytes.len();
        self.spool.push_back(Spooled {
            seq: self.last_seq,
            bytes,
        });
        self.persist(Self::pump)?;
        self.suffer()
    }

    /// Says that nothing follows, waits until the rig has stored everything, and closes.
    pub fn bye(mut self) -> Result<ClientCounts, Error> {
        self.persist(|client| {
            client.pump()?;
            while client.sent_seq < client.last_seq {
                client.wait()?;
                client.pump()?;
            }
            let bye = Envelope::bare(EnvelopeKind::Bye, client.last_seq);
            let link = client.link()?;
            let bytes = link.bytes_of(&bye)?;
            link.send(bytes)?;
            while !client.spool.is_empty() {
                client.wait()?;
            }
            Ok(())
        })?;
        if let Some(link) = self.link.take() {
            // Everything is stored; how the rig leaves does not matter.
            let _ = link.close();
        }
        Ok(self.counts)
    }

    /// What has happened so far.
    pub fn counts(&self) -> ClientCounts {
        self.counts
    }

    /// Number of the last message that the rig has acknowledged.
    pub fn acknowledged(&self) -> u64 {
        let kept = self.spool.front().map(|spooled| spooled.seq);
        kept.map_or(self.last_seq, |first| first.saturating_sub(1))
    }

    /// Cuts the connection when so many more bytes have been sent, in the middle of whatever it is.
    fn cut_after(&mut self, bytes: u64) {
        if let Some(link) = &mut self.link {
            link.cut_after(bytes);
        }
    }

    /// Sends the last message that went out once more, where it is not acknowledged and the rig grants it.
    fn repeat_last(&mut self) -> Result<(), Error> {
        let last = self.spool.back().map(|spooled| spooled.bytes.clone());
        let Some(last) = last.filter(|_| self.sent_seq == self.last_seq) else {
            return Ok(());
        };
        let after = self.sent_bytes + last.len() as u64;
        if after > self.credit_bytes {
            return Ok(());
        }
        self.persist(|client| {
            client.sent_bytes += last.len() as u64;
            client.link()?.send(last.clone())
        })
    }

    /// Sends something with a checksum that is wrong; the rig ends the connection.
    fn send_damaged(&mut self) -> Result<(), Error> {
        let envelope = Envelope {
            payload: &[1],
            ..Envelope::bare(EnvelopeKind::Data, self.last_seq + 1)
        };
        self.persist(|client| {
            let link = client.link()?;
            let mut bytes = link.bytes_of(&envelope)?;
            if let Some(last) = bytes.last_mut() {
                *last ^= 1;
            }
            link.send(bytes)
        })
    }

    /// Sends a message that is not the next; the rig ends the connection.
    fn send_ahead(&mut self, by: u64) -> Result<(), Error> {
        let Some(channel) = self.channels.first().map(|channel| channel.channel) else {
            return Ok(());
        };
        let envelope = Envelope {
            channel,
            payload: &[1],
            ..Envelope::bare(EnvelopeKind::Data, self.last_seq + 2 + by)
        };
        self.persist(|client| {
            let link = client.link()?;
            let bytes = link.bytes_of(&envelope)?;
            link.send(bytes)
        })
    }

    /// Does something on the connection; where that is lost, connects again and does it there.
    fn persist(
        &mut self,
        mut act: impl FnMut(&mut Self) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let mut lost = match act(self) {
            Ok(()) => return Ok(()),
            Err(error) => error,
        };
        let began = Instant::now();
        let patience = Duration::from_secs(self.config.reconnect_secs.into());
        loop {
            self.link = None;
            if !passes(&lost) || began.elapsed() >= patience {
                return Err(lost);
            }
            match self.open().and_then(|()| act(self)) {
                Ok(()) => return Ok(()),
                Err(error) => lost = error,
            }
            thread::sleep(RECONNECT_EVERY);
        }
    }

    /// Connects, says who we are and what the channels are, and sends again what the rig does not have.
    fn open(&mut self) -> Result<(), Error> {
        let mut link = Link::open(&self.config)?;
        self.counts.connections += 1;
        let hello = Hello {
            session: self.config.session.clone(),
            first_unacked: self.acknowledged() + 1,
            device: self.config.device.clone(),
            device_key: self.config.device_key,
            pairing_token: self.config.pairing_token,
        };
        link.send_around(EnvelopeKind::Hello, &hello.emit())?;
        self.link = Some(link);
        (self.sent_bytes, self.credit_bytes) = (0, 0);
        (self.exchanges.asked, self.exchanges.done) = (None, 0);
        // The credit follows the acknowledgement.
        while self.credit_bytes == 0 {
            self.wait()?;
        }
        // The rig knows us now.
        self.config.pairing_token = None;
        let acknowledged = self.acknowledged();
        let resumed = std::mem::replace(&mut self.sent_seq, acknowledged);
        self.counts.resent += resumed.saturating_sub(self.sent_seq);
        let channels: Vec<Vec<u8>> = self.channels.iter().map(Advertise::emit).collect();
        for payload in channels {
            self.link()?
                .send_around(EnvelopeKind::Advertise, &payload)?;
        }
        self.exchange_first_times()?;
        self.pump()
    }

    fn link(&mut self) -> Result<&mut Link, Error> {
        self.link.as_mut().ok_or_else(|| Error::EndOfStream {
            device: self.config.address.to_string(),
        })
    }

    /// Sends as much as the rig takes, and hears what it has said meanwhile.
    fn pump(&mut self) -> Result<(), Error> {
        while self.link()?.has_arrived() && self.hear(Duration::ZERO)? {}
        loop {
            let first = self.spool.front().map_or(0, |spooled| spooled.seq);
            let at = usize::try_from((self.sent_seq + 1).saturating_sub(first));
            let Some(next) = at.ok().and_then(|at| self.spool.get(at)) else {
                break;
            };
            let after = self.sent_bytes + next.bytes.len() as u64;
            if after > self.credit_bytes {
                break;
            }
            let (seq, bytes) = (next.seq, next.bytes.clone());
            self.link()?.send(bytes)?;
            (self.sent_seq, self.sent_bytes) = (seq, after);
        }
        let due = |asked: Instant| asked.elapsed() >= EXCHANGE_EVERY;
        if self.exchanges.asked.is_some_and(due) {
            self.ask_time()?;
        }
        Ok(())
    }

    fn wait_for_room(&mut self, bytes: usize) -> Result<(), Error> {
        loop {
            self.pump()?;
            let full = !self.spool.is_empty()
                && (self.spool.len() >= self.config.window_messages
                    || self.spooled_bytes + bytes > self.config.window_bytes);
            if !full {
                return Ok(());
            }
            self.wait()?;
        }
    }

    /// Hears one thing; a rig that says nothing for too long is lost.
    fn wait(&mut self) -> Result<(), Error> {
        let secs = self.config.ack_timeout_secs;
        if self.hear(Duration::from_secs(secs.into()))? {
            return Ok(());
        }
        let messages = self.spool.len();
        Err(self.link()?.protocol(format!(
            "no acknowledgement within {secs} s; {messages} messages are pending"
        )))
    }

    /// Whether the rig said something within `timeout`.
    fn hear(&mut self, timeout: Duration) -> Result<bool, Error> {
        let link = self.link()?;
        let Some(said) = link.hear(timeout)? else {
            return Ok(false);
        };
        match said {
            Said::Ack(seq) => self.forget(seq)?,
            Said::Credit(bytes) => self.credit_bytes = self.credit_bytes.max(bytes),
            Said::Time(response) => self.note_time(response),
            Said::State(state) => return Err(self.link()?.refused(state)),
        }
        Ok(true)
    }

    /// What the rig has stored need not be kept.
    fn forget(&mut self, acked: u64) -> Result<(), Error> {
        if acked > self.last_seq {
            let last = self.last_seq;
            return Err(self.link()?.protocol(format!(
                "message {acked} is acknowledged, but {last} was the last"
            )));
        }
        while self.spool.front().is_some_and(|first| first.seq <= acked) {
            let gone = self.spool.pop_front();
            self.spooled_bytes -= gone.map_or(0, |spooled| spooled.bytes.len());
        }
        Ok(())
    }

    fn exchange_first_times(&mut self) -> Result<(), Error> {
        if self.config.clock.is_none() {
            return Ok(());
        }
        for exchange in 0..FIRST_EXCHANGES {
            self.ask_time()?;
            while self.exchanges.done == exchange {
                self.wait()?;
            }
        }
        Ok(())
    }

    fn ask_time(&mut self) -> Result<(), Error> {
        let Some(clock) = self.config.clock.clone() else {
            return Ok(());
        };
        self.exchanges.asked = Some(Instant::now());
        let request = TimeRequest {
            t1_ns: clock.now_ns(),
            clock_id: clock.id,
            last: self.exchanges.last,
        };
        self.link()?
            .send_around(EnvelopeKind::TimeRequest, &request.emit())
    }

    fn note_time(&mut self, response: TimeResponse) {
        let Some(clock) = &self.config.clock else {
            return;
        };
        self.exchanges.done += 1;
        self.exchanges.last = TimeExchange {
            t1_ns: response.t1_ns,
            t2_ns: response.t2_ns,
            t3_ns: response.t3_ns,
            t4_ns: clock.now_ns(),
        };
    }
}

/// Whether to connect again may help.
fn passes(error: &Error) -> bool {
    !matches!(
        error,
        Error::Refused {
            may_pass: false,
            ..
        }
    )
}
