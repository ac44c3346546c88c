//! Xbus messages and MTData2 items: bytes to plain structs and back. All numbers are big-endian.

mod fixed;
mod item;
#[cfg(test)]
mod tests;
mod utc;

pub use item::{Coding, Item, Items, Precision, TriggerIn, Vector};
pub use utc::UtcTime;

use super::model::{BUS_ID, MAX_DATA_LEN, PREAMBLE};
use crate::WireError;

/// One Xbus message: what it is, and its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Message identifier, see [`super::model::message`].
    pub id: u8,
    /// Its data.
    pub data: &'a [u8],
}

/// A message at the front of some bytes, and how many of them it takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parsed<'a> {
    /// The message.
    pub message: Message<'a>,
    /// Bytes from preamble to checksum.
    pub len: usize,
}

impl<'a> Message<'a> {
    /// Reads the message at the front of `bytes`. `None`: so far nothing is wrong, but its end is not there yet.
    pub fn parse(bytes: &'a [u8]) -> Result<Option<Parsed<'a>>, WireError> {
        for (offset, expected) in [(0, PREAMBLE), (1, BUS_ID)] {
            match bytes.get(offset) {
                Some(&got) if got != expected => {
                    return Err(WireError::Constant {
                        offset,
                        expected: expected.into(),
                        got: got.into(),
                    });
                }
                Some(_) => {}
                None => return Ok(None),
            }
        }
        let (Some(&id), Some(&short_len)) = (bytes.get(2), bytes.get(3)) else {
            return Ok(None);
        };
        let (start, len) = if short_len == 0xFF {
            let (Some(&high), Some(&low)) = (bytes.get(4), bytes.get(5)) else {
                return Ok(None);
            };
            (6, usize::from(u16::from_be_bytes([high, low])))
        } else {
            (4, usize::from(short_len))
        };
        if len > MAX_DATA_LEN {
            return Err(WireError::Value {
                field: "data length",
                offset: 4,
                got: len as u64,
            });
        }
        let Some(whole) = bytes.get(..start + len + 1) else {
            return Ok(None);
        };
        let got = whole[start + len];
        let expected = checksum(&whole[1..start + len]);
        if got != expected {
            return Err(WireError::Checksum {
                expected: expected.into(),
                got: got.into(),
            });
        }
        Ok(Some(Parsed {
            message: Message {
                id,
                data: &whole[start..start + len],
            },
            len: whole.len(),
        }))
    }

    /// Appends the message's bytes. Data beyond what a message can hold is an error.
    pub fn emit(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        if self.data.len() > MAX_DATA_LEN {
            return Err(WireError::Length {
                expected: MAX_DATA_LEN,
                got: self.data.len(),
            });
        }
        let start = out.len();
        out.extend([PREAMBLE, BUS_ID, self.id]);
        match u8::try_from(self.data.len()) {
            Ok(len) if len < 0xFF => out.push(len),
            _ => {
                out.push(0xFF);
                out.extend((self.data.len() as u16).to_be_bytes());
            }
        }
        out.extend(self.data);
        out.push(checksum(&out[start + 1..]));
        Ok(())
    }
}

/// The byte that makes everything after the preamble sum to zero.
fn checksum(after_preamble: &[u8]) -> u8 {
    after_preamble
        .iter()
        .fold(0u8, |sum, byte| sum.wrapping_add(*byte))
        .wrapping_neg()
}

/// One line of `SetOutputConfiguration`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputSetting {
    /// Data identifier with its coding nibble, see [`super::model::data_id`].
    pub id: u16,
    /// Times per second; [`super::model::WITH_EVERY_PACKET`] for counters and stamps.
    pub rate_hz: u16,
}

impl OutputSetting {
    /// Reads the data of `SetOutputConfiguration` or of its answer.
    pub fn parse_all(data: &[u8]) -> Result<Vec<Self>, WireError> {
        let (settings, rest) = data.as_chunks::<4>();
        if !rest.is_empty() {
            return Err(WireError::Length {
                expected: data.len() - rest.len(),
                got: data.len(),
            });
        }
        Ok(settings
            .iter()
            .map(|&[id_high, id_low, rate_high, rate_low]| Self {
                id: u16::from_be_bytes([id_high, id_low]),
                rate_hz: u16::from_be_bytes([rate_high, rate_low]),
            })
            .collect())
    }

    /// The data of a `SetOutputConfiguration` message.
    pub fn emit_all(settings: &[Self]) -> Vec<u8> {
        settings
            .iter()
            .flat_map(|setting| {
                let [id_high, id_low] = setting.id.to_be_bytes();
                let [rate_high, rate_low] = setting.rate_hz.to_be_bytes();
                [id_high, id_low, rate_high, rate_low]
            })
            .collect()
    }
}
