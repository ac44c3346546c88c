//! The receiving side of one connection: envelopes to messages. No I/O.

use std::collections::BTreeMap;

use super::model::MAX_CHANNELS;
use super::wire::{Advertise, Envelope, EnvelopeKind, Hello, TimeRequest};
use crate::WireError;

/// What an app said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SidecarMessage {
    /// It opened its session.
    Hello(Hello),
    /// It described a channel.
    Advertise(Advertise),
    /// A message of a described channel.
    Data {
        /// The channel.
        channel: u32,
        /// Its number within the session, from 1.
        seq: u64,
        /// Time of the measurement on the channel's clock, nanoseconds.
        device_time_ns: i64,
        /// The message in the channel's encoding.
        payload: Vec<u8>,
    },
    /// It asks for the time.
    TimeRequest(TimeRequest),
    /// It has sent everything.
    Bye {
        /// Number of its last DATA.
        last_seq: u64,
    },
}

/// Why an app is not listened to any longer: after this nothing of the connection can be trusted. What was not acknowledged
/// comes again on the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// An envelope that cannot be read, or has no place there.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// DATA is numbered without a gap.
    #[error("DATA {got}, expected {expected}")]
    Gap {
        /// The next number.
        expected: u64,
        /// The number that came.
        got: u64,
    },
}

/// What a connection has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SidecarCounters {
    /// DATA messages passed on.
    pub data: u64,
    /// Their payload bytes.
    pub payload_bytes: u64,
    /// DATA dropped because it had come before.
    pub duplicated: u64,
}

/// Envelopes in, messages out.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    counters: SidecarCounters,
    greeted: bool,
    channels: BTreeMap<u32, Advertise>,
    last_seq: u64,
}

impl Decoder {
    /// A decoder at the beginning of a connection.
    pub fn new() -> Self {
        Self::default()
    }

    /// Decodes one envelope. `None`: a repetition, which changes nothing.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Option<SidecarMessage>, DecodeError> {
        self.message(&Envelope::parse(bytes)?)
    }

    /// After HELLO: everything up to here has been received on earlier connections, and is a repetition where it comes again.
    pub fn resume_after(&mut self, seq: u64) {
        self.last_seq = seq;
    }

    /// What was met so far.
    pub fn counters(&self) -> SidecarCounters {
        self.counters
    }

    /// Number of the last DATA passed on, on this connection or before.
    pub fn last_seq(&self) -> u64 {
        self.last_seq
    }

    /// Whether the session is open.
    pub fn is_greeted(&self) -> bool {
        self.greeted
    }

    fn message(&mut self, envelope: &Envelope<'_>) -> Result<Option<SidecarMessage>, DecodeError> {
        if self.greeted == (envelope.kind == EnvelopeKind::Hello) {
            return Err(out_of_place(envelope));
        }
        match envelope.kind {
            EnvelopeKind::Hello => {
                let hello = Hello::parse(envelope.payload)?;
                self.greeted = true;
                // What the device no longer holds was acknowledged on an earlier connection.
                self.last_seq = hello.first_unacked.saturating_sub(1);
                Ok(Some(SidecarMessage::Hello(hello)))
            }
            EnvelopeKind::Advertise => self.advertise(Advertise::parse(envelope.payload)?),
            EnvelopeKind::Data => self.data(envelope),
            EnvelopeKind::TimeRequest => {
                let request = TimeRequest::parse(envelope.payload)?;
                Ok(Some(SidecarMessage::TimeRequest(request)))
            }
            EnvelopeKind::Bye => {
                if envelope.seq != self.last_seq {
                    return Err(self.gap(envelope.seq));
                }
                Ok(Some(SidecarMessage::Bye {
                    last_seq: envelope.seq,
                }))
            }
            EnvelopeKind::Ack
            | EnvelopeKind::Credit
            | EnvelopeKind::TimeResponse
            | EnvelopeKind::State => Err(out_of_place(envelope)),
        }
    }

    fn advertise(&mut self, described: Advertise) -> Result<Option<SidecarMessage>, DecodeError> {
        let refused = |field| {
            Err(DecodeError::Wire(WireError::Value {
                field,
                offset: 0,
                got: described.channel.into(),
            }))
        };
        match self.channels.get(&described.channel) {
            Some(known) if *known == described => return Ok(None),
            Some(_) => return refused("channel defined twice differently"),
            None if self.channels.len() == MAX_CHANNELS => {
                return refused("channel above the limit");
            }
            None => {}
        }
        self.channels.insert(described.channel, described.clone());
        Ok(Some(SidecarMessage::Advertise(described)))
    }

    fn data(&mut self, envelope: &Envelope<'_>) -> Result<Option<SidecarMessage>, DecodeError> {
        if !self.channels.contains_key(&envelope.channel) {
            return Err(DecodeError::Wire(WireError::Value {
                field: "channel without a description",
                offset: 0,
                got: envelope.channel.into(),
            }));
        }
        if envelope.seq <= self.last_seq {
            self.counters.duplicated += 1;
            return Ok(None);
        }
        if envelope.seq - self.last_seq > 1 {
            return Err(self.gap(envelope.seq));
        }
        self.last_seq = envelope.seq;
        self.counters.data += 1;
        self.counters.payload_bytes += envelope.payload.len() as u64;
        Ok(Some(SidecarMessage::Data {
            channel: envelope.channel,
            seq: envelope.seq,
            device_time_ns: envelope.device_time_ns,
            payload: envelope.payload.to_vec(),
        }))
    }

    fn gap(&self, got: u64) -> DecodeError {
        DecodeError::Gap {
            expected: self.last_seq.saturating_add(1),
            got,
        }
    }
}

fn out_of_place(envelope: &Envelope<'_>) -> DecodeError {
    DecodeError::Wire(WireError::Value {
        field: "envelope type at this place",
        offset: 0,
        got: envelope.kind.id(),
    })
}

#[cfg(test)]
mod tests;
