//! Textured scenes of other people: binary glTF 2.0 files (`.glb`) with everything inside.
//!
//! Triangles with the picture of their base colour, shown as bright as it is painted. Anything else that a file may
//! hold (skins, animations, further textures) is passed over; a file that needs an extension beyond unlit materials is
//! refused.

use std::path::Path;

use nalgebra::{Matrix4, Quaternion, Translation3, UnitQuaternion, Vector3, Vector4};
use serde::Deserialize;
use zune_jpeg::zune_core::bytestream::ZCursor;

use super::canvas::Canvas;
use crate::Error;

/// A triangle with its place in a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triangle {
    /// Corners, metres, z up, counter-clockwise from where it is seen.
    pub corners_m: [[f32; 3]; 3],
    /// Of each corner, in widths and heights of the picture.
    pub places: [[f32; 2]; 3],
    /// Which picture; the one after the last is plain.
    pub picture: usize,
    /// Factor of the brightness.
    pub gain: f32,
}

/// What a file shows.
#[derive(Clone, Debug)]
pub(super) struct Scene {
    pub triangles: Vec<Triangle>,
    /// Brightness as seen, 0–1; the last is plain white.
    pub pictures: Vec<Canvas>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
#[derive(Default)]
struct Document {
    scene: usize,
    scenes: Vec<Nodes>,
    nodes: Vec<Node>,
    meshes: Vec<Mesh>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    materials: Vec<Material>,
    textures: Vec<Texture>,
    images: Vec<Picture>,
    extensions_required: Vec<String>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Nodes {
    nodes: Vec<usize>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Node {
    children: Vec<usize>,
    mesh: Option<usize>,
    matrix: Option<[f32; 16]>,
    translation: Option<[f32; 3]>,
    rotation: Option<[f32; 4]>,
    scale: Option<[f32; 3]>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: Attributes,
    indices: Option<usize>,
    material: Option<usize>,
    #[serde(default = "triangles")]
    mode: u32,
}

const fn triangles() -> u32 {
    4
}

#[derive(Deserialize)]
#[serde(rename_all = "UPPERCASE")]
struct Attributes {
    position: usize,
    #[serde(rename = "TEXCOORD_0")]
    place: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    count: usize,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct View {
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Material {
    pbr_metallic_roughness: Paint,
    double_sided: bool,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Paint {
    base_color_factor: Option<[f32; 4]>,
    base_color_texture: Option<TextureAt>,
}

#[derive(Deserialize)]
struct TextureAt {
    index: usize,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Texture {
    source: Option<usize>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Picture {
    buffer_view: Option<usize>,
}

/// Deepest tree of nodes; deeper ones go round in circles.
const MOST_LEVELS: usize = 64;
/// Nodes, those shown in several places counted in each.
const MOST_NODES: usize = 100_000;
/// Triangles of a whole scene, counted alike.
const MOST_TRIANGLES: usize = 20_000_000;
/// Pixels of one picture.
const MOST_PIXELS: usize = 1 << 28;
/// Bytes of the file's header, and of a chunk's.
const HEADER: usize = 12;
const CHUNK_HEADER: usize = 8;

/// Reads a file.
pub(super) fn read(path: &Path) -> Result<Scene, Error> {
    let refused = |problem: String| Error::Scene {
        path: path.to_owned(),
        problem,
    };
    let bytes = std::fs::read(path).map_err(|e| refused(e.to_string()))?;
    parse(&bytes).map_err(refused)
}

/// Reads the bytes of a file; what is wrong with them otherwise.
fn parse(bytes: &[u8]) -> Result<Scene, String> {
    if bytes.get(..4) != Some(b"glTF") {
        return Err("this is no binary glTF file (.glb)".to_owned());
    }
    let (json, rest) = chunk(bytes.get(HEADER..).unwrap_or_default())?;
    let (data, _) = chunk(rest).unwrap_or_default();
    let document: Document =
        serde_json::from_slice(json).map_err(|e| format!("its description: {e}"))?;
    let known = |name: &String| name == "KHR_materials_unlit";
    if let Some(name) = document.extensions_required.iter().find(|n| !known(n)) {
        return Err(format!(
            "it needs the extension {name}, which is not supported"
        ));
    }
    let mut pictures = Vec::new();
    for picture in &document.images {
        let view = picture
            .buffer_view
            .ok_or("a picture lies outside the file")?;
        pictures.push(decode(document.view(view, data)?)?);
    }
    let mut white = Canvas::new([1.0; 2], 0.5, 1.0);
    white.values.fill(1.0);
    pictures.push(white);
    let mut reading = Reading {
        document: &document,
        data,
        pictures: pictures.len(),
        nodes: 0,
        triangles: Vec::new(),
    };
    let scene = document
        .scenes
        .get(document.scene)
        .ok_or("it has no scene")?;
    for &node in &scene.nodes {
        reading.node(node, &Matrix4::identity(), 0)?;
    }
    if reading.triangles.is_empty() {
        return Err("it has no triangles".to_owned());
    }
    let triangles = reading.triangles;
    Ok(Scene {
        triangles,
        pictures,
    })
}

/// The first chunk's content, and what follows it.
fn chunk(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let cut = || "the file ends too early".to_owned();
    let length = bytes
        .get(..4)
        .and_then(|b| b.try_into().ok())
        .ok_or_else(cut)?;
    let end = CHUNK_HEADER + u32::from_le_bytes(length) as usize;
    let content = bytes.get(CHUNK_HEADER..end).ok_or_else(cut)?;
    Ok((content, bytes.get(end..).unwrap_or_default()))
}

/// A PNG or JPEG picture in grey.
fn decode(bytes: &[u8]) -> Result<Canvas, String> {
    let (width, height, channels, pixels) = if bytes.starts_with(b"\x89PNG") {
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::normalize_to_color8());
        let mut reader = decoder
            .read_info()
            .map_err(|e| format!("a PNG picture: {e}"))?;
        let size = reader
            .output_buffer_size()
            .filter(|size| *size <= 4 * MOST_PIXELS)
            .ok_or("a PNG picture is too large")?;
        let mut pixels = vec![0; size];
        let info = reader
            .next_frame(&mut pixels)
            .map_err(|e| format!("a PNG picture: {e}"))?;
        (
            info.width as usize,
            info.height as usize,
            info.color_type.samples(),
            pixels,
        )
    } else {
        let mut decoder = zune_jpeg::JpegDecoder::new(ZCursor::new(bytes));
        let pixels = decoder
            .decode()
            .map_err(|e| format!("a JPEG picture: {e}"))?;
        let (width, height) = decoder
            .dimensions()
            .ok_or("a JPEG picture without a size")?;
        (
            width,
            height,
            pixels.len() / (width * height).max(1),
            pixels,
        )
    };
    if width < 2 || height < 2 || channels == 0 {
        return Err("a picture has less than two pixels along an edge".to_owned());
    }
    let values = pixels
        .chunks_exact(channels)
        .take(width * height)
        .map(|p| match *p {
            [r, g, b, ..] => 0.299 * f32::from(r) + 0.587 * f32::from(g) + 0.114 * f32::from(b),
            [grey, ..] => f32::from(grey),
            [] => 0.0,
        });
    let values: Vec<f32> = values.map(|v| v / 255.0).collect();
    if values.len() < width * height {
        return Err("a picture ends too early".to_owned());
    }
    Ok(Canvas {
        width,
        height,
        texel_m: [1.0 / width as f32, 1.0 / height as f32],
        values,
    })
}

impl Document {
    fn view<'a>(&self, index: usize, data: &'a [u8]) -> Result<&'a [u8], String> {
        let view = self
            .buffer_views
            .get(index)
            .ok_or("a view that is not there")?;
        let end = view.byte_offset.checked_add(view.byte_length);
        end.and_then(|end| data.get(view.byte_offset..end))
            .ok_or_else(|| "a view beyond the end of the data".to_owned())
    }

    /// The numbers of an accessor, `N` to each element; integers as fractions of their range where `N` is not 1.
    fn numbers<const N: usize>(&self, index: usize, data: &[u8]) -> Result<Vec<[f64; N]>, String> {
        let accessor = self
            .accessors
            .get(index)
            .ok_or("an accessor that is not there")?;
        let view_index = accessor.buffer_view.ok_or("an accessor without a view")?;
        let bytes = self.view(view_index, data)?;
        let size = match accessor.component_type {
            5121 => 1,
            5123 => 2,
            5125 | 5126 => 4,
            other => return Err(format!("numbers of type {other}")),
        };
        let packed = size * N;
        let stride = self.buffer_views[view_index].byte_stride.unwrap_or(packed);
        let short = || "an accessor beyond the end of its view".to_owned();
        (0..accessor.count)
            .map(|k| {
                let start = k
                    .checked_mul(stride)
                    .and_then(|s| s.checked_add(accessor.byte_offset));
                let element = start
                    .and_then(|s| bytes.get(s..s.checked_add(packed)?))
                    .ok_or_else(short)?;
                let mut numbers = [0.0; N];
                for (number, raw) in numbers.iter_mut().zip(element.chunks_exact(size)) {
                    *number = match (accessor.component_type, raw) {
                        (5126, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]).into(),
                        (_, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]).into(),
                        (_, &[a, b]) if N == 1 => u16::from_le_bytes([a, b]).into(),
                        (_, &[a, b]) => f64::from(u16::from_le_bytes([a, b])) / 65535.0,
                        (_, &[a]) if N == 1 => a.into(),
                        (_, &[a]) => f64::from(a) / 255.0,
                        _ => return Err(short()),
                    };
                }
                Ok(numbers)
            })
            .collect()
    }
}

struct Reading<'a> {
    document: &'a Document,
    data: &'a [u8],
    pictures: usize,
    nodes: usize,
    triangles: Vec<Triangle>,
}

impl Reading<'_> {
    fn node(&mut self, index: usize, parent: &Matrix4<f32>, level: usize) -> Result<(), String> {
        let document = self.document;
        let node = document
            .nodes
            .get(index)
            .ok_or("a node that is not there")?;
        if level > MOST_LEVELS {
            return Err("its nodes go round in circles".to_owned());
        }
        self.nodes += 1;
        if self.nodes > MOST_NODES {
            return Err(format!("it shows more than {MOST_NODES} nodes"));
        }
        let own = match node.matrix {
            Some(columns) => Matrix4::from_column_slice(&columns),
            None => {
                let [x, y, z, w] = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
                let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
                let shift = Translation3::from(Vector3::from(node.translation.unwrap_or_default()));
                let scale = Vector3::from(node.scale.unwrap_or([1.0; 3]));
                shift.to_homogeneous()
                    * turn.to_homogeneous()
                    * Matrix4::new_nonuniform_scaling(&scale)
            }
        };
        let world = parent * own;
        if let Some(mesh) = node.mesh {
            let mesh = document
                .meshes
                .get(mesh)
                .ok_or("a mesh that is not there")?;
            for primitive in mesh.primitives.iter().filter(|p| p.mode == triangles()) {
                self.primitive(primitive, &world)?;
            }
        }
        for &child in &node.children {
            self.node(child, &world, level + 1)?;
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Primitive, world: &Matrix4<f32>) -> Result<(), String> {
        let document = self.document;
        let positions = document.numbers::<3>(primitive.attributes.position, self.data)?;
        let places = match primitive.attributes.place {
            Some(accessor) => document.numbers::<2>(accessor, self.data)?,
            None => Vec::new(),
        };
        let order: Vec<usize> = match primitive.indices {
            Some(accessor) => {
                let numbers = document.numbers::<1>(accessor, self.data)?;
                numbers.into_iter().map(|[n]| n as usize).collect()
            }
            None => (0..positions.len()).collect(),
        };
        let material = primitive.material.and_then(|m| document.materials.get(m));
        let paint = material.map(|m| &m.pbr_metallic_roughness);
        let texture = paint.and_then(|p| p.base_color_texture.as_ref());
        let picture = texture
            .and_then(|t| document.textures.get(t.index)?.source)
            .filter(|source| *source + 1 < self.pictures)
            .unwrap_or(self.pictures - 1);
        let [r, g, b, _] = paint.and_then(|p| p.base_color_factor).unwrap_or([1.0; 4]);
        let gain = (0.299 * r + 0.587 * g + 0.114 * b).max(0.0).sqrt();
        if self.triangles.len() + order.len() > MOST_TRIANGLES {
            return Err(format!("it has more than {MOST_TRIANGLES} triangles"));
        }
        for corner in order.chunks_exact(3) {
            let mut triangle = Triangle {
                corners_m: [[0.0; 3]; 3],
                places: [[0.0; 2]; 3],
                picture,
                gain,
            };
            for (k, &index) in corner.iter().enumerate() {
                let p = positions.get(index).ok_or("a corner that is not there")?;
                let at = world * Vector4::new(p[0] as f32, p[1] as f32, p[2] as f32, 1.0);
                // glTF has y up and looks along z.
                triangle.corners_m[k] = [at.x, -at.z, at.y];
                triangle.places[k] = places.get(index).map_or([0.0; 2], |p| p.map(|v| v as f32));
            }
            self.triangles.push(triangle);
            if material.is_some_and(|m| m.double_sided) {
                let mut back = triangle;
                back.corners_m.swap(1, 2);
                back.places.swap(1, 2);
                self.triangles.push(back);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_bytes_give_a_scene_or_a_sentence() {
        let json = br#"{"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0,"children":[0]}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
            "accessors":[{"bufferView":0,"componentType":5126,"count":3}],
            "bufferViews":[{"byteLength":36}]}"#;
        let mut file = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for content in [&json[..], &[0; 36]] {
            file.extend((content.len() as u32).to_le_bytes());
            file.extend([0; 4]);
            file.extend(content);
        }
        let problem = parse(&file).expect_err("circles");
        assert!(problem.contains("circles"), "{problem}");
        for end in 0..file.len() {
            assert!(parse(&file[..end]).is_err());
        }
        assert!(parse(b"glTF").is_err() && parse(b"PK").is_err());
    }

    #[test]
    fn scenes_that_grow_without_end_or_have_no_area_are_refused() {
        let file = |json: &str| {
            let mut file = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
            for content in [json.as_bytes(), &[0; 36]] {
                file.extend((content.len() as u32).to_le_bytes());
                file.extend([0; 4]);
                file.extend(content);
            }
            file
        };
        let rest = r#""scenes":[{"nodes":[0]}],"accessors":[{"bufferView":0,"componentType":5126,"count":3}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"bufferViews":[{"byteLength":36}]"#;
        // Each node shows the next one twice.
        let nodes: Vec<String> = (1..60)
            .map(|next| format!(r#"{{"children":[{next},{next}]}}"#))
            .collect();
        let doubling = format!(r#"{{{rest},"nodes":[{},{{"mesh":0}}]}}"#, nodes.join(","));
        let problem = parse(&file(&doubling)).expect_err("too many");
        assert!(problem.contains("more than 100000 nodes"), "{problem}");

        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("flat.glb");
        let flat = format!(r#"{{{rest},"nodes":[{{"mesh":0}}]}}"#);
        std::fs::write(&path, file(&flat)).expect("file");
        let problem = crate::World::of_file(&path).expect_err("flat").to_string();
        assert!(
            problem.contains("none of its triangles has an area"),
            "{problem}"
        );
    }
}
