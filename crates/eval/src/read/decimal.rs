//! Decimal numbers to whole nanoseconds.

use lsfb_types::Timestamp;

/// Digits that fit 64 bits whatever they are.
const MOST_OF_64_BITS: usize = 19;

/// `text × 10^exponent` as whole nanoseconds, exactly: seconds of this century in `f64` are off by 100 ns.
pub(super) fn decimal_nanos(text: &str, exponent: i64) -> Option<Timestamp> {
    let (negative, unsigned) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (mantissa, power) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, power)) => (mantissa, power.parse::<i32>().ok()?),
        None => (unsigned, 0),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    // Digits beyond the thirtieth cannot matter to a nanosecond that fits 64 bits.
    let mut digits: i128 = 0;
    let mut shift = exponent.checked_add(i64::from(power))?;
    let count = whole.len() + fraction.len();
    if count <= MOST_OF_64_BITS {
        // As nearly all stamps are: a 128-bit product for each digit would take longer than all else in the row.
        let mut few: u64 = 0;
        for byte in whole.bytes().chain(fraction.bytes()) {
            few = 10 * few + byte.is_ascii_digit().then(|| u64::from(byte - b'0'))?;
        }
        digits = i128::from(few);
    } else {
        for (place, byte) in whole.bytes().chain(fraction.bytes()).enumerate() {
            let digit = byte.is_ascii_digit().then(|| i128::from(byte - b'0'))?;
            if place < 30 {
                digits = digits * 10 + digit;
            } else {
                shift = shift.checked_add(1)?;
            }
        }
    }
    shift = shift.checked_sub(i64::try_from(fraction.len()).ok()?)?;
    let ten_to = |n: i64| 10i128.checked_pow(u32::try_from(n).ok()?);
    let magnitude = if digits == 0 || shift == 0 {
        digits
    } else if shift > 0 {
        digits.checked_mul(ten_to(shift)?)?
    } else {
        // Half up; below 10^-38 nothing is left.
        ten_to(-shift).map_or(0, |divisor| (digits + divisor / 2) / divisor)
    };
    let nanos = i64::try_from(if negative { -magnitude } else { magnitude }).ok()?;
    Some(Timestamp::from_nanos(nanos))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_exact() {
        let nanos = |text, exponent| decimal_nanos(text, exponent).map(Timestamp::nanos);
        assert_eq!(
            nanos("1311868164.363181", 9),
            Some(1_311_868_164_363_181_000)
        );
        assert_eq!(
            nanos("1.403715529112143517e+09", 9),
            Some(1_403_715_529_112_143_517)
        );
        assert_eq!(
            nanos("1403715524907143168", 0),
            Some(1_403_715_524_907_143_168)
        );
        assert_eq!(nanos("-0.0000000015", 9), Some(-2));
        assert_eq!(nanos("1e-60", 9), Some(0));
        assert_eq!(nanos("0e99", 9), Some(0));
        assert_eq!(
            nanos("0.00000000000000000000000000000000000000001", 9),
            Some(0)
        );
        for bad in [
            "",
            ".",
            "-",
            "1.2.3",
            "nan",
            "1e",
            "0x10",
            "1e12",
            "99999999999999999999",
            "1e2147483648",
        ] {
            assert_eq!(nanos(bad, 9), None, "{bad}");
        }
    }
}
