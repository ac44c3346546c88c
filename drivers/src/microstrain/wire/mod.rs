//! MIP packets, fields and commands: bytes to plain structs and back. All numbers are big-endian.

mod command;
mod field;
#[cfg(test)]
mod tests;

pub use command::{Ack, BaseRate, Command, FormatEntry};
pub use field::{Field, GpsTime};

use super::model::{CHECKSUM_LEN, HEADER_LEN, SYNC};
use crate::WireError;

/// One packet: a descriptor set, and fields that it gives meaning to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MipPacket<'a> {
    /// What the fields are about, see [`super::model::set`].
    pub descriptor_set: u8,
    /// Its fields as bytes, see [`RawFields`].
    pub payload: &'a [u8],
}

/// A packet at the front of some bytes, and how many of them it takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parsed<'a> {
    /// The packet.
    pub packet: MipPacket<'a>,
    /// Bytes from sync to checksum.
    pub len: usize,
}

impl<'a> MipPacket<'a> {
    /// Reads the packet at the front of `bytes`. `None`: so far nothing is wrong, but its end is not there yet.
    pub fn parse(bytes: &'a [u8]) -> Result<Option<Parsed<'a>>, WireError> {
        for (offset, expected) in SYNC.into_iter().enumerate() {
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
        let (Some(&descriptor_set), Some(&len)) = (bytes.get(2), bytes.get(3)) else {
            return Ok(None);
        };
        let end = HEADER_LEN + usize::from(len);
        let Some(whole) = bytes.get(..end + CHECKSUM_LEN) else {
            return Ok(None);
        };
        let (content, sum) = whole.split_at(end);
        let got = u16::from_be_bytes([sum[0], sum[1]]);
        let expected = checksum(content);
        if got != expected {
            return Err(WireError::Checksum {
                expected: expected.into(),
                got: got.into(),
            });
        }
        Ok(Some(Parsed {
            packet: MipPacket {
                descriptor_set,
                payload: &content[HEADER_LEN..],
            },
            len: whole.len(),
        }))
    }

    /// Appends the packet's bytes. A payload beyond 255 bytes is an error.
    pub fn emit(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let len = u8::try_from(self.payload.len()).map_err(|_| WireError::Length {
            expected: 255,
            got: self.payload.len(),
        })?;
        let start = out.len();
        out.extend(SYNC);
        out.extend([self.descriptor_set, len]);
        out.extend(self.payload);
        out.extend(checksum(&out[start..]).to_be_bytes());
        Ok(())
    }

    /// Its fields, as bytes.
    pub fn raw_fields(&self) -> RawFields<'a> {
        RawFields { rest: self.payload }
    }

    /// The fields of a data packet.
    pub fn fields(&self) -> impl Iterator<Item = Result<Field<'a>, WireError>> + use<'a> {
        let set = self.descriptor_set;
        self.raw_fields()
            .map(move |raw| raw.and_then(|raw| Field::parse(set, raw)))
    }
}

/// Fletcher's, over everything before it.
fn checksum(bytes: &[u8]) -> u16 {
    let (mut first, mut second) = (0u8, 0u8);
    for byte in bytes {
        first = first.wrapping_add(*byte);
        second = second.wrapping_add(first);
    }
    u16::from_be_bytes([first, second])
}

/// A field before it is known what it means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawField<'a> {
    /// What it is, within its packet's descriptor set.
    pub descriptor: u8,
    /// Its data.
    pub data: &'a [u8],
}

impl RawField<'_> {
    /// Appends length, descriptor and data. Data beyond 253 bytes is an error.
    pub fn emit(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let len = u8::try_from(self.data.len() + 2).map_err(|_| WireError::Length {
            expected: 253,
            got: self.data.len(),
        })?;
        out.extend([len, self.descriptor]);
        out.extend(self.data);
        Ok(())
    }
}

/// The fields of a packet, in order. After an error there is no next one.
#[derive(Clone, Debug)]
pub struct RawFields<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for RawFields<'a> {
    type Item = Result<RawField<'a>, WireError>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = std::mem::take(&mut self.rest);
        let &[len, descriptor, ..] = rest else {
            return (!rest.is_empty()).then_some(Err(WireError::Length {
                expected: 2,
                got: rest.len(),
            }));
        };
        let too_short = WireError::Length {
            expected: usize::from(len).max(2),
            got: rest.len(),
        };
        let Some((field, after)) = rest.split_at_checked(len.into()) else {
            return Some(Err(too_short));
        };
        let Some(data) = field.get(2..) else {
            return Some(Err(WireError::Value {
                field: "field length",
                offset: 0,
                got: len.into(),
            }));
        };
        self.rest = after;
        Some(Ok(RawField { descriptor, data }))
    }
}

fn fixed<const N: usize>(data: &[u8]) -> Result<[u8; N], WireError> {
    data.try_into().map_err(|_| WireError::Length {
        expected: N,
        got: data.len(),
    })
}
