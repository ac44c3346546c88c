//! COLMAP's `cameras.txt` and `rig_config.json`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use lsfb_geometry::camera::LensModel;
use lsfb_geometry::{Camera, Rig, Se3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    Exported, ExportedFile, ImportedRig, PosesOf, exact, in_model, mounted, not_used, parse_error,
    quaternion,
};
use crate::Error;

#[derive(Serialize, Deserialize)]
struct RigFile {
    cameras: Vec<RigMember>,
    #[serde(flatten)]
    others: BTreeMap<String, serde_json::Value>,
}

#[derive(Serialize, Deserialize)]
struct RigMember {
    image_prefix: String,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    ref_sensor: bool,
    /// w x y z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cam_from_rig_rotation: Option<[f64; 4]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cam_from_rig_translation: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    camera_model_name: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    camera_params: Option<Vec<f64>>,
    #[serde(flatten)]
    others: BTreeMap<String, serde_json::Value>,
}

/// Reads `cameras.txt` and, where given, the first rig of `rig_config.json`; `path` names the former in errors. A member whose
/// parameters are those of one camera is that camera; where they do not tell, members are the cameras in the order of their numbers.
/// The camera that the rig refers to is the origin.
pub fn import_colmap(
    cameras: &str,
    rig_config: Option<&str>,
    path: &str,
) -> Result<ImportedRig, Error> {
    let found = listed(cameras, path)?;
    let mut rig = Rig::empty("colmap");
    let Some(text) = rig_config else {
        for (k, listed) in found.into_iter().enumerate() {
            rig.cameras
                .insert(format!("cam{k}"), mounted(listed.camera, Se3::identity()));
        }
        return Ok(ImportedRig {
            rig,
            poses: PosesOf::Nothing,
            notes: vec!["it has no poses: all cameras are put at the origin".to_owned()],
        });
    };
    let fail = |problem: String| parse_error("rig_config.json", problem);
    let files: Vec<RigFile> = serde_json::from_str(text).map_err(|e| fail(e.to_string()))?;
    let mut notes = Vec::new();
    if files.len() > 1 {
        notes.push(format!(
            "rig_config.json has {} rigs: the first one is used",
            files.len()
        ));
    }
    let (members, others) = files
        .into_iter()
        .next()
        .map(|f| (f.cameras, f.others))
        .unwrap_or_default();
    if !others.is_empty() {
        let names: Vec<&str> = others.keys().map(String::as_str).collect();
        notes.push(not_used("rig_config.json", &names));
    }
    if members.len() != found.len() {
        return Err(fail(format!(
            "{} cameras in the rig, {} in {path}",
            members.len(),
            found.len()
        )));
    }
    let references = members.iter().filter(|m| m.ref_sensor).count();
    if references != 1 {
        return Err(fail(format!(
            "{references} of its cameras are the ref_sensor, expected 1"
        )));
    }
    let places = match places(&members, &found) {
        Some(places) => places,
        None => {
            if found.len() > 1 {
                notes.push(format!(
                    "the parameters do not tell which camera of {path} is which in rig_config.json: they are matched in the order of their numbers"
                ));
            }
            (0..found.len()).collect()
        }
    };
    for ((name, member), place) in names(&members).into_iter().zip(&members).zip(places) {
        if !member.others.is_empty() {
            let names: Vec<&str> = member.others.keys().map(String::as_str).collect();
            notes.push(not_used(&name, &names));
        }
        let pose = match (
            member.cam_from_rig_rotation,
            member.cam_from_rig_translation,
        ) {
            (None, None) if member.ref_sensor => Se3::identity(),
            _ if member.ref_sensor => {
                return Err(fail(format!(
                    "{name}: it is the ref_sensor, but has a cam_from_rig"
                )));
            }
            (Some(q), Some(t)) => {
                let q = quaternion(q).ok_or_else(|| {
                    fail(format!(
                        "{name}: the norm of cam_from_rig_rotation is not 1"
                    ))
                })?;
                Se3::new(q, Vector3::from(t)).inverse()
            }
            _ => return Err(fail(format!("{name}: it has no cam_from_rig"))),
        };
        let camera = found[place].camera;
        if rig
            .cameras
            .insert(name.clone(), mounted(camera, pose))
            .is_some()
        {
            return Err(fail(format!("a second camera named {name}")));
        }
    }
    Ok(ImportedRig {
        rig,
        poses: PosesOf::FirstCamera,
        notes,
    })
}

/// Names of a rig's members: the last folders of their images, or all of them where these are alike.
fn names(members: &[RigMember]) -> Vec<String> {
    let whole = |m: &RigMember| m.image_prefix.trim_matches('/').replace('/', "_");
    let last = |m: &RigMember| {
        let prefix = m.image_prefix.trim_end_matches('/');
        prefix.rsplit('/').next().unwrap_or_default().to_owned()
    };
    let short: Vec<String> = members.iter().map(last).collect();
    let is_new = |(k, name): (usize, &String)| !short[..k].contains(name);
    match short.iter().enumerate().all(is_new) {
        true => short,
        false => members.iter().map(whole).collect(),
    }
}

/// Which of the cameras each member is, by their parameters; `None` where these do not tell.
fn places(members: &[RigMember], found: &[Listed]) -> Option<Vec<usize>> {
    let mut places: Vec<usize> = Vec::with_capacity(members.len());
    for member in members {
        let parameters = member.camera_params.as_ref()?;
        let model = member.camera_model_name.as_deref();
        let is_alike = |listed: &Listed| {
            same(parameters, &listed.parameters) && model.is_none_or(|m| m == listed.model)
        };
        let alike: Vec<usize> = (0..found.len()).filter(|k| is_alike(&found[*k])).collect();
        // Which one of several that are the same does not matter.
        let first = &found[*alike.first()?];
        if alike.iter().any(|k| found[*k].camera != first.camera) {
            return None;
        }
        places.push(alike.into_iter().find(|k| !places.contains(k))?);
    }
    Some(places)
}

/// The cameras of `cameras.txt`, by their numbers.
fn listed(text: &str, path: &str) -> Result<Vec<Listed>, Error> {
    let mut found: Vec<Listed> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let fail = |problem: String| parse_error(path, format!("line {}: {problem}", number + 1));
        let camera = camera(line).map_err(fail)?;
        if found.iter().any(|other| other.id == camera.id) {
            return Err(fail(format!("a second camera {}", camera.id)));
        }
        found.push(camera);
    }
    found.sort_by_key(|c| c.id);
    match found.is_empty() {
        true => Err(parse_error(path, "it has no camera")),
        false => Ok(found),
    }
}

/// Whether two lists of parameters are the same but for the rounding of their texts.
fn same(a: &[f64], b: &[f64]) -> bool {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9 * a.abs().max(1.0);
    a.len() == b.len() && a.iter().zip(b).all(near)
}

/// A line of `cameras.txt`.
struct Listed {
    id: u32,
    model: String,
    camera: Camera,
    parameters: Vec<f64>,
}

fn camera(line: &str) -> Result<Listed, String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [id, model, width, height, values @ ..] = words.as_slice() else {
        return Err("expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS".to_owned());
    };
    let count = |w: &str| w.parse::<u32>().map_err(|_| format!("{w} is not a count"));
    let values: Vec<f64> = values
        .iter()
        .map(|w| w.parse().map_err(|_| format!("{w} is not a number")))
        .collect::<Result<_, String>>()?;
    let camera = Camera::from_colmap(model, [count(width)?, count(height)?], &values);
    Ok(Listed {
        id: count(id)?,
        model: (*model).to_owned(),
        camera: camera.map_err(|e| e.to_string())?,
        parameters: values,
    })
}

pub(super) fn export(rig: &Rig) -> Exported {
    let mut out = Exported::default();
    let mut cameras = String::from(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n",
    );
    let mut members = Vec::new();
    let mut first: Option<Se3> = None;
    for (k, (name, mounted)) in rig.cameras.iter().enumerate() {
        let camera = in_model(
            name,
            &mounted.camera,
            &[
                LensModel::PinholeRadtan,
                LensModel::KannalaBrandt,
                LensModel::FieldOfView,
            ],
            LensModel::KannalaBrandt,
            &mut out.notes,
        );
        // All of the models above are COLMAP's.
        let Some((model, parameters)) = camera.to_colmap() else {
            continue;
        };
        let words: Vec<String> = parameters.iter().map(|v| exact(*v)).collect();
        // Writing to a String cannot fail.
        let _ = writeln!(
            cameras,
            "{} {} {} {} {}",
            k + 1,
            model.name(),
            camera.width,
            camera.height,
            words.join(" ")
        );
        let rig_from_first = *first.get_or_insert(mounted.rig_from_camera);
        let pose = mounted.rig_from_camera.inverse() * rig_from_first;
        let q = pose.rotation.quaternion();
        let is_first = k == 0;
        members.push(RigMember {
            image_prefix: format!("{name}/"),
            ref_sensor: is_first,
            cam_from_rig_rotation: (!is_first).then_some([q.w, q.i, q.j, q.k]),
            cam_from_rig_translation: (!is_first).then_some(pose.translation.into()),
            camera_model_name: Some(model.name().to_owned()),
            camera_params: Some(parameters),
            others: BTreeMap::new(),
        });
    }
    out.files.push(ExportedFile {
        name: "cameras.txt".to_owned(),
        text: cameras,
    });
    // Names and numbers: nothing in it can fail.
    let text = serde_json::to_string_pretty(&[RigFile {
        cameras: members,
        others: BTreeMap::new(),
    }])
    .unwrap_or_default();
    out.files.push(ExportedFile {
        name: "rig_config.json".to_owned(),
        text: text + "\n",
    });
    if rig.imu().is_some() || first.is_some_and(|f| f != Se3::identity()) {
        out.notes.push(
            "COLMAP's rig is its first camera: the pose in the IMU frame, noise and time offsets are not written".to_owned(),
        );
    }
    out
}
