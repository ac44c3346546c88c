//! Opening and configuring a unit.

use std::path::PathBuf;
use std::time::Duration;

use lsfb_types::{Packet, Timestamp};

use super::model::{DEFAULT_BAUD, field, set};
use super::wire::{Ack, BaseRate, Command, FormatEntry, MipPacket};
use crate::Error;
use crate::conversation::{Conversation, StreamingLine};
use crate::transport::PacketSource;

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

impl MipConfig {
    /// What the unit is asked for: its fields with every so many samples of its base rate.
    pub fn format(decimation: u16) -> Vec<FormatEntry> {
        let entry = |descriptor| FormatEntry {
            descriptor,
            decimation,
        };
        FIELDS.map(entry).to_vec()
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
    line: StreamingLine,
    base_rate_hz: u16,
}

impl MipImu {
    /// Opens the line, silences the unit, sets its fields and rate, and starts it.
    pub fn open(config: &MipConfig) -> Result<Self, Error> {
        let mut unit = Conversation::open(&config.path, config.baud)?;
        request(&mut unit, &Command::Idle)?;
        request(&mut unit, &Command::Ping)?;
        let data_set = set::SENSOR;
        let answer = request(&mut unit, &Command::GetBaseRate { data_set })?;
        let base_rate_hz = answer.base_rate.map_or(0, |rate| rate.rate_hz);
        if config.rate_hz == 0 || base_rate_hz == 0 || base_rate_hz % config.rate_hz != 0 {
            return Err(unit.protocol(format!(
                "{} Hz is not possible with the unit's {base_rate_hz} Hz: choose a rate that divides it",
                config.rate_hz
            )));
        }
        let decimation = base_rate_hz / config.rate_hz;
        let format = Command::MessageFormat {
            data_set,
            entries: MipConfig::format(decimation),
        };
        request(&mut unit, &format)?;
        let started = request(&mut unit, &Command::Resume)?;
        Ok(Self {
            line: unit.finish(started.arrival),
            base_rate_hz,
        })
    }

    /// The rate that the unit divides, Hz.
    pub fn base_rate_hz(&self) -> u16 {
        self.base_rate_hz
    }
}

impl PacketSource for MipImu {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        self.line.recv(timeout)
    }
}

struct Answer {
    arrival: Timestamp,
    base_rate: Option<BaseRate>,
}

fn request(unit: &mut Conversation, command: &Command) -> Result<Answer, Error> {
    let (expected_set, descriptor) = (command.descriptor_set(), command.descriptor());
    let what = format!("command {descriptor:#04x} of set {expected_set:#04x}");
    let mut bytes = Vec::new();
    command
        .emit(&mut bytes)
        .map_err(|e| unit.protocol(format!("{what}: {e}")))?;
    unit.ask(&what, &bytes, |stream| {
        while let Some((arrival, answer)) = stream.next(
            |rest| {
                let parsed = MipPacket::parse(rest)?;
                Ok(parsed.map(|p| (answer_of(&p.packet, expected_set), p.len)))
            },
            |arrival, answer| (arrival, answer),
        ) {
            if let Some((ack, base_rate)) = answer
                && ack.descriptor == descriptor
            {
                return Some(match ack.code {
                    0 => Ok(Answer { arrival, base_rate }),
                    code => Err(format!("the unit rejected {what} with code {code:#04x}")),
                });
            }
        }
        None
    })
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
