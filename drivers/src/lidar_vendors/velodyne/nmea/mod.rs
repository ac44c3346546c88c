//! The two NMEA sentences that a sensor takes from a receiver: GPRMC, with the date, and GPGGA, without.

mod gga;

use std::fmt::Write;
use std::ops::RangeInclusive;

use crate::WireError;

pub use gga::Gga;

/// A sentence as a position packet carries it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sentence {
    /// Time, date and position.
    Rmc(Rmc),
    /// Time and position.
    Gga(Gga),
}

impl Sentence {
    /// Reads a sentence without its line end. Another one than these two is an error.
    pub fn parse(sentence: &[u8]) -> Result<Self, WireError> {
        match sentence.get(3..6) {
            Some(b"GGA") => Gga::parse(sentence).map(Self::Gga),
            _ => Rmc::parse(sentence).map(Self::Rmc),
        }
    }

    /// Seconds since 1970 of the whole second that a receiver with a fix names; `None` without a fix. A sentence without
    /// date names the second nearest to `about_secs`.
    pub fn unix_secs(&self, about_secs: i64) -> Option<i64> {
        match self {
            Self::Rmc(rmc) => rmc.valid.then(|| rmc.unix_secs()),
            Self::Gga(gga) => (gga.quality > 0).then(|| gga.unix_secs(about_secs)),
        }
    }
}

/// Recommended minimum data (GPRMC), as a plain struct with both directions.
///
/// Numbers are integers so that a sentence survives `parse` and `emit`; angles are in 1e-5 minutes (under 2 cm).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rmc {
    /// UTC hour, minute, second.
    pub hour: u8,
    /// UTC minute.
    pub minute: u8,
    /// UTC second.
    pub second: u8,
    /// Milliseconds of the second.
    pub millis: u16,
    /// Whether the receiver has a fix (status `A`).
    pub valid: bool,
    /// Latitude, 1e-5 arc minutes, north positive.
    pub latitude_e5_min: Option<i64>,
    /// Longitude, 1e-5 arc minutes, east positive.
    pub longitude_e5_min: Option<i64>,
    /// Speed over ground, 0.001 knots.
    pub speed_e3_knots: Option<u32>,
    /// Course over ground, 0.001 degrees.
    pub course_e3_deg: Option<u32>,
    /// UTC day of the month.
    pub day: u8,
    /// UTC month, 1–12.
    pub month: u8,
    /// UTC year; the sentence has two digits, read as 2000–2099.
    pub year: u16,
    /// Mode letter of NMEA 2.3 and later (`A` autonomous, `D` differential, `E` estimated, `N` not valid).
    pub mode: Option<char>,
}

impl Rmc {
    /// Reads a sentence without its line end. Magnetic variation is passed over; the checksum must be right.
    pub fn parse(sentence: &[u8]) -> Result<Self, WireError> {
        let text = body(sentence)?;
        let mut fields = text.split(',');
        let mut next = |field| fields.next().ok_or(bad(field));
        check_type(next("type")?, "RMC")?;
        let time = TimeOfDay::parse(next("time")?)?;
        let valid = next("status")? == "A";
        let latitude_e5_min = angle(next("latitude")?, next("north or south")?, 'S');
        let longitude_e5_min = angle(next("longitude")?, next("east or west")?, 'W');
        let speed_e3_knots = decimal(next("speed")?, 3).and_then(|v| u32::try_from(v).ok());
        let course_e3_deg = decimal(next("course")?, 3).and_then(|v| u32::try_from(v).ok());
        let date = next("date")?;
        Ok(Self {
            hour: time.hour,
            minute: time.minute,
            second: time.second,
            millis: time.millis,
            valid,
            latitude_e5_min,
            longitude_e5_min,
            speed_e3_knots,
            course_e3_deg,
            day: two_digits(date, 0, 1..=31, "day")?,
            month: two_digits(date, 2, 1..=12, "month")?,
            year: 2000 + u16::from(two_digits(date, 4, 0..=99, "year")?),
            mode: fields.nth(2).and_then(|text| text.chars().next()),
        })
    }

    /// Writes the sentence without its line end.
    pub fn emit(&self) -> String {
        let mut body = "GPRMC,".to_owned();
        TimeOfDay {
            hour: self.hour,
            minute: self.minute,
            second: self.second,
            millis: self.millis,
        }
        .emit(&mut body);
        // Writing to a `String` cannot fail.
        let _ = write!(body, ",{},", if self.valid { 'A' } else { 'V' });
        push_angle(&mut body, self.latitude_e5_min, 2, ['N', 'S']);
        push_angle(&mut body, self.longitude_e5_min, 3, ['E', 'W']);
        for value in [self.speed_e3_knots, self.course_e3_deg] {
            if let Some(v) = value {
                let _ = write!(body, "{:03}.{:03}", v / 1000, v % 1000);
            }
            body.push(',');
        }
        let _ = write!(
            body,
            "{:02}{:02}{:02},,",
            self.day,
            self.month,
            self.year % 100
        );
        if let Some(mode) = self.mode {
            let _ = write!(body, ",{mode}");
        }
        enclose(&body)
    }

    /// Seconds since 1970 of the whole second named here.
    pub fn unix_secs(&self) -> i64 {
        // Days of the civil calendar, counted in years that begin in March, so that the leap day comes last.
        let (y, m, d) = (
            i64::from(self.year),
            i64::from(self.month),
            i64::from(self.day),
        );
        let year = if m <= 2 { y - 1 } else { y };
        let month = (m + 9) % 12;
        let day_of_year = (153 * month + 2) / 5 + d - 1;
        let days = 365 * year + year.div_euclid(4) - year.div_euclid(100)
            + year.div_euclid(400)
            + day_of_year
            - 719_468;
        days * 86_400
            + i64::from(self.hour) * 3_600
            + i64::from(self.minute) * 60
            + i64::from(self.second)
    }
}

fn bad(field: &'static str) -> WireError {
    WireError::Value {
        field,
        offset: 0,
        got: 0,
    }
}

/// What stands between the `$` and the `*` of a sentence whose checksum is right.
fn body(sentence: &[u8]) -> Result<&str, WireError> {
    let star = sentence.iter().rposition(|b| *b == b'*');
    let star = star.ok_or(WireError::Length {
        expected: sentence.len() + 3,
        got: sentence.len(),
    })?;
    let body = sentence.get(1..star).unwrap_or_default();
    let expected = checksum(body);
    let got = sentence
        .get(star + 1..star + 3)
        .and_then(|hex| std::str::from_utf8(hex).ok())
        .and_then(|hex| u8::from_str_radix(hex, 16).ok())
        .ok_or(WireError::Length {
            expected: star + 3,
            got: sentence.len(),
        })?;
    if got != expected {
        return Err(WireError::Checksum {
            expected: expected.into(),
            got: got.into(),
        });
    }
    std::str::from_utf8(body).map_err(|_| bad("sentence"))
}

/// Sentence and checksum around a body.
fn enclose(body: &str) -> String {
    format!("${body}*{:02X}", checksum(body.as_bytes()))
}

/// Receivers of GPS alone call themselves `GP`, those of several systems `GN`.
fn check_type(text: &str, wanted: &str) -> Result<(), WireError> {
    match text.strip_prefix("GP").or(text.strip_prefix("GN")) {
        Some(kind) if kind == wanted => Ok(()),
        _ => Err(bad("sentence type")),
    }
}

/// `hhmmss.sss` of UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct TimeOfDay {
    hour: u8,
    minute: u8,
    second: u8,
    millis: u16,
}

impl TimeOfDay {
    fn parse(text: &str) -> Result<Self, WireError> {
        let millis = decimal(text.get(4..).unwrap_or_default(), 3).ok_or(bad("time"))?;
        Ok(Self {
            hour: two_digits(text, 0, 0..=23, "hour")?,
            minute: two_digits(text, 2, 0..=59, "minute")?,
            second: two_digits(text, 4, 0..=60, "second")?,
            millis: (millis % 1000) as u16,
        })
    }

    fn emit(self, body: &mut String) {
        // Writing to a `String` cannot fail.
        let _ = write!(body, "{:02}{:02}{:02}", self.hour, self.minute, self.second);
        if self.millis > 0 {
            let _ = write!(body, ".{:03}", self.millis);
        }
    }
}

fn two_digits(
    text: &str,
    at: usize,
    range: RangeInclusive<u8>,
    field: &'static str,
) -> Result<u8, WireError> {
    let value = text.get(at..at + 2).and_then(|t| t.parse::<u8>().ok());
    match value {
        Some(v) if range.contains(&v) => Ok(v),
        Some(v) => Err(WireError::Value {
            field,
            offset: 0,
            got: v.into(),
        }),
        None => Err(bad(field)),
    }
}

fn checksum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, b| sum ^ b)
}

/// A decimal number times `10^digits`; further digits are cut off.
fn decimal(text: &str, digits: u32) -> Option<i64> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    if whole.len() > 9 || !whole.bytes().all(|b| b.is_ascii_digit()) || whole.is_empty() {
        return None;
    }
    let mut value: i64 = whole.parse().ok()?;
    let mut fraction = fraction.bytes();
    for _ in 0..digits {
        let digit = match fraction.next() {
            None => 0,
            Some(b) if b.is_ascii_digit() => i64::from(b - b'0'),
            Some(_) => return None,
        };
        value = value * 10 + digit;
    }
    Some(value)
}

/// `dddmm.mmmm` and a hemisphere in 1e-5 minutes.
fn angle(text: &str, hemisphere: &str, negative: char) -> Option<i64> {
    let value = decimal(text, 5)?;
    let degrees = value / 10_000_000;
    let minutes = degrees * 60 * 100_000 + value % 10_000_000;
    Some(if hemisphere.starts_with(negative) {
        -minutes
    } else {
        minutes
    })
}

fn push_angle(body: &mut String, value: Option<i64>, degree_digits: usize, hemispheres: [char; 2]) {
    let Some(v) = value else {
        body.push_str(",,");
        return;
    };
    let magnitude = v.unsigned_abs();
    let (degrees, minutes_e5) = (magnitude / 6_000_000, magnitude % 6_000_000);
    let _ = write!(
        body,
        "{degrees:0degree_digits$}{:02}.{:05},{},",
        minutes_e5 / 100_000,
        minutes_e5 % 100_000,
        hemispheres[usize::from(v < 0)],
    );
}

#[cfg(test)]
mod tests;
