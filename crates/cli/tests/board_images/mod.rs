//! Images of a checkerboard before two cameras, as PNG files.

use std::path::Path;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, Se3, Vector2, Vector3, Vector6};

/// Squares along the edges of the board.
const SQUARES: [i32; 2] = [10, 7];
const SQUARE_M: f64 = 0.03;
/// Rays per pixel along each axis.
const RAYS: u32 = 3;

/// The inner corners as `--checkerboard` takes them.
pub const CHECKERBOARD: &str = "9,6,0.03";

fn camera() -> Camera {
    Camera {
        width: 480,
        height: 360,
        lens: Lens::PinholeRadtan {
            focal_px: [400.0, 401.0],
            principal_px: [241.0, 178.0],
            distortion: [-0.08, 0.02, 0.0, 0.0, 0.0],
        },
    }
}

/// Distance between the cameras, metres.
pub const BASELINE_M: f64 = 0.06;

/// Poses of the board's middle in the left camera: `[rotation, translation]`.
fn poses() -> impl Iterator<Item = Vector6<f64>> {
    const TILTS: [f64; 3] = [-0.5, 0.0, 0.5];
    let all = TILTS.into_iter().flat_map(|a| TILTS.map(|b| (a, b)));
    all.enumerate().map(|(k, (about_x, about_y))| {
        let (column, row) = ((k % 3) as f64 - 1.0, (k / 3) as f64 - 1.0);
        Vector6::new(
            about_x,
            about_y,
            0.1 * column,
            0.06 * column + 0.5 * BASELINE_M,
            0.05 * row,
            0.38 + 0.03 * (k % 4) as f64,
        )
    })
}

/// What a camera sees of the board; `torn_m` moves its right half away.
fn image(first_from_board: &Se3, camera_x_m: f64, torn_m: f64) -> Vec<u8> {
    let camera = camera();
    let board_from_camera =
        first_from_board.inverse() * Se3::new(Default::default(), Vector3::x() * camera_x_m);
    let from_corner = Vector2::new(f64::from(SQUARES[0]), f64::from(SQUARES[1])) * 0.5;
    let brightness = |pixel: Vector2<f64>| -> u32 {
        const WALL: u32 = 130;
        let Some(ray) = camera.unproject(&pixel) else {
            return WALL;
        };
        let ray = board_from_camera.rotation * ray;
        let along = -board_from_camera.translation.z / ray.z;
        let mut hit = board_from_camera.translation + ray * along;
        if hit.x > torn_m {
            hit.x -= torn_m;
        }
        let square = Vector2::new(hit.x, hit.y) / SQUARE_M + from_corner;
        let (i, j) = (square.x.floor() as i32, square.y.floor() as i32);
        let on = |k: i32, count: i32| (0..count).contains(&k);
        let margin = |k: i32, count: i32| (-1..=count).contains(&k);
        if on(i, SQUARES[0]) && on(j, SQUARES[1]) {
            if (i + j) % 2 == 0 { 30 } else { 225 }
        } else if margin(i, SQUARES[0]) && margin(j, SQUARES[1]) {
            225
        } else {
            WALL
        }
    };
    let (width, height) = (camera.width, camera.height);
    (0..width * height)
        .map(|k| {
            let (x, y) = (f64::from(k % width), f64::from(k / width));
            let part = |r: u32| (f64::from(r) + 0.5) / f64::from(RAYS) - 0.5;
            let rays = (0..RAYS).flat_map(|a| (0..RAYS).map(move |b| (part(a), part(b))));
            let sum: u32 = rays
                .map(|(u, v)| brightness(Vector2::new(x + u, y + v)))
                .sum();
            (sum / (RAYS * RAYS)) as u8
        })
        .collect()
}

fn write(path: &Path, pixels: &[u8]) {
    let file = std::fs::File::create(path).expect("file");
    let mut encoder = png::Encoder::new(file, camera().width, camera().height);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().expect("PNG");
    writer.write_image_data(pixels).expect("PNG");
}

/// Writes `left/0.png …` and `right/0.png …`; of a board whose right half stands off by `torn_m`.
pub fn write_stereo(folder: &Path, torn_m: f64) {
    for (name, camera_x_m) in [("left", 0.0), ("right", BASELINE_M)] {
        std::fs::create_dir(folder.join(name)).expect("folder");
        for (k, pose) in poses().enumerate() {
            let turn = pose.fixed_rows::<3>(0);
            let tilted = Se3::exp(&Vector6::new(turn[0], turn[1], turn[2], 0.0, 0.0, 0.0));
            let at = Se3::new(tilted.rotation, pose.fixed_rows::<3>(3).into_owned());
            let path = folder.join(name).join(format!("{k}.png"));
            write(&path, &image(&at, camera_x_m, torn_m));
        }
    }
}

/// Paints every image of a camera grey.
pub fn blind(folder: &Path, name: &str) {
    let grey = vec![128; (camera().width * camera().height) as usize];
    for k in 0..poses().count() {
        write(&folder.join(name).join(format!("{k}.png")), &grey);
    }
}
