//! Scenes of others in `lsfb sim`: lit by their own lamps unless that is refused.

use std::path::Path;

use crate::answer::json;
use crate::process::lsfb;

/// A binary glTF file of a grey floor of 4 × 4 m with a lamp 1.5 m above it, or as far below.
fn floor_with_lamp(path: &Path, height_m: f32) {
    let corners: [[f32; 3]; 4] = [
        [-2.0, 0.0, 2.0],
        [2.0, 0.0, 2.0],
        [2.0, 0.0, -2.0],
        [-2.0, 0.0, -2.0],
    ];
    let data: Vec<u8> = [0, 1, 2, 0, 2, 3]
        .iter()
        .flat_map(|k: &usize| corners[*k].map(f32::to_le_bytes))
        .flatten()
        .collect();
    let description = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"mesh":0,"children":[1]}},{{"translation":[1,{height_m},0],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[0.5,0.5,0.5,1]}}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":6,"type":"VEC3"}}],
        "bufferViews":[{{"buffer":0,"byteLength":{length}}}],"buffers":[{{"byteLength":{length}}}],
        "extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"point","intensity":300}}]}}}}}}"#,
        length = data.len()
    );
    let padded = format!(
        "{description:width$}",
        width = description.len().next_multiple_of(4)
    );
    let mut file = Vec::new();
    let whole = 12 + 8 + padded.len() + 8 + data.len();
    for part in [b"glTF", &2_u32.to_le_bytes(), &(whole as u32).to_le_bytes()] {
        file.extend_from_slice(part);
    }
    for (kind, chunk) in [(b"JSON", padded.as_bytes()), (b"BIN\0", data.as_slice())] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend_from_slice(kind);
        file.extend_from_slice(chunk);
    }
    std::fs::write(path, file).expect("written");
}

/// Scenes were shown as bright as they are painted unless --baked-light was given.
#[test]
fn a_scene_is_lit_by_its_own_lamps_unless_light_is_simple() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    floor_with_lamp(&root.join("above.glb"), 1.5);
    floor_with_lamp(&root.join("below.glb"), -1.5);
    let draw = |scene: &str, out: &str, more: &[&str]| {
        let all = [
            &["sim", "preview", "--scene", scene, "--out", out][..],
            more,
        ];
        json(root, &all.concat(), 0);
        std::fs::read(root.join(out).join("imported-top.png")).expect("picture")
    };
    let lit = draw("above.glb", "lit", &[]);
    let painted = draw("above.glb", "painted", &["--simple-light"]);
    assert!(lit != painted, "the lamp makes no difference");
    let dark = lsfb(
        root,
        &["sim", "preview", "--scene", "below.glb", "--out", "dark"],
    );
    let said = String::from_utf8_lossy(&dark.stderr);
    assert_eq!(dark.status.code(), Some(1), "{said}");
    assert!(
        said.contains("no light reaches") && said.contains("--simple-light"),
        "{said}"
    );
}
