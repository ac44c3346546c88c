//! A sequence as a session of LaMAR's capture format: lists of records by sensor, poses out of the sensor into what holds it, stamps in
//! microseconds. Format: microsoft/lamar-benchmark, `CAPTURE.md`, and naver/kapture, `kapture_format.adoc`.

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

/// The text files of a session, by name. `cameras` are the rows of `sensors.txt` behind the name of each camera of the rig, in its order:
/// COLMAP's model, size and parameters. Images lie in `raw_data/CAMERA/<ns>.png`.
pub fn lamar_session(
    recording: &Recording,
    rig: &Rig,
    cameras: &[String],
    truth: &[StampedPose],
) -> Result<Vec<(&'static str, String)>, Error> {
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
        "# timestamp, sensor_id, mac_addr, frequency, rssi, name, scan_time_start, scan_time_end\n"
            .to_owned();
    let mut bt = "# timestamp, sensor_id, mac_addr, rssi, name\n".to_owned();
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
                    heard.frequency_mhz,
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
                let sender = match heard.address.is_empty() {
                    true => format!("{}:{}:{}", heard.uuid, heard.major, heard.minor),
                    false => heard.address.clone(),
                };
                let _ = writeln!(
                    bt,
                    "{}, bt, {}, {}, ",
                    micros(advert.time),
                    word(&sender),
                    heard.rssi_dbm
                );
            }
        }
    }
    Ok(vec![
        ("sensors.txt", sensors),
        ("rigs.txt", rigs),
        ("trajectories.txt", trajectories),
        ("images.txt", images),
        ("wifi.txt", wifi),
        ("bt.txt", bt),
    ])
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
