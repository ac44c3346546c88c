//! Kalibr's camera chain and IMU files.

mod link;
mod write;

use std::collections::BTreeMap;

use lsfb_geometry::{ImuNoiseModel, Rig, Se3};
use serde::Deserialize;

use super::yaml::{self, Others};
use super::{ImportedImu, ImportedRig, PosesOf, mounted, parse_error};
use crate::Error;
use link::{Link, camera};

pub(super) use write::export;
pub use write::{ChainOrigin, camera_chain, imu_to_kalibr};

#[derive(Deserialize)]
struct ImuFile {
    accelerometer_noise_density: f64,
    accelerometer_random_walk: f64,
    gyroscope_noise_density: f64,
    gyroscope_random_walk: f64,
    #[serde(rename = "rostopic")]
    _topic: Option<String>,
    #[serde(rename = "update_rate")]
    _rate_hz: Option<f64>,
    #[serde(flatten)]
    others: Others,
}

/// Reads a camera chain, with or without the IMU; `path` names it in errors. Where no pose to an IMU is given the first camera
/// is the origin.
pub fn import_kalibr(text: &str, path: &str) -> Result<ImportedRig, Error> {
    let keys: Others = yaml::read(text, path)?;
    if let Some(problem) = no_chain(&keys) {
        return Err(parse_error(path, problem));
    }
    let chain: BTreeMap<String, Link> = yaml::read(text, path)?;
    let mut links: Vec<(u32, Link)> = Vec::new();
    for (name, link) in chain {
        let number = name.strip_prefix("cam").and_then(|n| n.parse().ok());
        let number = number
            .ok_or_else(|| parse_error(path, format!("{name}: expected cam0, cam1 and so on")))?;
        links.push((number, link));
    }
    links.sort_by_key(|l| l.0);
    let mut rig = Rig::empty("kalibr");
    let mut notes = Vec::new();
    let mut before: Option<Se3> = None;
    let has_imu = links.iter().any(|(_, l)| l.has_imu());
    for (number, link) in links {
        let name = format!("cam{number}");
        let fail = |problem: String| parse_error(path, format!("{name}: {problem}"));
        let (camera, miss_px) = camera(&link).map_err(fail)?;
        if miss_px > 0.0 {
            notes.push(format!(
                "{name}: the omni lens is converted to {}, with an error of up to {miss_px:.3} px",
                camera.lens.model().name()
            ));
        }
        let rig_from_camera = match (link.rig_from_camera(before).map_err(fail)?, before) {
            (Some(pose), _) => pose,
            (None, None) if !has_imu => {
                notes.push(format!(
                    "it has no pose relative to an IMU (T_cam_imu or T_imu_cam): {name} becomes the origin"
                ));
                Se3::identity()
            }
            _ => {
                return Err(fail(
                    "it has no pose: expected T_cam_imu, T_imu_cam or T_cn_cnm1".to_owned(),
                ));
            }
        };
        notes.extend(yaml::unused(&name, &link.others));
        before = Some(rig_from_camera);
        let mut mounted = mounted(camera, rig_from_camera);
        mounted.timing = link.timing(&name, &mut notes).map_err(fail)?;
        if rig.cameras.insert(name.clone(), mounted).is_some() {
            return Err(parse_error(path, format!("a second camera named {name}")));
        }
    }
    if rig.cameras.is_empty() {
        return Err(parse_error(path, "it has no camera"));
    }
    let poses = match has_imu {
        true => PosesOf::Imu,
        false => PosesOf::FirstCamera,
    };
    Ok(ImportedRig { rig, poses, notes })
}

/// Why a file with these keys is no camera chain, where none of them is a camera's.
fn no_chain(keys: &Others) -> Option<String> {
    let is_camera = |key: &String| {
        let number = key.strip_prefix("cam");
        number.is_some_and(|n| n.starts_with(|c: char| c.is_ascii_digit()))
    };
    if keys.is_empty() || keys.keys().any(is_camera) {
        return None;
    }
    let has = |words: &[&str]| keys.keys().any(|key| words.iter().any(|w| key.contains(w)));
    let looks_like = match () {
        () if has(&["body_T_cam", "num_of_cam"]) => {
            "; these are settings of VINS-Fusion, which names its cameras' files: use `lsfb calib import ros` for those in OpenCV's format"
        }
        () if has(&["Camera.fx", "Camera1.fx", "Camera.type", "ORBextractor"]) => {
            "; these are settings of ORB-SLAM, which are not supported"
        }
        () if has(&["noise_density"]) => {
            "; this is an IMU's file, which must come after the camera chain or with --rig"
        }
        () if has(&["camera_matrix", "distortion_coefficients"]) || keys.contains_key("K") => {
            "; this is a lens in the format of ROS and OpenCV: use `lsfb calib import ros`"
        }
        () => "",
    };
    Some(format!(
        "not a camera chain of Kalibr or OpenVINS, whose keys are cam0, cam1 and so on{looks_like}"
    ))
}

/// Reads the noise of an IMU: the file that Kalibr is given, which is flat, or that of its calibration, which names the IMU first.
pub fn import_kalibr_imu(text: &str, path: &str) -> Result<ImportedImu, Error> {
    let keys: Others = yaml::read(text, path)?;
    let mut notes = Vec::new();
    let is_flat = keys.keys().any(|key| key.contains("noise_density"));
    let (name, file) = match is_flat {
        true => ("imu".to_owned(), yaml::read(text, path)?),
        false => {
            let imus: BTreeMap<String, ImuFile> = yaml::read(text, path)?;
            let mut imus = imus.into_iter();
            let first = imus
                .next()
                .ok_or_else(|| parse_error(path, "it has no IMU"))?;
            for (other, _) in imus {
                notes.push(format!(
                    "{other} is not used: a rig has one IMU, and {} was taken",
                    first.0
                ));
            }
            first
        }
    };
    let mut others = file.others;
    // An IMU whose axes are taken as they are.
    if others.get("model").and_then(|m| m.as_str()) == Some("calibrated") {
        others.remove("model");
    }
    notes.extend(yaml::unused(&name, &others));
    let noise = ImuNoiseModel {
        gyro_noise_density: file.gyroscope_noise_density,
        accel_noise_density: file.accelerometer_noise_density,
        gyro_bias_walk: file.gyroscope_random_walk,
        accel_bias_walk: file.accelerometer_random_walk,
    };
    Ok(ImportedImu { noise, notes })
}
