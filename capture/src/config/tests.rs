use lsfb_drivers::mynt_s::{Exposure, StampInstant};

use super::*;

#[test]
fn reads_its_own_text_and_names_what_it_does_not_know() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("devices.toml");
    let config = DevicesConfig {
        lidars: vec![LidarNetConfig::default()],
        cameras: vec![CameraUnitConfig {
            stamp: StampInstant::ExposureEnd,
            exposure: Exposure::Manual {
                gain: 24,
                exposure: 90,
            },
            ..CameraUnitConfig::stereo("/run/lsfb/front".into(), ["cam0".into(), "cam1".into()])
        }],
        ..DevicesConfig::default()
    };
    std::fs::write(&path, config.to_toml()).unwrap();
    assert_eq!(DevicesConfig::read(&path).unwrap(), config);
    std::fs::write(&path, "[lidar]\nrpm = 600\n").unwrap();
    let message = DevicesConfig::read(&path).unwrap_err().to_string();
    assert!(
        message.contains("devices.toml: line 2: ")
            && message.contains("rpm")
            && message.lines().count() == 1,
        "{message}"
    );
}

#[test]
fn one_lidar_is_a_table_several_are_an_array_and_they_keep_apart() {
    let read = |text: &str| toml::from_str::<DevicesConfig>(text).unwrap();
    let one = read("[lidar]\nmodel = 'vlp-16'\n[imu]\npath = 'imu'\n");
    assert_eq!(
        (one.lidars.len(), one.lidars[0].name.as_str()),
        (1, "lidar")
    );
    assert_eq!((one.imus.len(), one.imus[0].name.as_str()), (1, "imu0"));
    let two = read(
        "[[lidar]]\n[[lidar]]\nname = 'lidar_rear'\ndata = '0.0.0.0:2369'\nposition = '0.0.0.0:8309'\n",
    );
    assert!(two.check().is_ok());
    assert_eq!(read(&two.to_toml()), two);
    let problem = |text: &str| read(text).check().unwrap_err().to_string();
    let message = problem("[[lidar]]\n[[lidar]]\nname = 'lidar_rear'\n");
    assert!(
        message.contains("lidar and lidar_rear listen on one port"),
        "{message}"
    );
    let told_apart = read(
        "[[lidar]]\nsensor = '192.168.1.201'\n[[lidar]]\nname = 'lidar_rear'\nsensor = '192.168.1.202'\n",
    );
    assert!(told_apart.check().is_ok());
    let message = problem(
        "[[lidar]]\nsensor = '192.168.1.201'\n[[lidar]]\nname = 'lidar_rear'\nsensor = '192.168.1.201'\n",
    );
    assert!(message.contains("listen on one port"), "{message}");
    let message = problem("[[lidar]]\n[[lidar]]\n");
    assert!(
        message
            .contains("setting lidar.name is \"lidar\": it must be a name that nothing else has"),
        "{message}"
    );
    let message = problem("[lidar]\nname = 'rear/left'\n");
    assert!(
        message.contains("letters, digits and underscores"),
        "{message}"
    );
}

#[test]
fn numbers_of_a_lidar_outside_their_bounds_are_refused_by_name() {
    let refused = |text: &str| {
        let config: DevicesConfig = toml::from_str(text).unwrap();
        config.check().unwrap_err().to_string()
    };
    // A whole number of degrees that is not there saturated to 0, and an empty buffer lost every packet.
    for (setting, expected) in [
        (
            "cut_azimuth_deg = nan",
            "setting lidar.cut_azimuth_deg is NaN",
        ),
        ("cut_azimuth_deg = 36000.0", "it must be -360 to 360"),
        ("receive_buffer_bytes = 0", "receive_buffer_bytes is 0"),
    ] {
        let message = refused(&format!("[lidar]\n{setting}\n"));
        assert!(message.contains(expected), "{message}");
    }
    let page = "[lidar.settings]\npage = '192.168.1.201:80'\n";
    for (setting, expected) in [
        (
            "rpm = 200",
            "setting lidar.settings.rpm is 200: it must be a multiple of 60 from 300 to 1200",
        ),
        (
            "rpm = 601",
            "rpm is 601: it must be a multiple of 60 from 300 to 1200",
        ),
        (
            "field_of_view_deg = [0, 360]",
            "setting lidar.settings.field_of_view_deg is 360: it must be 0 to 359",
        ),
        ("phase_lock_centideg = 36000", "it must be 0 to 35999"),
    ] {
        let message = refused(&format!("{page}{setting}\n"));
        assert!(message.contains(expected), "{message}");
    }
    let good = format!("{page}rpm = 600\nfield_of_view_deg = [0, 359]\n");
    let config: DevicesConfig = toml::from_str(&good).unwrap();
    assert!(config.check().is_ok());
    // The page of another vendor was asked as if it were this one's.
    let message = refused(&format!("[lidar]\nmodel = 'xt32'\n{good}"));
    assert!(message.contains("settings of model xt32"), "{message}");
}

#[test]
fn cameras_that_share_a_name_or_do_not_fill_a_frame_are_refused() {
    let with = |names: &[&[&str]]| DevicesConfig {
        cameras: names
            .iter()
            .map(|names| CameraUnitConfig {
                names: names.iter().map(|n| (*n).to_owned()).collect(),
                ..CameraUnitConfig::stereo(PathBuf::new(), Default::default())
            })
            .collect(),
        ..DevicesConfig::default()
    };
    for good in [
        &[&["cam0"][..], &["cam1"]][..],
        &[&["a", "b", "c", "d"], &["e", "f"]],
    ] {
        assert!(with(good).check().is_ok(), "{good:?}");
    }
    for (bad, expected) in [
        (
            &[&["cam0", "cam0"][..]][..],
            "setting camera.names is \"cam0\": it must be a name that nothing else has",
        ),
        (
            &[&["cam0", "cam1"], &["cam1", "cam2"]],
            "setting camera.names is \"cam1\": it must be a name that nothing else has",
        ),
        (
            &[&["a", "b", "c"]],
            "3 images do not fill a frame of 1280x400",
        ),
        (&[&[]], "0 images"),
    ] {
        let message = with(bad).check().unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}
