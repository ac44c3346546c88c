//! Commands to the unit, and its answers.

use super::{MipPacket, RawField, fixed};
use crate::WireError;
use crate::microstrain::model::{command, set};

/// Function selector: write the setting.
const WRITE: u8 = 1;

/// One field of a message format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FormatEntry {
    /// Field descriptor, see [`super::super::model::field`].
    pub descriptor: u8,
    /// It comes with every so many samples of the base rate.
    pub decimation: u16,
}

/// What the host asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Are you there.
    Ping,
    /// Stop sending data.
    Idle,
    /// Go on sending data.
    Resume,
    /// Ask for the rate that decimations divide.
    GetBaseRate {
        /// Of this data set.
        data_set: u8,
    },
    /// Set the fields of a data set.
    MessageFormat {
        /// Which set.
        data_set: u8,
        /// Its fields, at most 80.
        entries: Vec<FormatEntry>,
    },
}

impl Command {
    /// The descriptor set it belongs to.
    pub fn descriptor_set(&self) -> u8 {
        match self {
            Self::Ping | Self::Idle | Self::Resume => set::BASE,
            Self::GetBaseRate { .. } | Self::MessageFormat { .. } => set::THREE_DM,
        }
    }

    /// Its field descriptor, which the answer repeats.
    pub fn descriptor(&self) -> u8 {
        match self {
            Self::Ping => command::PING,
            Self::Idle => command::IDLE,
            Self::Resume => command::RESUME,
            Self::GetBaseRate { .. } => command::GET_BASE_RATE,
            Self::MessageFormat { .. } => command::MESSAGE_FORMAT,
        }
    }

    /// Appends a packet with this command alone.
    pub fn emit(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let mut data = Vec::new();
        match self {
            Self::Ping | Self::Idle | Self::Resume => {}
            Self::GetBaseRate { data_set } => data.push(*data_set),
            Self::MessageFormat { data_set, entries } => {
                let count = u8::try_from(entries.len()).map_err(|_| WireError::Length {
                    expected: 80,
                    got: entries.len(),
                })?;
                data.extend([WRITE, *data_set, count]);
                for entry in entries {
                    data.push(entry.descriptor);
                    data.extend(entry.decimation.to_be_bytes());
                }
            }
        }
        let mut payload = Vec::new();
        RawField {
            descriptor: self.descriptor(),
            data: &data,
        }
        .emit(&mut payload)?;
        MipPacket {
            descriptor_set: self.descriptor_set(),
            payload: &payload,
        }
        .emit(out)
    }

    /// Gives a field of a command packet its meaning; `None` for a command that this version does not know.
    pub fn parse(descriptor_set: u8, raw: RawField<'_>) -> Result<Option<Self>, WireError> {
        Ok(Some(match (descriptor_set, raw.descriptor) {
            (set::BASE, command::PING) => Self::Ping,
            (set::BASE, command::IDLE) => Self::Idle,
            (set::BASE, command::RESUME) => Self::Resume,
            (set::THREE_DM, command::GET_BASE_RATE) => {
                let [data_set] = fixed(raw.data)?;
                Self::GetBaseRate { data_set }
            }
            (set::THREE_DM, command::MESSAGE_FORMAT) => {
                let Some((&[selector, data_set, count], list)) = raw.data.split_first_chunk()
                else {
                    return Err(WireError::Length {
                        expected: 3,
                        got: raw.data.len(),
                    });
                };
                if selector != WRITE {
                    return Ok(None);
                }
                let (entries, rest) = list.as_chunks::<3>();
                if entries.len() != usize::from(count) || !rest.is_empty() {
                    return Err(WireError::Length {
                        expected: 3 * usize::from(count),
                        got: list.len(),
                    });
                }
                let entry = |&[descriptor, high, low]: &[u8; 3]| FormatEntry {
                    descriptor,
                    decimation: u16::from_be_bytes([high, low]),
                };
                Self::MessageFormat {
                    data_set,
                    entries: entries.iter().map(entry).collect(),
                }
            }
            _ => return Ok(None),
        }))
    }
}

/// The unit's answer to every command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// Descriptor of the command.
    pub descriptor: u8,
    /// 0: carried out; anything else says why not.
    pub code: u8,
}

impl Ack {
    /// Reads the field, if it is one.
    pub fn parse(raw: RawField<'_>) -> Result<Option<Self>, WireError> {
        if raw.descriptor != command::ACK {
            return Ok(None);
        }
        let [descriptor, code] = fixed(raw.data)?;
        Ok(Some(Self { descriptor, code }))
    }

    /// Appends the field.
    pub fn emit(self, out: &mut Vec<u8>) -> Result<(), WireError> {
        RawField {
            descriptor: command::ACK,
            data: &[self.descriptor, self.code],
        }
        .emit(out)
    }
}

/// The answer to [`Command::GetBaseRate`], beside its [`Ack`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BaseRate {
    /// Of this data set.
    pub data_set: u8,
    /// Samples per second; 0 where it varies.
    pub rate_hz: u16,
}

impl BaseRate {
    /// Reads the field, if it is one.
    pub fn parse(raw: RawField<'_>) -> Result<Option<Self>, WireError> {
        if raw.descriptor != command::BASE_RATE_REPLY {
            return Ok(None);
        }
        let [data_set, high, low] = fixed(raw.data)?;
        Ok(Some(Self {
            data_set,
            rate_hz: u16::from_be_bytes([high, low]),
        }))
    }

    /// Appends the field.
    pub fn emit(self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let [high, low] = self.rate_hz.to_be_bytes();
        RawField {
            descriptor: command::BASE_RATE_REPLY,
            data: &[self.data_set, high, low],
        }
        .emit(out)
    }
}
