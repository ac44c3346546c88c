//! The compression of PCD files: LZF, runs of bytes and references to what was unpacked before.

/// Unpacks to exactly `length` bytes.
pub(super) fn unpack(packed: &[u8], length: usize) -> Result<Vec<u8>, String> {
    let damaged = || "damaged compressed points".to_owned();
    let mut out: Vec<u8> = Vec::with_capacity(length.min(packed.len().saturating_mul(300)));
    let mut rest = packed;
    while let Some((control, behind)) = rest.split_first() {
        let control = usize::from(*control);
        rest = behind;
        if control < 32 {
            let (literal, behind) = rest.split_at_checked(control + 1).ok_or_else(damaged)?;
            out.extend_from_slice(literal);
            rest = behind;
        } else {
            let mut run = (control >> 5) + 2;
            if control >> 5 == 7 {
                let (more, behind) = rest.split_first().ok_or_else(damaged)?;
                run += usize::from(*more);
                rest = behind;
            }
            let (low, behind) = rest.split_first().ok_or_else(damaged)?;
            rest = behind;
            let back = ((control & 31) << 8 | usize::from(*low)) + 1;
            let from = out.len().checked_sub(back).ok_or_else(damaged)?;
            for k in from..from + run {
                // A reference may reach into what it writes itself.
                let byte = out.get(k).copied().ok_or_else(damaged)?;
                out.push(byte);
            }
        }
        if out.len() > length {
            return Err(damaged());
        }
    }
    match out.len() == length {
        true => Ok(out),
        false => Err(damaged()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_and_references_are_unpacked() {
        // "abc", then eight bytes from three back, then a long run of the last byte.
        let packed = [2, b'a', b'b', b'c', 6 << 5, 2, 7 << 5, 9, 0];
        let expected = b"abcabcabcabbbbbbbbbbbbbbbbbbb".to_vec();
        assert_eq!(unpack(&packed, 29).map(|b| b.len()), Ok(29));
        assert_eq!(unpack(&packed, 29), Ok(expected));
        assert!(unpack(&packed, 28).is_err() && unpack(&packed, 30).is_err());
        for cut in 1..packed.len() {
            assert!(unpack(&packed[..cut], 29).is_err(), "{cut}");
        }
        assert!(
            unpack(&[1 << 5, 9], 3).is_err(),
            "a reference before the beginning"
        );
    }
}
