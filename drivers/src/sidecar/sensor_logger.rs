//! What the app Sensor Logger pushes by HTTP: one JSON object for each batch of readings, every 200 ms or as it is set. No I/O.
//!
//! Its body, units and axes are those of the app's published reference (github.com/tszheichoi/awesome-sensor-logger: README.md,
//! PUSHING.md, UNITS.md, CROSSPLATFORM.md).
//!
//! ```text
//! {"messageId": 0, "sessionId": "…", "deviceId": "…",
//!  "payload": [{"name": "gyroscope", "time": 1698501144401773000, "values": {"x": 0.1, "y": 0.2, "z": 0.3}}, …]}
//! ```
//!
//! `messageId` counts the batches of a session from 0; they may overtake each other on the way. `time` is nanoseconds since 1970 by
//! the phone's clock. What is read becomes SI units in Android's axes: forces are +g upwards at rest.

use std::collections::BTreeMap;

use serde_json::Value;

/// Standard gravity, as the app takes it (UNITS.md), m/s².
const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
/// Readings of one body at most.
const MAX_READINGS: usize = 65_536;
/// Names of sensors that are counted apart at most.
const MAX_UNKNOWN: usize = 64;
/// Fewer forces say nothing about their unit: the phone may be falling.
const LEAST_FORCES: usize = 5;
/// Times of the years 2000 to 2038, which in another unit than nanoseconds lie elsewhere.
const POSSIBLE_NS: std::ops::Range<i64> = 946_684_800_000_000_000..2_147_483_647_000_000_000;
/// What a receiver may receive, dBm; iOS writes 127 where it does not know.
const POSSIBLE_DBM: std::ops::RangeInclusive<f64> = -200.0..=20.0;
/// Between forces at rest in g and in m/s²: hands neither hold a phone at less than a third of gravity nor at three times it.
const BETWEEN_UNITS: f64 = 3.2;

/// How the app is set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PushUnits {
    /// Android, or an iPhone with "Standardise Units & Frames" on: m/s², +g upwards at rest.
    #[default]
    Standard,
    /// An iPhone with that off: raw forces in g, and all accelerations with the sign turned around.
    Ios,
}

impl PushUnits {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Standard, Self::Ios];

    /// Its name on the command line and where the app's pairing is kept.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Standard => "standard",
            Self::Ios => "ios",
        }
    }
}

/// Which of the app's sensors a reading is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PushedKind {
    /// Specific force, raw, m/s².
    ForceUncalibrated,
    /// Specific force, m/s²; of Android only.
    Force,
    /// Acceleration without gravity, m/s²: of the system's own filter.
    LinearAcceleration,
    /// What that filter took away, m/s².
    Gravity,
    /// Angular velocity, raw, rad/s.
    RateUncalibrated,
    /// Angular velocity, rad/s.
    Rate,
    /// Magnetic field, raw, tesla.
    MagneticUncalibrated,
    /// Magnetic field, corrected by the system, tesla.
    Magnetic,
    /// Pressure of the air.
    Pressure,
    /// Position by satellites and whatever else the system knows.
    Location,
    /// A network heard; of Android only.
    Wifi,
    /// A Bluetooth advertisement.
    Bluetooth,
}

/// What was read.
#[derive(Clone, Debug, PartialEq)]
pub enum PushedValue {
    /// Three axes.
    Vector([f64; 3]),
    /// Pascal.
    PressurePa(f64),
    /// Degrees, metres above the ellipsoid, and the standard deviations where the system tells them, metres.
    Position {
        /// Latitude, degrees north.
        latitude_deg: f64,
        /// Longitude, degrees east.
        longitude_deg: f64,
        /// Height above the ellipsoid, metres; NaN where it is not known.
        altitude_m: f64,
        /// Across and upwards.
        sigma_m: Option<[f64; 2]>,
    },
    /// A network.
    Network {
        /// Address of the access point.
        bssid: String,
        /// Its name.
        ssid: String,
        /// MHz.
        frequency_mhz: u32,
        /// dBm.
        rssi_dbm: i16,
    },
    /// An advertisement.
    Advert {
        /// Address; of iOS a name that the system made up.
        address: String,
        /// dBm.
        rssi_dbm: i16,
        /// The advertisement as sent; of older versions of the app the manufacturer's part of it, as an element of its own.
        data: Vec<u8>,
    },
}

/// One reading.
#[derive(Clone, Debug, PartialEq)]
pub struct PushedReading {
    /// Sensor.
    pub kind: PushedKind,
    /// When, nanoseconds since 1970 by the phone's clock.
    pub time_ns: i64,
    /// What.
    pub value: PushedValue,
}

/// One batch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PushedBody {
    /// Its number in the session, from 0.
    pub message_id: u64,
    /// The recording that it is of.
    pub session_id: String,
    /// The readings in their order.
    pub readings: Vec<PushedReading>,
    /// What has no place in a recording: names of sensors, with how many readings.
    pub unknown: BTreeMap<String, u64>,
    /// Readings of known sensors without the values that belong to them.
    pub unreadable: u64,
    /// Of these, readings with a time that cannot be.
    pub untimely: u64,
}

/// Why a body is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PushError {
    /// No JSON, or another object.
    #[error("not a Sensor Logger body: expected messageId, sessionId and payload")]
    Body,
    /// All times are of no year in which phones are carried about.
    #[error(
        "its times are not nanoseconds since 1970 in the years 2000 to 2038: set the phone's clock, and push in the app's own format"
    )]
    Times,
    /// Too many readings.
    #[error("more than {MAX_READINGS} readings in one body: choose a shorter batch period")]
    Many,
    /// Forces in another unit than was said when the app was invited.
    #[error(
        "the raw accelerometer measures {} here, but the app was paired with the other unit: switch \
         \"Standardise Units & Frames\" in the app's settings, or pair it again with `--units`",
        if *.in_g { "in g" } else { "in m/s²" }
    )]
    Units {
        /// Which unit it is.
        in_g: bool,
    },
}

impl PushedBody {
    /// Reads a body.
    pub fn parse(bytes: &[u8], units: PushUnits) -> Result<Self, PushError> {
        let body: Value = serde_json::from_slice(bytes).map_err(|_| PushError::Body)?;
        let session_id = body.get("sessionId").and_then(Value::as_str);
        let readings = body.get("payload").and_then(Value::as_array);
        let message_id = body.get("messageId").and_then(Value::as_u64);
        let (Some(session_id), Some(readings), Some(message_id)) =
            (session_id, readings, message_id)
        else {
            return Err(PushError::Body);
        };
        if readings.len() > MAX_READINGS {
            return Err(PushError::Many);
        }
        let mut parsed = Self {
            message_id,
            session_id: session_id.to_owned(),
            ..Self::default()
        };
        for reading in readings {
            parsed.take(reading, units);
        }
        let is_none_timely = parsed.readings.is_empty() && parsed.untimely > 0;
        if is_none_timely {
            return Err(PushError::Times);
        }
        parsed.check_units(units)?;
        Ok(parsed)
    }

    fn take(&mut self, reading: &Value, units: PushUnits) {
        let name = reading.get("name").and_then(Value::as_str).unwrap_or("");
        let plain: String = name
            .chars()
            .filter(char::is_ascii_alphanumeric)
            .take(64)
            .map(|c| c.to_ascii_lowercase())
            .collect();
        let Some(kind) = kind_of(&plain) else {
            let counted = self.unknown.contains_key(&plain) || self.unknown.len() < MAX_UNKNOWN;
            let name = if counted { plain } else { "others".to_owned() };
            *self.unknown.entry(name).or_default() += 1;
            return;
        };
        let time_ns = reading.get("time").and_then(integer);
        let is_untimely = time_ns.is_some_and(|t| !POSSIBLE_NS.contains(&t));
        self.untimely += u64::from(is_untimely);
        let time_ns = time_ns.filter(|_| !is_untimely);
        let value = reading
            .get("values")
            .and_then(|values| value_of(kind, values, units));
        match (time_ns, value) {
            (Some(time_ns), Some(value)) => self.readings.push(PushedReading {
                kind,
                time_ns,
                value,
            }),
            _ => self.unreadable += 1,
        }
    }

    /// A wrong unit would pass every later look as a phone that moves strangely.
    fn check_units(&self, units: PushUnits) -> Result<(), PushError> {
        let mut norms: Vec<f64> = self
            .readings
            .iter()
            .filter_map(|reading| match (&reading.kind, &reading.value) {
                (PushedKind::ForceUncalibrated, PushedValue::Vector(v)) => {
                    Some(v.iter().map(|x| x * x).sum::<f64>().sqrt())
                }
                _ => None,
            })
            .collect();
        if norms.len() < LEAST_FORCES {
            return Ok(());
        }
        norms.sort_by(f64::total_cmp);
        let middle = norms.get(norms.len() / 2).copied().unwrap_or_default();
        match units {
            PushUnits::Standard if middle < BETWEEN_UNITS => Err(PushError::Units { in_g: true }),
            // Already multiplied.
            PushUnits::Ios if middle > BETWEEN_UNITS * STANDARD_GRAVITY_M_S2 => {
                Err(PushError::Units { in_g: false })
            }
            _ => Ok(()),
        }
    }
}

fn kind_of(name: &str) -> Option<PushedKind> {
    Some(match name {
        "accelerometeruncalibrated" => PushedKind::ForceUncalibrated,
        "totalacceleration" => PushedKind::Force,
        "accelerometer" => PushedKind::LinearAcceleration,
        "gravity" => PushedKind::Gravity,
        "gyroscopeuncalibrated" => PushedKind::RateUncalibrated,
        "gyroscope" => PushedKind::Rate,
        "magnetometeruncalibrated" => PushedKind::MagneticUncalibrated,
        "magnetometer" => PushedKind::Magnetic,
        "barometer" => PushedKind::Pressure,
        "location" => PushedKind::Location,
        "wifi" => PushedKind::Wifi,
        "bluetooth" => PushedKind::Bluetooth,
        _ => return None,
    })
}

fn value_of(kind: PushedKind, values: &Value, units: PushUnits) -> Option<PushedValue> {
    let of = |name: &str| values.get(name).and_then(number);
    let text = |name: &str| values.get(name).and_then(Value::as_str).unwrap_or("");
    let vector = |factor: f64| {
        let axes = [of("x")?, of("y")?, of("z")?];
        Some(PushedValue::Vector(axes.map(|axis| axis * factor)))
    };
    let is_turned = units == PushUnits::Ios;
    match kind {
        PushedKind::ForceUncalibrated if is_turned => vector(-STANDARD_GRAVITY_M_S2),
        PushedKind::LinearAcceleration | PushedKind::Gravity if is_turned => vector(-1.0),
        PushedKind::ForceUncalibrated
        | PushedKind::Force
        | PushedKind::LinearAcceleration
        | PushedKind::Gravity
        | PushedKind::RateUncalibrated
        | PushedKind::Rate => vector(1.0),
        // Microtesla.
        PushedKind::MagneticUncalibrated | PushedKind::Magnetic => vector(1e-6),
        // Millibar.
        PushedKind::Pressure => Some(PushedValue::PressurePa(of("pressure")? * 100.0)),
        PushedKind::Location => {
            let sigma = |name: &str| of(name).filter(|sigma| *sigma > 0.0);
            let across = sigma("horizontalAccuracy");
            Some(PushedValue::Position {
                latitude_deg: of("latitude").filter(|deg| deg.abs() <= 90.0)?,
                longitude_deg: of("longitude").filter(|deg| deg.abs() <= 180.0)?,
                altitude_m: of("altitude").unwrap_or(f64::NAN),
                sigma_m: across.zip(sigma("verticalAccuracy")).map(|(a, u)| [a, u]),
            })
        }
        PushedKind::Wifi => Some(PushedValue::Network {
            bssid: Some(text("bssid")).filter(|b| !b.is_empty())?.to_owned(),
            ssid: text("ssid").to_owned(),
            frequency_mhz: of("frequency").map_or(0, |f| f as u32),
            rssi_dbm: of("level").filter(|dbm| POSSIBLE_DBM.contains(dbm))? as i16,
        }),
        PushedKind::Bluetooth => Some(PushedValue::Advert {
            address: Some(text("id")).filter(|b| !b.is_empty())?.to_owned(),
            rssi_dbm: of("rssi").filter(|dbm| POSSIBLE_DBM.contains(dbm))? as i16,
            data: advert(text("advertisement"), text("manufacturerData"))?,
        }),
    }
}

/// The whole advertisement, or an element of type 0xFF made of the manufacturer's part.
fn advert(whole: &str, manufacturer: &str) -> Option<Vec<u8>> {
    if !whole.is_empty() {
        return bytes_of(whole);
    }
    let part = bytes_of(manufacturer)?;
    if part.is_empty() {
        return Some(part);
    }
    let length = u8::try_from(part.len() + 1).ok()?;
    Some([&[length, 0xFF], part.as_slice()].concat())
}

fn bytes_of(hex: &str) -> Option<Vec<u8>> {
    if !hex.len().is_multiple_of(2) {
        return None;
    }
    let pairs = (0..hex.len()).step_by(2);
    pairs
        .map(|at| u8::from_str_radix(hex.get(at..at + 2)?, 16).ok())
        .collect()
}

/// A number, which some versions of the app write as a text.
fn number(value: &Value) -> Option<f64> {
    let number = value
        .as_f64()
        .or_else(|| value.as_str().and_then(|text| text.parse().ok()))?;
    number.is_finite().then_some(number)
}

fn integer(value: &Value) -> Option<i64> {
    value
        .as_i64()
        .or_else(|| value.as_str().and_then(|text| text.parse().ok()))
        .or_else(|| {
            let ns = value.as_f64()?;
            (ns.abs() < 9.2e18).then_some(ns as i64)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The form of PUSHING.md; values of a phone that lies on its back.
    const BODY: &str = r#"{"messageId": 3, "sessionId": "c2f5e3a0-1f0e", "deviceId": "b7a1", "payload": [
        {"name": "accelerometeruncalibrated", "time": 1698501144401773000, "values": {"z": 9.79, "y": 0.02, "x": -0.11}, "accuracy": 3},
        {"name": "gyroscope", "time": 1698501144402773000, "values": {"z": 0.01, "y": -0.02, "x": 0.03}},
        {"name": "magnetometer", "time": 1698501144403773000, "values": {"z": -43.5, "y": 18.0, "x": 2.5}},
        {"name": "barometer", "time": 1698501144404773000, "values": {"relativeAltitude": 0.1, "pressure": 1013.25}},
        {"name": "location", "time": 1698501145514000000, "values": {"altitude": 214.2, "speedAccuracy": 0, "bearingAccuracy": 0,
            "latitude": 47.37, "bearing": 0, "horizontalAccuracy": 15.1, "verticalAccuracy": 1.77, "longitude": 8.54, "speed": 0}},
        {"name": "bluetooth", "time": 1698501145515000000, "values": {"id": "AC:DE:48:00:11:22", "rssi": -71,
            "manufacturerData": "4c0002159195b3ada9d0450085ff9fb0f65a520101020304c8"}},
        {"name": "wifi", "time": 1698501145516000000, "values": {"ssid": "hall", "bssid": "ac:de:48:00:11:23", "frequency": 5180, "level": -58}},
        {"name": "battery", "time": 1698501145517000000, "values": {"batteryLevel": 0.8, "batteryState": "unplugged", "lowPowerMode": false}},
        {"name": "Wrist Motion", "time": 1698501145517000000, "values": {}},
        {"name": "gyroscope", "time": 1698501145517000000, "values": {"x": null, "y": 0, "z": 0}}]}"#;

    #[test]
    fn a_body_of_the_published_form_is_read_in_si_units() {
        let body = PushedBody::parse(BODY.as_bytes(), PushUnits::Standard).unwrap();
        assert_eq!(
            (body.message_id, body.session_id.as_str()),
            (3, "c2f5e3a0-1f0e")
        );
        assert_eq!(body.unreadable, 1);
        let unknown = [("battery".to_owned(), 1), ("wristmotion".to_owned(), 1)];
        assert_eq!(body.unknown, BTreeMap::from(unknown));
        let value = |kind| {
            let found = body.readings.iter().find(|r| r.kind == kind).unwrap();
            found.value.clone()
        };
        assert_eq!(body.readings[0].time_ns, 1_698_501_144_401_773_000);
        assert_eq!(
            value(PushedKind::ForceUncalibrated),
            PushedValue::Vector([-0.11, 0.02, 9.79])
        );
        let PushedValue::Vector(field_t) = value(PushedKind::Magnetic) else {
            panic!("a vector");
        };
        assert!((field_t[2] + 43.5e-6).abs() < 1e-12, "{field_t:?}");
        assert_eq!(
            value(PushedKind::Pressure),
            PushedValue::PressurePa(101_325.0)
        );
        let PushedValue::Advert { data, .. } = value(PushedKind::Bluetooth) else {
            panic!("an advertisement");
        };
        assert_eq!(data[..6], [26, 0xFF, 0x4C, 0x00, 0x02, 0x15]);
    }

    /// CROSSPLATFORM.md: flat on a table the phone's z axis reads −1 g on iOS and +9.8 m/s² on Android.
    #[test]
    fn an_iphone_that_is_not_standardised_is_turned_around_and_never_taken_for_standard() {
        let reading = r#"{"name": "accelerometeruncalibrated", "time": 1698501144401773000, "values": {"x": 0.0, "y": 0.0, "z": Z}}"#;
        let of = |z: &str| {
            let readings = [reading.replace('Z', z), reading.replace('Z', z)].join(",");
            let gravity = r#"{"name": "gravity", "time": 1698501144401773000, "values": {"x": 0, "y": 0, "z": -9.8}}"#;
            format!(
                r#"{{"messageId": 0, "sessionId": "s", "payload": [{readings},{readings},{readings},{gravity}]}}"#
            )
        };
        let iphone = PushedBody::parse(of("-1.0").as_bytes(), PushUnits::Ios).unwrap();
        assert_eq!(
            iphone.readings[0].value,
            PushedValue::Vector([-0.0, -0.0, STANDARD_GRAVITY_M_S2])
        );
        assert_eq!(
            iphone.readings[6].value,
            PushedValue::Vector([-0.0, -0.0, 9.8])
        );
        for (z, units, in_g) in [
            ("-1.0", PushUnits::Standard, true),
            ("9.8", PushUnits::Ios, false),
        ] {
            let refused = PushedBody::parse(of(z).as_bytes(), units);
            assert_eq!(refused, Err(PushError::Units { in_g }));
        }
    }

    /// Milliseconds were taken for nanoseconds, 127 of iOS for a received power.
    #[test]
    fn times_and_powers_that_cannot_be_are_not_taken() {
        let body = |time: &str, rssi: i32| {
            let reading = format!(
                r#"{{"name": "bluetooth", "time": {time}, "values": {{"id": "a", "rssi": {rssi}}}}}"#
            );
            let text = format!(r#"{{"messageId": 0, "sessionId": "s", "payload": [{reading}]}}"#);
            PushedBody::parse(text.as_bytes(), PushUnits::Standard)
        };
        for time in [
            "1698501144",
            "1698501144401",
            "1698501144401773",
            "4000000000000000000",
        ] {
            assert_eq!(body(time, -70), Err(PushError::Times), "{time}");
        }
        let of = |rssi| body("1698501144401773000", rssi).map(|b| (b.readings.len(), b.unreadable));
        assert_eq!((of(-70), of(127)), (Ok((1, 0)), Ok((0, 1))));
    }

    #[test]
    fn no_other_bytes_are_taken() {
        for end in 0..BODY.len() {
            assert!(PushedBody::parse(&BODY.as_bytes()[..end], PushUnits::Standard).is_err());
        }
        for other in [
            "[]",
            "{}",
            r#"{"messageId":-1,"sessionId":"a","payload":[]}"#,
        ] {
            let refused = PushedBody::parse(other.as_bytes(), PushUnits::Standard);
            assert_eq!(refused, Err(PushError::Body), "{other}");
        }
    }
}
