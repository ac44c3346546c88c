//! COLMAP's sparse model, text and binary (COLMAP's documentation, "Output Format"). Numbers of cameras, images and points
//! count from 1.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use lsfb_geometry::camera::ColmapModel;

use super::{ExportedFile, Model, file, quaternion};
use crate::Error;
use crate::hd_map::HdMap;

/// What a point looks like that nobody gave a colour.
const GREY: u8 = 128;
pub(super) fn text(model: &Model) -> Vec<ExportedFile> {
    // Writing to a String cannot fail.
    let mut cameras = String::from(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n",
    );
    for (number, camera) in (1..).zip(model.cameras) {
        let [width, height] = camera.size;
        let _ = write!(cameras, "{number} {} {width} {height}", camera.model);
        for parameter in &camera.parameters {
            let _ = write!(cameras, " {parameter:?}");
        }
        cameras.push('\n');
    }
    let mut images = String::from(
        "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   POINTS2D[] as (X, Y, POINT3D_ID)\n",
    );
    for (number, image) in (1..).zip(&model.images) {
        let pose = &image.camera_from_world;
        let _ = write!(images, "{number}");
        for value in quaternion(pose).iter().chain(pose.translation.iter()) {
            let _ = write!(images, " {value:?}");
        }
        let _ = writeln!(images, " {} {}", image.camera + 1, image.name);
        let seen = image.seen.iter();
        let words: Vec<String> = seen
            .map(|(point, [u, v])| format!("{u:?} {v:?} {}", point + 1))
            .collect();
        let _ = writeln!(images, "{}", words.join(" "));
    }
    let mut points = String::from(
        "# 3D point list with one line of data per point:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n",
    );
    for (number, (position, error_px, track)) in (1..).zip(tracks(model)) {
        let [x, y, z]: [f64; 3] = position.into();
        let _ = write!(
            points,
            "{number} {x:?} {y:?} {z:?} {GREY} {GREY} {GREY} {error_px:?}"
        );
        for (image, place) in track {
            let _ = write!(points, " {image} {place}");
        }
        points.push('\n');
    }
    vec![
        file("cameras.txt", cameras),
        file("images.txt", images),
        file("points3D.txt", points),
    ]
}

pub(super) fn binary(model: &Model) -> Result<Vec<ExportedFile>, Error> {
    let mut cameras = (model.cameras.len() as u64).to_le_bytes().to_vec();
    for (number, camera) in (1_u32..).zip(model.cameras) {
        let known = ColmapModel::from_name(&camera.model);
        let known = known.ok_or_else(|| Error::CameraFormat {
            model: camera.model.clone(),
            format: "COLMAP",
        })?;
        cameras.extend(number.to_le_bytes());
        cameras.extend(known.number().to_le_bytes());
        cameras.extend(
            camera
                .size
                .map(|v| u64::from(v).to_le_bytes())
                .as_flattened(),
        );
        cameras.extend(camera.parameters.iter().flat_map(|v| v.to_le_bytes()));
    }
    let mut images = (model.images.len() as u64).to_le_bytes().to_vec();
    for (number, image) in (1_u32..).zip(&model.images) {
        let pose = &image.camera_from_world;
        images.extend(number.to_le_bytes());
        let numbers = quaternion(pose)
            .into_iter()
            .chain(pose.translation.iter().copied());
        images.extend(numbers.flat_map(f64::to_le_bytes));
        images.extend((image.camera as u32 + 1).to_le_bytes());
        images.extend(image.name.as_bytes());
        images.push(0);
        images.extend((image.seen.len() as u64).to_le_bytes());
        for (point, pixel) in &image.seen {
            images.extend(pixel.map(f64::to_le_bytes).as_flattened());
            images.extend((u64::from(*point) + 1).to_le_bytes());
        }
    }
    let points_count = model.map.map_or(0, HdMap::point_count);
    let mut points = (points_count as u64).to_le_bytes().to_vec();
    for (number, (position, error_px, track)) in (1_u64..).zip(tracks(model)) {
        points.extend(number.to_le_bytes());
        points.extend(position.iter().flat_map(|v| v.to_le_bytes()));
        points.extend([GREY; 3]);
        points.extend(error_px.to_le_bytes());
        points.extend((track.len() as u64).to_le_bytes());
        for (image, place) in track {
            points.extend(image.to_le_bytes());
            points.extend(place.to_le_bytes());
        }
    }
    Ok(vec![
        file("cameras.bin", cameras),
        file("images.bin", images),
        file("points3D.bin", points),
    ])
}

/// Of each point: position, reprojection error in pixels, and the images with its place among what they saw.
fn tracks<'a>(
    model: &'a Model,
) -> impl Iterator<Item = (lsfb_geometry::Vector3<f64>, f64, Vec<(u32, u32)>)> + 'a {
    let mut of_point: BTreeMap<u32, Vec<(u32, u32)>> = BTreeMap::new();
    for (number, image) in (1_u32..).zip(&model.images) {
        for (place, (point, _)) in (0_u32..).zip(&image.seen) {
            of_point.entry(*point).or_default().push((number, place));
        }
    }
    let points = model.map.into_iter().flat_map(|map| {
        let numbered = (0..map.point_count() as u32).zip(map.positions());
        numbered.map(move |(point, position)| (map, point, position))
    });
    points.map(move |(map, point, position)| {
        let error_px = map.quality(point).map_or(0.0, |q| q.reprojection_rms_px);
        let track = of_point.remove(&point).unwrap_or_default();
        (position, error_px, track)
    })
}
