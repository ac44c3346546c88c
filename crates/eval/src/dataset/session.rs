//! A sequence as a session of LaMAR's capture format: lists of records by sensor, poses out of the sensor into what holds it, stamps in
//! microseconds. Format: microsoft/lamar-benchmark, `CAPTURE.md` and the readers in `scantools/capture/`, which want kilohertz and of
//! Bluetooth iBeacons alone, and naver/kapture, `kapture_format.adoc`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use lsfb_geometry::{Rig, Se3, StampedPose, Trajectory};
use lsfb_recording::{Recording, message};
use lsfb_types::Timestamp;

use crate::Error;
use crate::slam_bench::camera_name;

/// What holds all sensors.
const RIG: &str = "rig";
const US: i64 = 1000;

/// A session.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LamarSession {
    /// Its text files, by name.
    pub files: Vec<(&'static str, String)>,
    /// Bluetooth advertisements that are none of an iBeacon: the format has no place for them.
    pub without_beacon: usize,
}

/// The text files of a session. `cameras` are the rows of `sensors.txt` behind the name of each camera of the rig, in its order:
/// COLMAP's model, size and parameters. Images lie in `raw_data/CAMERA/<ns>.png`.
pub fn lamar_session(
    recording: &Recording,
    rig: &Rig,
    cameras: &[String],
    truth: &[StampedPose],
) -> Result<LamarSession, Error> {
    let mut sensors = "# sensor_id, name, sensor_type, [sensor_params]+\n".to_owned();
    let mut rigs = "# rig_id, sensor_id, qw, qx, qy, qz, tx, ty, tz\n".to_owned();
    for ((name, mounted), camera) in rig.cameras.iter().zip(cameras) {
        // Writing into a string cannot fail.
        let _ = writeln!(sensors, "{name}, , camera, {camera}");
        let _ = writeln!(rigs, "{RIG}, {name}, {}", pose(&mounted.rig_from_camera));
    }
    // Its readers look poses up by the very stamps of images.
    let placed = Trajectory::new(truth.to_vec());
    let mut poses: BTreeMap<i64, Se3> = truth
        .iter()
        .map(|place| (micros(place.time), place.world_from_rig))
        .collect();
    let mut images: Vec<(i64, String)> = Vec::new();
    let topics = recording.topics().iter().filter(|t| t.messages > 0);
    for topic in topics.clone().filter(|t| t.schema == message::IMAGE.name) {
        let camera = camera_name(&topic.topic);
        // Its own clock may not be the rig's.
        let mounted = rig.cameras.get(camera);
        let shift_s = mounted.map_or(0.0, |mounted| mounted.timing.rig_from_camera_s);
        for image in recording.images(&topic.topic)? {
            let own = image?.time;
            let time = own.plus_secs(shift_s);
            let at = micros(time);
            if let Some(world_from_rig) = placed.at(time) {
                poses.insert(at, world_from_rig);
            }
            images.push((at, format!("{at}, {camera}, {camera}/{}.png", own.nanos())));
        }
    }
    images.sort();
    let mut trajectories =
        "# timestamp, device_id, qw, qx, qy, qz, tx, ty, tz, *covar\n".to_owned();
    for (at, world_from_rig) in poses {
        let _ = writeln!(trajectories, "{at}, {RIG}, {}", pose(&world_from_rig));
    }
    let rows = images.iter().map(|(_, row)| format!("{row}\n"));
    let images: String = std::iter::once("# timestamp, sensor_id, image_path\n".to_owned())
        .chain(rows)
        .collect();
    let mut wifi =
        "# timestamp, sensor_id, mac_addr, frequency_khz, rssi_dbm, name, scan_time_start_us, scan_time_end_us\n"
            .to_owned();
    let mut bt = "# timestamp, sensor_id, id, rssi_dbm, name\n".to_owned();
    let mut without_beacon = 0;
    for topic in topics {
        if topic.schema == message::WIFI_READING.name {
            let _ = writeln!(sensors, "wifi, , wifi");
            for reading in recording.wifi(Some(&topic.topic))? {
                let reading = reading?;
                let (heard, at) = (&reading.sample, micros(reading.time));
                let _ = writeln!(
                    wifi,
                    "{at}, wifi, {}, {}, {}, {}, {at}, {at}",
                    word(&heard.bssid),
                    u64::from(heard.frequency_mhz) * 1000,
                    heard.rssi_dbm,
                    word(&heard.ssid)
                );
            }
        }
        if topic.schema == message::BLE_ADVERT.name {
            let _ = writeln!(sensors, "bt, , bluetooth");
            for advert in recording.ble(Some(&topic.topic))? {
                let advert = advert?;
                let heard = &advert.sample;
                if heard.uuid.is_empty() {
                    without_beacon += 1;
                    continue;
                }
                let _ = writeln!(
                    bt,
                    "{}, bt, {}:{}:{}, {}, ",
                    micros(advert.time),
                    word(&heard.uuid),
                    heard.major,
                    heard.minor,
                    heard.rssi_dbm
                );
            }
        }
    }
    let files = vec![
        ("sensors.txt", sensors),
        ("rigs.txt", rigs),
        ("trajectories.txt", trajectories),
        ("images.txt", images),
        ("wifi.txt", wifi),
        ("bt.txt", bt),
    ];
    Ok(LamarSession {
        files,
        without_beacon,
    })
}

/// To the nearest microsecond.
fn micros(time: Timestamp) -> i64 {
    (time.nanos() + US / 2).div_euclid(US)
}

fn pose(of: &Se3) -> String {
    let (q, t) = (of.rotation.quaternion(), of.translation);
    format!(
        "{}, {}, {}, {}, {}, {}, {}",
        q.w, q.i, q.j, q.k, t.x, t.y, t.z
    )
}

/// A name that stays in its cell.
fn word(name: &str) -> String {
    name.replace(|c: char| c == ',' || c == '"' || c.is_control(), "_")
}

#[cfg(test)]
mod tests {
    use lsfb_recording::message::{BleAdvert, Schema, WifiReading};
    use lsfb_recording::{Channel, Writer, WriterConfig};

    use super::*;

    /// LaMAR's own readers refuse a session with another sender than an iBeacon, and take megahertz for kilohertz.
    #[test]
    fn radio_is_as_its_readers_want_it() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("walk.mcap");
        let mut writer = Writer::create(&path, &WriterConfig::default()).expect("a file");
        let time = Timestamp::from_nanos(1_700_000_000_123_456_789);
        let mut put = |topic: &str, schema: Schema, bytes: &[u8]| {
            let channel = Channel {
                topic,
                schema_name: schema.name,
                schema_text: schema.text,
            };
            writer
                .write_cdr(&channel, time, time, bytes)
                .expect("written");
        };
        let wifi = WifiReading {
            bssid: "02:00:5e:00:00:01".to_owned(),
            ssid: "net, one".to_owned(),
            frequency_mhz: 5180,
            rssi_dbm: -61,
            ..WifiReading::default()
        };
        put(
            "/sidecar/phone/wifi",
            message::WIFI_READING,
            &message::encode_wifi(time, "wifi", &wifi),
        );
        let beacon = BleAdvert {
            address: "02:00:5e:00:00:02".to_owned(),
            uuid: "e2c56db5-dffb-48d2-b060-d0f5a71096e0".to_owned(),
            major: 7,
            minor: 9,
            rssi_dbm: -70,
            ..BleAdvert::default()
        };
        let watch = BleAdvert {
            address: "02:00:5e:00:00:03".to_owned(),
            ..BleAdvert::default()
        };
        for advert in [&beacon, &watch] {
            let bytes = message::encode_ble(time, "ble", advert);
            put("/sidecar/phone/ble", message::BLE_ADVERT, &bytes);
        }
        writer.finish().expect("finished");
        let recording = Recording::open(&path).expect("recording");
        let rig = Rig {
            name: "phone".to_owned(),
            calibrated_unix_s: None,
            cameras: BTreeMap::new(),
            imus: BTreeMap::new(),
            lidars: BTreeMap::new(),
        };
        let session = lamar_session(&recording, &rig, &[], &[]).expect("a session");
        assert_eq!(session.without_beacon, 1);
        let rows = |wanted: &str| {
            let file = session.files.iter().find(|(name, _)| *name == wanted);
            let (_, text) = file.expect(wanted);
            text.lines().skip(1).map(str::to_owned).collect::<Vec<_>>()
        };
        let at = 1_700_000_000_123_457_i64;
        assert_eq!(
            rows("wifi.txt"),
            [format!(
                "{at}, wifi, 02:00:5e:00:00:01, 5180000, -61, net_ one, {at}, {at}"
            )]
        );
        assert_eq!(
            rows("bt.txt"),
            [format!(
                "{at}, bt, e2c56db5-dffb-48d2-b060-d0f5a71096e0:7:9, -70, "
            )]
        );
    }
}
