//! Textured scenes of other people: binary glTF 2.0 files (`.glb`) with everything inside.
//!
//! Triangles with the picture of their base colour, what shines of them, how smooth they are, and lamps (`KHR_lights_punctual`). Anything
//! else that a file may hold (skins, animations, further textures) is passed over; a file that needs another extension is refused.

mod document;
mod picture;

use std::path::Path;

use nalgebra::{Matrix4, Quaternion, Translation3, UnitQuaternion, Vector3, Vector4};

use super::canvas::Canvas;
use super::irradiance::PointLight;
use crate::Error;
use document::{Document, Lamp, Material, Primitive, TextureAt, triangles};
pub(super) use picture::Values;
use picture::{MOST_PIXELS, decode};

/// A triangle with its place in a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triangle {
    /// Corners, metres, z up, counter-clockwise from where it is seen.
    pub corners_m: [[f32; 3]; 3],
    /// Of each corner, in widths and heights of the picture.
    pub places: [[f32; 2]; 3],
    /// Which finish it has.
    pub finish: usize,
}

/// What surfaces are like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Finish {
    /// Picture of the base colour; the last one is plain.
    pub picture: usize,
    /// Factor of its values.
    pub factor: f32,
    /// Picture of what shines, and the luminance of its white, cd/m².
    pub shine: usize,
    pub shine_cd_m2: f32,
    /// How much of what a smooth surface would mirror it does mirror, 0–1.
    pub gloss: f32,
    /// Whether light makes no difference to it.
    pub unlit: bool,
}

/// What a file shows.
#[derive(Clone, Debug)]
pub(super) struct Scene {
    pub triangles: Vec<Triangle>,
    pub finishes: Vec<Finish>,
    /// The last is plain white.
    pub pictures: Vec<Canvas>,
    pub lamps: Vec<PointLight>,
    /// Where the first directional light is (a unit vector towards it), and the illuminance of what faces it, lux.
    pub sun: Option<([f32; 3], f32)>,
}

/// Luminance of white paper in a lit room: what shines with a factor of 1 is as bright, where a file says nothing about its strength, cd/m².
const PAPER_CD_M2: f32 = 160.0;
/// What is rougher than this mirrors nothing that one could make out.
const MATT: f32 = 0.5;
/// Lamps farther away than this from the scene's origin are refused, metres.
const FARTHEST_M: f32 = 1e6;
/// From where further directional lights shine, metres.
const AFAR_M: f32 = 5e3;
/// Deepest tree of nodes; deeper ones go round in circles.
const MOST_LEVELS: usize = 64;
/// Nodes, those shown in several places counted in each.
const MOST_NODES: usize = 100_000;
/// Triangles of a whole scene, counted alike.
const MOST_TRIANGLES: usize = 20_000_000;
/// Corners read for them.
const MOST_CORNERS: usize = 60_000_000;
/// Pixels of all pictures.
const MOST_PIXELS_ALTOGETHER: usize = 4 * MOST_PIXELS;
/// Lamps.
const MOST_LAMPS: usize = 4096;
/// Extensions that are read, or make no difference to what is.
const KNOWN: [&str; 3] = [
    "KHR_materials_unlit",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
];
/// Bytes of the file's header, and of a chunk's.
const HEADER: usize = 12;
const CHUNK_HEADER: usize = 8;

/// Reads a file.
pub(super) fn read(path: &Path, values: Values) -> Result<Scene, Error> {
    let refused = |problem: String| Error::Scene {
        path: path.to_owned(),
        problem,
    };
    let bytes = std::fs::read(path).map_err(|e| refused(e.to_string()))?;
    parse(&bytes, values).map_err(refused)
}

/// Reads the bytes of a file; what is wrong with them otherwise.
fn parse(bytes: &[u8], values: Values) -> Result<Scene, String> {
    if bytes.get(..4) != Some(b"glTF") {
        return Err("not a binary glTF file (.glb)".to_owned());
    }
    let (json, rest) = chunk(bytes.get(HEADER..).unwrap_or_default())?;
    let (data, _) = chunk(rest).unwrap_or_default();
    let document: Document =
        serde_json::from_slice(json).map_err(|e| format!("its description: {e}"))?;
    let known = |name: &String| KNOWN.contains(&name.as_str());
    if let Some(name) = document.extensions_required.iter().find(|n| !known(n)) {
        return Err(format!(
            "it needs the extension {name}, which is not supported"
        ));
    }
    let mut pictures: Vec<Canvas> = Vec::new();
    let mut pixels = 0;
    for picture in &document.images {
        let view = picture
            .buffer_view
            .ok_or("an image lies outside the file")?;
        let picture = decode(document.view(view, data)?, values)?;
        pixels += picture.values.len();
        if pixels > MOST_PIXELS_ALTOGETHER {
            return Err(format!(
                "its images have more than {MOST_PIXELS_ALTOGETHER} pixels"
            ));
        }
        pictures.push(picture);
    }
    let mut white = Canvas::new([1.0; 2], 0.5, 1.0);
    white.values.fill(1.0);
    pictures.push(white);
    let mut reading = Reading {
        document: &document,
        data,
        pictures: pictures.len(),
        values,
        nodes: 0,
        corners: 0,
        triangles: Vec::new(),
        finishes: Vec::new(),
        lamps: Vec::new(),
        sun: None,
    };
    // One for each material, and one for what has none.
    let materials = document.materials.iter().map(Some).chain([None]);
    reading.finishes = materials.map(|m| reading.finish(m)).collect();
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
    let Reading {
        triangles,
        finishes,
        lamps,
        sun,
        ..
    } = reading;
    Ok(Scene {
        triangles,
        finishes,
        pictures,
        lamps,
        sun,
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

/// A number that light can be computed with.
fn bounded(value: f32) -> f32 {
    if value.is_nan() {
        return 0.0;
    }
    value.clamp(0.0, 1e9)
}

struct Reading<'a> {
    document: &'a Document,
    data: &'a [u8],
    pictures: usize,
    values: Values,
    nodes: usize,
    corners: usize,
    triangles: Vec<Triangle>,
    finishes: Vec<Finish>,
    lamps: Vec<PointLight>,
    sun: Option<([f32; 3], f32)>,
}

impl Reading<'_> {
    fn node(&mut self, index: usize, parent: &Matrix4<f32>, level: usize) -> Result<(), String> {
        let document = self.document;
        let node = document.nodes.get(index).ok_or("a missing node")?;
        if level > MOST_LEVELS {
            return Err("its nodes form a cycle".to_owned());
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
        if let Some(at) = &node.extensions.lamp {
            let lamps = &document.extensions.lights.lights;
            self.lamp(lamps.get(at.light).ok_or("a missing light")?, &world)?;
        }
        if let Some(mesh) = node.mesh {
            let mesh = document.meshes.get(mesh).ok_or("a missing mesh")?;
            for primitive in mesh.primitives.iter().filter(|p| p.mode == triangles()) {
                self.primitive(primitive, &world)?;
            }
        }
        for &child in &node.children {
            self.node(child, &world, level + 1)?;
        }
        Ok(())
    }

    fn finish(&self, material: Option<&Material>) -> Finish {
        let plain = self.pictures - 1;
        let picture = |texture: Option<&TextureAt>| {
            texture
                .and_then(|t| self.document.textures.get(t.index)?.source)
                .filter(|source| *source < plain)
                .unwrap_or(plain)
        };
        let Some(material) = material else {
            return Finish {
                picture: plain,
                factor: 1.0,
                shine: plain,
                shine_cd_m2: 0.0,
                gloss: 0.0,
                unlit: false,
            };
        };
        let paint = &material.pbr_metallic_roughness;
        let [r, g, b, _] = paint.base_color_factor.unwrap_or([1.0; 4]);
        let white_cd_m2 = match &material.extensions.strength {
            // With a strength, candela per square metre.
            Some(strength) => strength.emissive_strength,
            None => PAPER_CD_M2,
        };
        let shine = Values::Light.grey(material.emissive_factor);
        let roughness = paint.roughness_factor.unwrap_or(1.0);
        Finish {
            picture: picture(paint.base_color_texture.as_ref()),
            factor: bounded(self.values.grey([r, g, b])),
            shine: picture(material.emissive_texture.as_ref()),
            shine_cd_m2: bounded(shine * white_cd_m2),
            gloss: (1.0 - roughness / MATT).clamp(0.0, 1.0),
            unlit: material.extensions.unlit.is_some(),
        }
    }

    fn lamp(&mut self, lamp: &Lamp, world: &Matrix4<f32>) -> Result<(), String> {
        if self.lamps.len() >= MOST_LAMPS {
            return Err(format!("it has more than {MOST_LAMPS} lights"));
        }
        let strength =
            Values::Light.grey(lamp.color.unwrap_or([1.0; 3])) * lamp.intensity.unwrap_or(1.0);
        let strength = bounded(strength);
        let upright = |v: Vector4<f32>| [v.x, -v.z, v.y];
        let position = upright(world * Vector4::new(0.0, 0.0, 0.0, 1.0));
        // Lamps shine along −z.
        let along = world * Vector4::new(0.0, 0.0, -1.0, 0.0);
        let length = along.norm();
        let is_placed =
            position.iter().all(|v| v.abs() < FARTHEST_M) && length > 1e-12 && length.is_finite();
        if !is_placed {
            return Err("a light has no position and direction".to_owned());
        }
        let direction = upright(along / length);
        let [inner, outer] = [lamp.spot.inner_cone_angle, lamp.spot.outer_cone_angle];
        let everywhere = PointLight {
            position,
            direction,
            intensity_cd: strength,
            cosines: [-2.0, -3.0],
        };
        match lamp.kind.as_str() {
            "point" => self.lamps.push(everywhere),
            "spot" => {
                let outer = outer.clamp(1e-3, std::f32::consts::FRAC_PI_2);
                let inner = inner.clamp(0.0, outer);
                self.lamps.push(PointLight {
                    cosines: [inner.cos(), outer.cos()],
                    ..everywhere
                });
            }
            "directional" if self.sun.is_none() => {
                self.sun = Some((direction.map(|v| -v), strength))
            }
            "directional" => self.lamps.push(PointLight {
                position: direction.map(|v| -AFAR_M * v),
                intensity_cd: strength * AFAR_M * AFAR_M,
                ..everywhere
            }),
            other => return Err(format!("a light of the type {other:?}")),
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
        self.corners += positions.len() + order.len();
        if self.corners > MOST_CORNERS {
            return Err(format!("it shows more than {MOST_CORNERS} corners"));
        }
        let material = primitive.material.and_then(|m| document.materials.get(m));
        let finish = match primitive.material {
            Some(number) if material.is_some() => number,
            _ => document.materials.len(),
        };
        if self.triangles.len() + order.len() > MOST_TRIANGLES {
            return Err(format!("it has more than {MOST_TRIANGLES} triangles"));
        }
        for corner in order.chunks_exact(3) {
            let mut triangle = Triangle {
                corners_m: [[0.0; 3]; 3],
                places: [[0.0; 2]; 3],
                finish,
            };
            for (k, &index) in corner.iter().enumerate() {
                let p = positions.get(index).ok_or("a missing vertex")?;
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

/// A file of a description and data, for tests.
#[cfg(test)]
pub(super) fn file(json: &str, data: &[u8]) -> Vec<u8> {
    let mut file = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for content in [json.as_bytes(), data] {
        file.extend((content.len() as u32).to_le_bytes());
        file.extend([0; 4]);
        file.extend(content);
    }
    file
}

#[cfg(test)]
mod tests;
