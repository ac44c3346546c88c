//! Xbus bytes to inertial readings. No I/O.

use lsfb_types::{ImuSample, Packet, Timestamp};

use super::model::message;
use super::wire::{Item, Items, Message, TriggerIn};
use crate::byte_stream::ByteStream;
use crate::{Decoded, WireError};

/// Finds messages in a byte stream that may begin anywhere and be damaged anywhere.
///
/// After a bad message it looks again from the byte behind the bogus preamble, so that a good message inside is found.
#[derive(Clone, Debug)]
pub struct Framer {
    max_data_len: usize,
    stream: ByteStream,
}

/// A message taken out of the stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FramedMessage {
    /// When its first byte arrived.
    pub arrival: Timestamp,
    /// Message identifier.
    pub id: u8,
    /// Its data.
    pub data: Vec<u8>,
}

impl Framer {
    /// `max_data_len`: a longer length field is taken for damage instead of being waited for.
    pub fn new(max_data_len: usize) -> Self {
        Self {
            max_data_len,
            stream: ByteStream::default(),
        }
    }

    /// Adds bytes as they arrived.
    pub fn push(&mut self, arrival: Timestamp, bytes: &[u8]) {
        self.stream.push(arrival, bytes);
    }

    /// The next whole message, if there is one.
    pub fn next_message(&mut self) -> Option<FramedMessage> {
        next_message(&mut self.stream, self.max_data_len)
    }

    /// For the end of the stream: gives up an unfinished message at the front, so that whole ones behind it are found.
    pub fn skip_unfinished(&mut self) -> bool {
        self.stream.skip_unfinished()
    }
}

/// The next whole message of a stream, if there is one.
pub(super) fn next_message(stream: &mut ByteStream, max_data_len: usize) -> Option<FramedMessage> {
    stream.next(
        |rest| {
            check_length(rest, max_data_len)?;
            let parsed = Message::parse(rest)?;
            Ok(parsed.map(|p| ((p.message.id, p.message.data.to_vec()), p.len)))
        },
        |arrival, (id, data)| FramedMessage { arrival, id, data },
    )
}

/// A length that no message has is damage.
fn check_length(rest: &[u8], max_data_len: usize) -> Result<(), WireError> {
    let got = match *rest {
        [_, _, _, 0xFF, high, low, ..] => usize::from(u16::from_be_bytes([high, low])),
        // The long form begins with 0xFF; its length is not there yet.
        [_, _, _, 0xFF, ..] => 0,
        [_, _, _, len, ..] => len.into(),
        _ => 0,
    };
    if got > max_data_len {
        return Err(WireError::Length {
            expected: max_data_len,
            got,
        });
    }
    Ok(())
}

/// What one MTData2 packet said.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuReading {
    /// Angular velocity and specific force; `None` in packets that carry only triggers or status.
    pub sample: Option<ImuSample>,
    /// UTC of the sample, nanoseconds since 1970; `None` where the unit does not know it.
    pub utc_ns: Option<i64>,
    /// Counter of packets, wraps at 65 536.
    pub packet_counter: Option<u16>,
    /// Temperature, °C.
    pub temperature_celsius: Option<f64>,
    /// Status bits as sent.
    pub status: Option<u32>,
    /// Pulses on SyncIn lines 1 and 2.
    pub triggers: [Option<TriggerIn>; 2],
}

/// What the decoder has met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuCounters {
    /// Packets decoded.
    pub packets: u64,
    /// Bytes that belong to no message.
    pub skipped_bytes: u64,
    /// Messages dropped for their checksum.
    pub bad_checksums: u64,
    /// Messages whose items could not be read.
    pub bad_items: u64,
    /// Packets that the packet counter says are missing.
    pub missing: u64,
    /// Packets dropped because they repeat the one before.
    pub duplicated: u64,
    /// Error messages of the unit.
    pub device_errors: u64,
}

/// How the decoder reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoderConfig {
    /// Longest data of a message, bytes. A damaged length beyond it costs no waiting.
    pub max_data_len: usize,
}

impl Default for DecoderConfig {
    /// 512 bytes: more than all outputs of a unit together.
    fn default() -> Self {
        Self { max_data_len: 512 }
    }
}

/// Bytes in, readings out.
///
/// `device_ticks` is `SampleTimeFine`: 100 µs each, wraps at 2³² (4.97 days); 0 where the unit does not send it.
#[derive(Clone, Debug)]
pub struct Decoder {
    framer: Framer,
    counters: ImuCounters,
    last_packet_counter: Option<u16>,
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new(config: DecoderConfig) -> Self {
        Self {
            framer: Framer::new(config.max_data_len),
            counters: ImuCounters::default(),
            last_packet_counter: None,
        }
    }

    /// Adds a piece of the stream; call [`Decoder::next_reading`] until it is empty.
    pub fn push(&mut self, packet: &Packet) {
        self.framer.push(packet.arrival, &packet.bytes);
    }

    /// The next reading, or `None` until more is pushed.
    pub fn next_reading(&mut self) -> Option<Decoded<ImuReading>> {
        while let Some(framed) = self.framer.next_message() {
            match framed.id {
                message::MT_DATA2 => match parse_reading(&framed) {
                    Ok(reading) if self.is_new(&reading.sample) => {
                        self.counters.packets += 1;
                        return Some(reading);
                    }
                    Ok(_) => self.counters.duplicated += 1,
                    Err(_) => self.counters.bad_items += 1,
                },
                message::ERROR => self.counters.device_errors += 1,
                // Late answers to requests carry nothing for us.
                _ => {}
            }
        }
        None
    }

    /// The stream has ended: what is left behind an unfinished message.
    pub fn finish(&mut self) -> Vec<Decoded<ImuReading>> {
        let mut readings = Vec::new();
        loop {
            while let Some(reading) = self.next_reading() {
                readings.push(reading);
            }
            if !self.framer.skip_unfinished() {
                return readings;
            }
        }
    }

    /// What was met so far.
    pub fn counters(&self) -> ImuCounters {
        ImuCounters {
            skipped_bytes: self.framer.stream.skipped_bytes(),
            bad_checksums: self.framer.stream.bad_checksums(),
            ..self.counters
        }
    }

    fn is_new(&mut self, reading: &ImuReading) -> bool {
        let Some(counter) = reading.packet_counter else {
            return true;
        };
        let step = self
            .last_packet_counter
            .map_or(1, |last| counter.wrapping_sub(last));
        if step == 0 {
            return false;
        }
        // Half the range backwards is a unit that began anew, not 32 768 lost packets.
        if step < 0x8000 {
            self.counters.missing += u64::from(step - 1);
        }
        self.last_packet_counter = Some(counter);
        true
    }
}

fn parse_reading(framed: &FramedMessage) -> Result<Decoded<ImuReading>, WireError> {
    let mut reading = ImuReading::default();
    let mut device_ticks = 0;
    let mut specific_force = None;
    let mut angular_velocity = None;
    for item in Items::new(&framed.data) {
        match item? {
            Item::SampleTimeFine(ticks) => device_ticks = ticks.into(),
            Item::PacketCounter(counter) => reading.packet_counter = Some(counter),
            Item::Utc(time) => reading.utc_ns = time.unix_nanos(),
            Item::Temperature { celsius, .. } => reading.temperature_celsius = Some(celsius),
            Item::Acceleration(vector) => specific_force = Some(vector.xyz),
            Item::RateOfTurn(vector) => angular_velocity = Some(vector.xyz),
            // The plain outputs are preferred where a unit sends both.
            Item::AccelerationHr(vector) => {
                specific_force.get_or_insert(vector.xyz);
            }
            Item::RateOfTurnHr(vector) => {
                angular_velocity.get_or_insert(vector.xyz);
            }
            Item::StatusWord(status) => reading.status = Some(status),
            Item::StatusByte(status) => {
                reading.status.get_or_insert(status.into());
            }
            Item::TriggerIn1(trigger) => reading.triggers[0] = Some(trigger),
            Item::TriggerIn2(trigger) => reading.triggers[1] = Some(trigger),
            _ => {}
        }
    }
    reading.sample = specific_force.zip(angular_velocity).map(
        |(specific_force_m_s2, angular_velocity_rad_s)| ImuSample {
            angular_velocity_rad_s,
            specific_force_m_s2,
        },
    );
    Ok(Decoded {
        arrival: framed.arrival,
        device_ticks,
        sample: reading,
    })
}

#[cfg(test)]
mod tests;
