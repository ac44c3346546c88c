//! The UTC item: date and time with nanoseconds.

use super::fixed::fixed;
use crate::WireError;

/// Date and time as the unit sends it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UtcTime {
    /// Nanoseconds of the second.
    pub nanosecond: u32,
    /// Year.
    pub year: u16,
    /// 1–12.
    pub month: u8,
    /// 1–31.
    pub day: u8,
    /// 0–23.
    pub hour: u8,
    /// 0–59.
    pub minute: u8,
    /// 0–60.
    pub second: u8,
    /// Bit 0: date valid; bit 1: time valid; bit 2: resolved to the second.
    pub flags: u8,
}

impl UtcTime {
    /// All three validity bits.
    pub const VALID: u8 = 7;

    /// Nanoseconds since 1970-01-01, or `None` where a field is out of range or the flags say that it is not known.
    pub fn unix_nanos(&self) -> Option<i64> {
        let in_range = (1970..=2200).contains(&self.year)
            && (1..=12).contains(&self.month)
            && (1..=31).contains(&self.day)
            && self.hour < 24
            && self.minute < 60
            && self.second <= 60
            && self.nanosecond < 1_000_000_000;
        if !in_range || self.flags & Self::VALID != Self::VALID {
            return None;
        }
        let days = days_from_civil(self.year.into(), self.month.into(), self.day.into());
        let seconds = ((days * 24 + i64::from(self.hour)) * 60 + i64::from(self.minute)) * 60
            + i64::from(self.second);
        Some(seconds * 1_000_000_000 + i64::from(self.nanosecond))
    }

    /// The valid date and time of `nanos` since 1970, or `None` before that year and after 2200.
    pub fn from_unix_nanos(nanos: i64) -> Option<Self> {
        let seconds = nanos.div_euclid(1_000_000_000);
        let day_number = seconds.div_euclid(86_400);
        let second_of_day = seconds.rem_euclid(86_400);
        if !(0..84_371).contains(&day_number) {
            return None;
        }
        let mut year = 1970 + day_number / 366;
        while days_from_civil(year + 1, 1, 1) <= day_number {
            year += 1;
        }
        let mut month = 1;
        while month < 12 && days_from_civil(year, month + 1, 1) <= day_number {
            month += 1;
        }
        Some(Self {
            nanosecond: nanos.rem_euclid(1_000_000_000) as u32,
            year: year as u16,
            month: month as u8,
            day: (day_number - days_from_civil(year, month, 1) + 1) as u8,
            hour: (second_of_day / 3600) as u8,
            minute: (second_of_day / 60 % 60) as u8,
            second: (second_of_day % 60) as u8,
            flags: Self::VALID,
        })
    }

    pub(super) fn parse(value: &[u8]) -> Result<Self, WireError> {
        let [
            n0,
            n1,
            n2,
            n3,
            y0,
            y1,
            month,
            day,
            hour,
            minute,
            second,
            flags,
        ] = fixed(value)?;
        Ok(Self {
            nanosecond: u32::from_be_bytes([n0, n1, n2, n3]),
            year: u16::from_be_bytes([y0, y1]),
            month,
            day,
            hour,
            minute,
            second,
            flags,
        })
    }

    pub(super) fn emit(&self, out: &mut Vec<u8>) {
        out.extend(self.nanosecond.to_be_bytes());
        out.extend(self.year.to_be_bytes());
        out.extend([
            self.month,
            self.day,
            self.hour,
            self.minute,
            self.second,
            self.flags,
        ]);
    }
}

/// Days from 1970-01-01 to a date of the Gregorian calendar, counting years from March so that the leap day is last.
fn days_from_civil(year: i64, month: i64, day: i64) -> i64 {
    let march_year = if month > 2 { year } else { year - 1 };
    let month_from_march = (month + 9) % 12;
    let leap_days = march_year / 4 - march_year / 100 + march_year / 400;
    // 306 days from March to the year's end; 719 468 days from 0000-03-01 to 1970-01-01.
    march_year * 365 + leap_days + (month_from_march * 306 + 5) / 10 + day - 1 - 719_468
}
