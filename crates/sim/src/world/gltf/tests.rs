use super::*;

fn shown(bytes: &[u8]) -> Result<Scene, String> {
    parse(bytes, Values::Shown)
}

/// One triangle of three corners, with more of a description.
fn triangle(more: &str) -> String {
    format!(
        r#"{{"scenes":[{{"nodes":[0]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3}}],
            "bufferViews":[{{"byteLength":36}}],{more}}}"#
    )
}

#[test]
fn any_bytes_give_a_scene_or_a_sentence() {
    let json = triangle(
        r#""nodes":[{"mesh":0,"children":[0]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#,
    );
    let file = file(&json, &[0; 36]);
    let problem = shown(&file).expect_err("circles");
    assert!(problem.contains("cycle"), "{problem}");
    for end in 0..file.len() {
        assert!(shown(&file[..end]).is_err());
    }
    assert!(shown(b"glTF").is_err() && shown(b"PK").is_err());
}

#[test]
fn scenes_that_grow_without_end_are_refused() {
    // Each node shows the next one twice.
    let nodes: Vec<String> = (1..60)
        .map(|next| format!(r#"{{"children":[{next},{next}]}}"#))
        .collect();
    let mesh = r#""meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#;
    let doubling = triangle(&format!(
        r#"{mesh},"nodes":[{},{{"mesh":0}}]"#,
        nodes.join(",")
    ));
    let problem = shown(&file(&doubling, &[0; 36])).expect_err("too many");
    assert!(problem.contains("more than 100000 nodes"), "{problem}");

    // Elements that all lie at one place, as many as one likes.
    let json = r#"{"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":1000000000000}],"bufferViews":[{"byteLength":36,"byteStride":0}]}"#;
    let problem = shown(&file(json, &[0; 36])).expect_err("endless");
    assert!(problem.contains("every 0 bytes"), "{problem}");
}

/// What strangers' files hold, and what is said about it; nothing where it is read all the same.
#[test]
fn faults_of_files_are_named() {
    let mesh = r#""meshes":[{"primitives":[{"attributes":{"POSITION":0},"material":0}]}]"#;
    let lamp = |lamp: &str, node: &str| {
        format!(
            r#"{mesh},"nodes":[{{"mesh":0,"extensions":{{"KHR_lights_punctual":{{"light":0}}}}{node}}}],
            "extensions":{{"KHR_lights_punctual":{{"lights":[{lamp}]}}}}"#
        )
    };
    let node = r#""nodes":[{"mesh":0}]"#;
    let cases = [
        (
            format!(
                r#"{mesh},{node},"materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":7}}}}}}]"#
            ),
            "",
        ),
        (
            format!(r#"{mesh},{node},"materials":[{{"emissiveFactor":[1e38,1e38,1e38]}}]"#),
            "",
        ),
        (
            format!(
                r#"{mesh},{node},"materials":[{{"emissiveFactor":[-1,0,0],"emissiveTexture":{{"index":1}}}}],"textures":[{{"source":4}}]"#
            ),
            "",
        ),
        (
            format!(r#"{mesh},{node},"images":[{{"uri":"wall.png"}}]"#),
            "an image lies outside the file",
        ),
        (
            format!(r#"{mesh},{node},"images":[{{"bufferView":0}}]"#),
            "a JPEG picture",
        ),
        (
            format!(r#"{mesh},{node},"images":[{{"bufferView":9}}]"#),
            "a missing buffer view",
        ),
        (
            format!(r#"{mesh},{node},"extensionsRequired":["KHR_draco_mesh_compression"]"#),
            "KHR_draco_mesh_compression",
        ),
        (
            format!(r#"{mesh},{node},"extensionsRequired":["KHR_lights_punctual"]"#),
            "",
        ),
        (lamp(r#"{"type":"point","intensity":40}"#, ""), ""),
        (
            lamp(
                r#"{"type":"spot","spot":{"innerConeAngle":9,"outerConeAngle":-3}}"#,
                "",
            ),
            "",
        ),
        (
            lamp(r#"{"type":"area"}"#, ""),
            "a light of the type \"area\"",
        ),
        (
            lamp(r#"{"type":"point"}"#, r#","scale":[0,0,0]"#),
            "a light has no position and direction",
        ),
        (
            lamp(r#"{"type":"point"}"#, r#","translation":[1e30,0,0]"#),
            "a light has no position and direction",
        ),
        (
            lamp(r#"{"type":"point"}"#, r#","rotation":[0,0,0,0]"#),
            "a light has no position and direction",
        ),
        (
            format!(
                r#"{mesh},"nodes":[{{"mesh":0,"extensions":{{"KHR_lights_punctual":{{"light":3}}}}}}]"#
            ),
            "a missing light",
        ),
        (
            format!(r#"{mesh},"nodes":[{{"mesh":4}}]"#),
            "a missing mesh",
        ),
        (
            format!(r#"{node},"meshes":[{{"primitives":[{{"attributes":{{"POSITION":5}}}}]}}]"#),
            "a missing accessor",
        ),
        (
            format!(r#"{mesh},"nodes":[{{"mesh":0,"children":[17]}}]"#),
            "a missing node",
        ),
    ];
    for (more, expected) in cases {
        match shown(&file(&triangle(&more), &[0; 36])) {
            Ok(_) => assert!(expected.is_empty(), "{more}"),
            Err(problem) => assert!(
                !expected.is_empty() && problem.contains(expected),
                "{problem}: {more}"
            ),
        }
    }
}

/// A picture of one pixel would have no neighbours to be interpolated with, and a bomb no end.
#[test]
fn pictures_have_a_size_within_reason() {
    let png = |width: u32, height: u32| {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        let mut writer = encoder.write_header().expect("header");
        writer
            .write_image_data(&vec![188; (width * height) as usize])
            .expect("pixels");
        drop(writer);
        bytes
    };
    let read = |bytes: &[u8], values| decode(bytes, values);
    assert!(read(&png(1, 5), Values::Shown).is_err());
    assert!(read(&png(9000, 9000), Values::Shown).is_err_and(|e| e.contains("too large")));
    let value = |values| read(&png(4, 4), values).expect("picture").values[0];
    // sRGB 188 is half the light.
    assert!((value(Values::Light) - 0.503).abs() < 0.001);
    assert!((value(Values::Shown) - 188.0 / 255.0).abs() < 1e-6);
}
