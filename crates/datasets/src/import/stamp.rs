//! Stamps as text: decimal numbers in some unit, exact to the nanosecond.

use lsfb_types::StampUnit;

/// Stamps from the year 2000 to 2100 in seconds since 1970: in each unit they have sizes that they have in no other.
const THIS_CENTURY_S: std::ops::Range<f64> = 946_684_800.0..4_102_444_800.0;

/// The unit in which a stamp is one of this century; `None` where it is in none.
pub(super) fn unit_of_unix_stamp(text: &str) -> Option<StampUnit> {
    let value: f64 = text.trim().parse().ok()?;
    let is_now = |unit: &StampUnit| {
        THIS_CENTURY_S.contains(&(value / 10f64.powi(9 - i32::from(unit.exponent()))))
    };
    StampUnit::ALL.into_iter().find(is_now)
}

/// Nanoseconds of a stamp; what is wrong with it, in words.
pub(super) fn parse(text: &str, unit: StampUnit) -> Result<i64, String> {
    let text = text.trim();
    nanos(text, unit.exponent().into())
        .ok_or_else(|| format!("`{text}` is not a stamp in {}", unit.sign()))
}

/// `decimals` of the unit make a nanosecond.
fn nanos(text: &str, decimals: usize) -> Option<i64> {
    if text.contains(['e', 'E']) {
        let nanos: f64 = text.parse::<f64>().ok()? * 10f64.powi(decimals as i32);
        return (nanos.abs() < 9e18).then_some(nanos.round() as i64);
    }
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let all_digits = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if whole.is_empty() || !all_digits(whole) || !all_digits(fraction) {
        return None;
    }
    // Whoever counts nanoseconds has no parts of them: these are seconds.
    if decimals == 0 && !fraction.is_empty() {
        return None;
    }
    let mut nanos: i64 = whole.parse().ok()?;
    for place in 0..decimals {
        let digit = fraction.as_bytes().get(place).map_or(0, |b| b - b'0');
        nanos = nanos.checked_mul(10)?.checked_add(i64::from(digit))?;
    }
    let rounds_up = fraction
        .as_bytes()
        .get(decimals)
        .is_some_and(|b| *b >= b'5');
    nanos.checked_add(i64::from(rounds_up))?.checked_mul(sign)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_exact_in_every_unit() {
        use StampUnit::*;
        for (unit, text, nanos) in [
            (
                Seconds,
                "1627530745.040137",
                Some(1_627_530_745_040_137_000),
            ),
            (Seconds, "-0.5", Some(-500_000_000)),
            (Seconds, "12", Some(12_000_000_000)),
            (Seconds, "1.5e3", Some(1_500_000_000_000)),
            (Seconds, "1520527958463478167", None),
            (
                Milliseconds,
                "1574560118905",
                Some(1_574_560_118_905_000_000),
            ),
            (
                Microseconds,
                "1555399760151000",
                Some(1_555_399_760_151_000_000),
            ),
            (
                Nanoseconds,
                "1520527958463478167",
                Some(1_520_527_958_463_478_167),
            ),
            (Nanoseconds, "1520527958.5", None),
            (Microseconds, "7.5", Some(7_500)),
            (Nanoseconds, "99999999999999999999", None),
            (Seconds, "", None),
            (Seconds, "nan", None),
            (Seconds, "1.2.3", None),
            (Seconds, ".5", None),
        ] {
            assert_eq!(parse(text, unit).ok(), nanos, "{text} {}", unit.sign());
        }
    }

    #[test]
    fn the_unit_of_a_stamp_of_this_century_is_known_by_its_size() {
        let unit = unit_of_unix_stamp;
        assert_eq!(unit("1555398770.5"), Some(StampUnit::Seconds));
        assert_eq!(unit("1555398770307"), Some(StampUnit::Milliseconds));
        assert_eq!(unit("1555399760151000"), Some(StampUnit::Microseconds));
        assert_eq!(unit("1520527958463478167"), Some(StampUnit::Nanoseconds));
        for unknown in ["1", "86400", "x", "nan"] {
            assert_eq!(unit(unknown), None, "{unknown}");
        }
    }
}
