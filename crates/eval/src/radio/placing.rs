//! Readings of a recording, each at its place.

use lsfb_geometry::Vector3;
use lsfb_recording::{Recording, message};
use lsfb_types::{Bounds, Timestamp};
use serde::{Deserialize, Serialize};

use crate::Error;

/// How uncertain a place is between two that are known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlacingConfig {
    /// Standard deviation of each coordinate of a known place, metres, where it brings none of its own. The antenna is within a hand's
    /// breadth of the body whose places are known.
    pub place_sigma_m: f64,
    /// Standard deviation of the time between hearing and stamp, seconds: Android stamps a beacon when the driver hands it on.
    pub stamp_sigma_secs: f64,
    /// Acceleration of the body between known places that are close in time, m/s².
    pub acceleration_m_s2: f64,
    /// How fast the body strays from the straight line between known places that are far apart in time: variance of a coordinate grows by
    /// this in each second, m²/s. From 130 waypoints of Indoor Location 2.0, each left out in turn: 1.9.
    pub straying_m2_s: f64,
    /// Readings between known places further apart than this get no place, seconds.
    pub longest_gap_secs: f64,
}

lsfb_types::bounds! {
    PlacingConfig {
        place_sigma_m: number(Bounds::Within(0.0, 100.0)),
        stamp_sigma_secs: number(Bounds::Within(0.0, 60.0)),
        acceleration_m_s2: number(Bounds::Within(0.0, 100.0)),
        straying_m2_s: number(Bounds::Within(0.0, 100.0)),
        longest_gap_secs: number(Bounds::Within(1e-3, 3600.0)),
    }
}

impl Default for PlacingConfig {
    fn default() -> Self {
        Self {
            place_sigma_m: 0.1,
            stamp_sigma_secs: 0.05,
            acceleration_m_s2: 2.0,
            straying_m2_s: 1.9,
            longest_gap_secs: 60.0,
        }
    }
}

/// Where the body was at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownPlace {
    /// When.
    pub time: Timestamp,
    /// In the world of the trajectory, or on the floor plan with height zero, metres.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each coordinate, metres; `None` takes that of the settings.
    pub sigma_m: Option<f64>,
}

/// What was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RadioKind {
    /// An access point's beacon, heard in a scan.
    Wifi,
    /// A Bluetooth advertisement.
    Ble,
    /// The magnetic field.
    Magnetic,
}

/// A reading at its place.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedReading {
    /// What was measured.
    pub kind: RadioKind,
    /// When it was heard; not when its scan was handed out.
    pub time: Timestamp,
    /// Number of the scan; zero where there is none.
    pub scan: u32,
    /// Address of the sender, or UUID, major and minor of a beacon without one; the topic of a magnetometer.
    pub source: String,
    /// Received power, dBm; zero of the magnetic field.
    pub rssi_dbm: i16,
    /// The field in the sensor's axes, tesla; zero of radio.
    pub field_t: [f64; 3],
    /// Where the body was, metres.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each coordinate, metres.
    pub sigma_m: f64,
}

/// Readings at their places, and those without.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Placed {
    /// In order of kind, and within it as recorded.
    pub readings: Vec<PlacedReading>,
    /// Before the first known place or after the last.
    pub outside: usize,
    /// Between known places that are too far apart in time.
    pub in_gaps: usize,
}

/// Gives the readings of a recording their places. `known` must be in order of time; of places of one time the first counts.
pub fn place(
    recording: &Recording,
    known: &[KnownPlace],
    config: &PlacingConfig,
) -> Result<Placed, Error> {
    let mut placed = Placed::default();
    let mut add = |time: Timestamp, reading: PlacedReading| match at(known, time, config) {
        Where::At(position_m, sigma_m) => placed.readings.push(PlacedReading {
            position_m,
            sigma_m,
            ..reading
        }),
        Where::Outside => placed.outside += 1,
        Where::InGap => placed.in_gaps += 1,
    };
    let empty = |kind, time| PlacedReading {
        kind,
        time,
        scan: 0,
        source: String::new(),
        rssi_dbm: 0,
        field_t: [0.0; 3],
        position_m: Vector3::zeros(),
        sigma_m: 0.0,
    };
    for topic in topics(recording, message::WIFI_READING.name) {
        for item in recording.wifi(Some(&topic))? {
            let item = item?;
            let reading = PlacedReading {
                scan: item.sample.scan,
                source: item.sample.bssid,
                rssi_dbm: item.sample.rssi_dbm,
                ..empty(RadioKind::Wifi, item.time)
            };
            add(item.time, reading);
        }
    }
    for topic in topics(recording, message::BLE_ADVERT.name) {
        for item in recording.ble(Some(&topic))? {
            let item = item?;
            let heard = item.sample;
            let reading = PlacedReading {
                source: heard.sender(),
                rssi_dbm: heard.rssi_dbm,
                ..empty(RadioKind::Ble, item.time)
            };
            add(item.time, reading);
        }
    }
    for topic in topics(recording, message::MAGNETIC_FIELD.name) {
        // What the device takes off the field is no field.
        if topic.ends_with("_bias") {
            continue;
        }
        for item in recording.magnetic(Some(&topic))? {
            let item = item?;
            let reading = PlacedReading {
                source: topic.clone(),
                field_t: item.sample.field_t,
                ..empty(RadioKind::Magnetic, item.time)
            };
            add(item.time, reading);
        }
    }
    Ok(placed)
}

/// The waypoints of an imported walk: where its walker said to be, on the floor plan.
pub fn waypoints(recording: &Recording) -> Result<Vec<KnownPlace>, Error> {
    #[derive(Deserialize)]
    struct Point {
        x_m: f64,
        y_m: f64,
    }
    let mut known = Vec::new();
    for topic in topics(recording, message::REMARK.name) {
        for item in recording.messages(&topic)? {
            let item = item?;
            let no_waypoint = |why: String| Error::NotATrajectory {
                path: recording.path().to_owned(),
                what: format!("{topic}: not a waypoint: {why}"),
            };
            let remark = message::decode_remark(&item.bytes);
            let remark = remark.map_err(|why| no_waypoint(why.to_string()))?;
            if remark.kind != "waypoint" {
                continue;
            }
            let point: Point =
                serde_json::from_str(&remark.text).map_err(|why| no_waypoint(why.to_string()))?;
            known.push(KnownPlace {
                time: item.time,
                position_m: Vector3::new(point.x_m, point.y_m, 0.0),
                sigma_m: None,
            });
        }
    }
    known.sort_by_key(|k| k.time);
    Ok(known)
}

fn topics(recording: &Recording, schema: &str) -> Vec<String> {
    let all = recording.topics().iter();
    all.filter(|t| t.schema == schema && t.messages > 0)
        .map(|t| t.topic.clone())
        .collect()
}

enum Where {
    At(Vector3<f64>, f64),
    Outside,
    InGap,
}

/// Along the straight line between the known places around a time.
fn at(known: &[KnownPlace], time: Timestamp, config: &PlacingConfig) -> Where {
    let after = known.partition_point(|k| k.time < time);
    // At the time of the first known place it is the beginning of the first gap.
    let is_first = after == 0 && known.first().is_some_and(|k| k.time == time);
    let end = after.max(usize::from(is_first));
    let (Some(start), Some(end)) = (
        end.checked_sub(1).and_then(|start| known.get(start)),
        known.get(end),
    ) else {
        return Where::Outside;
    };
    let gap_secs = end.time.secs_since(start.time);
    if gap_secs > config.longest_gap_secs {
        return Where::InGap;
    }
    let share = match gap_secs > 0.0 {
        true => time.secs_since(start.time) / gap_secs,
        false => 0.0,
    };
    let way = end.position_m - start.position_m;
    let own = |k: &KnownPlace| k.sigma_m.unwrap_or(config.place_sigma_m);
    // Both ends may be wrong alike.
    let known_m = own(start).max(own(end));
    let speed_m_s = match gap_secs > 0.0 {
        true => way.norm() / gap_secs,
        false => 0.0,
    };
    let between = share * (1.0 - share);
    // A parabola over a short time; over a long one nobody walks evenly.
    let bent_m = 0.5 * config.acceleration_m_s2 * between * gap_secs * gap_secs;
    let strayed_m = (config.straying_m2_s * between * gap_secs).sqrt();
    let parts = [
        known_m,
        speed_m_s * config.stamp_sigma_secs,
        bent_m.min(strayed_m),
    ];
    let sigma_m = parts.iter().map(|p| p * p).sum::<f64>().sqrt();
    Where::At(start.position_m + share * way, sigma_m)
}
