//! Numbers as people read them.

/// About four significant digits, no exponent between 0.0001 and a million.
pub fn significant(value: f64) -> String {
    digits(value, 4)
}

/// As [`significant`] with three digits, for running text.
pub fn rounded(value: f64) -> String {
    digits(value, 3)
}

fn digits(value: f64, count: i32) -> String {
    let magnitude = value.abs();
    if value == 0.0 {
        return "0".to_owned();
    }
    if !value.is_finite() {
        return "–".to_owned();
    }
    if value.fract() == 0.0 && magnitude < 1e15 {
        return grouped(value);
    }
    if !(1e-4..1e6).contains(&magnitude) {
        return format!("{value:.2e}");
    }
    let decimals = (count - 1 - magnitude.log10().floor() as i32).clamp(0, 7) as usize;
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    };
    text.replace('-', "−")
}

/// A value and its unit, never torn apart at the end of a line.
pub fn with_unit(number: &str, unit: &str) -> String {
    let gap = if unit.is_empty() || unit == "°" {
        ""
    } else {
        "\u{a0}"
    };
    format!("{number}{gap}{unit}")
}

/// Whole numbers with a thin space between thousands.
fn grouped(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) && digits.len() > 4 {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    if value < 0.0 {
        format!("−{text}")
    } else {
        text
    }
}

/// `value` with the digits its axis needs.
pub(crate) fn tick_label(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() {
        return text.trim_start_matches('-').to_owned();
    }
    text.replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_digits_where_they_matter() {
        for (value, text) in [
            (0.0, "0"),
            (0.012_345_67, "0.01235"),
            (1.5, "1.5"),
            (-2.25, "−2.25"),
            (123.456, "123.5"),
            (48_213.0, "48\u{202f}213"),
            (1234.0, "1234"),
            (1e-7, "1.00e-7"),
            (f64::NAN, "–"),
        ] {
            assert_eq!(significant(value), text);
        }
    }

    #[test]
    fn labels_have_the_digits_of_their_axis() {
        assert_eq!(tick_label(-0.5, 1), "−0.5");
        assert_eq!(tick_label(-0.0, 1), "0.0");
    }
}
