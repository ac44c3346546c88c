//! Scenes of other people: binary glTF files. The fuzzer gives what is inside: the description, 0xFF, the data.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_sim::{LightConfig, World};
use lsfb_types::no_progress;

fuzz_target!(|data: &[u8]| {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}.glb", std::process::id()));
    let mut bytes = data.to_vec();
    if !data.starts_with(b"glTF") {
        let end = data.iter().position(|byte| *byte == 0xFF);
        let (description, rest) = data.split_at(end.unwrap_or(data.len()));
        bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for content in [description, rest.get(1..).unwrap_or_default()] {
            bytes.extend((content.len() as u32).to_le_bytes());
            bytes.extend([0; 4]);
            bytes.extend(content);
        }
    }
    std::fs::write(&path, bytes).expect("a scratch file");
    let light = LightConfig {
        baked: data.len() % 2 == 1,
        spacing_m: 1.0,
        paths: 8,
        ..LightConfig::default()
    };
    if let Ok(world) = World::of_file(&path, &light, 1, &no_progress) {
        let _ = world.cast([0.0, 0.0, 1.0], [0.0, 0.6, -0.8]);
        let _ = world.extent_m();
    }
});
