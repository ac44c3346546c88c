//! The checks of a rig on what others recorded: TUM VI's calibration sequence with the official rig.

#![allow(clippy::print_stdout, reason = "figures")]

use std::path::Path;

use lsfb_calib::camera::image_files;
use lsfb_calib::camera_imu::read_imu_table;
use lsfb_calib::verify::{Check, Verification, VerifyConfig, verify};
use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, Matrix3, Rig, RigCamera, Se3, UnitQuaternion, Vector3};
use lsfb_perception::image;
use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_tests::recordings as data;
use lsfb_types::{Image, Stamped, Timestamp, Verdict, no_progress};

const CAMERAS: [&str; 2] = ["cam0", "cam1"];
/// Stereo pairs that are used: twelve seconds.
const IMAGES: usize = 240;

/// The official calibration.
fn rig(path: &Path) -> Rig {
    let text = std::fs::read_to_string(path).expect("the reference");
    let reference: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let mut rig = Rig::empty("TUM VI");
    for name in CAMERAS {
        let camera = &reference[name];
        let entry = |i: usize, j: usize| number(&camera["T_cam_imu"][i][j]);
        let rotation = UnitQuaternion::from_matrix(&Matrix3::from_fn(entry));
        let camera_from_rig = Se3::new(rotation, Vector3::from_fn(|i, _| entry(i, 3)));
        let intrinsic = |k: usize| number(&camera["intrinsics"][k]);
        let mounted = RigCamera {
            camera: Camera {
                width: 512,
                height: 512,
                lens: Lens::KannalaBrandt {
                    focal_px: [intrinsic(0), intrinsic(1)],
                    principal_px: [intrinsic(2), intrinsic(3)],
                    distortion: std::array::from_fn(|k| number(&camera["k"][k])),
                },
            },
            rig_from_camera: camera_from_rig.inverse(),
            timing: Default::default(),
            sigmas: Default::default(),
        };
        rig.cameras.insert(name.to_owned(), mounted);
    }
    rig
}

/// Both cameras and the IMU in one recording.
fn record(folder: &Path, path: &Path) {
    fn stamped<T>(time: Timestamp, sample: T) -> Stamped<T> {
        Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample,
        }
    }
    let mut writer = Writer::create(path, &WriterConfig::default()).expect("a file");
    let table = read_imu_table(&folder.join("imu0/data.csv")).expect("a table");
    let mut samples = table.into_iter().peekable();
    let files = CAMERAS.map(|c| image_files(&folder.join(c).join("data")).expect("images"));
    for k in 0..IMAGES {
        for (name, files) in CAMERAS.iter().zip(&files) {
            let stem = files[k].file_stem().and_then(|s| s.to_str());
            let time = Timestamp::from_nanos(stem.expect("a stamp").parse().expect("a number"));
            while let Some((time, sample)) = samples.next_if(|s| s.0 <= time) {
                writer
                    .write_imu("imu0", &stamped(time, sample))
                    .expect("written");
            }
            let image: Image = image::read(&files[k]).expect("an image");
            writer
                .write_image(name, &stamped(time, image))
                .expect("written");
        }
    }
    writer.finish().expect("closed");
}

fn check<'a>(found: &'a Verification, name: &str) -> &'a Check {
    let check = found.checks.iter().find(|c| c.name == name);
    check.unwrap_or_else(|| panic!("{name} in {:?}", found.checks))
}

#[test]
fn clocks_and_mounts_of_tum_vi_are_right_and_wrong_ones_are_named() {
    let test = "clocks_and_mounts_of_tum_vi_are_right_and_wrong_ones_are_named";
    let Some(folder) = data(test, "vision/tumvi_calib_imu1/mav0") else {
        return;
    };
    let mut rig = rig(&folder.join("../reference_calibration.json"));
    let temporary = tempfile::tempdir().expect("a folder");
    let path = temporary.path().join("tum.mcap");
    record(&folder, &path);
    let recording = Recording::open(&path).expect("a recording");
    let run = |rig: &Rig| {
        verify(&recording, rig, &VerifyConfig::default(), &no_progress).expect("verified")
    };

    let right = run(&rig);
    for name in [
        "cam0 time offset",
        "cam0 rotation to the IMU",
        "cam1 time offset",
        "cam1 rotation to the IMU",
        "cam0–cam1 epipolar",
    ] {
        let found = check(&right, name);
        println!(
            "{name}: {:?} ± {:?} {}",
            found.value, found.sigma, found.unit
        );
        assert_eq!(found.outcome, Verdict::Pass, "{found:?}");
    }

    // One camera is late, the other early.
    for (name, wrong_s) in CAMERAS.iter().zip([0.005, -0.005]) {
        let camera = rig.cameras.get_mut(*name).expect("a camera");
        camera.timing.rig_from_camera_s = wrong_s;
    }
    let wrong = run(&rig);
    for (name, sign) in CAMERAS.iter().zip([-1.0, 1.0]) {
        let found = check(&wrong, &format!("{name} time offset"));
        assert_eq!(found.outcome, Verdict::Fail, "{found:?}");
        let off_ms = found.value.expect("a value") - sign * 5.0;
        assert!(off_ms.abs() < 0.5, "{found:?}");
    }
}
