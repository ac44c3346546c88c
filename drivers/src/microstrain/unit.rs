//! The unit's side of a conversation, for mocks.

use super::model::set;
use super::wire::{Ack, BaseRate, Command, FormatEntry, MipPacket};
use crate::WireError;
use crate::byte_stream::ByteStream;

/// A command that the unit does not know.
const UNKNOWN_COMMAND: u8 = 0x01;
/// A command whose parameters the unit does not take.
const INVALID_PARAMETER: u8 = 0x03;

/// A unit that takes commands, byte for byte: a mock holds one, gives it what the host sent, and sends what it answers.
#[derive(Clone, Debug)]
pub struct MipUnit {
    base_rate_hz: u16,
    stream: ByteStream,
    format: Vec<FormatEntry>,
    streaming: bool,
}

impl MipUnit {
    /// A unit that has just powered up: idle, with no fields chosen.
    pub fn new(base_rate_hz: u16) -> Self {
        Self {
            base_rate_hz,
            stream: ByteStream::default(),
            format: Vec::new(),
            streaming: false,
        }
    }

    /// Whether it sends data now.
    pub fn is_streaming(&self) -> bool {
        self.streaming
    }

    /// The fields of inertial data that were asked for.
    pub fn format(&self) -> &[FormatEntry] {
        &self.format
    }

    /// Carries out the commands in what the host sent, which may be cut anywhere, and returns the answers.
    pub fn handle(&mut self, bytes: &[u8]) -> Result<Vec<u8>, WireError> {
        let mut answers = Vec::new();
        self.stream.push(Default::default(), bytes);
        while let Some((descriptor_set, payload)) = self.stream.next(
            |rest| {
                let parsed = MipPacket::parse(rest)?;
                Ok(parsed.map(|p| ((p.packet.descriptor_set, p.packet.payload.to_vec()), p.len)))
            },
            |_, packet| packet,
        ) {
            let packet = MipPacket {
                descriptor_set,
                payload: &payload,
            };
            // A packet for each command: the answers to many would not fit into one.
            for raw in packet.raw_fields().map_while(Result::ok) {
                let mut reply = None;
                let code = match Command::parse(descriptor_set, raw) {
                    Ok(Some(command)) => self.carry_out(&command, &mut reply),
                    Ok(None) => UNKNOWN_COMMAND,
                    Err(_) => INVALID_PARAMETER,
                };
                let descriptor = raw.descriptor;
                let mut answer = Vec::new();
                Ack { descriptor, code }.emit(&mut answer)?;
                if let Some(rate) = reply {
                    rate.emit(&mut answer)?;
                }
                MipPacket {
                    descriptor_set,
                    payload: &answer,
                }
                .emit(&mut answers)?;
            }
        }
        Ok(answers)
    }

    fn carry_out(&mut self, command: &Command, reply: &mut Option<BaseRate>) -> u8 {
        match command {
            Command::Ping => {}
            Command::Idle => self.streaming = false,
            Command::Resume => self.streaming = true,
            Command::GetBaseRate { data_set } if *data_set == set::SENSOR => {
                *reply = Some(BaseRate {
                    data_set: *data_set,
                    rate_hz: self.base_rate_hz,
                });
            }
            Command::MessageFormat { data_set, entries } if *data_set == set::SENSOR => {
                if entries.iter().any(|entry| entry.decimation == 0) {
                    return INVALID_PARAMETER;
                }
                self.format.clone_from(entries);
            }
            Command::GetBaseRate { .. } | Command::MessageFormat { .. } => {
                return INVALID_PARAMETER;
            }
        }
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_commands_in_one_packet_have_an_answer_each() {
        let payload = [2u8, 0x01].repeat(120);
        let packet = MipPacket {
            descriptor_set: set::BASE,
            payload: &payload,
        };
        let mut request = Vec::new();
        packet.emit(&mut request).unwrap();
        let answers = MipUnit::new(1000).handle(&request).unwrap();
        let one = MipPacket::parse(&answers).unwrap().unwrap();
        assert_eq!(answers.len(), 120 * one.len);
    }
}
