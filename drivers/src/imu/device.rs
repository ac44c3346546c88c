//! Opening and configuring a unit.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use lsfb_types::Packet;

use super::decode::{DecoderConfig, FramedMessage, Framer};
use super::model::{DEFAULT_BAUD, WITH_EVERY_PACKET, data_id, message};
use super::wire::{Message, OutputSetting};
use crate::Error;
use crate::transport::PacketSource;
use crate::transport::serial::SerialLine;

/// How often a request is repeated before the unit counts as absent: a measuring unit may miss the first.
const ATTEMPTS: u32 = 5;
/// How long one answer is waited for. The manual allows half a second.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// Which line, and what the unit shall send.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImuConfig {
    /// Serial line, for instance `/dev/lsfb/imu_xsens_0380A2C1`.
    pub path: PathBuf,
    /// Speed of the line, baud.
    pub baud: u32,
    /// Samples per second.
    pub rate_hz: u16,
}

impl Default for ImuConfig {
    /// 200 Hz at 921 600 baud on the first USB serial line.
    fn default() -> Self {
        Self {
            path: PathBuf::from("/dev/ttyUSB0"),
            baud: DEFAULT_BAUD,
            rate_hz: 200,
        }
    }
}

impl ImuConfig {
    /// The outputs asked for: counter, both times, temperature, acceleration, rate of turn, status; 32-bit floats.
    pub fn outputs(&self) -> Vec<OutputSetting> {
        let every = |id| OutputSetting {
            id,
            rate_hz: WITH_EVERY_PACKET,
        };
        let at_rate = |id| OutputSetting {
            id,
            rate_hz: self.rate_hz,
        };
        vec![
            every(data_id::PACKET_COUNTER),
            every(data_id::SAMPLE_TIME_FINE),
            every(data_id::UTC_TIME),
            at_rate(data_id::TEMPERATURE),
            at_rate(data_id::ACCELERATION),
            at_rate(data_id::RATE_OF_TURN),
            every(data_id::STATUS_WORD),
        ]
    }
}

/// The unit's serial number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceId(pub u32);

/// A configured, measuring unit: yields pieces of its byte stream for [`super::Decoder`].
#[derive(Debug)]
pub struct XsensImu {
    line: SerialLine,
    id: DeviceId,
    /// What arrived behind the last answer.
    first: Option<Packet>,
}

impl XsensImu {
    /// Opens the line, sets the outputs, checks that the unit accepted them, and starts measuring.
    pub fn open(config: &ImuConfig) -> Result<Self, Error> {
        let mut session = Session {
            line: SerialLine::open(&config.path, config.baud)?,
            framer: Framer::new(DecoderConfig::default().max_data_len),
        };
        session.request(message::GO_TO_CONFIG, &[])?;
        let id = session.request(message::REQ_DID, &[])?;
        // Four bytes; where firmware sends eight, the last four are kept.
        let &[.., a, b, c, d] = id.data.as_slice() else {
            return Err(session.protocol(format!(
                "the device id has {} bytes instead of 4 or 8",
                id.data.len()
            )));
        };
        let wanted = config.outputs();
        let answer = session.request(
            message::SET_OUTPUT_CONFIGURATION,
            &OutputSetting::emit_all(&wanted),
        )?;
        let accepted = OutputSetting::parse_all(&answer.data)
            .map_err(|e| session.protocol(format!("answer to the output configuration: {e}")))?;
        if accepted != wanted {
            return Err(session.protocol(format!(
                "asked for outputs {wanted:04x?}, the unit accepted {accepted:04x?}; choose a rate it can deliver"
            )));
        }
        let start = session.request(message::GO_TO_MEASUREMENT, &[])?;
        let bytes = session.framer.take_rest();
        let first = (!bytes.is_empty()).then_some(Packet {
            arrival: start.arrival,
            bytes,
        });
        Ok(Self {
            line: session.line,
            id: DeviceId(u32::from_be_bytes([a, b, c, d])),
            first,
        })
    }

    /// The unit's serial number.
    pub fn id(&self) -> DeviceId {
        self.id
    }
}

impl PacketSource for XsensImu {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        match self.first.take() {
            Some(packet) => Ok(Some(packet)),
            None => self.line.recv(timeout),
        }
    }
}

/// A conversation of requests and answers, before measuring begins.
struct Session {
    line: SerialLine,
    framer: Framer,
}

impl Session {
    fn request(&mut self, id: u8, data: &[u8]) -> Result<FramedMessage, Error> {
        let mut bytes = Vec::new();
        Message { id, data }
            .emit(&mut bytes)
            .map_err(|e| self.protocol(format!("request {id:#04x}: {e}")))?;
        for _ in 0..ATTEMPTS {
            self.line.send(&bytes)?;
            let deadline = Instant::now() + ANSWER_TIMEOUT;
            while let Some(left) = deadline.checked_duration_since(Instant::now()) {
                if let Some(answer) = self.next_answer(id)? {
                    return Ok(answer);
                }
                if let Some(packet) = self.line.recv(left)? {
                    self.framer.push(packet.arrival, &packet.bytes);
                }
            }
        }
        Err(self.protocol(format!(
            "no answer to request {id:#04x}; check that the unit is on and that the baud rate is right"
        )))
    }

    /// The answer among what has arrived; data of a unit that is still measuring passes by.
    fn next_answer(&mut self, id: u8) -> Result<Option<FramedMessage>, Error> {
        while let Some(framed) = self.framer.next_message() {
            if framed.id == id.wrapping_add(1) {
                return Ok(Some(framed));
            }
            if framed.id == message::ERROR {
                return Err(self.protocol(format!(
                    "the unit refuses request {id:#04x} with code {:02x?}",
                    framed.data
                )));
            }
        }
        Ok(None)
    }

    fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.line.device().to_owned(),
            problem,
        }
    }
}

#[cfg(test)]
mod tests;
