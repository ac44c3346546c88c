//! kapture 1.1 (its specification, `kapture_format.adoc`): poses take points of the world into the sensor or its rig, and those of `rigs.txt`
//! points of the rig into the sensor.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::Se3;

use super::lens::camera;
use super::listed::{Listed, pose};
use crate::Error;

pub(super) const SENSORS: &str = "sensors/sensors.txt";
/// Rigs on rigs on rigs: more of them is a circle.
const DEEPEST_RIG: usize = 8;

pub(super) fn read(folder: &Path) -> Result<Listed, Error> {
    let sensors = folder.join("sensors");
    let records = sensors.join("records_camera.txt");
    let mut listed = Listed::new(folder, &records);
    let own = folder.join(SENSORS);
    for row in Row::of(&own)? {
        if row.word(2) != Some("camera") {
            continue;
        }
        let fail = |why: String| row.refuse(&own, &why);
        let (Some(name), Some(model)) = (row.word(0), row.word(3)) else {
            return Err(fail("a camera needs a model".to_owned()));
        };
        let [width, height, parameters @ ..] = &row.words[4..] else {
            return Err(fail("a camera needs its size".to_owned()));
        };
        let side = |word: &str| word.parse::<f64>().ok().filter(|v| *v >= 1.0);
        let size = side(width)
            .zip(side(height))
            .map(|(w, h)| [w as u32, h as u32]);
        let size = size.ok_or_else(|| fail("a camera needs its size".to_owned()))?;
        let parameters: Option<Vec<f64>> = parameters.iter().map(|w| w.parse().ok()).collect();
        let parameters =
            parameters.ok_or_else(|| fail("a parameter of the lens is not a number".to_owned()))?;
        let found = camera(model, size, &parameters).map_err(fail)?;
        listed.add_camera(name, found)?;
    }
    let in_rig = in_rigs(&sensors.join("rigs.txt"))?;
    for camera in in_rig.keys() {
        let (_, camera_from_rig) = outermost(camera, &in_rig);
        listed.mount(camera, camera_from_rig.inverse());
    }
    let poses = trajectories(&sensors.join("trajectories.txt"))?;
    for row in Row::of(&records)? {
        let (Some(time), Some(name), Some(file)) = (row.word(0), row.word(1), row.word(2)) else {
            return Err(row.refuse(&records, "expected timestamp, device_id, image_path"));
        };
        if !listed.has_camera(name) {
            return Err(row.refuse(&records, &format!("camera {name} is not in sensors.txt")));
        }
        let pose = camera_from_world(time, name, &poses, &in_rig);
        let pose = pose.map(|pose| pose.inverse());
        let file = sensors.join("records_data").join(file);
        let (rig, _) = outermost(name, &in_rig);
        // A pose of the camera's own may be another than its rig's.
        let has_own = poses.contains_key(&(time.to_owned(), name.to_owned()));
        if rig == name || has_own {
            listed.add_image(file, name, pose);
        } else {
            listed.add_image_of_rig(file, name, pose, (rig.to_owned(), time.to_owned()));
        }
    }
    Ok(listed)
}

/// By the stamp as it is written, and the device.
type Poses = BTreeMap<(String, String), Se3>;
/// Of each sensor the rig and `sensor_from_rig`.
type InRig = BTreeMap<String, (String, Se3)>;

fn camera_from_world(time: &str, camera: &str, poses: &Poses, in_rig: &InRig) -> Option<Se3> {
    let (mut device, mut camera_from_device) = (camera, Se3::identity());
    for _ in 0..DEEPEST_RIG {
        if let Some(device_from_world) = poses.get(&(time.to_owned(), device.to_owned())) {
            return Some(camera_from_device * *device_from_world);
        }
        let (rig, device_from_rig) = in_rig.get(device)?;
        camera_from_device = camera_from_device * *device_from_rig;
        device = rig;
    }
    None
}

/// The rig on which a device is in the end, itself where it is on none, and `device_from_rig`.
fn outermost<'a>(mut device: &'a str, in_rig: &'a InRig) -> (&'a str, Se3) {
    let mut device_from_rig = Se3::identity();
    for _ in 0..DEEPEST_RIG {
        let Some((rig, inner_from_outer)) = in_rig.get(device) else {
            break;
        };
        device_from_rig = device_from_rig * *inner_from_outer;
        device = rig;
    }
    (device, device_from_rig)
}

fn in_rigs(path: &Path) -> Result<InRig, Error> {
    let mut found = InRig::new();
    if !path.is_file() {
        return Ok(found);
    }
    for row in Row::of(path)? {
        let (Some(rig), Some(sensor)) = (row.word(0), row.word(1)) else {
            return Err(row.refuse(path, "expected rig_id, sensor_id and a pose"));
        };
        let pose = row.pose(path)?;
        let pose = pose.ok_or_else(|| row.refuse(path, "the pose is missing"))?;
        found.insert(sensor.to_owned(), (rig.to_owned(), pose));
    }
    Ok(found)
}

fn trajectories(path: &Path) -> Result<Poses, Error> {
    let mut found = Poses::new();
    // A kapture of images without poses lacks the file.
    if !path.is_file() {
        return Ok(found);
    }
    for row in Row::of(path)? {
        let (Some(time), Some(device)) = (row.word(0), row.word(1)) else {
            return Err(row.refuse(path, "expected timestamp, device_id and a pose"));
        };
        // What is not known of a pose is left empty.
        if let Some(pose) = row.pose(path)? {
            found.insert((time.to_owned(), device.to_owned()), pose);
        }
    }
    Ok(found)
}

/// A line of a list.
struct Row {
    /// From 1.
    line: usize,
    words: Vec<String>,
}

impl Row {
    fn of(path: &Path) -> Result<Vec<Self>, Error> {
        let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
        let lines = text.lines().enumerate();
        let rows = lines.filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
        Ok(rows
            .map(|(index, line)| Self {
                line: index + 1,
                words: line.split(',').map(|word| word.trim().to_owned()).collect(),
            })
            .collect())
    }

    /// `None` where it is missing or empty.
    fn word(&self, index: usize) -> Option<&str> {
        let word = self.words.get(index).map(String::as_str);
        word.filter(|word| !word.is_empty())
    }

    /// qw qx qy qz tx ty tz behind two words; `None` where one of them is left empty.
    fn pose(&self, path: &Path) -> Result<Option<Se3>, Error> {
        let mut numbers = [0.0; 7];
        for (number, index) in numbers.iter_mut().zip(2..) {
            let Some(word) = self.word(index) else {
                return Ok(None);
            };
            let parsed = word.parse();
            *number = parsed.map_err(|_| self.refuse(path, &format!("{word} is not a number")))?;
        }
        let [w, x, y, z, t @ ..] = numbers;
        let found = pose([w, x, y, z], t);
        let found = found.ok_or_else(|| self.refuse(path, "the pose is not a rigid transform"))?;
        Ok(Some(found))
    }

    fn refuse(&self, path: &Path, why: &str) -> Error {
        Error::PosedLayout {
            path: path.to_owned(),
            reason: format!("line {}: {why}", self.line),
        }
    }
}
