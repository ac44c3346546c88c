//! Calibrations of other programs: Kalibr's camera chains, IMU and targets, ROS's CameraInfo, COLMAP's cameras and rigs,
//! Basalt's calibration, tables of IMU samples, and transforms between sensors.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use lsfb_calib::camera_imu::read_imu_table;
use lsfb_calib::exchange::{
    Format, export, import_basalt, import_camera_info, import_colmap, import_kalibr,
    import_kalibr_imu,
};
use lsfb_calib::{Target, TransformEdge};
use lsfb_geometry::Rig;

/// Images of more pixels are no faster to refuse, and slow to fit another lens to.
const LARGEST: u32 = 10_000;

/// What was read is a rig that can be written, and read again. Its lenses can be written in their own program's words.
fn assert_rig(rig: &Rig, format: Format) {
    let text = rig.to_toml();
    let again = Rig::from_toml(&text, "fuzz").expect("it was written");
    // Rotations may change in their last bit.
    assert!(again.cameras.keys().eq(rig.cameras.keys()));
    let is_small = |rig: &Rig| {
        let mut sizes = rig
            .cameras
            .values()
            .map(|c| c.camera.width.max(c.camera.height));
        sizes.all(|size| size < LARGEST)
    };
    if is_small(rig) {
        let exported = export(rig, format, 200.0).expect("it has a camera");
        assert!(!exported.files.is_empty());
    }
}

fn with_file<T>(data: &[u8], read: impl FnOnce(&Path) -> T) -> T {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}-exchange", std::process::id()));
    std::fs::write(&path, data).expect("a scratch file");
    read(&path)
}

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    let text = String::from_utf8_lossy(data);
    match kind {
        b'k' => {
            if let Ok(found) = import_kalibr(&text, "fuzz") {
                assert_rig(&found.rig, Format::Kalibr);
            }
        }
        b'n' => drop(import_kalibr_imu(&text, "fuzz")),
        b'r' => {
            if let Ok(found) = import_camera_info(&text, "fuzz") {
                assert!(found.camera.lens.problem().is_none());
            }
        }
        b'c' => {
            // What follows the first zero is the rig.
            let (cameras, rig) = text.split_once('\0').unwrap_or((&text, ""));
            if let Ok(found) = import_colmap(cameras, Some(rig).filter(|r| !r.is_empty()), "fuzz") {
                assert_rig(&found.rig, Format::Colmap);
            }
        }
        b'b' => {
            if let Ok(found) = import_basalt(&text, "fuzz") {
                assert_rig(&found.rig, Format::Basalt);
            }
        }
        b't' => {
            if let Ok(target) = with_file(data, Target::read_kalibr) {
                let written = target.to_kalibr();
                let again = with_file(written.as_bytes(), Target::read_kalibr);
                assert_eq!(again.expect("it was written"), target);
            }
        }
        b'e' => {
            if let Ok(edge) = with_file(data, TransformEdge::read) {
                let written = edge.to_json();
                let again = with_file(written.as_bytes(), TransformEdge::read);
                let again = again.expect("it was written");
                assert_eq!((again.target, again.source), (edge.target, edge.source));
            }
        }
        _ => {
            if let Ok(samples) = with_file(data, read_imu_table) {
                for (_, sample) in samples {
                    let values = sample.angular_velocity_rad_s.into_iter();
                    let mut values = values.chain(sample.specific_force_m_s2);
                    assert!(values.all(f64::is_finite));
                }
            }
        }
    }
});
