//! What `lsfb localize --out-matches` writes, held against the poses beside it.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::{Quaternion, Rig, Se3, UnitQuaternion, Vector2, Vector3};

/// The lines of a table, by the names of its columns.
fn table(path: &Path) -> Vec<BTreeMap<String, String>> {
    let text = std::fs::read_to_string(path).expect("a table");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("a head").split(',').collect();
    let row = |line: &str| {
        let fields = names.iter().zip(line.split(','));
        fields
            .map(|(n, f)| ((*n).to_owned(), f.to_owned()))
            .collect()
    };
    lines.map(row).collect()
}

/// Projects the point of each line by the pose of its frame and the rig's camera: it is as far from the pixel as is written there, and each
/// frame has as many lines as inliers. Returns their number.
pub fn hold_against_poses(poses: &Path, matches: &Path, rig: &Rig) -> usize {
    let poses = table(poses);
    let matches = table(matches);
    let numbers = |row: &BTreeMap<String, String>, names: &[&str]| -> Vec<f64> {
        let number = |name: &&str| row[*name].parse().expect("a number");
        names.iter().map(number).collect()
    };
    for pose in &poses {
        let of_frame = matches.iter().filter(|m| m["frame"] == pose["frame"]);
        let of_frame: Vec<_> = of_frame.collect();
        let inliers: usize = pose["inliers"].parse().unwrap_or(0);
        assert_eq!(of_frame.len(), inliers, "{}", pose["frame"]);
        if inliers == 0 {
            continue;
        }
        let v = numbers(pose, &["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]);
        let world_from_rig = Se3::new(
            UnitQuaternion::from_quaternion(Quaternion::new(v[6], v[3], v[4], v[5])),
            Vector3::new(v[0], v[1], v[2]),
        );
        for m in of_frame {
            assert_eq!(m["localized"], pose["localized"]);
            let v = numbers(m, &["u_px", "v_px", "x_m", "y_m", "z_m", "residual_px"]);
            let mounted = &rig.cameras[&m["camera"]];
            let camera_from_world = (world_from_rig * mounted.rig_from_camera).inverse();
            let point = camera_from_world * Vector3::new(v[2], v[3], v[4]);
            let expected = mounted.camera.project(&point).expect("in front of it");
            let residual = (expected - Vector2::new(v[0], v[1])).norm();
            assert!((residual - v[5]).abs() < 1e-6 && residual < 20.0, "{m:?}");
        }
    }
    matches.len()
}
