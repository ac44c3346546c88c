//! `lsfb vio` on a hand-held pair of cameras of TUM VI (`LSFB_TEST_DATA`).

use std::fs;
use std::path::{Path, PathBuf};

use crate::answer::json;
use crate::process::lsfb;
use crate::running::Running;
use lsfb_geometry::camera::Lens;
use lsfb_geometry::{
    Camera, ImuNoiseModel, Matrix3, Rig, RigCamera, RigImu, Se3, UnitQuaternion, Vector3,
};
use lsfb_recording::read_tum;
use lsfb_tests::recordings;
use nix::sys::signal::Signal;
use serde_json::Value;

/// Images that a part of the walk has: eight seconds.
const IMAGES: usize = 160;

/// The walk's first seconds, of one camera, as a folder of TUM VI; `dark` of its images show nothing.
fn part(walk: &Path, dark: std::ops::Range<usize>, folder: &Path) {
    let (from, to) = (walk.join("mav0"), folder.join("walk/mav0"));
    let images = to.join("cam0/data");
    fs::create_dir_all(&images).expect("folder");
    fs::create_dir_all(to.join("imu0")).expect("folder");
    fs::copy(from.join("imu0/data.csv"), to.join("imu0/data.csv")).expect("samples");
    let list = fs::read_to_string(from.join("cam0/data.csv")).expect("list of images");
    let rows: Vec<&str> = list.lines().take(1 + IMAGES).collect();
    let black = image::black(512, 512);
    for (k, row) in rows[1..].iter().enumerate() {
        let (_, name) = row.split_once(',').expect("two cells");
        let place = images.join(name);
        match dark.contains(&k) {
            true => fs::write(&place, &black).expect("an image"),
            false => std::os::unix::fs::symlink(from.join("cam0/data").join(name), &place)
                .expect("an image"),
        }
    }
    fs::write(to.join("cam0/data.csv"), rows.join("\n")).expect("list");
}

mod image {
    /// A black image as PNG.
    pub fn black(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        let mut writer = encoder.write_header().expect("a head");
        let pixels = vec![0; (width * height) as usize];
        writer.write_image_data(&pixels).expect("pixels");
        writer.finish().expect("an end");
        bytes
    }
}

/// The first camera's rig by the data set's own calibration, changed.
fn write_rig(calibrated: &Path, change: impl Fn(&mut Rig), place: &Path) {
    let text = fs::read_to_string(calibrated.join("reference_calibration.json")).expect("JSON");
    let value: Value = serde_json::from_str(&text).expect("JSON");
    let all = |value: &Value| -> Vec<f64> {
        let numbers = value.as_array().expect("a list").iter();
        numbers.map(|v| v.as_f64().expect("a number")).collect()
    };
    let camera = &value["cam0"];
    let (f, k) = (all(&camera["intrinsics"]), all(&camera["k"]));
    let rows = camera["T_cam_imu"].as_array().expect("rows");
    let m: Vec<f64> = rows[..3].iter().flat_map(all).collect();
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let camera_from_rig = Se3::new(
        UnitQuaternion::from_matrix(&rotation),
        Vector3::new(m[3], m[7], m[11]),
    );
    let noise = |name: &str| value["imu_noise"][name].as_f64().expect("a number");
    let mut rig = Rig::empty("tumvi");
    rig.imus.insert(
        "imu0".to_owned(),
        RigImu {
            rig_from_imu: Se3::identity(),
            noise: ImuNoiseModel {
                gyro_noise_density: noise("gyro_density"),
                accel_noise_density: noise("acc_density"),
                gyro_bias_walk: noise("gyro_walk"),
                accel_bias_walk: noise("acc_walk"),
            },
        },
    );
    rig.cameras.insert(
        "cam0".to_owned(),
        RigCamera {
            camera: Camera {
                width: 512,
                height: 512,
                lens: Lens::KannalaBrandt {
                    focal_px: [f[0], f[1]],
                    principal_px: [f[2], f[3]],
                    distortion: [k[0], k[1], k[2], k[3]],
                },
            },
            rig_from_camera: camera_from_rig.inverse(),
            timing: Default::default(),
            sigmas: Default::default(),
        },
    );
    change(&mut rig);
    fs::write(place, rig.to_toml()).expect("rig");
}

fn finding<'a>(judged: &'a Value, code: &str) -> &'a Value {
    let findings = judged["findings"].as_array().expect("findings");
    let found = findings.iter().find(|f| f["code"] == code);
    found.unwrap_or_else(|| panic!("no {code} in {findings:?}"))
}

/// Lines of a table with some of their columns multiplied; what is no number stays.
fn scaled(text: &str, columns: std::ops::Range<usize>, by: f64) -> String {
    let lines = text.lines().map(|line| {
        let cells = line.split(',').enumerate().map(|(k, cell)| {
            let value: Option<f64> = cell.trim().parse().ok();
            let value = value.filter(|_| columns.contains(&k));
            value.map_or(cell.to_owned(), |value| (value * by).to_string())
        });
        cells.collect::<Vec<_>>().join(",")
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// A walk of TUM VI, and the folder with the calibration of its device; `None` where they are absent.
fn tumvi(test: &str) -> Option<[PathBuf; 2]> {
    Some([
        recordings(test, "vision/tumvi_calib_imu1_next")?,
        recordings(test, "vision/tumvi_calib_imu1")?,
    ])
}

/// A folder of TUM VI becomes a trajectory; two seconds of darkness in it are left out, said, and not bridged.
#[test]
fn a_walk_has_poses_but_where_it_was_dark() {
    let Some([walk, calibrated]) = tumvi("a_walk_has_poses_but_where_it_was_dark") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let at = folder.path();
    let dark = 80..120;
    part(&walk, dark.clone(), at);
    write_rig(&calibrated, |_| {}, &at.join("rig.toml"));
    let arguments = ["vio", "walk", "--rig", "rig.toml", "--out", "walk.tum"];
    let said = json(at, &arguments, 3);
    assert_eq!(said["verdict"], "warn");
    let left_out = finding(&said, "not-followed");
    let secs = left_out["value"].as_f64().expect("seconds");
    assert!((1.9..2.6).contains(&secs), "{left_out}");
    let list = fs::read_to_string(at.join("walk/mav0/cam0/data.csv")).expect("list");
    let stamp = |k: usize| -> i64 {
        let row = list.lines().nth(1 + k).expect("a row");
        row.split(',').next().expect("a stamp").parse().expect("ns")
    };
    let (from, to) = (stamp(dark.start), stamp(dark.end - 1));
    let found = read_tum(&at.join("walk.tum")).expect("a trajectory");
    let within = found.poses().iter().map(|p| p.time.nanos());
    assert!(within.clone().all(|ns| ns < from || ns > to));
    assert!(within.clone().any(|ns| ns < from) && within.clone().any(|ns| ns > to));
    // It comes out of the darkness where it should, by as much as it says. Motion capture's own frame is turned against the IMU's.
    let truth = walk.join("mav0/mocap0/data.csv");
    let truth = truth.to_str().expect("UTF-8");
    let judged = json(at, &["eval", "walk.tum", "--truth", truth], 0);
    let ate_m = judged["ate_translation_m"]["rmse"]
        .as_f64()
        .expect("metres");
    let stated_m = said["largest_position_sigma_m"].as_f64().expect("metres");
    assert!(
        ate_m < 0.03 && ate_m < 2.0 * stated_m,
        "{ate_m} m, {stated_m} m"
    );
    // Nothing but the results is left.
    assert!(!at.join("walk.imported.mcap").exists());
    let again = lsfb(at, &arguments);
    let again = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(again.contains("up to date"), "{again}");
}

/// A camera that is not where the rig says fails the judgement; samples in other units are refused.
#[test]
fn a_rig_or_an_imu_that_is_not_as_stated_is_said() {
    let Some([walk, calibrated]) = tumvi("a_rig_or_an_imu_that_is_not_as_stated_is_said") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let at = folder.path();
    part(&walk, 0..0, at);
    let turned = |rig: &mut Rig| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 3f64.to_radians());
        let camera = rig.cameras.get_mut("cam0").expect("cam0");
        camera.rig_from_camera.rotation *= turn;
    };
    write_rig(&calibrated, turned, &at.join("turned.toml"));
    let said = json(
        at,
        &["vio", "walk", "--rig", "turned.toml", "--out", "t.tum"],
        4,
    );
    assert_eq!(said["verdict"], "fail");
    let off = finding(&said, "camera-off");
    assert_eq!(
        (&off["where"], &off["verdict"]),
        (&"cam0".into(), &"fail".into())
    );
    assert!(off["value"].as_f64().expect("σ") > 10.0, "{off}");

    write_rig(&calibrated, |_| {}, &at.join("rig.toml"));
    let samples = at.join("walk/mav0/imu0/data.csv");
    let text = fs::read_to_string(&samples).expect("samples");
    fs::write(&samples, scaled(&text, 4..7, 1.05)).expect("samples");
    let said = json(
        at,
        &["vio", "walk", "--rig", "rig.toml", "--out", "s.tum"],
        0,
    );
    // Its accelerometer is 1.65 ms earlier than its gyroscope, in each part of the recording, with one camera and with two.
    let delay_s = said["accel_delay_s"].as_f64().expect("seconds");
    assert!((-2.3e-3..-1.0e-3).contains(&delay_s), "{delay_s} s");
    assert_eq!(finding(&said, "imu-errors")["verdict"], "warn");
    // The path is 5 % too long with it; once nothing said so.
    let gravity = finding(&said, "gravity");
    assert_eq!(gravity["verdict"], "warn");
    assert!(gravity["value"].as_f64().expect("%") > 4.0, "{gravity}");

    fs::write(&samples, scaled(&text, 1..4, 1f64.to_degrees())).expect("samples");
    let refused = lsfb(at, &["vio", "walk", "--rig", "rig.toml", "--out", "d.tum"]);
    assert_eq!(refused.status.code(), Some(1));
    let why = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        why.contains("in degrees per second") && !at.join("d.tum").exists(),
        "{why}"
    );
    assert!(!at.join("d.imported.mcap").exists());
}

/// The samples of a folder, each line changed; `None` drops it. Numbers count from the stamp, which is given in seconds after the first.
fn change_samples(at: &Path, change: impl Fn(f64, Vec<f64>) -> Option<Vec<f64>>) {
    let place = at.join("walk/mav0/imu0/data.csv");
    let text = fs::read_to_string(&place).expect("samples");
    let stamp = |line: &str| -> Option<i64> { line.split(',').next()?.trim().parse().ok() };
    let list = fs::read_to_string(at.join("walk/mav0/cam0/data.csv")).expect("list");
    let first = list.lines().find_map(stamp).expect("a stamp");
    let lines = text.lines().filter_map(|line| {
        let Some(ns) = stamp(line) else {
            return Some(line.to_owned());
        };
        let numbers = line.split(',').skip(1);
        let numbers = numbers
            .map(|n| n.trim().parse().expect("a number"))
            .collect();
        let changed = change((ns - first) as f64 * 1e-9, numbers)?;
        let cells: Vec<String> = changed.iter().map(f64::to_string).collect();
        Some(format!("{ns},{}", cells.join(",")))
    });
    let lines: Vec<String> = lines.collect();
    fs::write(&place, lines.join("\n")).expect("samples");
}

/// Stopped when all images were followed: they are not followed again.
fn stopped_it_goes_on_to_the_same(at: &Path) {
    let arguments = ["vio", "walk", "--rig", "rig.toml", "--out", "again.tum"];
    let mut running = Running::lsfb(at, arguments.map(str::to_owned));
    running.wait_for("motion");
    running.signal(Signal::SIGTERM);
    assert_eq!(running.wait().code(), Some(143), "{}", running.said());
    let kept = at.join("again.tum.unfinished");
    assert!(kept.join("followed.stage").exists());
    let again = lsfb(at, &arguments);
    let said = String::from_utf8_lossy(&again.stderr);
    assert_eq!(again.status.code(), Some(3), "{said}");
    assert!(said.contains("again.tum: resuming where it stopped") && !said.contains("following"));
    assert!(!kept.exists());
    for name in [".tum", "_covariance.txt"] {
        let read = |of: &str| fs::read(at.join(format!("{of}{name}"))).expect("a result");
        assert!(read("walk") == read("again"), "{name}");
    }
}

/// Once it was refused for the IMU's axes and both clocks.
#[test]
fn a_pause_of_the_imu_parts_the_walk_and_is_said() {
    let Some([walk, calibrated]) = tumvi("a_pause_of_the_imu_parts_the_walk_and_is_said") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let at = folder.path();
    part(&walk, 0..0, at);
    write_rig(&calibrated, |_| {}, &at.join("rig.toml"));
    change_samples(at, |secs, all| (!(2.0..3.0).contains(&secs)).then_some(all));
    let arguments = ["vio", "walk", "--rig", "rig.toml", "--out", "walk.tum"];
    let said = json(at, &arguments, 3);
    let pause = finding(&said, "imu-pause");
    assert!((pause["value"].as_f64().expect("s") - 1.0).abs() < 0.02);
    let what = pause["what"].as_str().expect("text");
    assert!(
        what.contains("from 2.0") || what.contains("from 1.99"),
        "{what}"
    );
    let left_out = finding(&said, "not-measured")["value"].as_f64().expect("s");
    assert!((1.8..3.2).contains(&left_out), "{left_out} s");
    let found = read_tum(&at.join("walk.tum")).expect("a trajectory");
    assert!(found.len() >= 48, "{} poses", found.len());
    stopped_it_goes_on_to_the_same(at);
    // Without the longest part's neighbours nothing is left.
    change_samples(at, |secs, all| (secs % 1.0 < 0.4).then_some(all));
    let refused = lsfb(at, &["vio", "walk", "--rig", "rig.toml", "--out", "p.tum"]);
    assert_eq!(refused.status.code(), Some(4));
    let why = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(why.contains("no IMU samples"), "{why}");
}

/// Once there was no answer for minutes.
#[test]
fn an_axis_of_the_gyroscope_with_the_wrong_sign_is_named() {
    let test = "an_axis_of_the_gyroscope_with_the_wrong_sign_is_named";
    let Some([walk, calibrated]) = tumvi(test) else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let at = folder.path();
    part(&walk, 0..0, at);
    write_rig(&calibrated, |_| {}, &at.join("rig.toml"));
    change_samples(at, |_, mut all| {
        all[2] = -all[2];
        Some(all)
    });
    let refused = lsfb(at, &["vio", "walk", "--rig", "rig.toml", "--out", "z.tum"]);
    assert_eq!(refused.status.code(), Some(4));
    let why = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(why.contains("about its z axis"), "{why}");
    assert!(!at.join("z.tum").exists());
}
