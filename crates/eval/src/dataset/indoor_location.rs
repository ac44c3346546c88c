//! A walk as a text of Microsoft Indoor Location 2.0: a record on each line, `unix_ms TAB TYPE_… TAB values`, with waypoints on the floor
//! plan. Columns: `location-competition/indoor-location-competition-20`, README.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use lsfb_geometry::StampedPose;
use lsfb_recording::{Recording, message};
use lsfb_types::Timestamp;

use crate::Error;

/// Time between waypoints: their walkers said one every ten seconds.
const WAYPOINT_SECS: f64 = 10.0;
const MS: i64 = 1_000_000;
const MICROTESLA_PER_TESLA: f64 = 1e6;

/// The text. Stamps are rounded to milliseconds, as the format has them; the truth's x and y are those of the floor plan.
pub fn indoor_location(
    recording: &Recording,
    truth: &[StampedPose],
    floor: &str,
) -> Result<String, Error> {
    let mut rows: Vec<(i64, String)> = Vec::new();
    let mut next: Option<Timestamp> = None;
    for (i, place) in truth.iter().enumerate() {
        // The first, one every ten seconds, and the last.
        if next.is_none_or(|next| place.time >= next) || i + 1 == truth.len() {
            let p = place.world_from_rig.translation;
            rows.push((
                millis(place.time),
                format!("TYPE_WAYPOINT\t{}\t{}", p.x, p.y),
            ));
            next = Some(place.time.plus_secs(WAYPOINT_SECS));
        }
    }
    let topics = || recording.topics().iter().filter(|t| t.messages > 0);
    if topics().any(|t| t.schema == message::IMU.name) {
        for sample in recording.imu()? {
            let sample = sample?;
            for (kind, [x, y, z]) in [
                ("ACCELEROMETER", sample.sample.specific_force_m_s2),
                ("GYROSCOPE", sample.sample.angular_velocity_rad_s),
            ] {
                let row = format!("TYPE_{kind}\t{x}\t{y}\t{z}\t3");
                rows.push((millis(sample.time), row));
            }
        }
    }
    for topic in topics() {
        let name = topic.topic.as_str();
        if topic.schema == message::MAGNETIC_FIELD.name && !name.ends_with("_bias") {
            let is_corrected = name.ends_with("_calibrated");
            for sample in recording.magnetic(Some(name))? {
                let sample = sample?;
                let [x, y, z] = sample.sample.field_t.map(|v| v * MICROTESLA_PER_TESLA);
                rows.push((
                    millis(sample.time),
                    match is_corrected {
                        true => format!("TYPE_MAGNETIC_FIELD\t{x}\t{y}\t{z}\t3"),
                        // What the device would take off is not known apart.
                        false => {
                            format!("TYPE_MAGNETIC_FIELD_UNCALIBRATED\t{x}\t{y}\t{z}\t0\t0\t0\t3")
                        }
                    },
                ));
            }
        }
        if topic.schema == message::WIFI_READING.name {
            // Readings of a scan are handed out together, behind the newest of them; arrivals are of the recorder's clock.
            let mut ends: BTreeMap<u32, Timestamp> = BTreeMap::new();
            for reading in recording.wifi(Some(name))? {
                let reading = reading?;
                let end = ends.entry(reading.sample.scan).or_insert(reading.time);
                *end = (*end).max(reading.time);
            }
            for reading in recording.wifi(Some(name))? {
                let reading = reading?;
                let heard = &reading.sample;
                let end = ends.get(&heard.scan).copied();
                rows.push((
                    millis(end.unwrap_or(reading.time)),
                    format!(
                        "TYPE_WIFI\t{}\t{}\t{}\t{}\t{}",
                        word(&heard.ssid),
                        word(&heard.bssid),
                        heard.rssi_dbm,
                        heard.frequency_mhz,
                        millis(reading.time)
                    ),
                ));
            }
        }
        if topic.schema == message::BLE_ADVERT.name {
            for advert in recording.ble(Some(name))? {
                let advert = advert?;
                let heard = &advert.sample;
                let at = millis(advert.time);
                // The distance is the app's own guess from both powers, by free space.
                let distance_m =
                    10_f64.powf(f64::from(heard.measured_power_dbm - heard.rssi_dbm) / 20.0);
                rows.push((
                    at,
                    format!(
                        "TYPE_BEACON\t{}\t{}\t{}\t{}\t{}\t{distance_m}\t{}\t{at}",
                        word(&heard.uuid),
                        heard.major,
                        heard.minor,
                        heard.measured_power_dbm,
                        heard.rssi_dbm,
                        word(&heard.address)
                    ),
                ));
            }
        }
    }
    // Rows of one millisecond stay as they came.
    rows.sort_by_key(|(ms, _)| *ms);
    let first = rows.first().map_or(0, |(ms, _)| *ms);
    let last = rows.last().map_or(0, |(ms, _)| *ms);
    let mut text = format!("#\tstartTime:{first}\n#\tFloorName:{}\n", word(floor));
    for (ms, row) in rows {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "{ms}\t{row}");
    }
    let _ = writeln!(text, "#\tendTime:{last}");
    Ok(text)
}

/// To the nearest millisecond.
fn millis(time: Timestamp) -> i64 {
    (time.nanos() + MS / 2).div_euclid(MS)
}

/// A name that stays in its cell.
fn word(name: &str) -> String {
    name.replace(char::is_control, "_")
}
