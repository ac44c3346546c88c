//! The one NMEA sentence the sensor needs: GPRMC, which sets its minutes and seconds.

use std::fmt::Write;

use crate::WireError;

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
        let star = sentence
            .iter()
            .rposition(|b| *b == b'*')
            .ok_or(WireError::Length {
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
        let bad = |field| WireError::Value {
            field,
            offset: 0,
            got: 0,
        };
        let text = std::str::from_utf8(body).map_err(|_| bad("sentence"))?;
        let mut fields = text.split(',');
        let mut next = |field| fields.next().ok_or(bad(field));
        if next("type")? != "GPRMC" {
            return Err(bad("sentence type"));
        }
        let time = next("time")?;
        let valid = next("status")? == "A";
        let latitude_e5_min = angle(next("latitude")?, next("north or south")?, 'S');
        let longitude_e5_min = angle(next("longitude")?, next("east or west")?, 'W');
        let speed_e3_knots = decimal(next("speed")?, 3).and_then(|v| u32::try_from(v).ok());
        let course_e3_deg = decimal(next("course")?, 3).and_then(|v| u32::try_from(v).ok());
        let date = next("date")?;
        let two = |text: &str, at: usize| text.get(at..at + 2).and_then(|t| t.parse::<u8>().ok());
        let in_range = |value: Option<u8>, low: u8, high: u8, field| match value {
            Some(v) if (low..=high).contains(&v) => Ok(v),
            Some(v) => Err(WireError::Value {
                field,
                offset: 0,
                got: v.into(),
            }),
            None => Err(bad(field)),
        };
        let millis = decimal(time.get(4..).unwrap_or_default(), 3).ok_or(bad("time"))?;
        Ok(Self {
            hour: in_range(two(time, 0), 0, 23, "hour")?,
            minute: in_range(two(time, 2), 0, 59, "minute")?,
            second: in_range(two(time, 4), 0, 60, "second")?,
            millis: (millis % 1000) as u16,
            valid,
            latitude_e5_min,
            longitude_e5_min,
            speed_e3_knots,
            course_e3_deg,
            day: in_range(two(date, 0), 1, 31, "day")?,
            month: in_range(two(date, 2), 1, 12, "month")?,
            year: 2000 + u16::from(in_range(two(date, 4), 0, 99, "year")?),
            mode: fields.nth(2).and_then(|text| text.chars().next()),
        })
    }

    /// Writes the sentence without its line end.
    pub fn emit(&self) -> String {
        let mut body = format!("GPRMC,{:02}{:02}{:02}", self.hour, self.minute, self.second);
        // Writing to a `String` cannot fail.
        if self.millis > 0 {
            let _ = write!(body, ".{:03}", self.millis);
        }
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
        let sum = checksum(body.as_bytes());
        format!("${body}*{sum:02X}")
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
mod tests {
    use super::*;

    #[test]
    fn sentences_of_both_ages_are_read() {
        let old =
            Rmc::parse(b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A")
                .unwrap();
        let expected = Rmc {
            hour: 12,
            minute: 35,
            second: 19,
            millis: 0,
            valid: true,
            latitude_e5_min: Some((48 * 60 + 7) * 100_000 + 3_800),
            longitude_e5_min: Some((11 * 60 + 31) * 100_000),
            speed_e3_knots: Some(22_400),
            course_e3_deg: Some(84_400),
            day: 23,
            month: 3,
            year: 2094,
            mode: None,
        };
        assert_eq!(old, expected);
        let new =
            Rmc::parse(b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W,A*07")
                .unwrap();
        assert_eq!(
            new,
            Rmc {
                mode: Some('A'),
                ..expected
            }
        );
        let absent =
            Rmc::parse(b"$GPRMC,235959,V,4807.038,N,01131.000,E,000.0,000.0,311224,,,N*6C")
                .unwrap();
        assert_eq!((absent.valid, absent.speed_e3_knots), (false, Some(0)));
        assert_eq!((absent.year, absent.mode), (2024, Some('N')));
        // 2024-12-31T23:59:59Z
        assert_eq!(absent.unix_secs(), 1_735_689_599);
    }

    #[test]
    fn what_is_written_is_read_back() {
        let rmc = Rmc {
            hour: 10,
            minute: 0,
            second: 7,
            millis: 250,
            valid: true,
            latitude_e5_min: Some(-291_234_567),
            longitude_e5_min: Some(-1_079_999_999),
            speed_e3_knots: Some(1_234),
            course_e3_deg: Some(359_999),
            day: 1,
            month: 3,
            year: 2026,
            mode: Some('D'),
        };
        assert_eq!(Rmc::parse(rmc.emit().as_bytes()), Ok(rmc));
        // 2026-03-01T10:00:07Z
        assert_eq!(rmc.unix_secs(), 1_772_359_207);
        let bare = Rmc {
            day: 29,
            month: 2,
            year: 2000,
            ..Rmc::default()
        };
        assert_eq!(Rmc::parse(bare.emit().as_bytes()), Ok(bare));
        assert_eq!(bare.unix_secs(), 951_782_400);
    }

    #[test]
    fn damaged_sentences_are_errors() {
        let good = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A";
        for at in 1..good.len() - 3 {
            let mut bad = *good;
            bad[at] ^= 0x01;
            assert!(Rmc::parse(&bad).is_err(), "{at}");
            let _ = Rmc::parse(&good[..at]);
        }
        for text in [
            "",
            "*",
            "$*00",
            "$GPGGA*56",
            "$GPRMC*4B",
            "$GPRMC,,,,,,,,,*67",
            "$GPRMC,é*00",
        ] {
            assert!(Rmc::parse(text.as_bytes()).is_err(), "{text}");
        }
    }
}
