//! Opening and configuring a unit.

use std::path::PathBuf;
use std::time::Duration;

use lsfb_types::Packet;

use super::decode::{DecoderConfig, FramedMessage, next_message};
use super::model::{DEFAULT_BAUD, WITH_EVERY_PACKET, data_id, message};
use super::wire::{Message, OutputSetting};
use crate::Error;
use crate::conversation::{Conversation, StreamingLine};
use crate::transport::PacketSource;

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
    line: StreamingLine,
    id: DeviceId,
}

impl XsensImu {
    /// Opens the line, sets the outputs, checks that the unit accepted them, and starts measuring.
    pub fn open(config: &ImuConfig) -> Result<Self, Error> {
        let mut unit = Conversation::open(&config.path, config.baud)?;
        request(&mut unit, message::GO_TO_CONFIG, &[])?;
        let id = request(&mut unit, message::REQ_DID, &[])?;
        // Four bytes; where firmware sends eight, the last four are kept.
        let &[.., a, b, c, d] = id.data.as_slice() else {
            return Err(unit.protocol(format!(
                "the device id has {} bytes instead of 4 or 8",
                id.data.len()
            )));
        };
        let wanted = config.outputs();
        let answer = request(
            &mut unit,
            message::SET_OUTPUT_CONFIGURATION,
            &OutputSetting::emit_all(&wanted),
        )?;
        let accepted = OutputSetting::parse_all(&answer.data)
            .map_err(|e| unit.protocol(format!("answer to the output configuration: {e}")))?;
        if accepted != wanted {
            return Err(unit.protocol(format!(
                "asked for outputs {wanted:04x?}, the unit accepted {accepted:04x?}; choose a rate it can deliver"
            )));
        }
        let start = request(&mut unit, message::GO_TO_MEASUREMENT, &[])?;
        Ok(Self {
            line: unit.finish(start.arrival),
            id: DeviceId(u32::from_be_bytes([a, b, c, d])),
        })
    }

    /// The unit's serial number.
    pub fn id(&self) -> DeviceId {
        self.id
    }
}

impl PacketSource for XsensImu {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        self.line.recv(timeout)
    }
}

fn request(unit: &mut Conversation, id: u8, data: &[u8]) -> Result<FramedMessage, Error> {
    let what = format!("request {id:#04x}");
    let mut bytes = Vec::new();
    Message { id, data }
        .emit(&mut bytes)
        .map_err(|e| unit.protocol(format!("{what}: {e}")))?;
    unit.ask(&what, &bytes, |stream| {
        while let Some(framed) = next_message(stream, DecoderConfig::default().max_data_len) {
            if framed.id == id.wrapping_add(1) {
                return Some(Ok(framed));
            }
            if framed.id == message::ERROR {
                return Some(Err(format!(
                    "the unit rejected {what} with code {:02x?}",
                    framed.data
                )));
            }
        }
        None
    })
}

#[cfg(test)]
mod tests;
