use lsfb_geometry::{Camera, Matrix3, UnitQuaternion, Vector3};

use super::*;
use crate::hd_map::tests::small_map;

fn cameras() -> Vec<ColmapCamera> {
    let pinhole = ColmapCamera {
        model: "PINHOLE".to_owned(),
        size: [640, 480],
        parameters: vec![400.0, 400.0, 320.0, 240.0],
    };
    vec![pinhole; 2]
}

fn text_of<'a>(files: &'a [ExportedFile], path: &str) -> &'a str {
    let found = files.iter().find(|f| f.path == path).expect(path);
    std::str::from_utf8(&found.bytes).expect("text")
}

/// Every observation is in COLMAP's text, where the point's own projection says.
#[test]
fn colmap_sees_the_points_where_the_map_does() {
    let map = small_map();
    let files = map
        .export(MapFormat::ColmapText, &cameras())
        .expect("files");
    let rows = |path| {
        text_of(&files, path)
            .lines()
            .filter(|l| !l.starts_with('#'))
    };
    let numbers =
        |line: &str| -> Vec<f64> { line.split(' ').filter_map(|w| w.parse().ok()).collect() };
    let points: Vec<Vec<f64>> = rows("points3D.txt").map(numbers).collect();
    assert_eq!(points.len(), map.point_count());
    let images: Vec<&str> = rows("images.txt").collect();
    assert_eq!(images.len(), 2 * 4);
    let (mut seen, mut errors_px) = (0, vec![Vec::new(); points.len()]);
    let camera = Camera::pinhole(640, 480, [400.0, 400.0], [320.0, 240.0]);
    for lines in images.chunks(2) {
        let [_, w, x, y, z, tx, ty, tz, ..] = numbers(lines[0])[..] else {
            panic!("{}", lines[0]);
        };
        let q = UnitQuaternion::from_quaternion(lsfb_geometry::Quaternion::new(w, x, y, z));
        for [u, v, point] in numbers(lines[1]).as_chunks().0 {
            let row = &points[*point as usize - 1];
            let in_camera = q * Vector3::new(row[1], row[2], row[3]) + Vector3::new(tx, ty, tz);
            seen += 1;
            if let Some(pixel) = camera.project(&in_camera) {
                errors_px[*point as usize - 1].push((pixel.x - u).hypot(pixel.y - v));
            }
        }
    }
    assert_eq!(seen, map.observation_count());
    for (row, errors) in points.iter().zip(errors_px) {
        let squares: f64 = errors.iter().map(|e| e * e).sum();
        let rms = (squares / errors.len().max(1) as f64).sqrt();
        assert!(
            (rms - row[7]).abs() <= 1e-3 * rms.max(1.0),
            "{rms} {}",
            row[7]
        );
        assert_eq!(row.len(), 8 + 2 * 4);
    }
}

#[test]
fn the_other_formats_hold_the_same() {
    let map = small_map();
    let export = |format| map.export(format, &cameras()).expect("files");
    let binary = export(MapFormat::ColmapBinary);
    let count = |path: &str| {
        let found = binary.iter().find(|f| f.path == path).expect(path);
        let head = found.bytes.first_chunk().expect("a count");
        (u64::from_le_bytes(*head), found.bytes.len())
    };
    assert_eq!(count("cameras.bin"), (2, 8 + 2 * (4 + 4 + 16 + 32)));
    let names = 2 * "cam0/0.png ".len() + 2 * "cam0/1000.png ".len();
    assert_eq!(
        count("images.bin"),
        (4, 8 + 4 * (4 + 56 + 4 + 8 + 40 * 24) + names)
    );
    assert_eq!(
        count("points3D.bin"),
        (40, 8 + 40 * (8 + 24 + 3 + 8 + 8 + 4 * 8))
    );

    let kapture = export(MapFormat::Kapture);
    let lines = |path| {
        text_of(&kapture, path)
            .lines()
            .filter(|l| !l.starts_with('#'))
            .count()
    };
    assert_eq!(lines("sensors/sensors.txt"), 2);
    assert_eq!(lines("sensors/rigs.txt"), 2);
    assert_eq!(lines("sensors/trajectories.txt"), 4);
    assert_eq!(lines("reconstruction/points3d.txt"), 40);
    assert_eq!(lines("reconstruction/observations.txt"), 40);
    let keypoints = kapture.iter().filter(|f| f.path.ends_with(".png.kpt"));
    assert!(keypoints.clone().all(|f| f.bytes.len() == 40 * 8));
    assert_eq!(keypoints.count(), 4);

    let nerfstudio = export(MapFormat::Nerfstudio);
    let json: serde_json::Value =
        serde_json::from_str(text_of(&nerfstudio, "transforms.json")).expect("json");
    let frames = json["frames"].as_array().expect("frames");
    assert_eq!(frames.len(), 4);
    assert_eq!(frames[0]["fl_x"], 400.0);
    // A camera of ours that looks along z of the world looks along −z of its own in OpenGL's axes.
    let turned = Matrix3::from_fn(|r, c| {
        frames[0]["transform_matrix"][r][c]
            .as_f64()
            .expect("a number")
    });
    let ours = map
        .keyframe(0)
        .expect("a keyframe")
        .world_from_rig
        .rotation_matrix();
    assert!((turned * -Vector3::z() - ours * Vector3::z()).norm() < 1e-12);

    for format in [MapFormat::Las, MapFormat::Laz] {
        let bytes = export(format).remove(0).bytes;
        let mut reader = las::Reader::new(std::io::Cursor::new(bytes)).expect("LAS");
        let read = reader.read_points(100).expect("points");
        assert_eq!(read.len(), 40);
        let far = read.x().zip(map.positions()).map(|(x, p)| (x - p.x).abs());
        assert!(far.fold(0.0, f64::max) <= 1e-4);
    }
    let ply = export(MapFormat::Ply).remove(0).bytes;
    let end = b"end_header\n";
    let head = ply
        .windows(end.len())
        .position(|w| w == end)
        .expect("a header");
    assert_eq!(ply.len(), head + end.len() + 40 * (24 + 8 + 4));
}

#[test]
fn a_camera_that_a_format_does_not_know_is_refused() {
    let mut fov = cameras();
    fov[1].model = "FOV".to_owned();
    fov[1].parameters.push(0.9);
    let error = small_map()
        .export(MapFormat::Nerfstudio, &fov)
        .expect_err("refused");
    assert!(
        error
            .to_string()
            .contains("nerfstudio has no camera model FOV"),
        "{error}"
    );
    small_map()
        .export(MapFormat::ColmapBinary, &fov)
        .expect("COLMAP knows it");
}
