//! Units in which others' files give their stamps.

use std::fmt;
use std::str::FromStr;

/// Unit of the stamps in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "kebab-case")
)]
pub enum StampUnit {
    /// Seconds.
    Seconds,
    /// Milliseconds.
    Milliseconds,
    /// Microseconds.
    Microseconds,
    /// Nanoseconds.
    Nanoseconds,
}

impl StampUnit {
    /// Every unit.
    pub const ALL: [Self; 4] = [
        Self::Seconds,
        Self::Milliseconds,
        Self::Microseconds,
        Self::Nanoseconds,
    ];

    /// Its sign: `s`, `ms`, `us` or `ns`.
    pub const fn sign(self) -> &'static str {
        match self {
            Self::Seconds => "s",
            Self::Milliseconds => "ms",
            Self::Microseconds => "us",
            Self::Nanoseconds => "ns",
        }
    }

    /// Power of ten that makes nanoseconds of it.
    pub const fn exponent(self) -> u8 {
        match self {
            Self::Seconds => 9,
            Self::Milliseconds => 6,
            Self::Microseconds => 3,
            Self::Nanoseconds => 0,
        }
    }

    /// Length of the unit, seconds.
    pub const fn secs(self) -> f64 {
        match self {
            Self::Seconds => 1.0,
            Self::Milliseconds => 1e-3,
            Self::Microseconds => 1e-6,
            Self::Nanoseconds => 1e-9,
        }
    }
}

impl fmt::Display for StampUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
        })
    }
}

impl FromStr for StampUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.to_lowercase().as_str() {
            "s" | "sec" | "secs" | "seconds" => Ok(Self::Seconds),
            "ms" | "msec" | "milliseconds" => Ok(Self::Milliseconds),
            "us" | "µs" | "usec" | "microseconds" => Ok(Self::Microseconds),
            "ns" | "nsec" | "nanoseconds" => Ok(Self::Nanoseconds),
            _ => Err("expected s, ms, us or ns".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_read_by_its_sign_and_by_its_name() {
        for unit in StampUnit::ALL {
            assert_eq!(unit.sign().parse(), Ok(unit));
            assert_eq!(unit.to_string().to_uppercase().parse(), Ok(unit));
            let nanos = unit.secs() * 1e9;
            assert!((nanos - 10f64.powi(unit.exponent().into())).abs() < 1e-6 * nanos);
        }
        assert!("h".parse::<StampUnit>().is_err());
    }
}
