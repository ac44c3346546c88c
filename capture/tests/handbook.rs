//! `docs/devices.md` is what the code reads: every example can be read, every key is described with its default.

use std::path::{Path, PathBuf};

use lsfb_capture::{
    CameraUnitConfig, DevicesConfig, ImuLineConfig, LidarNetConfig, LidarSettingsConfig,
    RecorderConfig, SidecarConfig,
};

fn handbook() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/devices.md");
    std::fs::read_to_string(path).expect("docs/devices.md")
}

/// Keys of a table with the defaults that are written for them.
fn described(handbook: &str) -> Vec<(String, String)> {
    let rows = handbook.lines().filter_map(|line| {
        let mut cells = line.strip_prefix("| `")?.split(" | ");
        let key = cells.next()?.strip_suffix('`')?.to_owned();
        Some((key, cells.next()?.trim_matches('`').to_owned()))
    });
    rows.collect()
}

#[test]
fn every_example_of_the_handbook_is_a_list_of_devices() {
    let text = handbook();
    let folder = tempfile::tempdir().expect("folder");
    let list = folder.path().join("devices.toml");
    let examples: Vec<&str> = text
        .split("```toml\n")
        .skip(1)
        .filter_map(|rest| rest.split("```").next())
        .collect();
    assert!(examples.len() >= 5, "{examples:?}");
    for example in examples {
        std::fs::write(&list, example).expect("list");
        DevicesConfig::read(&list).unwrap_or_else(|error| panic!("{error}\n{example}"));
    }
}

#[test]
fn every_key_is_described_and_every_default_is_right() {
    let described = described(&handbook());
    let settings = LidarSettingsConfig {
        page: ([192, 168, 1, 201], 80).into(),
        rpm: Some(600),
        returns: None,
        field_of_view_deg: Some([0, 359]),
        phase_lock_centideg: Some(0),
        destination: Some([192, 168, 1, 100].into()),
    };
    let lidar = LidarNetConfig {
        settings: Some(settings),
        ..LidarNetConfig::default()
    };
    let imu: ImuLineConfig = toml::from_str("path = \"x\"").expect("an IMU");
    let whole = DevicesConfig {
        rig: Some(PathBuf::from("rig.toml")),
        lidars: vec![lidar],
        cameras: vec![CameraUnitConfig::stereo(PathBuf::new(), Default::default())],
        imus: vec![imu],
        sidecar: Some(SidecarConfig::new(
            ([127, 0, 0, 1], 8790).into(),
            PathBuf::from("sidecar"),
        )),
        ..DevicesConfig::default()
    };
    let written: toml::Table = whole.to_toml().parse().expect("TOML");
    let mut keys = Vec::new();
    for (name, value) in &written {
        match value {
            toml::Value::Table(section) => keys.extend(section.clone()),
            toml::Value::Array(units) => {
                let unit = units[0].as_table().expect("a unit");
                keys.extend(unit.clone());
            }
            plain => keys.push((name.clone(), plain.clone())),
        }
    }
    assert!(keys.len() > 25, "{keys:?}");
    for (key, value) in keys {
        let rows: Vec<_> = described.iter().filter(|(name, _)| *name == key).collect();
        assert!(!rows.is_empty(), "{key} is not described");
        let has_no_default = ["required", "none", "as it is"];
        let default = value.to_string();
        let right = rows
            .iter()
            .any(|(_, said)| has_no_default.contains(&said.as_str()) || *said == default);
        assert!(right, "{key}: {rows:?}, and it is {default}");
    }
}

/// Keys that a table may have, by what is said of one that it may not.
fn keys_of<T: serde::de::DeserializeOwned>() -> Vec<String> {
    let Err(refused) = toml::from_str::<T>("no-such-key = 1") else {
        panic!("an unknown key is taken");
    };
    let words = refused.message();
    let listed = words.split_once("expected one of ").expect(words).1;
    let keys = listed
        .split(", ")
        .map(|key| key.trim_matches('`').to_owned());
    keys.collect()
}

/// What is left out when nobody sets it has no default to be found by.
#[test]
fn every_key_that_is_read_has_its_row() {
    let handbook = handbook();
    let described: Vec<String> = described(&handbook)
        .into_iter()
        .map(|(key, _)| key)
        .collect();
    let settings = keys_of::<LidarSettingsConfig>();
    let settings = settings
        .iter()
        .map(|key| format!("settings.{key}"))
        .collect();
    let sections: [Vec<String>; 6] = [
        keys_of::<LidarNetConfig>(),
        settings,
        keys_of::<CameraUnitConfig>(),
        keys_of::<ImuLineConfig>(),
        keys_of::<RecorderConfig>(),
        keys_of::<SidecarConfig>(),
    ];
    for key in sections.iter().flatten() {
        assert!(described.contains(key), "{key} is not described");
    }
    // Sections have a heading each, and what else the list has a row.
    for key in keys_of::<DevicesConfig>() {
        let is_section = handbook.contains(&format!("[{key}]"));
        assert!(
            is_section || described.contains(&key),
            "{key} is not described"
        );
    }
    let read: usize = sections.iter().map(Vec::len).sum();
    assert!(read > 40, "{read}");
}
