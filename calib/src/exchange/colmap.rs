//! COLMAP's `cameras.txt` and `rig_config.json`. Its pixel (0, 0) is the corner of the first pixel, not its centre.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use lsfb_geometry::camera::{Lens, LensModel};
use lsfb_geometry::{Camera, Rig, Se3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    Exported, ExportedFile, ImportedRig, checked, exact, in_model, mounted, not_used, parse_error,
    quaternion,
};
use crate::Error;

/// From our pixels to COLMAP's.
const HALF_PIXEL: f64 = 0.5;

#[derive(Serialize, Deserialize)]
struct RigFile {
    cameras: Vec<RigMember>,
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

/// Reads `cameras.txt` and, where given, the first rig of `rig_config.json`, whose members are the cameras in the order of
/// their numbers; `path` names the former in errors. The first camera of the rig is the origin.
pub fn import_colmap(
    cameras: &str,
    rig_config: Option<&str>,
    path: &str,
) -> Result<ImportedRig, Error> {
    let mut found: Vec<Listed> = Vec::new();
    for (number, line) in cameras.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let camera =
            camera(line).map_err(|p| parse_error(path, format!("line {}: {p}", number + 1)))?;
        found.push(camera);
    }
    found.sort_by_key(|c| c.id);
    if found.is_empty() {
        return Err(parse_error(path, "no camera in it"));
    }
    let mut rig = Rig::empty("colmap");
    let Some(text) = rig_config else {
        for (k, listed) in found.into_iter().enumerate() {
            rig.cameras
                .insert(format!("cam{k}"), mounted(listed.camera, Se3::identity()));
        }
        let notes = vec!["no poses in it: all cameras are at the origin".to_owned()];
        return Ok(ImportedRig { rig, notes });
    };
    let fail = |problem: String| parse_error("rig_config.json", problem);
    let files: Vec<RigFile> = serde_json::from_str(text).map_err(|e| fail(e.to_string()))?;
    let mut notes = Vec::new();
    if files.len() > 1 {
        notes.push(format!(
            "rig_config.json has {} rigs: the first is taken",
            files.len()
        ));
    }
    let members = files
        .into_iter()
        .next()
        .map(|f| f.cameras)
        .unwrap_or_default();
    if members.len() != found.len() {
        return Err(fail(format!(
            "{} cameras in the rig, {} in {path}",
            members.len(),
            found.len()
        )));
    }
    for (member, listed) in members.into_iter().zip(found) {
        let name = member
            .image_prefix
            .trim_end_matches('/')
            .rsplit('/')
            .next()
            .unwrap_or_default()
            .to_owned();
        if !member.others.is_empty() {
            let names: Vec<&str> = member.others.keys().map(String::as_str).collect();
            notes.push(not_used(&name, &names));
        }
        let pose = match (
            member.cam_from_rig_rotation,
            member.cam_from_rig_translation,
        ) {
            _ if member.ref_sensor => Se3::identity(),
            (Some(q), Some(t)) => {
                let q = quaternion(q)
                    .ok_or_else(|| fail(format!("{name}: cam_from_rig_rotation has not norm 1")))?;
                Se3::new(q, Vector3::from(t)).inverse()
            }
            _ => return Err(fail(format!("{name}: it has no cam_from_rig"))),
        };
        if member
            .camera_params
            .is_some_and(|p| !same(&p, &listed.parameters))
        {
            notes.push(format!(
                "{name}: camera_params of rig_config.json differ from {path} and are not used"
            ));
        }
        rig.cameras.insert(name, mounted(listed.camera, pose));
    }
    Ok(ImportedRig { rig, notes })
}

/// Whether two lists of parameters are the same but for the rounding of their texts.
fn same(a: &[f64], b: &[f64]) -> bool {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9 * a.abs().max(1.0);
    a.len() == b.len() && a.iter().zip(b).all(near)
}

/// A line of `cameras.txt`.
struct Listed {
    id: u32,
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
    let camera = checked(Camera {
        width: count(width)?,
        height: count(height)?,
        lens: lens(model, &values)?,
    })?;
    Ok(Listed {
        id: count(id)?,
        camera,
        parameters: values,
    })
}

fn lens(model: &str, values: &[f64]) -> Result<Lens, String> {
    let (focals, distorted) = match model {
        "SIMPLE_PINHOLE" => (1, 0),
        "PINHOLE" => (2, 0),
        "SIMPLE_RADIAL" | "SIMPLE_RADIAL_FISHEYE" => (1, 1),
        "RADIAL" | "RADIAL_FISHEYE" => (1, 2),
        "OPENCV" | "OPENCV_FISHEYE" => (2, 4),
        "FULL_OPENCV" => (2, 8),
        "FOV" => (2, 1),
        other => return Err(format!("model {other} is not known")),
    };
    if values.len() != focals + 2 + distorted {
        return Err(format!(
            "{} parameters for {model}, expected {}",
            values.len(),
            focals + 2 + distorted
        ));
    }
    let (focal, rest) = values.split_at(focals);
    let focal_px = [focal[0], focal[focals - 1]];
    let principal_px = [rest[0] - HALF_PIXEL, rest[1] - HALF_PIXEL];
    let d = &rest[2..];
    let at = |k: usize| d.get(k).copied().unwrap_or(0.0);
    Ok(match model {
        "OPENCV_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" => Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [at(0), at(1), at(2), at(3)],
        },
        "FOV" => Lens::FieldOfView {
            focal_px,
            principal_px,
            distortion: [at(0)],
        },
        "FULL_OPENCV" if d[5..].iter().any(|k| *k != 0.0) => {
            return Err("rational distortion with k4 to k6 is not known".to_owned());
        }
        // k1 k2 p1 p2 k3, the latter three only of the OPENCV models.
        _ => Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [at(0), at(1), at(2), at(3), at(4)],
        },
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
        let ([fx, fy], [cx, cy]) = (camera.focal_px(), camera.principal_px());
        let pinhole = [fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL];
        let (model, distortion) = match camera.lens {
            Lens::PinholeRadtan {
                distortion: [0.0, 0.0, 0.0, 0.0, 0.0],
                ..
            } => ("PINHOLE", vec![]),
            Lens::PinholeRadtan {
                distortion: [k1, k2, p1, p2, 0.0],
                ..
            } => ("OPENCV", vec![k1, k2, p1, p2]),
            Lens::PinholeRadtan {
                distortion: [k1, k2, p1, p2, k3],
                ..
            } => ("FULL_OPENCV", vec![k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
            Lens::FieldOfView { distortion, .. } => ("FOV", distortion.to_vec()),
            lens => ("OPENCV_FISHEYE", lens.distortion().to_vec()),
        };
        let parameters = [&pinhole[..], &distortion].concat();
        let words: Vec<String> = parameters.iter().map(|v| exact(*v)).collect();
        // Writing to a String cannot fail.
        let _ = writeln!(
            cameras,
            "{} {model} {} {} {}",
            k + 1,
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
            camera_model_name: Some(model.to_owned()),
            camera_params: Some(parameters),
            others: BTreeMap::new(),
        });
    }
    out.files.push(ExportedFile {
        name: "cameras.txt".to_owned(),
        text: cameras,
    });
    // Names and numbers: nothing in it can fail.
    let text = serde_json::to_string_pretty(&[RigFile { cameras: members }]).unwrap_or_default();
    out.files.push(ExportedFile {
        name: "rig_config.json".to_owned(),
        text: text + "\n",
    });
    if rig.imu().is_some() || first.is_some_and(|f| f != Se3::identity()) {
        out.notes.push(
            "COLMAP's rig is its first camera: the pose in the IMU, noise and time offsets have no place".to_owned(),
        );
    }
    out
}
