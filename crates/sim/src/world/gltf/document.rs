//! The description of a glTF file, as far as it is read, and the numbers in its data (Khronos Group, "glTF 2.0 Specification").

use serde::Deserialize;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
#[derive(Default)]
pub(super) struct Document {
    pub scene: usize,
    pub scenes: Vec<Nodes>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<Mesh>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<View>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub images: Vec<Picture>,
    pub extensions_required: Vec<String>,
    pub extensions: SceneExtensions,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct SceneExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    pub lights: Lights,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct Lights {
    pub lights: Vec<Lamp>,
}

/// A lamp without a body: candela, for directional ones lux.
#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct Lamp {
    #[serde(rename = "type")]
    pub kind: String,
    pub color: Option<[f32; 3]>,
    pub intensity: Option<f32>,
    pub spot: Cone,
}

/// Angles of a spot from its axis, radians.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Cone {
    pub inner_cone_angle: f32,
    pub outer_cone_angle: f32,
}

impl Default for Cone {
    fn default() -> Self {
        Self {
            inner_cone_angle: 0.0,
            outer_cone_angle: std::f32::consts::FRAC_PI_4,
        }
    }
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct Nodes {
    pub nodes: Vec<usize>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct Node {
    pub children: Vec<usize>,
    pub mesh: Option<usize>,
    pub matrix: Option<[f32; 16]>,
    pub translation: Option<[f32; 3]>,
    pub rotation: Option<[f32; 4]>,
    pub scale: Option<[f32; 3]>,
    pub extensions: NodeExtensions,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    pub lamp: Option<LampAt>,
}

#[derive(Deserialize)]
pub(super) struct LampAt {
    pub light: usize,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct Mesh {
    pub primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub attributes: Attributes,
    pub indices: Option<usize>,
    pub material: Option<usize>,
    #[serde(default = "triangles")]
    pub mode: u32,
}

pub(super) const fn triangles() -> u32 {
    4
}

#[derive(Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct Attributes {
    pub position: usize,
    #[serde(rename = "TEXCOORD_0")]
    pub place: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<usize>,
    #[serde(default)]
    pub byte_offset: usize,
    pub component_type: u32,
    pub count: usize,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct View {
    #[serde(default)]
    pub byte_offset: usize,
    pub byte_length: usize,
    pub byte_stride: Option<usize>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Material {
    pub pbr_metallic_roughness: Paint,
    pub emissive_factor: [f32; 3],
    pub emissive_texture: Option<TextureAt>,
    pub double_sided: bool,
    pub extensions: MaterialExtensions,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_unlit")]
    pub unlit: Option<Unlit>,
    #[serde(rename = "KHR_materials_emissive_strength")]
    pub strength: Option<Strength>,
}

#[derive(Deserialize)]
pub(super) struct Unlit {}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Strength {
    pub emissive_strength: f32,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Paint {
    pub base_color_factor: Option<[f32; 4]>,
    pub base_color_texture: Option<TextureAt>,
    pub roughness_factor: Option<f32>,
}

#[derive(Deserialize)]
pub(super) struct TextureAt {
    pub index: usize,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct Texture {
    pub source: Option<usize>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Picture {
    pub buffer_view: Option<usize>,
}

impl Document {
    pub(super) fn view<'a>(&self, index: usize, data: &'a [u8]) -> Result<&'a [u8], String> {
        let view = self
            .buffer_views
            .get(index)
            .ok_or("a missing buffer view")?;
        let end = view.byte_offset.checked_add(view.byte_length);
        end.and_then(|end| data.get(view.byte_offset..end))
            .ok_or_else(|| "a view beyond the end of the data".to_owned())
    }

    /// The numbers of an accessor, `N` to each element; integers as fractions of their range where `N` is not 1.
    pub(super) fn numbers<const N: usize>(
        &self,
        index: usize,
        data: &[u8],
    ) -> Result<Vec<[f64; N]>, String> {
        let accessor = self.accessors.get(index).ok_or("a missing accessor")?;
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
        if stride < packed {
            return Err(format!("elements of {packed} bytes every {stride} bytes"));
        }
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
