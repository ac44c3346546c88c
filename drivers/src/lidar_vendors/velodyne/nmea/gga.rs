use std::fmt::Write;

use crate::WireError;

use super::{TimeOfDay, angle, bad, body, check_type, decimal, enclose, push_angle};

const DAY_SECS: i64 = 86_400;

/// Fix data (GPGGA), as a plain struct with both directions. It names no date.
///
/// Numbers are integers so that a sentence survives `parse` and `emit`; angles are in 1e-5 minutes (under 2 cm).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gga {
    /// UTC hour, minute, second.
    pub hour: u8,
    /// UTC minute.
    pub minute: u8,
    /// UTC second.
    pub second: u8,
    /// Milliseconds of the second.
    pub millis: u16,
    /// Latitude, 1e-5 arc minutes, north positive.
    pub latitude_e5_min: Option<i64>,
    /// Longitude, 1e-5 arc minutes, east positive.
    pub longitude_e5_min: Option<i64>,
    /// 0 without a fix, 1 GPS, 2 differential, 4 and 5 RTK; the meaning of more is the receiver's.
    pub quality: u8,
    /// Satellites in use.
    pub satellites: Option<u8>,
    /// Horizontal dilution of precision, 0.01.
    pub hdop_e2: Option<u32>,
    /// Height above mean sea level, mm.
    pub altitude_mm: Option<i64>,
    /// Height of the geoid above the ellipsoid, mm.
    pub geoid_mm: Option<i64>,
}

impl Gga {
    /// Reads a sentence without its line end. What differential corrections say is passed over; the checksum must be right.
    pub fn parse(sentence: &[u8]) -> Result<Self, WireError> {
        let mut fields = body(sentence)?.split(',');
        let mut next = |field| fields.next().ok_or(bad(field));
        check_type(next("type")?, "GGA")?;
        let time = TimeOfDay::parse(next("time")?)?;
        let latitude_e5_min = angle(next("latitude")?, next("north or south")?, 'S');
        let longitude_e5_min = angle(next("longitude")?, next("east or west")?, 'W');
        let quality = next("quality")?.parse().map_err(|_| bad("quality"))?;
        let satellites = next("satellites")?.parse().ok();
        let hdop_e2 = decimal(next("dilution")?, 2).and_then(|v| u32::try_from(v).ok());
        let altitude_mm = metres(next("altitude")?, next("altitude unit")?)?;
        let geoid_mm = metres(next("geoid")?, next("geoid unit")?)?;
        Ok(Self {
            hour: time.hour,
            minute: time.minute,
            second: time.second,
            millis: time.millis,
            latitude_e5_min,
            longitude_e5_min,
            quality,
            satellites,
            hdop_e2,
            altitude_mm,
            geoid_mm,
        })
    }

    /// Writes the sentence without its line end.
    pub fn emit(&self) -> String {
        let mut body = "GPGGA,".to_owned();
        TimeOfDay {
            hour: self.hour,
            minute: self.minute,
            second: self.second,
            millis: self.millis,
        }
        .emit(&mut body);
        body.push(',');
        push_angle(&mut body, self.latitude_e5_min, 2, ['N', 'S']);
        push_angle(&mut body, self.longitude_e5_min, 3, ['E', 'W']);
        // Writing to a `String` cannot fail.
        let _ = write!(body, "{},", self.quality);
        if let Some(count) = self.satellites {
            let _ = write!(body, "{count:02}");
        }
        body.push(',');
        if let Some(hdop) = self.hdop_e2 {
            let _ = write!(body, "{}.{:02}", hdop / 100, hdop % 100);
        }
        for height_mm in [self.altitude_mm, self.geoid_mm] {
            body.push(',');
            if let Some(mm) = height_mm {
                let sign = if mm < 0 { "-" } else { "" };
                let mm = mm.unsigned_abs();
                let _ = write!(body, "{sign}{}.{:03}", mm / 1000, mm % 1000);
            }
            body.push_str(",M");
        }
        body.push_str(",,");
        enclose(&body)
    }

    /// Seconds since 1970 of the whole second named here, on the day that brings it nearest to `about_secs`.
    pub fn unix_secs(&self, about_secs: i64) -> i64 {
        let of_day =
            i64::from(self.hour) * 3_600 + i64::from(self.minute) * 60 + i64::from(self.second);
        let ahead = (of_day - about_secs.rem_euclid(DAY_SECS)).rem_euclid(DAY_SECS);
        let step = if ahead > DAY_SECS / 2 {
            ahead - DAY_SECS
        } else {
            ahead
        };
        about_secs.saturating_add(step)
    }
}

/// A signed height in millimetres; `None` where the field is empty.
fn metres(text: &str, unit: &str) -> Result<Option<i64>, WireError> {
    if text.is_empty() {
        return Ok(None);
    }
    let (sign, magnitude) = match text.strip_prefix('-') {
        Some(magnitude) => (-1, magnitude),
        None => (1, text),
    };
    let mm = decimal(magnitude, 3).ok_or(bad("height"))?;
    if unit != "M" {
        return Err(bad("height unit"));
    }
    Ok(Some(sign * mm))
}
