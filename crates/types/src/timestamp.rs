use std::fmt;
use std::ops::{Add, Sub};

/// Nanoseconds on the recording's one clock: UTC since 1970 where a device is disciplined by PPS/NMEA or the host by
/// NTP, host monotonic mapped to UTC once otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(i64);

impl Timestamp {
    /// From nanoseconds.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// From seconds; rounds to the nearest nanosecond. For configuration and files whose unit is seconds.
    pub fn from_secs_f64(secs: f64) -> Self {
        // Whole seconds apart from the fraction: 1.7e9 s in f64 nanoseconds would lose a quarter of a microsecond.
        let whole = secs.floor();
        Self(whole as i64 * 1_000_000_000 + ((secs - whole) * 1e9).round() as i64)
    }

    /// Nanoseconds.
    pub const fn nanos(self) -> i64 {
        self.0
    }

    /// Seconds from `earlier` to `self`, negative where `earlier` is later. Subtracts first, converts then.
    pub fn secs_since(self, earlier: Self) -> f64 {
        (self - earlier) as f64 / 1e9
    }

    /// `self` moved by `nanos`.
    pub const fn plus_nanos(self, nanos: i64) -> Self {
        Self(self.0.saturating_add(nanos))
    }

    /// `self` moved by `secs`, rounded to the nearest nanosecond.
    pub fn plus_secs(self, secs: f64) -> Self {
        self.plus_nanos((secs * 1e9).round() as i64)
    }
}

impl Sub for Timestamp {
    type Output = i64;
    /// Nanoseconds between two stamps.
    fn sub(self, earlier: Self) -> i64 {
        self.0.saturating_sub(earlier.0)
    }
}

impl Add<i64> for Timestamp {
    type Output = Self;
    fn add(self, nanos: i64) -> Self {
        self.plus_nanos(nanos)
    }
}

impl fmt::Display for Timestamp {
    /// Seconds with nine decimals, exactly: the first column of a TUM file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let magnitude = self.0.unsigned_abs();
        write!(
            f,
            "{sign}{}.{:09}",
            magnitude / 1_000_000_000,
            magnitude % 1_000_000_000
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_of_this_century_keep_their_nanoseconds() {
        let a = Timestamp::from_nanos(1_771_234_567_123_456_789);
        assert_eq!(a.plus_nanos(7).secs_since(a), 7e-9);
        assert_eq!(a.to_string(), "1771234567.123456789");
        assert_eq!(
            Timestamp::from_nanos(-1_500_000_000).to_string(),
            "-1.500000000"
        );
        assert_eq!(Timestamp::from_secs_f64(12.25).nanos(), 12_250_000_000);
        assert_eq!(Timestamp::from_secs_f64(-0.25).nanos(), -250_000_000);
    }
}
