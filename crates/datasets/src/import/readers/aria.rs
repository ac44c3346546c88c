//! Glasses of Project Aria: one VRS file. Stamps are nanoseconds of the glasses' own clock; those of images are of the middle of the
//! exposure of the middle row, forces point upward at rest.
//!
//! Meaning of the stamps: projectaria_tools, "How data from Project Aria devices is timestamped".

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_recording::message::{BleAdvert, WifiReading, WifiScan};
use lsfb_types::{ImuSample, Timestamp, median};
use serde::Deserialize;

use super::TESLA_PER_MICROTESLA;
use crate::Error;
use crate::import::collected::{Collected, StreamId, measured};
use crate::import::payload::{ImageRecord, Kind, Payload, Pixels};
use crate::import::stream::Record;
use crate::import::table::{possible_dbm, possible_mhz};
use crate::import::vrs::{Found, Id, ImageAt, Layout, Values, Vrs};

/// Types of streams that a recording takes: what they are, and the topic of the first of them.
const SLAM_CAMERA: u32 = 1201;
const IMU: u32 = 1202;
const MAGNETOMETER: u32 = 1203;
const EYE_CAMERA: u32 = 211;
const COLOUR_CAMERA: u32 = 214;
const WIFI: u32 = 282;
const BLUETOOTH: u32 = 283;
/// And some that it does not.
const OTHERS: [(u32, &str); 5] = [
    (231, "sound"),
    (246, "temperatures"),
    (247, "air pressure"),
    (248, "proximity"),
    (281, "satellite positions"),
];
/// Between the head of a Bluetooth packet on the air, its access address, and what is advertised: the packet's head and the sender.
const ACCESS_ADDRESS: [u8; 4] = [0xd6, 0xbe, 0x89, 0x8e];
const ADVERTISED_AT: usize = 12;
/// From this field on, numbers are microtesla: the first glasses have those, later ones tesla.
const SURELY_MICROTESLA: f64 = 0.1;

pub(super) fn read(source: &Path, into: &mut Collected) -> Result<(), Error> {
    let fail = |problem: String| Error::Recorded {
        path: source.to_owned(),
        problem,
    };
    let mut vrs = Vrs::open(source).map_err(fail)?;
    into.used.insert(source.to_owned());
    let mut streams: BTreeMap<Id, StreamId> = BTreeMap::new();
    let mut layouts: BTreeMap<(Id, u32), Result<Layout, String>> = BTreeMap::new();
    let mut left: BTreeMap<(Id, String), u64> = BTreeMap::new();
    let mut scans: BTreeMap<i64, WifiScan> = BTreeMap::new();
    while let Some(found) = vrs.record() {
        let found = match found {
            Ok(found) => found,
            Err(why) => {
                // Of which stream it and all behind it were is not known.
                let id = into.stream("the file", "broken", Kind::Vector);
                let place = || source.display().to_string();
                into.take(id, place, Err(why));
                break;
            }
        };
        let Some((topic, kind)) = topic(found.id) else {
            *left.entry((found.id, no_place())).or_default() += 1;
            continue;
        };
        let tags = vrs.streams.get(&found.id);
        let layout = layouts.entry((found.id, found.version)).or_insert_with(|| {
            Layout::of(
                tags.ok_or("the file does not say what it contains")?,
                found.version,
            )
        });
        if let (Kind::Image, Ok(layout)) = (kind, &layout)
            && layout.behind != "image/jpg"
        {
            let why = format!(
                "only JPEG images are supported, but these are {}: convert the file with Aria's tools",
                layout.behind
            );
            *left.entry((found.id, why)).or_default() += 1;
            continue;
        }
        let stream = *streams.entry(found.id).or_insert_with(|| {
            let what = format!("{} in {}", name(found.id), found.id);
            into.stream(what, &topic, kind)
        });
        let record = layout.as_ref().map_err(Clone::clone).and_then(|layout| {
            let bytes = vrs.bytes(&found.place)?;
            let values = layout.values(&bytes)?;
            record(&values, &found, source, &mut scans)
        });
        into.take(stream, || format!("byte {}", found.head_at), record);
    }
    put_scans(scans, into);
    magnetic_unit(&streams, into);
    for ((id, why), records) in left {
        into.leave_out(format!("{} in {id}", name(id)), records, &why);
    }
    notes(&vrs, into);
    Ok(())
}

fn no_place() -> String {
    "cannot be held by a recording".to_owned()
}

/// The topic of a stream, and what it is filled with.
fn topic(id: Id) -> Option<(String, Kind)> {
    let camera = |name: &str| Some((format!("{name}{}/image", id.instance), Kind::Image));
    match id.of {
        SLAM_CAMERA => camera("slam"),
        EYE_CAMERA => camera("eye"),
        COLOUR_CAMERA => camera("rgb"),
        // The first is the glasses' main one.
        IMU if id.instance <= 1 => Some(("imu".to_owned(), Kind::Imu)),
        IMU => Some((format!("imu{}", id.instance), Kind::Imu)),
        MAGNETOMETER => Some(("mag".to_owned(), Kind::Magnetic)),
        WIFI => Some(("wifi".to_owned(), Kind::Wifi)),
        BLUETOOTH => Some(("ble".to_owned(), Kind::Ble)),
        _ => None,
    }
}

fn name(id: Id) -> &'static str {
    match id.of {
        SLAM_CAMERA => "SLAM camera",
        EYE_CAMERA => "eye camera",
        COLOUR_CAMERA => "colour camera",
        IMU => "IMU",
        MAGNETOMETER => "magnetometer",
        WIFI => "Wi-Fi",
        BLUETOOTH => "Bluetooth",
        other => OTHERS
            .iter()
            .find(|(of, _)| *of == other)
            .map_or("data", |(_, name)| name),
    }
}

fn record(
    values: &Values<'_>,
    found: &Found,
    source: &Path,
    scans: &mut BTreeMap<i64, WifiScan>,
) -> Result<Record, String> {
    match found.id.of {
        IMU => {
            let sample = ImuSample {
                angular_velocity_rad_s: values.axes("gyroscope")?,
                specific_force_m_s2: values.axes("accelerometer")?,
            };
            Ok(measured(captured(values)?, Payload::Imu(sample)))
        }
        MAGNETOMETER => {
            let field = values.axes("magnetometer")?;
            Ok(measured(captured(values)?, Payload::Magnetic(field)))
        }
        WIFI => wifi(values, scans),
        BLUETOOTH => bluetooth(values),
        _ => {
            let exposure_ns = values.number("exposure_duration_s")? * 1e9;
            let number = values.unsigned("frame_number")?;
            let image = ImageRecord {
                pixels: Pixels::Record(Box::new(ImageAt {
                    file: source.to_owned(),
                    place: found.place,
                    skip: values.size,
                })),
                exposure_ns: exposure_ns.round() as u32,
                device_ns: 0,
                frame_id: u32::try_from(number).unwrap_or(u32::MAX),
            };
            Ok(measured(captured(values)?, Payload::Image(Box::new(image))))
        }
    }
}

fn captured(values: &Values<'_>) -> Result<i64, String> {
    values.int("capture_timestamp_ns")
}

/// When it was heard, and when the system handed it out.
fn heard(values: &Values<'_>) -> Result<[Timestamp; 2], String> {
    Ok([
        Timestamp::from_nanos(values.int("board_timestamp_ns")?),
        Timestamp::from_nanos(values.int("system_timestamp_ns")?),
    ])
}

/// Readings are told apart by when their scan was asked for.
fn wifi(values: &Values<'_>, scans: &mut BTreeMap<i64, WifiScan>) -> Result<Record, String> {
    let [time, arrival] = heard(values)?;
    let started = values.int("board_request_start_timestamp_ns")?;
    let ended = values.int("board_request_complete_timestamp_ns")?;
    let next = scans.len() as u32 + 1;
    let reading = WifiReading {
        scan: scans.get(&started).map_or(next, |scan| scan.scan),
        ssid: values.text("ssid")?,
        bssid: values.text("bssid_mac")?,
        rssi_dbm: possible_dbm(values.number("rssi")?)?,
        frequency_mhz: possible_mhz(values.number("freq_mhz")?)?,
    };
    let scan = scans.entry(started).or_insert(WifiScan {
        scan: next,
        started: Timestamp::from_nanos(started),
        ended: Timestamp::from_nanos(ended),
        readings: 0,
    });
    scan.readings += 1;
    Ok(Record {
        time,
        arrival,
        payload: Payload::Wifi(Box::new(reading)),
    })
}

fn put_scans(scans: BTreeMap<i64, WifiScan>, into: &mut Collected) {
    if scans.is_empty() {
        return;
    }
    let id = into.stream("scans of Wi-Fi", "wifi_scan", Kind::WifiScan);
    for scan in scans.into_values() {
        let record = measured(scan.ended.nanos(), Payload::WifiScan(scan));
        into.take(id, String::new, Ok(record));
    }
    if let Some(stream) = into.streams.get_mut(id) {
        stream.derived = true;
    }
}

fn bluetooth(values: &Values<'_>) -> Result<Record, String> {
    let [time, arrival] = heard(values)?;
    let packet = values.behind();
    let advertised = match packet.starts_with(&ACCESS_ADDRESS) {
        true => packet.get(ADVERTISED_AT..).unwrap_or_default(),
        false => packet,
    };
    let rssi_dbm = possible_dbm(values.number("rssi")?)?;
    let advert = BleAdvert::heard(values.text("mac_address")?, rssi_dbm, advertised.to_vec());
    Ok(Record {
        time,
        arrival,
        payload: Payload::Ble(Box::new(advert)),
    })
}

/// The first glasses wrote microtesla, later ones tesla: the field of the earth tells which.
fn magnetic_unit(streams: &BTreeMap<Id, StreamId>, into: &mut Collected) {
    let own = streams.iter().filter(|(id, _)| id.of == MAGNETOMETER);
    for id in own.map(|(_, stream)| *stream) {
        let Some(stream) = into.streams.get_mut(id) else {
            continue;
        };
        let fields = stream.records.iter_mut();
        let mut fields: Vec<&mut [f64; 3]> = fields
            .filter_map(|r| match &mut r.payload {
                Payload::Magnetic(field) => Some(field),
                _ => None,
            })
            .collect();
        let lengths = fields
            .iter()
            .map(|[x, y, z]| (x * x + y * y + z * z).sqrt());
        if median(lengths.collect()).is_some_and(|field| field > SURELY_MICROTESLA) {
            for field in &mut fields {
                **field = field.map(|v| v * TESLA_PER_MICROTESLA);
            }
            into.notes
                .push("mag: values look like microtesla and were converted to tesla".to_owned());
        }
    }
}

/// What is used of `calib_json`.
#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct Calibration {
    imu_calibrations: Vec<ImuCalibration>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct ImuCalibration {
    label: String,
    accelerometer: Option<Late>,
    gyroscope: Option<Late>,
}

#[derive(Deserialize)]
struct Late {
    #[serde(
        alias = "TimeOffsetSec_Device_Accel",
        alias = "TimeOffsetSec_Device_Gyro"
    )]
    late_s: Option<f64>,
}

fn notes(vrs: &Vrs, into: &mut Collected) {
    if let Some(began) = vrs.tags.get("capture_time_epoch") {
        into.notes
            .push(format!("recorded {began} s after the beginning of 1970"));
    }
    let Some(text) = vrs.tags.get("calib_json") else {
        return;
    };
    into.notes.push(
        "the glasses' own calibration is left out because a rig has no such lens model (FisheyeRadTanThinPrism); calibrate them, or give --rig".to_owned(),
    );
    let Ok(calibration) = serde_json::from_str::<Calibration>(text) else {
        return;
    };
    for imu in calibration.imu_calibrations {
        let late = |sensor: Option<Late>| sensor.and_then(|s| s.late_s).map(|s| s * 1e3);
        if let (Some(gyro_ms), Some(accel_ms)) = (late(imu.gyroscope), late(imu.accelerometer))
            && (gyro_ms, accel_ms) != (0.0, 0.0)
        {
            into.notes.push(format!(
                "{}: stamped when a sample was ready; according to the glasses' calibration it was measured {gyro_ms:.2} ms (gyroscope) and {accel_ms:.2} ms (accelerometer) earlier",
                imu.label
            ));
        }
    }
}
