//! nerfstudio's `transforms.json` (its documentation, "Data conventions"), and that of the NeRF paper's scenes, which has `camera_angle_x`
//! alone. Poses are `world_from_camera` in OpenGL's axes: y up, looking along −z.

use std::path::{Path, PathBuf};

use lsfb_geometry::{Camera, Matrix3, Se3, Vector3, so3};
use lsfb_perception::image;
use serde_json::{Map, Value};

use super::ROTATION_ROUNDING;
use super::lens::camera;
use super::listed::Listed;
use crate::Error;

pub(super) const FILE: &str = "transforms.json";
/// What the NeRF paper's scenes leave away.
const EXTENSION: &str = "png";

type Object = Map<String, Value>;

pub(super) fn read(folder: &Path) -> Result<Listed, Error> {
    let path = folder.join(FILE);
    let text = std::fs::read_to_string(&path).map_err(Error::io(&path))?;
    let mut listed = Listed::new(folder, &path);
    let whole: Object = serde_json::from_str(&text)
        .map_err(|e| listed.refuse(format!("not a JSON object: {e}")))?;
    let frames = whole.get("frames").and_then(Value::as_array);
    let frames = frames.ok_or_else(|| listed.refuse("it has no list named frames"))?;
    for (number, frame) in frames.iter().enumerate() {
        let fail = |listed: &Listed, why: &str| listed.refuse(format!("frame {number}: {why}"));
        let frame = frame.as_object();
        let frame = frame.ok_or_else(|| fail(&listed, "it is not an object"))?;
        let name = frame.get("file_path").and_then(Value::as_str);
        let name = name.ok_or_else(|| fail(&listed, "it has no file_path"))?;
        let file = image_file(folder, name);
        let pose = match frame.get("transform_matrix") {
            None => None,
            Some(matrix) => Some(world_from_camera(matrix).ok_or_else(|| {
                fail(
                    &listed,
                    "transform_matrix is not a rigid transform of 4 rows of 4 numbers",
                )
            })?),
        };
        let found = camera_of(&[frame, &whole], &file)?.map_err(|why| fail(&listed, &why))?;
        let camera = match listed.same_camera(&found) {
            Some(name) => name,
            None => {
                let name = (0..)
                    .map(|k| format!("cam{k}"))
                    .find(|name| !listed.has_camera(name))
                    .unwrap_or_default();
                listed.add_camera(&name, found)?;
                name
            }
        };
        listed.add_image(file, &camera, pose);
    }
    Ok(listed)
}

fn image_file(folder: &Path, name: &str) -> PathBuf {
    let file = folder.join(name);
    match file.extension() {
        None => file.with_extension(EXTENSION),
        Some(_) => file,
    }
}

fn world_from_camera(matrix: &Value) -> Option<Se3> {
    let rows = matrix.as_array().filter(|rows| rows.len() == 4)?;
    let mut m = [[0.0; 4]; 4];
    for (row, values) in m.iter_mut().zip(rows) {
        let values = values.as_array().filter(|v| v.len() == 4)?;
        for (entry, value) in row.iter_mut().zip(values) {
            *entry = value.as_f64().filter(|v| v.is_finite())?;
        }
    }
    if m[3] != [0.0, 0.0, 0.0, 1.0] {
        return None;
    }
    let rotation = Matrix3::from_fn(|i, j| m[i][j]);
    // Their camera is ours turned half a turn about x.
    let ours = rotation * Matrix3::from_diagonal(&[1.0, -1.0, -1.0].into());
    let rotation = so3::from_rounded(&ours, ROTATION_ROUNDING)?;
    Some(Se3::new(rotation, Vector3::new(m[0][3], m[1][3], m[2][3])))
}

/// The camera of a frame: what it says itself counts before what is said for all.
fn camera_of(said: &[&Object; 2], file: &Path) -> Result<Result<Camera, String>, Error> {
    let value = |name: &str| said.iter().find_map(|o| o.get(name));
    let number = |name: &str| value(name).and_then(Value::as_f64);
    let side = |name: &str| number(name).map(|v| v as u32);
    let size = match (side("w"), side("h")) {
        (Some(w), Some(h)) => [w, h],
        _ => {
            let pixels = image::read(file)?;
            [pixels.width, pixels.height]
        }
    };
    let of_angle = |name: &str, side: u32| {
        number(name).map(|angle_rad| 0.5 * f64::from(side) / (0.5 * angle_rad).tan())
    };
    let focal_x = number("fl_x").or_else(|| of_angle("camera_angle_x", size[0]));
    let focal_y = number("fl_y").or_else(|| of_angle("camera_angle_y", size[1]));
    let Some([fx, fy]) = focal_x
        .or(focal_y)
        .map(|f| [focal_x.unwrap_or(f), focal_y.unwrap_or(f)])
    else {
        return Ok(Err("there is no fl_x and no camera_angle_x".to_owned()));
    };
    let centre = size.map(|side| 0.5 * f64::from(side));
    let principal = [
        number("cx").unwrap_or(centre[0]),
        number("cy").unwrap_or(centre[1]),
    ];
    let d = |name: &str| number(name).unwrap_or(0.0);
    let model = value("camera_model").and_then(Value::as_str);
    let pinhole = [fx, fy, principal[0], principal[1]];
    Ok(match model.unwrap_or("OPENCV") {
        "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" if d("k4") != 0.0 => {
            Err("k4 is supported for fisheye lenses only: undistort the images".to_owned())
        }
        "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" => {
            let distortion = [d("k1"), d("k2"), d("p1"), d("p2"), d("k3"), 0.0, 0.0, 0.0];
            camera("FULL_OPENCV", size, &[&pinhole[..], &distortion].concat())
        }
        "OPENCV_FISHEYE" => {
            let distortion = ["k1", "k2", "k3", "k4"].map(d);
            camera(
                "OPENCV_FISHEYE",
                size,
                &[&pinhole[..], &distortion].concat(),
            )
        }
        other => Err(format!(
            "camera_model {other} is not supported: undistort the images to OPENCV without distortion"
        )),
    })
}
