//! The receiving side of one connection: envelopes to messages. No I/O.

use std::collections::BTreeMap;

use super::model::MAX_CHANNELS;
use super::wire::{Advertise, Envelope, EnvelopeKind, Hello};
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
    /// It has sent everything.
    Bye {
        /// Number of its last DATA.
        last_seq: u64,
    },
}

/// What a connection has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SidecarCounters {
    /// DATA messages passed on.
    pub data: u64,
    /// Their payload bytes.
    pub payload_bytes: u64,
    /// Envelopes dropped because their checksum is wrong.
    pub bad_checksum: u64,
    /// Envelopes dropped because they could not be read or did not belong there.
    pub malformed: u64,
    /// DATA that the numbers say is missing; damaged ones are among them.
    pub missing: u64,
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

    /// Decodes one envelope. `None`: a repetition, which changes nothing. An error is counted here, and the connection may go on.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Option<SidecarMessage>, WireError> {
        let message = Envelope::parse(bytes).and_then(|envelope| self.message(&envelope));
        message.inspect_err(|error| {
            *match error {
                WireError::Checksum { .. } => &mut self.counters.bad_checksum,
                _ => &mut self.counters.malformed,
            } += 1;
        })
    }

    /// What was met so far.
    pub fn counters(&self) -> SidecarCounters {
        self.counters
    }

    /// Number of the last DATA passed on.
    pub fn last_seq(&self) -> u64 {
        self.last_seq
    }

    fn message(&mut self, envelope: &Envelope<'_>) -> Result<Option<SidecarMessage>, WireError> {
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
            EnvelopeKind::Advertise => {
                let advertise = Advertise::parse(envelope.payload)?;
                let refused = |field| {
                    Err(WireError::Value {
                        field,
                        offset: 0,
                        got: advertise.channel.into(),
                    })
                };
                match self.channels.get(&advertise.channel) {
                    Some(known) if *known == advertise => return Ok(None),
                    Some(_) => return refused("channel described in two ways"),
                    None if self.channels.len() == MAX_CHANNELS => {
                        return refused("channel beyond the limit");
                    }
                    None => {}
                }
                self.channels.insert(advertise.channel, advertise.clone());
                Ok(Some(SidecarMessage::Advertise(advertise)))
            }
            EnvelopeKind::Data => self.data(envelope),
            EnvelopeKind::Bye => {
                self.count_missing_before(envelope.seq.saturating_add(1));
                Ok(Some(SidecarMessage::Bye {
                    last_seq: envelope.seq,
                }))
            }
            EnvelopeKind::Ack => Err(out_of_place(envelope)),
        }
    }

    fn data(&mut self, envelope: &Envelope<'_>) -> Result<Option<SidecarMessage>, WireError> {
        if !self.channels.contains_key(&envelope.channel) {
            return Err(WireError::Value {
                field: "channel without a description",
                offset: 0,
                got: envelope.channel.into(),
            });
        }
        if envelope.seq <= self.last_seq {
            self.counters.duplicated += 1;
            return Ok(None);
        }
        self.count_missing_before(envelope.seq);
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

    fn count_missing_before(&mut self, seq: u64) {
        let missing = seq.saturating_sub(self.last_seq).saturating_sub(1);
        self.counters.missing = self.counters.missing.saturating_add(missing);
    }
}

fn out_of_place(envelope: &Envelope<'_>) -> WireError {
    WireError::Value {
        field: "envelope type at this place",
        offset: 0,
        got: envelope.kind.id(),
    }
}

#[cfg(test)]
mod tests;
