//! Microsoft Indoor Location 2.0: one text per walk, a record per line: `unix_ms TAB TYPE_… TAB values`.
//!
//! Columns: `location-competition/indoor-location-competition-20`, README.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_recording::message::{BleAdvert, Remark, WifiReading, WifiScan};
use lsfb_types::StampUnit::Milliseconds;
use lsfb_types::Timestamp;

use super::TESLA_PER_MICROTESLA;
use crate::Error;
use crate::import::collected::{Collected, StreamId};
use crate::import::payload::{Kind, Payload};
use crate::import::stream::Record;
use crate::import::table::{Row, Table};

/// Types of lines whose values are three numbers, and topics of these: of the values, and of what the device takes off them.
const VECTORS: [(&str, Kind, [&str; 2]); 6] = [
    ("TYPE_ACCELEROMETER", Kind::Vector, ["accel", ""]),
    ("TYPE_GYROSCOPE", Kind::Vector, ["gyro", ""]),
    (
        "TYPE_MAGNETIC_FIELD",
        Kind::Magnetic,
        ["mag_calibrated", ""],
    ),
    (
        "TYPE_ACCELEROMETER_UNCALIBRATED",
        Kind::Vector,
        ["accel_uncalibrated", "accel_bias"],
    ),
    (
        "TYPE_GYROSCOPE_UNCALIBRATED",
        Kind::Vector,
        ["gyro_uncalibrated", "gyro_bias"],
    ),
    (
        "TYPE_MAGNETIC_FIELD_UNCALIBRATED",
        Kind::Magnetic,
        ["mag", "mag_bias"],
    ),
];
/// Stamp, type, three values, accuracy.
const VECTOR_CELLS: usize = 6;
/// Three values more: the bias.
const UNCALIBRATED_CELLS: usize = 9;
/// A rotation vector is shorter than one, but for rounding.
const LONGEST_ROTATION: f64 = 1.0 + 1e-3;

pub(super) fn read(source: &Path, into: &mut Collected) -> Result<(), Error> {
    let table = into.table(source)?;
    let mut walk = Walk::new(&table);
    for row in table.rows('\t') {
        walk.line(&row, into);
    }
    walk.finish(into);
    if !table.text().lines().any(|l| l.starts_with("#\tendTime:")) {
        into.notes.push(format!(
            "{}: no endTime: the app was stopped early, or the file was truncated",
            table.name()
        ));
    }
    Ok(())
}

struct Walk<'a> {
    table: &'a Table,
    floor: String,
    /// By the type of their lines: streams of the values and of the bias.
    vectors: BTreeMap<&'static str, [Option<StreamId>; 2]>,
    orientation: Option<StreamId>,
    waypoints: Option<StreamId>,
    scans: Option<StreamId>,
    wifi: Option<StreamId>,
    beacons: Option<StreamId>,
    /// Readings of the scan that is being read, and when the device had it.
    scan: WifiScan,
    scan_ms: Option<i64>,
    others: BTreeMap<String, u64>,
}

/// The stream of a type; it begins with its first record.
fn stream(
    id: &mut Option<StreamId>,
    into: &mut Collected,
    what: &str,
    topic: &str,
    kind: Kind,
) -> StreamId {
    *id.get_or_insert_with(|| into.stream(what, topic, kind))
}

impl<'a> Walk<'a> {
    fn new(table: &'a Table) -> Self {
        let floor = table.text().lines().filter(|l| l.starts_with('#'));
        let floor = floor
            .flat_map(|l| l.split('\t'))
            .find_map(|c| c.strip_prefix("FloorName:"));
        Self {
            table,
            floor: floor.unwrap_or_default().trim().to_owned(),
            vectors: BTreeMap::new(),
            orientation: None,
            waypoints: None,
            scans: None,
            wifi: None,
            beacons: None,
            scan: WifiScan::default(),
            scan_ms: None,
            others: BTreeMap::new(),
        }
    }

    fn line(&mut self, row: &Row<'_>, into: &mut Collected) {
        let what = row.text(1);
        if let Some((name, kind, topics)) = VECTORS.iter().find(|(name, ..)| *name == what) {
            return self.vector(row, name, *kind, *topics, into);
        }
        match what {
            "TYPE_ROTATION_VECTOR" => {
                let id = stream(
                    &mut self.orientation,
                    into,
                    what,
                    "orientation",
                    Kind::Orientation,
                );
                into.row(id, self.table, row, orientation(row));
            }
            "TYPE_WAYPOINT" => {
                let id = stream(&mut self.waypoints, into, what, "waypoint", Kind::Waypoint);
                into.row(id, self.table, row, waypoint(row, &self.floor));
            }
            "TYPE_WIFI" => self.wifi(row, into),
            "TYPE_BEACON" => {
                let id = stream(&mut self.beacons, into, what, "ble", Kind::Ble);
                into.row(id, self.table, row, beacon(row));
            }
            _ => {
                let what = match what {
                    "" => "lines without a type",
                    what => what,
                };
                *self.others.entry(what.to_owned()).or_default() += 1;
            }
        }
    }

    fn vector(
        &mut self,
        row: &Row<'_>,
        name: &'static str,
        kind: Kind,
        [values, bias]: [&str; 2],
        into: &mut Collected,
    ) {
        let ids = self.vectors.entry(name).or_default();
        let id = stream(&mut ids[0], into, name, values, kind);
        if bias.is_empty() {
            let read = |row: &Row<'_>| {
                row.expect_cells(VECTOR_CELLS..=VECTOR_CELLS)?;
                Ok((row.stamp(0, Milliseconds)?, payload(kind, row.numbers(2)?)))
            };
            return into.row(id, self.table, row, read(row));
        }
        let read = |row: &Row<'_>, from: usize| {
            row.expect_cells(UNCALIBRATED_CELLS..=UNCALIBRATED_CELLS)?;
            // Neither is of use without the other.
            row.numbers::<6>(2)?;
            Ok((
                row.stamp(0, Milliseconds)?,
                payload(kind, row.numbers(from)?),
            ))
        };
        let record: Result<_, String> = read(row, 2);
        if record.is_ok() {
            let of_bias = stream(&mut ids[1], into, &format!("bias in {name}"), bias, kind);
            into.row(of_bias, self.table, row, read(row, 5));
        }
        into.row(id, self.table, row, record);
    }

    fn wifi(&mut self, row: &Row<'_>, into: &mut Collected) {
        // A scan stands before its readings.
        stream(
            &mut self.scans,
            into,
            "scans of TYPE_WIFI",
            "wifi_scan",
            Kind::WifiScan,
        );
        let id = stream(&mut self.wifi, into, "TYPE_WIFI", "wifi", Kind::Wifi);
        let at_ms = row.stamp(0, Milliseconds).ok();
        if at_ms.is_some() && at_ms != self.scan_ms {
            self.end_scan(into);
            self.scan_ms = at_ms;
            self.scan.scan += 1;
        }
        let record = reading(row, self.scan.scan);
        self.scan.readings += u32::from(record.is_ok());
        let table = self.table;
        into.take(
            id,
            || format!("{}: line {}", table.name(), row.line),
            record,
        );
    }

    /// The readings of a scan are handed out together, at its end; when it began is not said.
    fn end_scan(&mut self, into: &mut Collected) {
        let readings = std::mem::take(&mut self.scan.readings);
        if let (Some(at_ns), Some(id), 1..) = (self.scan_ms.take(), self.scans, readings) {
            let ended = Timestamp::from_nanos(at_ns);
            let record = Record {
                time: ended,
                arrival: ended,
                payload: Payload::WifiScan(WifiScan {
                    ended,
                    readings,
                    ..self.scan
                }),
            };
            into.take(id, String::new, Ok(record));
        }
    }

    fn finish(mut self, into: &mut Collected) {
        self.end_scan(into);
        if let Some(scans) = self.scans.and_then(|id| into.streams.get_mut(id)) {
            scans.derived = true;
        }
        for ids in self.vectors.values() {
            if let Some(bias) = ids[1].and_then(|id| into.streams.get_mut(id)) {
                bias.derived = true;
            }
        }
        let id = |name| self.vectors.get(name).and_then(|ids| ids[0]);
        if let (Some(gyro), Some(accel)) = (id("TYPE_GYROSCOPE"), id("TYPE_ACCELEROMETER")) {
            into.combine(gyro, accel);
        }
        for (what, records) in self.others {
            into.leave_out(what, records, "cannot be held by a recording");
        }
    }
}

fn payload(kind: Kind, [x, y, z]: [f64; 3]) -> Payload {
    match kind {
        Kind::Magnetic => Payload::Magnetic([x, y, z].map(|v| v * TESLA_PER_MICROTESLA)),
        _ => Payload::Vector([x, y, z]),
    }
}

/// Android leaves out the fourth number of the quaternion: it makes its length one.
fn orientation(row: &Row<'_>) -> Result<(i64, Payload), String> {
    row.expect_cells(VECTOR_CELLS..=VECTOR_CELLS)?;
    let [x, y, z]: [f64; 3] = row.numbers(2)?;
    let square = x * x + y * y + z * z;
    if square > LONGEST_ROTATION {
        return Err(format!("a rotation vector with norm {:.3}", square.sqrt()));
    }
    let w = (1.0 - square).max(0.0).sqrt();
    Ok((
        row.stamp(0, Milliseconds)?,
        Payload::Orientation([x, y, z, w]),
    ))
}

fn waypoint(row: &Row<'_>, floor: &str) -> Result<(i64, Payload), String> {
    row.expect_cells(4..=4)?;
    let [x_m, y_m]: [f64; 2] = row.numbers(2)?;
    let remark = Remark {
        kind: "waypoint".to_owned(),
        text: serde_json::json!({ "x_m": x_m, "y_m": y_m, "floor": floor }).to_string(),
        position_in_world_m: None,
    };
    Ok((
        row.stamp(0, Milliseconds)?,
        Payload::Waypoint(Box::new(remark)),
    ))
}

fn reading(row: &Row<'_>, scan: u32) -> Result<Record, String> {
    row.expect_cells(7..=7)?;
    let reading = WifiReading {
        scan,
        ssid: row.text(2).to_owned(),
        bssid: row.text(3).to_owned(),
        rssi_dbm: row.dbm(4)?,
        frequency_mhz: row.mhz(5)?,
    };
    Ok(Record {
        time: Timestamp::from_nanos(row.stamp(6, Milliseconds)?),
        arrival: Timestamp::from_nanos(row.stamp(0, Milliseconds)?),
        payload: Payload::Wifi(Box::new(reading)),
    })
}

fn beacon(row: &Row<'_>) -> Result<(i64, Payload), String> {
    row.expect_cells(10..=10)?;
    let advert = BleAdvert {
        uuid: row.text(2).to_owned(),
        major: row.whole(3)?,
        minor: row.whole(4)?,
        // As the beacon has it: some say what cannot be.
        measured_power_dbm: row.number(5)?.round() as i16,
        rssi_dbm: row.dbm(6)?,
        address: row.text(8).to_owned(),
        data: Vec::new(),
    };
    Ok((row.stamp(0, Milliseconds)?, Payload::Ble(Box::new(advert))))
}
