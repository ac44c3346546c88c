//! A rig as TOML. The text names the calibration, so that it is written value by value and equal rigs give equal bytes.

use std::collections::BTreeMap;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use toml::Table;

use super::{
    CameraSigmas, ImuNoiseModel, MAIN_IMU, MAIN_LIDAR, Rig, RigCamera, RigImu, RigLidar, is_sigma,
};
use crate::Se3;

/// A rig as its file says it: an IMU or a LiDAR that is alone and has the usual name stands in `[imu]` or `[lidar]`.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RigFile {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    calibrated_unix_s: Option<i64>,
    #[serde(default)]
    cameras: BTreeMap<String, RigCamera>,
    imu: Option<RigImu>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    imus: BTreeMap<String, RigImu>,
    lidar: Option<RigLidar>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    lidars: BTreeMap<String, RigLidar>,
}

impl TryFrom<RigFile> for Rig {
    type Error = String;

    fn try_from(file: RigFile) -> Result<Self, String> {
        for (name, camera) in &file.cameras {
            check_sigmas(name, camera)?;
        }
        let rig = Self {
            name: file.name,
            calibrated_unix_s: file.calibrated_unix_s,
            cameras: file.cameras,
            imus: joined(file.imu, file.imus, ("imu", MAIN_IMU))?,
            lidars: joined(file.lidar, file.lidars, ("lidar", MAIN_LIDAR))?,
        };
        match rig.main_imu() {
            Some((name, imu)) if imu.rig_from_imu != Se3::identity() => Err(format!(
                "{name} is the main IMU, whose frame is the rig's: it has no rig_from_imu"
            )),
            _ => Ok(rig),
        }
    }
}

fn check_sigmas(name: &str, camera: &RigCamera) -> Result<(), String> {
    let stated = camera.sigmas.entries();
    let stated = stated
        .iter()
        .filter_map(|(entry, values)| Some((entry, values.as_ref()?)));
    for (entry, values) in stated {
        if let Some(wrong) = values.iter().find(|sigma| !is_sigma(**sigma)) {
            return Err(format!(
                "{entry} = {wrong} in cameras.{name}.sigmas: a standard deviation must be above zero; leave out unknown ones"
            ));
        }
    }
    Ok(())
}

/// Both ways to write a sensor, in one list.
fn joined<T>(
    alone: Option<T>,
    mut listed: BTreeMap<String, T>,
    (table, name): (&str, &str),
) -> Result<BTreeMap<String, T>, String> {
    if let Some(sensor) = alone
        && listed.insert(name.to_owned(), sensor).is_some()
    {
        return Err(format!(
            "[{table}] and [{table}s.{name}] are the same sensor"
        ));
    }
    Ok(listed)
}

impl From<Rig> for RigFile {
    fn from(mut rig: Rig) -> Self {
        let imu = is_alone(&rig.imus, MAIN_IMU).then(|| rig.imus.remove(MAIN_IMU));
        let lidar = is_alone(&rig.lidars, MAIN_LIDAR).then(|| rig.lidars.remove(MAIN_LIDAR));
        Self {
            name: rig.name,
            calibrated_unix_s: rig.calibrated_unix_s,
            cameras: rig.cameras,
            imu: imu.flatten(),
            imus: rig.imus,
            lidar: lidar.flatten(),
            lidars: rig.lidars,
        }
    }
}

fn is_alone<T>(sensors: &BTreeMap<String, T>, name: &str) -> bool {
    sensors.len() == 1 && sensors.contains_key(name)
}

/// An IMU as the file says it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ImuTable {
    gyro_noise_density: f64,
    accel_noise_density: f64,
    gyro_bias_walk: f64,
    accel_bias_walk: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rig_from_imu: Option<pose_as_table::PoseTable>,
}

impl TryFrom<ImuTable> for RigImu {
    type Error = String;

    fn try_from(table: ImuTable) -> Result<Self, String> {
        Ok(Self {
            rig_from_imu: match table.rig_from_imu {
                Some(pose) => pose.pose()?,
                None => Se3::identity(),
            },
            noise: ImuNoiseModel {
                gyro_noise_density: table.gyro_noise_density,
                accel_noise_density: table.accel_noise_density,
                gyro_bias_walk: table.gyro_bias_walk,
                accel_bias_walk: table.accel_bias_walk,
            },
        })
    }
}

impl From<RigImu> for ImuTable {
    fn from(imu: RigImu) -> Self {
        let pose = (imu.rig_from_imu != Se3::identity()).then_some(imu.rig_from_imu);
        Self {
            gyro_noise_density: imu.noise.gyro_noise_density,
            accel_noise_density: imu.noise.accel_noise_density,
            gyro_bias_walk: imu.noise.gyro_bias_walk,
            accel_bias_walk: imu.noise.accel_bias_walk,
            rig_from_imu: pose.as_ref().map(pose_as_table::PoseTable::from),
        }
    }
}

impl Rig {
    /// The TOML text: the same for equal rigs, and again the same after it was read back, so that its hash names the
    /// calibration. Built value by value, so that nothing in it can fail.
    pub fn to_toml(&self) -> String {
        let mut rig = Table::new();
        rig.insert("name".into(), self.name.clone().into());
        if let Some(time) = self.calibrated_unix_s {
            rig.insert("calibrated_unix_s".into(), time.into());
        }
        insert_sensors(&mut rig, &self.imus, ("imu", MAIN_IMU), RigImu::table);
        insert_sensors(
            &mut rig,
            &self.lidars,
            ("lidar", MAIN_LIDAR),
            RigLidar::table,
        );
        let cameras: Table = self
            .cameras
            .iter()
            .map(|(name, camera)| (name.clone(), camera.table().into()))
            .collect();
        rig.insert("cameras".into(), cameras.into());
        rig.to_string()
    }
}

/// Writes `[imu]` for an IMU that is alone and has the usual name, `[imus.<name>]` for others; likewise LiDARs.
fn insert_sensors<T>(
    rig: &mut Table,
    sensors: &BTreeMap<String, T>,
    (key, usual_name): (&str, &str),
    table: impl Fn(&T) -> Table,
) {
    match sensors.get(usual_name) {
        _ if sensors.is_empty() => {}
        Some(sensor) if sensors.len() == 1 => {
            rig.insert(key.to_owned(), table(sensor).into());
        }
        _ => {
            let all = sensors
                .iter()
                .map(|(name, sensor)| (name.clone(), table(sensor).into()));
            rig.insert(format!("{key}s"), all.collect::<Table>().into());
        }
    }
}

impl RigImu {
    fn table(&self) -> Table {
        let mut table = numbers(&[
            ("gyro_noise_density", self.noise.gyro_noise_density),
            ("accel_noise_density", self.noise.accel_noise_density),
            ("gyro_bias_walk", self.noise.gyro_bias_walk),
            ("accel_bias_walk", self.noise.accel_bias_walk),
        ]);
        if self.rig_from_imu != Se3::identity() {
            table.insert("rig_from_imu".into(), pose(&self.rig_from_imu).into());
        }
        table
    }
}

impl RigLidar {
    fn table(&self) -> Table {
        let mut table = numbers(&[("range_noise_m", self.range_noise_m)]);
        table.insert("rig_from_lidar".into(), pose(&self.rig_from_lidar).into());
        table
    }
}

impl RigCamera {
    fn table(&self) -> Table {
        let lens = &self.camera.lens;
        let mut lens_table = Table::new();
        lens_table.insert("model".into(), lens.model().name().into());
        lens_table.insert("focal_px".into(), lens.focal_px().to_vec().into());
        lens_table.insert("principal_px".into(), lens.principal_px().to_vec().into());
        lens_table.insert("distortion".into(), lens.distortion().to_vec().into());
        let mut camera = Table::new();
        camera.insert("width".into(), self.camera.width.into());
        camera.insert("height".into(), self.camera.height.into());
        camera.insert("lens".into(), lens_table.into());
        let mut mounted = Table::new();
        mounted.insert("camera".into(), camera.into());
        mounted.insert("rig_from_camera".into(), pose(&self.rig_from_camera).into());
        if !self.timing.is_ideal() {
            let timing = [
                ("rig_from_camera_s", self.timing.rig_from_camera_s),
                ("readout_s", self.timing.readout_s),
            ];
            mounted.insert("timing".into(), numbers(&timing).into());
        }
        if !self.sigmas.are_unknown() {
            mounted.insert("sigmas".into(), sigmas(&self.sigmas).into());
        }
        mounted
    }
}

fn sigmas(sigmas: &CameraSigmas) -> Table {
    let stated = sigmas.entries().into_iter();
    let stated = stated.filter_map(|(entry, values)| {
        let values = values?;
        let value = match values.as_slice() {
            [one] => (*one).into(),
            _ => values.into(),
        };
        Some((entry.to_owned(), value))
    });
    stated.collect()
}

fn numbers(entries: &[(&str, f64)]) -> Table {
    entries
        .iter()
        .map(|(name, value)| ((*name).to_owned(), (*value).into()))
        .collect()
}

/// A quaternion made a unit; one that is a unit but for rounding stays to the last bit, so that what was written is what is
/// read.
fn unit(q: Quaternion<f64>) -> UnitQuaternion<f64> {
    if (q.norm() - 1.0).abs() < 1e-12 {
        UnitQuaternion::new_unchecked(q)
    } else {
        UnitQuaternion::new_normalize(q)
    }
}

fn pose(pose: &Se3) -> Table {
    let rotation_xyzw = unit(*pose.rotation.quaternion()).coords.as_slice().to_vec();
    let translation_m = pose.translation.as_slice().to_vec();
    Table::from_iter([
        ("rotation_xyzw".to_owned(), toml::Value::from(rotation_xyzw)),
        ("translation_m".to_owned(), translation_m.into()),
    ])
}

/// `{ rotation_xyzw = [..], translation_m = [..] }`
pub(super) mod pose_as_table {
    use super::*;
    use serde::{Deserializer, Serializer, de::Error};

    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct PoseTable {
        rotation_xyzw: [f64; 4],
        translation_m: [f64; 3],
    }

    impl PoseTable {
        pub fn pose(&self) -> Result<Se3, String> {
            let [x, y, z, w] = self.rotation_xyzw;
            let q = Quaternion::new(w, x, y, z);
            if !((q.norm() - 1.0).abs() < 1e-3) {
                return Err(format!("rotation_xyzw has norm {}, expected 1", q.norm()));
            }
            Ok(Se3::new(unit(q), Vector3::from(self.translation_m)))
        }
    }

    impl From<&Se3> for PoseTable {
        fn from(pose: &Se3) -> Self {
            let q = pose.rotation.quaternion();
            Self {
                rotation_xyzw: [q.i, q.j, q.k, q.w],
                translation_m: pose.translation.into(),
            }
        }
    }

    pub fn serialize<S: Serializer>(pose: &Se3, serializer: S) -> Result<S::Ok, S::Error> {
        PoseTable::from(pose).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Se3, D::Error> {
        PoseTable::deserialize(deserializer)?
            .pose()
            .map_err(D::Error::custom)
    }
}
