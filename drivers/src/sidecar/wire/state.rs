//! Why the rig ends a connection.

use super::protobuf::{Fields, Value, put_bytes, put_varint};
use super::text;
use crate::WireError;

/// Why a connection is refused or ended. The numbers are the protocol's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Refusal {
    /// The device was never paired, or its key is not the one that it was paired with.
    NotPaired,
    /// The invitation does not exist: mistyped, used already, or too old.
    WrongToken,
    /// Another device of this name is paired already.
    NameTaken,
    /// Too many attempts failed lately from this address.
    TooManyAttempts,
    /// As many devices as there may be are connected.
    Full,
    /// Something could not be read, or had no place there.
    BadMessage,
    /// A topic that is not this device's, or is described in two ways.
    BadTopic,
    /// DATA was sent beyond the credit.
    BeyondCredit,
    /// DATA is missing between two that came.
    Gap,
    /// Nothing was heard for too long.
    Silent,
    /// The same device has connected again.
    Replaced,
    /// Something that was received could not be stored; it must be sent again.
    NotStored,
    /// The recording has ended.
    Ended,
}

impl Refusal {
    /// In order of their numbers, from 1.
    pub const ALL: [Self; 13] = [
        Self::NotPaired,
        Self::WrongToken,
        Self::NameTaken,
        Self::TooManyAttempts,
        Self::Full,
        Self::BadMessage,
        Self::BadTopic,
        Self::BeyondCredit,
        Self::Gap,
        Self::Silent,
        Self::Replaced,
        Self::NotStored,
        Self::Ended,
    ];

    /// Its number on the wire.
    pub fn code(self) -> u64 {
        let at = Self::ALL.iter().position(|refusal| *refusal == self);
        at.map_or(0, |at| at as u64 + 1)
    }

    /// A few words for counts and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotPaired => "not paired",
            Self::WrongToken => "wrong, used or expired invitation",
            Self::NameTaken => "name of another device",
            Self::TooManyAttempts => "too many attempts",
            Self::Full => "too many devices",
            Self::BadMessage => "bad message",
            Self::BadTopic => "bad topic",
            Self::BeyondCredit => "beyond the credit",
            Self::Gap => "gap in the numbers",
            Self::Silent => "silent for too long",
            Self::Replaced => "connected again",
            Self::NotStored => "not stored",
            Self::Ended => "recording ended",
        }
    }

    /// Whether to connect again in the same way may help.
    pub fn may_pass(self) -> bool {
        !matches!(
            self,
            Self::NotPaired | Self::WrongToken | Self::NameTaken | Self::BadTopic
        )
    }
}

/// The last that the rig says on a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct State {
    /// Why; `None`: a number that this version does not know.
    pub refusal: Option<Refusal>,
    /// The same for people.
    pub text: String,
}

impl State {
    /// Reads the payload.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut code = 0;
        let mut words = String::new();
        for field in Fields::new(payload) {
            match field? {
                (1, Value::Varint(value)) => code = value,
                (2, Value::Bytes(value)) => words = text(value)?,
                _ => {}
            }
        }
        Ok(Self {
            refusal: Refusal::ALL.into_iter().find(|r| r.code() == code),
            text: words,
        })
    }

    /// The payload's bytes.
    pub fn emit(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_varint(1, self.refusal.map_or(0, Refusal::code), &mut out);
        put_bytes(2, self.text.as_bytes(), &mut out);
        out
    }
}
