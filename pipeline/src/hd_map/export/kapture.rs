//! kapture 1.1 (its specification, `kapture_format.adoc`): sensors, trajectories, images, keypoints, points and observations.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::{ExportedFile, Model, file, quaternion};

const HEAD: &str = "# kapture format: 1.1\n";
/// Name of the rig, which no camera has.
const RIG: &str = "rig";
/// Name of the kind of keypoints.
const KEYPOINTS: &str = "lsfb";

/// Cameras, where they are on each other, poses and names of images. Poses are those of the cameras, as most readers want them.
pub(super) fn sensors(model: &Model) -> Vec<ExportedFile> {
    let names = model.names;
    // Writing to a String cannot fail.
    let mut sensors = format!("{HEAD}# sensor_id, name, sensor_type, [sensor_params]+\n");
    for (name, camera) in names.iter().zip(model.cameras) {
        let [width, height] = camera.size;
        let _ = write!(
            sensors,
            "{name}, {name}, camera, {}, {width}, {height}",
            camera.model
        );
        for parameter in &camera.parameters {
            let _ = write!(sensors, ", {parameter:?}");
        }
        sensors.push('\n');
    }
    let mut trajectories = format!("{HEAD}# timestamp, device_id, qw, qx, qy, qz, tx, ty, tz\n");
    let mut records = format!("{HEAD}# timestamp, device_id, image_path\n");
    for image in &model.images {
        let camera = names.get(image.camera).map_or("", String::as_str);
        let pose = &image.camera_from_world;
        let _ = write!(trajectories, "{}, {camera}", image.time_ns);
        for value in quaternion(pose).iter().chain(pose.translation.iter()) {
            let _ = write!(trajectories, ", {value:?}");
        }
        trajectories.push('\n');
        let _ = writeln!(records, "{}, {camera}, {}", image.time_ns, image.name);
    }
    let mut rigs = format!("{HEAD}# rig_id, sensor_id, qw, qx, qy, qz, tx, ty, tz\n");
    for (name, mounted) in names.iter().zip(&model.mounted) {
        if let Some(rig_from_camera) = mounted {
            let pose = rig_from_camera.inverse();
            let _ = write!(rigs, "{RIG}, {name}");
            for value in quaternion(&pose).iter().chain(pose.translation.iter()) {
                let _ = write!(rigs, ", {value:?}");
            }
            rigs.push('\n');
        }
    }
    vec![
        file("sensors/sensors.txt", sensors),
        file("sensors/rigs.txt", rigs),
        file("sensors/trajectories.txt", trajectories),
        file("sensors/records_camera.txt", records),
    ]
}

/// The same, with what the images saw of the map.
pub(super) fn files(model: &Model) -> Vec<ExportedFile> {
    let mut by_point: BTreeMap<u32, String> = BTreeMap::new();
    let mut files = sensors(model);
    for image in &model.images {
        let mut keypoints = Vec::with_capacity(8 * image.seen.len());
        for (place, (point, pixel)) in image.seen.iter().enumerate() {
            keypoints.extend(pixel.map(|v| (v as f32).to_le_bytes()).as_flattened());
            let _ = write!(
                by_point.entry(*point).or_default(),
                ", {}, {place}",
                image.name
            );
        }
        let path = format!("reconstruction/keypoints/{KEYPOINTS}/{}.kpt", image.name);
        files.push(file(&path, keypoints));
    }
    let mut points = format!("{HEAD}# X, Y, Z, R, G, B\n");
    for position in model.map.iter().flat_map(|map| map.positions()) {
        let [x, y, z]: [f64; 3] = position.into();
        let _ = writeln!(points, "{x:?}, {y:?}, {z:?}, 128, 128, 128");
    }
    let mut observations =
        format!("{HEAD}# point3d_id, keypoints_type, [image_path, feature_id]*\n");
    for (point, seen) in by_point {
        let _ = writeln!(observations, "{point}, {KEYPOINTS}{seen}");
    }
    let kind = format!("{HEAD}# name, dtype, dsize\n{KEYPOINTS}, float32, 2\n");
    files.extend([
        file("reconstruction/points3d.txt", points),
        file("reconstruction/observations.txt", observations),
        file(
            &format!("reconstruction/keypoints/{KEYPOINTS}/keypoints.txt"),
            kind,
        ),
    ]);
    files
}
