//! HD maps: a small one of ours with edits and the right hashes, or whatever the fuzzer makes of its list of files.
#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use lsfb_geometry::{Camera, Rig, RigCamera, Se3, StampedPose, Vector3};
use lsfb_pipeline::features::{Feature, Features, Keypoint};
use lsfb_pipeline::hd_map::{
    HdMap, HdMapConfig, KeyframeImage, MapContent, MapPoint, PointObservation,
};
use lsfb_pipeline::localization::{Localizer, LocalizerConfig};
use lsfb_types::Timestamp;
use sha2::{Digest, Sha256};

const POINTS: u32 = 6;

struct Whole {
    folder: PathBuf,
    header: toml::Table,
    /// Name and bytes of each table, in the order of the list.
    tables: Vec<(String, Vec<u8>)>,
}

static WHOLE: LazyLock<Whole> = LazyLock::new(|| {
    let folder = std::env::temp_dir().join(format!("lsfb-fuzz-{}-map", std::process::id()));
    let keyframes = [StampedPose {
        time: Timestamp::from_nanos(1_000),
        world_from_rig: Se3::identity(),
    }];
    let images = [KeyframeImage {
        keyframe: 0,
        camera: "cam0".to_owned(),
        features: Features {
            keypoints: (0..POINTS)
                .map(|i| Keypoint {
                    pixel: [10.0 * i as f32, 5.0],
                    scale_px: 2.0,
                    angle_rad: 0.0,
                    response: 0.1,
                })
                .collect(),
            descriptors: (0..POINTS as u8)
                .map(|i| std::array::from_fn(|d| (d as u8 ^ i.wrapping_mul(37)) & 0x7f))
                .collect(),
        },
    }];
    let points: Vec<MapPoint> = (0..POINTS)
        .map(|keypoint| MapPoint {
            point_in_world: Vector3::new(f64::from(keypoint), 2.0, 3.0),
            observations: vec![PointObservation { image: 0, keypoint }],
            reprojection_rms_px: 0.5,
        })
        .collect();
    let mut rig = Rig::empty("fuzz");
    let camera = Camera::pinhole(640, 480, [400.0; 2], [320.0, 240.0]);
    let mounted = RigCamera {
        camera,
        rig_from_camera: Se3::identity(),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    rig.cameras.insert("cam0".to_owned(), mounted);
    let content = MapContent {
        rig: &rig,
        keyframes: &keyframes,
        images: &images,
        points: &points,
        feature: &Feature::Sift,
        provenance: "fuzz",
    };
    let map = HdMap::build(&content, &HdMapConfig::default(), &lsfb_types::no_progress);
    map.and_then(|map| map.write(&folder)).expect("a small map");
    let text = std::fs::read_to_string(folder.join(HdMap::HEADER)).expect("written");
    let header: toml::Table = text.parse().expect("its own text");
    let names = header["files"].as_array().expect("a list").iter();
    let tables = names.map(|file| {
        let name = file["name"].as_str().expect("a name").to_owned();
        let bytes = std::fs::read(folder.join(&name)).expect("written");
        (name, bytes)
    });
    Whole {
        tables: tables.collect(),
        header,
        folder,
    }
});

/// Writes a table anew, and its length and hash into the list.
fn put(header: &mut toml::Table, whole: &Whole, table: usize, bytes: &[u8]) {
    let (name, _) = &whole.tables[table];
    std::fs::write(whole.folder.join(name), bytes).expect("a scratch file");
    let hash: String = Sha256::digest(bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect();
    let entry = header["files"]
        .as_array_mut()
        .and_then(|files| files.get_mut(table));
    let entry = entry.and_then(toml::Value::as_table_mut).expect("an entry");
    entry.insert("bytes".to_owned(), toml::Value::Integer(bytes.len() as i64));
    entry.insert("sha256".to_owned(), hash.into());
    // What has no checksum is held against its hash.
    entry.remove("crc32c");
}

fuzz_target!(|data: &[u8]| {
    let whole = &*WHOLE;
    let mut touched = Vec::new();
    let text = if let [b'T', text @ ..] = data {
        text.to_vec()
    } else {
        let mut header = whole.header.clone();
        let mut tables: Vec<Vec<u8>> = whole
            .tables
            .iter()
            .map(|(_, bytes)| bytes.clone())
            .collect();
        for edit in data.chunks_exact(5).take(16) {
            let table = usize::from(edit[0] & 7) % tables.len();
            let bytes = &mut tables[table];
            // The beginning and the end are the interesting parts.
            let at = usize::from(u16::from_le_bytes([edit[1], edit[2]])) % bytes.len().max(1);
            let at = if edit[0] & 8 == 0 {
                at
            } else {
                bytes.len().saturating_sub(1 + at)
            };
            match edit[0] >> 4 {
                0 => bytes.truncate(at),
                1 => {
                    let key = ["points", "keyframes", "observations", "descriptors"]
                        [usize::from(edit[3] & 3)];
                    header.insert(key.to_owned(), toml::Value::Integer(edit[4].into()));
                }
                _ => {
                    if let Some(byte) = bytes.get_mut(at) {
                        *byte ^= edit[3];
                    }
                }
            }
            touched.push(table);
        }
        for &table in &touched {
            put(&mut header, whole, table, &tables[table]);
        }
        header.to_string().into_bytes()
    };
    std::fs::write(whole.folder.join(HdMap::HEADER), text).expect("a scratch file");
    if let Ok(map) = HdMap::open(&whole.folder) {
        for point in 0..map.point_count() as u32 {
            let _ = (map.position(point), map.descriptors(point).len());
            let _ = map.observations(point).count();
        }
        let _ = (0..map.keyframe_count() as u32)
            .filter_map(|k| map.keyframe(k))
            .count();
        let _ = map.positions().count();
        let _ = Localizer::new(&map, &LocalizerConfig::default());
    }
    for table in touched {
        let (name, bytes) = &whole.tables[table];
        std::fs::write(whole.folder.join(name), bytes).expect("a scratch file");
    }
});
