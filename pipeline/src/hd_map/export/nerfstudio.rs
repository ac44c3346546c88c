//! nerfstudio's `transforms.json` (its documentation, "Data conventions"): a camera per frame, poses in OpenGL's axes (y up, looking
//! along −z), points in a PLY file that is written beside it.

use lsfb_geometry::Matrix3;
use serde_json::{Map, Value, json};

use super::{ColmapCamera, ExportedFile, Model, file};
use crate::Error;

pub(super) fn files(model: &Model) -> Result<Vec<ExportedFile>, Error> {
    let lenses: Vec<Map<String, Value>> =
        model.cameras.iter().map(lens).collect::<Result<_, _>>()?;
    let frames: Vec<Value> = model
        .images
        .iter()
        .map(|image| {
            let mut frame = lenses.get(image.camera).cloned().unwrap_or_default();
            let pose = image.camera_from_world.inverse();
            // Their camera is ours turned half a turn about x.
            let r = pose.rotation_matrix() * Matrix3::from_diagonal(&[1.0, -1.0, -1.0].into());
            let t = pose.translation;
            let row = |i: usize| json!([r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]]);
            let rows = json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]);
            frame.insert("file_path".to_owned(), json!(image.name));
            frame.insert("transform_matrix".to_owned(), rows);
            Value::Object(frame)
        })
        .collect();
    let whole = json!({ "ply_file_path": "points.ply", "frames": frames });
    Ok(vec![file("transforms.json", format!("{whole:#}\n"))])
}

/// A camera in nerfstudio's names.
fn lens(camera: &ColmapCamera) -> Result<Map<String, Value>, Error> {
    let (model, names): (&str, &[&str]) = match camera.model.as_str() {
        "PINHOLE" => ("OPENCV", &[]),
        "OPENCV" => ("OPENCV", &["k1", "k2", "p1", "p2"]),
        "FULL_OPENCV" => ("OPENCV", &["k1", "k2", "p1", "p2", "k3"]),
        "OPENCV_FISHEYE" => ("OPENCV_FISHEYE", &["k1", "k2", "k3", "k4"]),
        other => {
            return Err(Error::CameraFormat {
                model: other.to_owned(),
                format: "nerfstudio",
            });
        }
    };
    let [w, h] = camera.size;
    let mut found = Map::from_iter([
        ("camera_model".to_owned(), json!(model)),
        ("w".to_owned(), json!(w)),
        ("h".to_owned(), json!(h)),
    ]);
    let names = ["fl_x", "fl_y", "cx", "cy"].iter().chain(names);
    let values = names.zip(&camera.parameters);
    found.extend(values.map(|(name, value)| ((*name).to_owned(), json!(value))));
    Ok(found)
}
