//! Numbers as clouds pack them.

/// Kind of a packed number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberKind {
    /// Eight bits with a sign.
    I8,
    /// Eight bits.
    U8,
    /// Sixteen bits with a sign.
    I16,
    /// Sixteen bits.
    U16,
    /// Thirty-two bits with a sign.
    I32,
    /// Thirty-two bits.
    U32,
    /// Sixty-four bits with a sign.
    I64,
    /// Sixty-four bits.
    U64,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

/// Which byte of a number comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The least significant.
    Little,
    /// The most significant.
    Big,
}

impl NumberKind {
    /// Bytes that it takes.
    pub const fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Whether it counts in whole units.
    pub const fn is_whole(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The number at the beginning of `bytes`; NaN where they are too few. Above 2⁵³ to the nearest double.
    pub(super) fn read(self, bytes: &[u8], order: ByteOrder) -> f64 {
        let mut wide = [0_u8; 8];
        let Some(bytes) = bytes.get(..self.bytes()) else {
            return f64::NAN;
        };
        let low = wide.iter_mut();
        match order {
            ByteOrder::Little => low.zip(bytes).for_each(|(to, from)| *to = *from),
            ByteOrder::Big => low
                .zip(bytes.iter().rev())
                .for_each(|(to, from)| *to = *from),
        }
        let [a, b, c, d, ..] = wide;
        match self {
            Self::I8 => f64::from(i8::from_le_bytes([a])),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I64 => i64::from_le_bytes(wide) as f64,
            Self::U64 => u64::from_le_bytes(wide) as f64,
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(wide),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_read_in_both_orders() {
        for (kind, bytes, expected) in [
            (NumberKind::I8, &[0xfe_u8][..], -2.0),
            (NumberKind::U8, &[0xfe], 254.0),
            (NumberKind::I16, &[0xfe, 0xff], -2.0),
            (NumberKind::U16, &[0xfe, 0xff], 65_534.0),
            (NumberKind::I32, &[0xfe, 0xff, 0xff, 0xff], -2.0),
            (NumberKind::U32, &[1, 0, 0, 1], 16_777_217.0),
            (NumberKind::I64, &[0xff; 8], -1.0),
            (NumberKind::U64, &[0, 1, 0, 0, 0, 0, 0, 0], 256.0),
            (NumberKind::F32, &1.5_f32.to_le_bytes(), 1.5),
            (NumberKind::F64, &(-0.1_f64).to_le_bytes(), -0.1),
        ] {
            let swapped: Vec<u8> = bytes.iter().rev().copied().collect();
            assert_eq!(kind.read(bytes, ByteOrder::Little), expected, "{kind:?}");
            assert_eq!(kind.read(&swapped, ByteOrder::Big), expected, "{kind:?}");
            assert!(kind.read(&bytes[1..], ByteOrder::Little).is_nan());
        }
    }
}
