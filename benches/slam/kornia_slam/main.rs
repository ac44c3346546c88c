//! Runs the crate `kornia-slam` on an EuRoC folder as `lsfb bench slam` exports it (`mav0/cam0`, `cam1`, `imu0` and `rig.toml`) and writes the
//! live pose of the body for each image as TUM text. The crate is a library; the program that its authors run on EuRoC is not on crates.io.
//!
//! `kornia_slam_euroc FOLDER OUT.tum [stereo|stereo-imu]`, stereo by default. Settings are the crate's, with mapping in the same thread, so
//! that a run can be repeated; points nearer than 35 baselines enter the map at once, as in the authors' program.

use std::error::Error;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use kornia_3d::pose::Pose3d;
use kornia_3d::stereo::{CameraCalib, StereoRectifier};
use kornia_algebra::{Mat3F64, Vec3F64};
use kornia_image::{Image, ImageSize, InterpolationMode};
use kornia_imgproc::calibration::distortion::PolynomialDistortion;
use kornia_imgproc::features::OrbDetector;
use kornia_imgproc::resize::resize_fast_mono;
use kornia_sensors::imu::ImuMeasurement;
use kornia_slam::mapping::LocalMappingMode;
use kornia_slam::stereo::{StereoMatchConfig, compute_stereo_matches};
use kornia_slam::{Frame, SensorRig, SlamConfig, SlamSystem, TrackingStatus};

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Pyramid of the crate's ORB detector.
const SCALE: f32 = 1.2;
const LEVELS: usize = 8;
/// Baselines within which depth by stereo is taken as known.
const CLOSE_BASELINES: f64 = 35.0;

/// A camera of the rig.
struct Camera {
    calib: CameraCalib,
    body_from_camera: Pose3d,
}

/// The numbers of a line `name = ...` in a table of the rig file.
fn numbers(rig: &str, table: &str, name: &str) -> Outcome<Vec<f64>> {
    let missing = || format!("rig.toml: no {name} in [{table}]");
    let (_, rest) = rig
        .split_once(&format!("[{table}]\n"))
        .ok_or_else(missing)?;
    let own = rest.split("\n[").next().unwrap_or(rest);
    let line = own
        .lines()
        .find_map(|l| l.strip_prefix(name)?.trim_start().strip_prefix('='));
    let list = line.ok_or_else(missing)?.trim().trim_matches(['[', ']']);
    Ok(list
        .split(',')
        .map(|n| n.trim().parse())
        .collect::<Result<_, _>>()?)
}

/// The camera of that name; the rig's frame is the body's. EuRoC's `sensor.yaml` has no place for the fifth coefficient of a lens.
fn camera(rig: &str, name: &str) -> Outcome<Camera> {
    let of = |table: &str, what: &str| numbers(rig, &format!("cameras.{name}.{table}"), what);
    let (width, height) = (of("camera", "width")?, of("camera", "height")?);
    let lens = "camera.lens";
    let (f, c, d) = (
        of(lens, "focal_px")?,
        of(lens, "principal_px")?,
        of(lens, "distortion")?,
    );
    let (q, t) = (
        of("rig_from_camera", "rotation_xyzw")?,
        of("rig_from_camera", "translation_m")?,
    );
    let ([x, y, z, w], 5) = (<[f64; 4]>::try_from(q).map_err(|_| "rotation")?, d.len()) else {
        return Err(format!("{name}: no pinhole with radial-tangential distortion").into());
    };
    let rotation = Mat3F64::from_cols(
        Vec3F64::new(
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + z * w),
            2.0 * (x * z - y * w),
        ),
        Vec3F64::new(
            2.0 * (x * y - z * w),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + x * w),
        ),
        Vec3F64::new(
            2.0 * (x * z + y * w),
            2.0 * (y * z - x * w),
            1.0 - 2.0 * (x * x + y * y),
        ),
    );
    Ok(Camera {
        calib: CameraCalib {
            width: width[0] as usize,
            height: height[0] as usize,
            fx: f[0],
            fy: f[1],
            cx: c[0],
            cy: c[1],
            distortion: PolynomialDistortion {
                k1: d[0],
                k2: d[1],
                p1: d[2],
                p2: d[3],
                k3: d[4],
                k4: 0.0,
                k5: 0.0,
                k6: 0.0,
            },
        },
        body_from_camera: Pose3d::new(rotation, Vec3F64::new(t[0], t[1], t[2])),
    })
}

/// Rows of a `data.csv`, split at commas.
fn rows(path: &Path) -> Outcome<Vec<Vec<String>>> {
    let text = fs::read_to_string(path)?;
    let data = text
        .lines()
        .filter(|l| !l.starts_with('#') && !l.trim().is_empty());
    Ok(data
        .map(|l| l.split(',').map(|c| c.trim().to_owned()).collect())
        .collect())
}

fn image(path: &Path, [width, height]: [usize; 2]) -> Outcome<Image<u8, 1>> {
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(fs::File::open(path)?)).read_info()?;
    let mut pixels = vec![0; reader.output_buffer_size().ok_or("size")?];
    reader.next_frame(&mut pixels)?;
    Ok(Image::new(ImageSize { width, height }, pixels)?)
}

fn pyramid(image: &Image<u8, 1>) -> Outcome<Vec<Image<u8, 1>>> {
    let mut levels = vec![image.clone()];
    for level in 1..LEVELS {
        let size = |full: usize| ((full as f32 / SCALE.powi(level as i32)).round() as usize).max(1);
        let size = ImageSize {
            width: size(image.width()),
            height: size(image.height()),
        };
        let mut smaller = Image::from_size_val(size, 0)?;
        resize_fast_mono(image, &mut smaller, InterpolationMode::Bilinear)?;
        levels.push(smaller);
    }
    Ok(levels)
}

/// x, y, z, w of a rotation, by the largest of the four.
fn quaternion(pose: &Pose3d) -> [f64; 4] {
    let x = pose.rotation * Vec3F64::new(1.0, 0.0, 0.0);
    let y = pose.rotation * Vec3F64::new(0.0, 1.0, 0.0);
    let z = pose.rotation * Vec3F64::new(0.0, 0.0, 1.0);
    let squares = [
        1.0 + x.x - y.y - z.z,
        1.0 - x.x + y.y - z.z,
        1.0 - x.x - y.y + z.z,
        1.0 + x.x + y.y + z.z,
    ];
    let mut largest = 3;
    for i in 0..3 {
        if squares[i] > squares[largest] {
            largest = i;
        }
    }
    let (a, b, c) = (y.z - z.y, z.x - x.z, x.y - y.x);
    let (d, e, f) = (x.y + y.x, x.z + z.x, y.z + z.y);
    let s = squares[largest];
    let q = match largest {
        0 => [s, d, e, a],
        1 => [d, s, f, b],
        2 => [e, f, s, c],
        _ => [a, b, c, s],
    };
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / norm)
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, out, mode @ ..] = arguments.as_slice() else {
        return Err("kornia_slam_euroc FOLDER OUT.tum [stereo|stereo-imu]".into());
    };
    let with_imu = match mode {
        [] => false,
        [mode] if mode == "stereo" => false,
        [mode] if mode == "stereo-imu" => true,
        _ => return Err("stereo or stereo-imu".into()),
    };
    let root = Path::new(folder).join("mav0");
    let rig = fs::read_to_string(Path::new(folder).join("rig.toml"))?;
    let [left, right] = [camera(&rig, "cam0")?, camera(&rig, "cam1")?];
    let right_from_left = right
        .body_from_camera
        .inverse()
        .compose(&left.body_from_camera);
    let rectifier = StereoRectifier::from_calib(
        &left.calib,
        &right.calib,
        right_from_left.rotation,
        right_from_left.translation,
    )?;
    let rectified = rectifier.rectified_camera();
    let rectified_from_left = Pose3d::new(rectifier.left_rectifying_rotation(), Vec3F64::ZERO);
    let body_from_rectified = left
        .body_from_camera
        .compose(&rectified_from_left.inverse());
    let mut rig = SensorRig::new(rectified.clone());
    if with_imu {
        rig = rig.with_imu(body_from_rectified);
    }
    let mut system = SlamSystem::with_rig(
        rig,
        SlamConfig {
            stereo_close_depth_m: Some(rectifier.baseline() * CLOSE_BASELINES),
            local_mapping: LocalMappingMode::Synchronous,
            debug: true,
            ..SlamConfig::default()
        },
    );
    let matching = StereoMatchConfig::new(
        rectifier.baseline() as f32,
        rectified.fx as f32,
        SCALE,
        LEVELS,
    );
    let detector = OrbDetector {
        n_keypoints: 1000,
        ..OrbDetector::default()
    };
    let mut inertial = Vec::new();
    if with_imu {
        for row in rows(&root.join("imu0/data.csv"))? {
            let v: Vec<f64> = row.iter().map(|c| c.parse()).collect::<Result<_, _>>()?;
            inertial.push(ImuMeasurement {
                timestamp: v[0] * 1e-9,
                gyro: Vec3F64::new(v[1], v[2], v[3]),
                accel: Vec3F64::new(v[4], v[5], v[6]),
            });
        }
    }
    let mut inertial = inertial.into_iter().peekable();
    let rights = rows(&root.join("cam1/data.csv"))?;
    let size = [left.calib.width, left.calib.height];
    let mut text = String::new();
    let mut previous: Option<Image<u8, 1>> = None;
    for (idx, row) in rows(&root.join("cam0/data.csv"))?.iter().enumerate() {
        // Pairs have one stamp; an image without its partner is left out.
        let Some(partner) = rights.iter().find(|r| r[0] == row[0]) else {
            continue;
        };
        let stamp_ns: i64 = row[0].parse()?;
        let secs = stamp_ns as f64 * 1e-9;
        let raw = [
            image(&root.join("cam0/data").join(&row[1]), size)?,
            image(&root.join("cam1/data").join(&partner[1]), size)?,
        ];
        let (mut one, mut other) = (raw[0].clone(), raw[1].clone());
        rectifier.rectify_left(&raw[0], &mut one)?;
        rectifier.rectify_right(&raw[1], &mut other)?;
        let features = detector.detect_and_extract_u8(&one)?;
        let found = compute_stereo_matches(
            &pyramid(&one)?,
            &pyramid(&other)?,
            &features,
            &detector.detect_and_extract_u8(&other)?,
            &matching,
        );
        let frame = Frame {
            idx,
            keypoint_colors: vec![[0; 3]; features.len()],
            features,
            pose_world_to_cam: Pose3d::IDENTITY,
            image_size: one.size(),
            u_right: found.u_right,
            depth: found.depth,
            keypoints_undist: Vec::new(),
        };
        let mut samples = Vec::new();
        while let Some(sample) = inertial.next_if(|s| s.timestamp <= secs) {
            samples.push(sample);
        }
        let result = system.process_frame(frame, previous.as_ref(), &one, secs, samples);
        // Where gravity was found the world is turned: what was said before is of another world. Later refinements turn it by little.
        let turned = |line: &String| line.contains("VIBA0 accepted");
        if system.drain_debug_messages().iter().any(turned) {
            text.clear();
        }
        if result.status != TrackingStatus::Skipped {
            let pose = result
                .pose_world_to_cam
                .inverse()
                .compose(&body_from_rectified.inverse());
            let (p, [x, y, z, w]) = (pose.translation, quaternion(&pose));
            writeln!(
                text,
                "{}.{:09} {} {} {} {x} {y} {z} {w}",
                stamp_ns / 1_000_000_000,
                stamp_ns % 1_000_000_000,
                p.x,
                p.y,
                p.z
            )?;
        }
        previous = Some(one);
    }
    if text.is_empty() {
        return Err("never initialised".into());
    }
    fs::write(out, text)?;
    Ok(())
}
