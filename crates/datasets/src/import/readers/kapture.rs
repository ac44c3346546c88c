//! kapture (NAVER) and the capture format of LaMAR, which is made after it: lists of records by sensor, images and clouds as files.
//!
//! Poses are turned around in LaMAR: `rigs.txt` and `trajectories.txt` of kapture take points into the sensor, those of LaMAR out of
//! it. Neither says the unit of its stamps, and files of one dataset differ: each is told by the size of its first stamp.
//! Formats: naver/kapture, `kapture_format.adoc`; microsoft/lamar-benchmark, `CAPTURE.md`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Camera, CameraTiming, Rig, RigCamera, Se3, StampedPose, Trajectory, Vector3};
use lsfb_recording::message::{BleAdvert, WifiReading, WifiScan};
use lsfb_types::{StampUnit, Timestamp};

use super::ios_logger::rotation;
use super::{image_file, topic_name};
use crate::Error;
use crate::import::ImportConfig;
use crate::import::collected::{Collected, StreamId};
use crate::import::payload::{Kind, Payload};
use crate::import::stamp::unit_of_unix_stamp;
use crate::import::stream::Record;
use crate::import::table::{Row, Table};

/// No scan takes longer, nanoseconds: an hour.
const LONGEST_SCAN_NS: i64 = 3_600_000_000_000;
/// Characters of a UUID with its hyphens.
const UUID_CHARS: usize = 36;

/// Which of the two.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    Kapture,
    Lamar,
}

impl Layout {
    /// A list of records.
    fn list(self, source: &Path, kapture: &str, lamar: &str) -> PathBuf {
        match self {
            Self::Kapture => source.join("sensors").join(kapture),
            Self::Lamar => source.join(lamar),
        }
    }

    /// Where the files are that the lists name.
    fn data(self, source: &Path) -> PathBuf {
        match self {
            Self::Kapture => source.join("sensors").join("records_data"),
            Self::Lamar => source.join("raw_data"),
        }
    }

    /// The pose of a sensor in what it is placed in.
    fn placed(self, pose: Se3) -> Se3 {
        match self {
            Self::Kapture => pose.inverse(),
            Self::Lamar => pose,
        }
    }
}

pub(super) fn read(
    source: &Path,
    config: &ImportConfig,
    layout: Layout,
    into: &mut Collected,
) -> Result<(), Error> {
    let list = |kapture: &str, lamar: &str| layout.list(source, kapture, lamar);
    let sensors = into.table(&list("sensors.txt", "sensors.txt"))?;
    let rigs = list("rigs.txt", "rigs.txt");
    let rigs = match rigs.is_file() {
        true => Some(into.table(&rigs)?),
        false => None,
    };
    into.rig = rig(
        &sensors,
        rigs.as_ref(),
        layout,
        &config.device,
        &mut into.notes,
    );
    let data = layout.data(source);
    let mut reader = Reader {
        config,
        data,
        into,
        streams: BTreeMap::new(),
    };
    reader.files(&list("records_camera.txt", "images.txt"), Kind::Image)?;
    reader.files(&list("records_lidar.txt", "pointclouds.txt"), Kind::Cloud)?;
    reader.wifi(&list("records_wifi.txt", "wifi.txt"))?;
    reader.bluetooth(&list("records_bluetooth.txt", "bt.txt"))?;
    reader.trajectories(&list("trajectories.txt", "trajectories.txt"), layout)
}

struct Reader<'a> {
    config: &'a ImportConfig,
    data: PathBuf,
    into: &'a mut Collected,
    /// By the list and the sensor.
    streams: BTreeMap<(String, String), StreamId>,
}

impl Reader<'_> {
    /// A list with the unit of its stamps; `None` where there is none, or nothing in it.
    fn open(&mut self, path: &Path) -> Result<Option<(Table, StampUnit)>, Error> {
        if !path.is_file() {
            return Ok(None);
        }
        let table = self.into.table(path)?;
        let Some(first) = table.rows(',').next().map(|row| row.text(0).to_owned()) else {
            let empty = format!("{}: it has no records", table.name());
            self.into.notes.push(empty);
            return Ok(None);
        };
        let unit = self
            .config
            .stamp_unit
            .or_else(|| unit_of_unix_stamp(&first));
        let unit = unit.ok_or_else(|| Error::Recorded {
            path: path.to_owned(),
            problem: format!(
                "its first stamp `{first}` is not a time of this century in any unit: give the unit with --stamp-unit"
            ),
        })?;
        self.into
            .notes
            .push(format!("{}: stamps in {}", table.name(), unit.sign()));
        Ok(Some((table, unit)))
    }

    /// The stream of a sensor. Clouds keep its name as a LiDAR's, images as a camera's of the device; a radio is a device of its own.
    fn stream(&mut self, table: &Table, sensor: &str, topic: &str, kind: Kind) -> StreamId {
        let key = (format!("{}{topic}", table.name()), sensor.to_owned());
        if let Some(id) = self.streams.get(&key) {
            return *id;
        }
        let what = format!("{sensor} in {}", table.name());
        let name = topic_name(sensor);
        let id = match kind {
            Kind::Image | Kind::Cloud => self.into.stream(what, &format!("{name}/{topic}"), kind),
            _ => self.into.stream_of(&name, what, topic, kind),
        };
        self.streams.insert(key, id);
        id
    }

    /// Images or clouds: stamp, sensor, file.
    fn files(&mut self, path: &Path, kind: Kind) -> Result<(), Error> {
        let Some((table, unit)) = self.open(path)? else {
            return Ok(());
        };
        let topic = if kind == Kind::Cloud {
            "points"
        } else {
            "image"
        };
        for (number, row) in table.rows(',').enumerate() {
            let record = row.expect_cells(3..=3).and_then(|()| {
                let payload = match (image_file(&self.data, row.text(2), number)?, kind) {
                    (Payload::Image(_), Kind::Cloud) => Payload::Cloud(self.data.join(row.text(2))),
                    (image, _) => image,
                };
                Ok((row.stamp(0, unit)?, payload))
            });
            let stream = self.stream(&table, row.text(1), topic, kind);
            self.into.row(stream, &table, &row, record);
        }
        Ok(())
    }

    /// Stamp, sensor, BSSID, frequency, RSSI, SSID, begin and end of the scan. Readings of one stamp are one scan.
    fn wifi(&mut self, path: &Path) -> Result<(), Error> {
        let Some((table, unit)) = self.open(path)? else {
            return Ok(());
        };
        let mut scans: BTreeMap<(String, i64), (WifiScan, StreamId)> = BTreeMap::new();
        let mut counts: BTreeMap<String, u32> = BTreeMap::new();
        for row in table.rows(',') {
            let sensor = row.text(1).to_owned();
            let of_scans = self.stream(&table, &sensor, "wifi_scan", Kind::WifiScan);
            let stream = self.stream(&table, &sensor, "wifi", Kind::Wifi);
            let record = row.expect_cells(8..=8).and_then(|()| {
                let time_ns = row.stamp(0, unit)?;
                let time = |cell| Ok::<_, String>(Timestamp::from_nanos(row.stamp(cell, unit)?));
                let (started, ended) = (time(6)?, time(7)?);
                scan_can_be(started, ended, Timestamp::from_nanos(time_ns))?;
                let (scan, _) = scans.entry((sensor.clone(), time_ns)).or_insert_with(|| {
                    let number = counts.entry(sensor.clone()).or_default();
                    *number += 1;
                    let scan = WifiScan {
                        scan: *number,
                        started,
                        ended,
                        readings: 0,
                    };
                    (scan, of_scans)
                });
                let reading = WifiReading {
                    scan: scan.scan,
                    bssid: row.text(2).to_owned(),
                    frequency_mhz: row.mhz(3)?,
                    rssi_dbm: row.dbm(4)?,
                    ssid: row.text(5).to_owned(),
                };
                scan.readings += 1;
                Ok((time_ns, Payload::Wifi(Box::new(reading))))
            });
            self.into.row(stream, &table, &row, record);
        }
        for ((_, time_ns), (scan, stream)) in scans {
            let time = Timestamp::from_nanos(time_ns);
            let record = Record {
                time,
                arrival: time,
                payload: Payload::WifiScan(scan),
            };
            self.into.take(stream, || table.name(), Ok(record));
            if let Some(stream) = self.into.streams.get_mut(stream) {
                stream.derived = true;
            }
        }
        Ok(())
    }

    /// Stamp, sensor, address, RSSI, name. Who is heard may be anything, not only a beacon.
    fn bluetooth(&mut self, path: &Path) -> Result<(), Error> {
        let Some((table, unit)) = self.open(path)? else {
            return Ok(());
        };
        let mut named = 0;
        for row in table.rows(',') {
            let record = row.expect_cells(4..=5).and_then(|()| {
                let advert = BleAdvert {
                    rssi_dbm: row.dbm(3)?,
                    ..sender(row.text(2))
                };
                named += u64::from(!row.text(4).is_empty());
                Ok((row.stamp(0, unit)?, Payload::Ble(Box::new(advert))))
            });
            let stream = self.stream(&table, row.text(1), "ble", Kind::Ble);
            self.into.row(stream, &table, &row, record);
        }
        if named > 0 {
            self.into.leave_out(
                "names of Bluetooth devices",
                named,
                "cannot be held by a recording",
            );
        }
        Ok(())
    }

    /// Poses that were made of these records afterwards: beside the recording, not in it.
    fn trajectories(&mut self, path: &Path, layout: Layout) -> Result<(), Error> {
        let Some((table, unit)) = self.open(path)? else {
            return Ok(());
        };
        let mut poses: BTreeMap<String, Vec<StampedPose>> = BTreeMap::new();
        let mut wrong: Vec<String> = Vec::new();
        for row in table.rows(',') {
            match pose(&row, unit, layout) {
                Ok(pose) => poses.entry(topic_name(row.text(1))).or_default().push(pose),
                Err(why) => wrong.push(format!("{}: line {}: {why}", table.name(), row.line)),
            }
        }
        if let Some(first) = wrong.first() {
            return Err(Error::Recorded {
                path: path.to_owned(),
                problem: format!("{} poses cannot be read; the first: {first}", wrong.len()),
            });
        }
        for (device, poses) in poses {
            let read = poses.len();
            let trajectory = Trajectory::new(poses);
            if trajectory.len() < read {
                return Err(Error::Recorded {
                    path: path.to_owned(),
                    problem: format!(
                        "{} of {read} poses of {device} have the stamp of another one: a repeated list, or two sensors whose names differ only in punctuation",
                        read - trajectory.len()
                    ),
                });
            }
            self.into.trajectories.push((device, trajectory));
        }
        Ok(())
    }
}

fn pose(row: &Row<'_>, unit: StampUnit, layout: Layout) -> Result<StampedPose, String> {
    // LaMAR adds a covariance behind it.
    row.expect_cells(9..=usize::MAX)?;
    let listed = Se3::new(
        rotation(row.numbers(2)?)?,
        Vector3::from(row.numbers::<3>(6)?),
    );
    Ok(StampedPose {
        time: Timestamp::from_nanos(row.stamp(0, unit)?),
        world_from_rig: layout.placed(listed),
    })
}

/// The cameras, where what is said of them is enough for a rig.
fn rig(
    sensors: &Table,
    rigs: Option<&Table>,
    layout: Layout,
    device: &str,
    notes: &mut Vec<String>,
) -> Option<Rig> {
    let mut poses: BTreeMap<&str, Se3> = BTreeMap::new();
    let placed = rigs
        .map(|table| table.rows(',').collect::<Vec<_>>())
        .unwrap_or_default();
    let cells: Vec<(String, Result<Se3, String>)> = placed
        .iter()
        .map(|row| {
            let pose = row.expect_cells(9..=9).and_then(|()| {
                let translation = Vector3::from(row.numbers::<3>(6)?);
                Ok(layout.placed(Se3::new(rotation(row.numbers(2)?)?, translation)))
            });
            (row.text(1).to_owned(), pose)
        })
        .collect();
    for (sensor, pose) in &cells {
        match pose {
            Ok(pose) => {
                poses.insert(sensor, *pose);
            }
            Err(why) => notes.push(format!("rigs.txt: {sensor}: {why}")),
        }
    }
    let rows: Vec<Row<'_>> = sensors
        .rows(',')
        .filter(|row| row.text(2) == "camera")
        .collect();
    let mut rig = Rig::empty(device);
    for row in &rows {
        let name = row.text(0);
        let pose = match (poses.get(name), rows.len()) {
            (Some(pose), _) => *pose,
            (None, 1) => Se3::identity(),
            (None, _) => {
                notes.push(format!(
                    "{name}: its pose relative to the cameras is unknown: it is not in the rig"
                ));
                continue;
            }
        };
        match camera(row) {
            Ok(camera) => {
                let mounted = RigCamera {
                    camera,
                    rig_from_camera: pose,
                    timing: CameraTiming::default(),
                    sigmas: Default::default(),
                };
                rig.cameras.insert(topic_name(name), mounted);
            }
            Err(why) => notes.push(format!("{name}: it is not in the rig: {why}")),
        }
    }
    (!rig.cameras.is_empty()).then_some(rig)
}

/// Sensor, name, `camera`, then model, width, height and parameters as COLMAP has them.
fn camera(row: &Row<'_>) -> Result<Camera, String> {
    let model = row.text(3);
    let (width, height) = (row.whole(4)?, row.whole(5)?);
    let parameters: Result<Vec<f64>, String> =
        (6..row.cells.len()).map(|c| row.number(c)).collect();
    Camera::from_colmap(model, [width, height], &parameters?).map_err(|e| e.to_string())
}

/// A scan ends behind its beginning and not far from its readings; zero where it is not known.
fn scan_can_be(started: Timestamp, ended: Timestamp, read: Timestamp) -> Result<(), String> {
    let unknown = Timestamp::from_nanos(0);
    let known = [started, ended].into_iter().filter(|t| *t != unknown);
    let is_near = known.clone().all(|t| (read - t).abs() <= LONGEST_SCAN_NS);
    match is_near && (known.count() < 2 || started <= ended) {
        true => Ok(()),
        false => {
            Err("a scan that does not end after its beginning, or not near its readings".to_owned())
        }
    }
}

/// LaMAR's `guid:major:minor` of an iBeacon; anything else is an address.
fn sender(id: &str) -> BleAdvert {
    let parts: Vec<&str> = id.split(':').collect();
    let beacon = |uuid: &str, major: &str, minor: &str| {
        (uuid.len() == UUID_CHARS).then_some(())?;
        Some(BleAdvert {
            uuid: uuid.to_owned(),
            major: major.parse().ok()?,
            minor: minor.parse().ok()?,
            ..BleAdvert::default()
        })
    };
    let found = match parts[..] {
        [uuid, major, minor] => beacon(uuid, major, minor),
        _ => None,
    };
    found.unwrap_or_else(|| BleAdvert {
        address: id.to_owned(),
        ..BleAdvert::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An iBeacon's number was read as an address.
    #[test]
    fn lamar_has_beacons() {
        let beacon = sender("e2c56db5-dffb-48d2-b060-d0f5a71096e0:7:65535");
        assert_eq!((beacon.major, beacon.minor), (7, 65_535));
        assert_eq!(beacon.uuid, "e2c56db5-dffb-48d2-b060-d0f5a71096e0");
        assert!(beacon.address.is_empty());
        for other in [
            "35:A8:4B:D9:95:06",
            "a:1:2",
            "e2c56db5-dffb-48d2-b060-d0f5a71096e0:7:65536",
            "",
        ] {
            let heard = sender(other);
            assert_eq!((heard.address.as_str(), heard.uuid.as_str()), (other, ""));
        }
    }
}
