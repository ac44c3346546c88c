//! Opening and configuring a unit.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use lsfb_types::Packet;

use super::model::{DEFAULT_BAUD, field, set};
use super::wire::{Ack, BaseRate, Command, FormatEntry, MipPacket};
use crate::Error;
use crate::byte_stream::ByteStream;
use crate::transport::PacketSource;
use crate::transport::serial::SerialLine;

/// How often a command is repeated before the unit counts as absent.
const ATTEMPTS: u32 = 5;
/// How long one answer is waited for.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// Which line, and what the unit shall send.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MipConfig {
    /// Serial line, for instance `/dev/lsfb/imu_mip`.
    pub path: PathBuf,
    /// Speed of the line, baud.
    pub baud: u32,
    /// Samples per second; the unit's base rate must be a multiple of it.
    pub rate_hz: u16,
}

impl Default for MipConfig {
    /// 200 Hz at 921 600 baud on the line that the udev rule names.
    fn default() -> Self {
        Self {
            path: PathBuf::from("/dev/lsfb/imu_mip"),
            baud: DEFAULT_BAUD,
            rate_hz: 200,
        }
    }
}

/// Fields asked for: both times, specific force, angular velocity.
const FIELDS: [u8; 4] = [
    field::REFERENCE_TIME,
    field::REFERENCE_DELTA,
    field::ACCELEROMETER,
    field::GYROSCOPE,
];

/// A configured, measuring unit: yields pieces of its byte stream for [`super::Decoder`].
#[derive(Debug)]
pub struct MipImu {
    line: SerialLine,
    base_rate_hz: u16,
    /// What arrived behind the last answer.
    first: Option<Packet>,
}

impl MipImu {
    /// Opens the line, silences the unit, sets its fields and rate, and starts it.
    pub fn open(config: &MipConfig) -> Result<Self, Error> {
        let mut session = Session {
            line: SerialLine::open(&config.path, config.baud)?,
            stream: ByteStream::default(),
        };
        session.request(&Command::Idle)?;
        session.request(&Command::Ping)?;
        let data_set = set::SENSOR;
        let answer = session.request(&Command::GetBaseRate { data_set })?;
        let base_rate_hz = answer.base_rate.map_or(0, |rate| rate.rate_hz);
        if config.rate_hz == 0 || base_rate_hz == 0 || base_rate_hz % config.rate_hz != 0 {
            return Err(session.protocol(format!(
                "{} Hz cannot be made of the unit's {base_rate_hz} Hz: choose a rate that divides it",
                config.rate_hz
            )));
        }
        let decimation = base_rate_hz / config.rate_hz;
        let entries = FIELDS.map(|descriptor| FormatEntry {
            descriptor,
            decimation,
        });
        session.request(&Command::MessageFormat {
            data_set,
            entries: entries.to_vec(),
        })?;
        let started = session.request(&Command::Resume)?;
        let bytes = session.stream.take_rest();
        let first = (!bytes.is_empty()).then_some(Packet {
            arrival: started.arrival,
            bytes,
        });
        Ok(Self {
            line: session.line,
            base_rate_hz,
            first,
        })
    }

    /// The rate that the unit divides, Hz.
    pub fn base_rate_hz(&self) -> u16 {
        self.base_rate_hz
    }
}

impl PacketSource for MipImu {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        match self.first.take() {
            Some(packet) => Ok(Some(packet)),
            None => self.line.recv(timeout),
        }
    }
}

/// A conversation of commands and answers, before measuring begins.
struct Session {
    line: SerialLine,
    stream: ByteStream,
}

struct Answer {
    arrival: lsfb_types::Timestamp,
    ack: Ack,
    base_rate: Option<BaseRate>,
}

impl Session {
    fn request(&mut self, command: &Command) -> Result<Answer, Error> {
        let mut bytes = Vec::new();
        command
            .emit(&mut bytes)
            .map_err(|e| self.protocol(format!("command {:#04x}: {e}", command.descriptor())))?;
        for _ in 0..ATTEMPTS {
            self.line.send(&bytes)?;
            let deadline = Instant::now() + ANSWER_TIMEOUT;
            while let Some(left) = deadline.checked_duration_since(Instant::now()) {
                if let Some(answer) = self.next_answer(command) {
                    if answer.ack.code == 0 {
                        return Ok(answer);
                    }
                    return Err(self.protocol(format!(
                        "the unit refuses command {:#04x} of set {:#04x} with code {:#04x}",
                        command.descriptor(),
                        command.descriptor_set(),
                        answer.ack.code
                    )));
                }
                if let Some(packet) = self.line.recv(left)? {
                    self.stream.push(packet.arrival, &packet.bytes);
                }
            }
        }
        Err(self.protocol(format!(
            "no answer to command {:#04x}; check that the unit is on and that the baud rate is right",
            command.descriptor()
        )))
    }

    /// The answer among what has arrived; data of a unit that is still measuring passes by.
    fn next_answer(&mut self, command: &Command) -> Option<Answer> {
        let expected_set = command.descriptor_set();
        while let Some(answer) = self.stream.next(
            |rest| {
                let parsed = MipPacket::parse(rest)?;
                Ok(parsed.map(|p| (answer_of(&p.packet, expected_set), p.len)))
            },
            |arrival, answer| answer.map(|(ack, base_rate)| (arrival, ack, base_rate)),
        ) {
            if let Some((arrival, ack, base_rate)) = answer
                && ack.descriptor == command.descriptor()
            {
                return Some(Answer {
                    arrival,
                    ack,
                    base_rate,
                });
            }
        }
        None
    }

    fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.line.device().to_owned(),
            problem,
        }
    }
}

/// What a packet of `expected_set` answers.
fn answer_of(packet: &MipPacket<'_>, expected_set: u8) -> Option<(Ack, Option<BaseRate>)> {
    if packet.descriptor_set != expected_set {
        return None;
    }
    let fields = || packet.raw_fields().map_while(Result::ok);
    let ack = fields().find_map(|raw| Ack::parse(raw).ok().flatten())?;
    let base_rate = fields().find_map(|raw| BaseRate::parse(raw).ok().flatten());
    Some((ack, base_rate))
}

#[cfg(test)]
mod tests;
