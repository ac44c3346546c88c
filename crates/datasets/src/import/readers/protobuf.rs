//! The part of protobuf's wire format that a recorder writes: fields by number, of messages in messages.

/// Value of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Value<'a> {
    Varint(u64),
    Fixed32([u8; 4]),
    Fixed64([u8; 8]),
    Bytes(&'a [u8]),
}

/// The bytes break off within a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Cut;

/// The first field of some bytes, and what is behind it.
pub(super) fn field(bytes: &[u8]) -> Result<(u64, Value<'_>, &[u8]), Cut> {
    let (key, rest) = varint(bytes)?;
    let (value, rest) = match key & 7 {
        0 => {
            let (value, rest) = varint(rest)?;
            (Value::Varint(value), rest)
        }
        1 => {
            let (value, rest) = rest.split_first_chunk().ok_or(Cut)?;
            (Value::Fixed64(*value), rest)
        }
        2 => {
            let (length, rest) = varint(rest)?;
            let length = usize::try_from(length).map_err(|_| Cut)?;
            let (value, rest) = rest.split_at_checked(length).ok_or(Cut)?;
            (Value::Bytes(value), rest)
        }
        5 => {
            let (value, rest) = rest.split_first_chunk().ok_or(Cut)?;
            (Value::Fixed32(*value), rest)
        }
        _ => return Err(Cut),
    };
    Ok((key >> 3, value, rest))
}

fn varint(bytes: &[u8]) -> Result<(u64, &[u8]), Cut> {
    let mut value = 0_u64;
    for (n, byte) in bytes.iter().take(10).enumerate() {
        value |= u64::from(byte & 0x7f) << (7 * n);
        if byte & 0x80 == 0 {
            return Ok((value, &bytes[n + 1..]));
        }
    }
    Err(Cut)
}

impl Value<'_> {
    /// A signed number of 64 bits.
    pub(super) fn int(&self) -> Option<i64> {
        match self {
            Self::Varint(value) => Some(value.cast_signed()),
            _ => None,
        }
    }

    /// Adds what it says of a repeated `float`: one number, or many that are packed.
    pub(super) fn append_floats(&self, floats: &mut Vec<f64>) {
        match self {
            Self::Fixed32(bytes) => floats.push(f64::from(f32::from_le_bytes(*bytes))),
            Self::Bytes(bytes) => {
                let (numbers, _) = bytes.as_chunks::<4>();
                floats.extend(numbers.iter().map(|b| f64::from(f32::from_le_bytes(*b))));
            }
            Self::Varint(_) | Self::Fixed64(_) => {}
        }
    }
}
