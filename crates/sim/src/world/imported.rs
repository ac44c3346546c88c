//! Scenes of other people as worlds: as bright as they are painted, or in the light of their own lamps.

use std::path::Path;

use lsfb_types::ProgressFn;

use super::atlas::Atlas;
use super::bvh::Bvh;
use super::canvas::Canvas;
use super::crowd::Crowd;
use super::facet::{Facet, Outline};
use super::gltf::{self, Finish, Triangle, Values};
use super::irradiance::{Optics, SunDisc};
use super::lit::{self, Lights, NOMINAL_LX};
use super::skin::{Beyond, LightMaps, Skin};
use super::vector::{cross, norm, sub};
use super::{EXPOSURE, Substance, World};
use crate::Error;
use crate::config::LightConfig;

/// Sky of a scene that has no light of its own: an overcast day, 500 lx in the open, cd/m².
const OVERCAST_CD_M2: f32 = NOMINAL_LX / std::f32::consts::PI;
/// Light that a map holds at most, 1 being nominal.
const MOST_LIGHT: f32 = 200.0;
/// Reflectances are within these.
const ALBEDO: [f32; 2] = [0.02, 0.95];
/// Places of a triangle at which its picture is looked up for its mean, along either edge.
const LOOKS: usize = 6;

/// What is seen of a triangle.
struct FacetMaterial {
    picture: usize,
    gain: f32,
    reflectance: f32,
    optics: Optics,
}

impl World {
    /// The scene of a binary glTF file: as bright as it is painted, or, with settings, in traced light.
    pub fn of_file(
        path: &Path,
        config: &LightConfig,
        seed: u64,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let values = match config.baked {
            true => Values::Light,
            false => Values::Shown,
        };
        let refused = |problem: &str| Error::Scene {
            path: path.to_owned(),
            problem: problem.to_owned(),
        };
        let scene = gltf::read(path, values)?;
        let mut triangles = Vec::new();
        let mut unsorted = Vec::new();
        for triangle in scene.triangles {
            let [corner, q, r] = triangle.corners_m;
            let (a, b) = (sub(q, corner), sub(r, corner));
            // Slivers have no direction to face, and what is infinitely large no place.
            let area = norm(cross(a, b));
            if area > 1e-9 && area.is_finite() {
                unsorted.push(Facet::new(corner, a, b, Outline::Triangle));
                triangles.push(triangle);
            }
        }
        if unsorted.is_empty() {
            return Err(refused("none of its triangles has an area"));
        }
        let (bvh, order) = Bvh::build(&unsorted);
        let facets: Vec<Facet> = order.iter().map(|&i| unsorted[i]).collect();
        let triangles: Vec<Triangle> = order.iter().map(|&i| triangles[i]).collect();
        let means: Vec<f32> = scene
            .pictures
            .iter()
            .map(|p| p.values.iter().sum::<f32>() / p.values.len() as f32)
            .collect();
        let seen: Vec<FacetMaterial> = triangles
            .iter()
            .map(|t| {
                let finish = &scene.finishes[t.finish];
                match config.baked {
                    true => in_light(finish, t, &scene.pictures),
                    false => as_painted(finish, means[finish.picture]),
                }
            })
            .collect();
        let mut atlas = Atlas::default();
        for mut picture in scene.pictures {
            if config.baked {
                for value in &mut picture.values {
                    *value = (EXPOSURE * *value).sqrt();
                }
            }
            atlas.push(&picture);
        }
        let mut skins: Vec<Skin> = facets
            .iter()
            .zip(&triangles)
            .zip(&seen)
            .map(|((facet, triangle), seen)| skin(facet, triangle, seen))
            .collect();
        let (mut light, mut lit) = (LightMaps::default(), None);
        if config.baked {
            let optics: Vec<(Facet, Optics)> = facets
                .iter()
                .zip(&seen)
                .map(|(f, s)| (*f, s.optics))
                .collect();
            let mut lights = Lights {
                sun: scene.sun.map(|(direction, illuminance_lx)| SunDisc {
                    direction,
                    illuminance_lx,
                }),
                points: scene.lamps,
                ..Lights::default()
            };
            let shines = optics.iter().any(|(_, o)| o.luminance_cd_m2 > 0.0);
            if lights.sun.is_none() && lights.points.is_empty() && !shines {
                lights.void_cd_m2 = OVERCAST_CD_M2;
            }
            let gloss = triangles.iter().map(|t| scene.finishes[t.finish].gloss);
            let traced = lit::trace(
                (&optics, gloss.collect()),
                &lights,
                None,
                config,
                seed,
                progress,
            )?;
            for (number, skin) in skins.iter_mut().enumerate() {
                skin.light = number as u32;
            }
            if traced.0.are_dark() {
                return Err(refused(
                    "no light reaches any of its surfaces: add lights (KHR_lights_punctual) or emissive surfaces, or show it without light (--simple-light; light.baked = false in the settings)",
                ));
            }
            light = traced.0;
            lit = Some(traced.1);
        }
        Ok(Self {
            reflectances: seen.iter().map(|s| s.reflectance).collect(),
            skins,
            substances: vec![Substance::default(); facets.len()],
            facets,
            bvh,
            atlas,
            light,
            crowd: Crowd::default(),
            lit,
            night: None,
            closed: None,
        })
    }
}

/// Brightness is the square root of reflected light.
fn as_painted(finish: &Finish, mean: f32) -> FacetMaterial {
    FacetMaterial {
        picture: finish.picture,
        gain: finish.factor.sqrt(),
        reflectance: mean.powi(2) * finish.factor,
        optics: Optics::default(),
    }
}

/// What a triangle does to light, and which of its pictures one sees: that of what shines where it outshines the rest.
fn in_light(finish: &Finish, triangle: &Triangle, pictures: &[Canvas]) -> FacetMaterial {
    let of = |picture: usize| mean(&pictures[picture], &triangle.places);
    let base = of(finish.picture);
    let [least, most] = ALBEDO;
    let reflectance = (base * finish.factor).clamp(least, most);
    // What light makes no difference to is as bright as it would be in a lit room.
    let (shine, shine_cd_m2) = match finish.unlit {
        true => (finish.picture, finish.factor * OVERCAST_CD_M2),
        false => (finish.shine, finish.shine_cd_m2),
    };
    let share = of(shine);
    let luminance_cd_m2 = share * shine_cd_m2;
    let outshines = finish.unlit || luminance_cd_m2 > reflectance * OVERCAST_CD_M2;
    // What shines scatters little, and no less than its map of light can make up for.
    let albedo = match outshines {
        true => (luminance_cd_m2 / OVERCAST_CD_M2 / MOST_LIGHT).clamp(least, most),
        false => reflectance,
    };
    FacetMaterial {
        picture: if outshines { shine } else { finish.picture },
        // The map holds the light under which the whole would be as bright as it shines.
        gain: match outshines {
            true => (albedo / share.max(1e-4)).sqrt(),
            false => finish.factor.sqrt(),
        },
        reflectance,
        optics: Optics {
            albedo,
            luminance_cd_m2,
            // Nothing lights it; painted skies are so, and the sun shines through them.
            backdrop: finish.unlit,
            ..Optics::default()
        },
    }
}

/// Mean of a picture over a triangle of it.
fn mean(picture: &Canvas, places: &[[f32; 2]; 3]) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0_f32);
    for i in 0..LOOKS {
        for j in 0..LOOKS - i {
            let [u, v] = [i, j].map(|k| (k as f32 + 0.33) / LOOKS as f32);
            let [x, y] = [0, 1].map(|k| {
                let [p, q, r] = places.map(|place| place[k]);
                let at = p + u * (q - p) + v * (r - p);
                at - at.floor()
            });
            // Casts from float to integer saturate, and are 0 for what is no number.
            let column = ((x * picture.width as f32) as usize).min(picture.width - 1);
            let row = ((y * picture.height as f32) as usize).min(picture.height - 1);
            sum += picture.values[row * picture.width + column];
            count += 1.0;
        }
    }
    sum / count
}

fn skin(facet: &Facet, triangle: &Triangle, seen: &FacetMaterial) -> Skin {
    let [p, q, r] = triangle.places;
    let edges = [q, r].map(|end| [end[0] - p[0], end[1] - p[1]]);
    let lengths = [norm(facet.edge_a), norm(facet.edge_b)];
    let per_metre = |k: usize| edges[k][0].hypot(edges[k][1]) / lengths[k].max(1e-6);
    Skin {
        edges,
        offset: p,
        beyond: Beyond::Repeated,
        zoom: per_metre(0).max(per_metre(1)),
        gain: seen.gain,
        ..Skin::baked(seen.picture)
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::no_progress;
    use wide::f32x8;

    use super::*;
    use crate::world::{LANES, RayPacket};

    /// A file of quads: four corners each, as in the file (y up), counter-clockwise, of the materials in their order.
    fn scene(quads: &[[[f32; 3]; 4]], materials: &str, more: &str) -> Vec<u8> {
        let mut data = Vec::new();
        for [p, q, r, s] in quads {
            for corner in [p, q, r, p, r, s] {
                data.extend(corner.iter().flat_map(|v| v.to_le_bytes()));
            }
        }
        let list = |each: &dyn Fn(usize) -> String| {
            let all: Vec<String> = (0..quads.len()).map(each).collect();
            all.join(",")
        };
        let json = format!(
            r#"{{"scenes":[{{"nodes":[0]}}],"meshes":[{{"primitives":[{}]}}],"accessors":[{}],"bufferViews":[{}],
                "materials":[{materials}],{more}}}"#,
            list(&|k| format!(r#"{{"attributes":{{"POSITION":{k}}},"material":{k}}}"#)),
            list(&|k| format!(r#"{{"bufferView":{k},"componentType":5126,"count":6}}"#)),
            list(&|k| format!(r#"{{"byteOffset":{},"byteLength":72}}"#, 72 * k)),
        );
        gltf::file(&json, &data)
    }

    fn lit(bytes: &[u8]) -> Result<World, Error> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("scene.glb");
        std::fs::write(&path, bytes).expect("written");
        let config = LightConfig {
            baked: true,
            spacing_m: 0.2,
            paths: 32,
            ..LightConfig::default()
        };
        World::of_file(&path, &config, 3, &no_progress)
    }

    /// A floor of 8 × 8 m, as in the file.
    const FLOOR: [[f32; 3]; 4] = [
        [-4.0, 0.0, 4.0],
        [4.0, 0.0, 4.0],
        [4.0, 0.0, -4.0],
        [-4.0, 0.0, -4.0],
    ];
    const GREY: &str = r#"{"pbrMetallicRoughness":{"baseColorFactor":[0.5,0.5,0.5,1]}}"#;

    /// Illuminance of the floor, z up.
    fn floor_lx(world: &World, x: f32, y: f32) -> f32 {
        let from = [x, y, 0.5];
        let hit = world.cast(from, [0.0, 0.0, -1.0]).expect("floor");
        let at = world.facets()[hit.facet].coordinates([x, y, 0.0]);
        world.illuminance_lx(hit.facet, at).expect("lit")
    }

    /// I cos / d² for a point and within a spot's cone, nothing beyond it; E cos for the sun.
    #[test]
    fn lamps_of_a_file_light_its_scene() {
        let lamps = |lamps: &str, nodes: &str| {
            let more = format!(
                r#""nodes":[{{"mesh":0,"children":[1]}},{nodes}],
                "extensions":{{"KHR_lights_punctual":{{"lights":[{lamps}]}}}}"#
            );
            lit(&scene(&[FLOOR], GREY, &more)).expect("a scene")
        };
        let near = |got: f32, expected: f32| {
            assert!(
                (got - expected).abs() < 0.03 * expected + 0.2,
                "{got} {expected}"
            );
        };
        let at = r#"{"translation":[1,2,-1],"extensions":{"KHR_lights_punctual":{"light":0}}}"#;
        let point = lamps(r#"{"type":"point","intensity":400}"#, at);
        near(floor_lx(&point, 1.0, 1.0), 100.0);
        near(floor_lx(&point, -1.0, 1.0), 400.0 * 2.0 / 8.0_f32.powf(1.5));
        // Looking down: −z turned to −y.
        let down = r#"{"translation":[0,2,0],"rotation":[-0.70710678,0,0,0.70710678],"extensions":{"KHR_lights_punctual":{"light":0}}}"#;
        let spot = lamps(
            r#"{"type":"spot","intensity":400,"spot":{"innerConeAngle":0.4,"outerConeAngle":0.5}}"#,
            down,
        );
        near(floor_lx(&spot, 0.0, 0.0), 100.0);
        assert!(floor_lx(&spot, 2.0, 0.0) < 0.5);
        let sun = lamps(r#"{"type":"directional","intensity":1000}"#, down);
        near(floor_lx(&sun, 1.5, -2.0), 1000.0);
    }

    /// A square of edge 1 m, 1 m above the floor: π L times the factor of four rectangles (Howell, B-4), 0.2394 for half of it each way.
    #[test]
    fn what_shines_lights_the_scene_and_is_seen() {
        let shine = r#"{"emissiveFactor":[1,1,1],"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":1000}}}"#;
        let above = [
            [-0.5, 1.0, -0.5],
            [0.5, 1.0, -0.5],
            [0.5, 1.0, 0.5],
            [-0.5, 1.0, 0.5],
        ];
        let materials = format!("{GREY},{shine}");
        let world = lit(&scene(
            &[FLOOR, above],
            &materials,
            r#""nodes":[{"mesh":0}]"#,
        ))
        .expect("a scene");
        let factor = {
            let a = 0.5_f32;
            let root = (1.0 + a * a).sqrt();
            4.0 * (a / root * (a / root).atan()) / std::f32::consts::PI
        };
        let expected = 1000.0 * std::f32::consts::PI * factor;
        let got = floor_lx(&world, 0.05, 0.05);
        assert!((got / expected - 1.0).abs() < 0.04, "{got} {expected}");
        let moment = world.moment(0.0, [100.0, 100.0]);
        let value = |from: [f32; 3], ray: [f32; 3]| {
            let rays = RayPacket::from_point(from, ray.map(f32x8::splat));
            world.see(&rays, 0.002, &moment)[LANES - 1].value
        };
        // Its luminance is π · 1000 / 500 of white's at nominal light: that times 0.9, by its root.
        let up = value([0.0, 0.0, 0.5], [0.0, 0.0, 1.0]);
        let expected = 255.0 * (EXPOSURE * 1000.0 / OVERCAST_CD_M2).sqrt();
        assert!((up / expected - 1.0).abs() < 0.02, "{up} {expected}");
        let down = value([0.0, 0.0, 0.5], [0.0, 0.0, -1.0]);
        let expected = 255.0 * (EXPOSURE * 0.5 * got / NOMINAL_LX).sqrt();
        assert!((down / expected - 1.0).abs() < 0.04, "{down} {expected}");
    }

    #[test]
    fn a_scene_without_lamps_lies_under_a_grey_sky_and_one_without_light_is_refused() {
        let open = lit(&scene(&[FLOOR], GREY, r#""nodes":[{"mesh":0}]"#)).expect("open");
        let got = floor_lx(&open, 0.0, 0.0);
        assert!((got / NOMINAL_LX - 1.0).abs() < 0.02, "{got}");
        let below = r#""nodes":[{"mesh":0,"children":[1]},{"translation":[0,-2,0],"extensions":{"KHR_lights_punctual":{"light":0}}}],
            "extensions":{"KHR_lights_punctual":{"lights":[{"type":"point"}]}}"#;
        let problem = lit(&scene(&[FLOOR], GREY, below))
            .expect_err("dark")
            .to_string();
        assert!(problem.contains("no light reaches"), "{problem}");
    }

    /// Corners that are no numbers, infinitely far away, or all the same leave the rest of the scene; alone, they are refused.
    #[test]
    fn triangles_without_a_place_or_an_area_are_left_out() {
        let odd = [
            [[f32::NAN, 0.0, 0.0]; 4],
            [
                [f32::INFINITY, 0.0, 1.0],
                [1.0, 2.0, 3.0],
                [4.0, 1.0, 1.0],
                [2.0, 2.0, 0.0],
            ],
            [
                [1e30, 0.0, 0.0],
                [-1e30, 0.0, 1e30],
                [0.0, 1e30, 0.0],
                [1e30; 3],
            ],
            [[1.0, 1.0, 1.0]; 4],
        ];
        let materials = [GREY; 5].join(",");
        let nodes = r#""nodes":[{"mesh":0}]"#;
        let all = [&odd[..], &[FLOOR]].concat();
        let world = lit(&scene(&all, &materials, nodes)).expect("the floor");
        assert_eq!(world.facets().len(), 2);
        let problem = lit(&scene(&odd, &materials, nodes))
            .expect_err("nothing left")
            .to_string();
        assert!(
            problem.contains("none of its triangles has an area"),
            "{problem}"
        );
    }

    /// Bytes changed at random give a world or a sentence, in traced light too.
    #[test]
    fn damaged_files_give_a_world_or_a_sentence() {
        let shine = r#"{"emissiveFactor":[1,1,1]}"#;
        let bytes = scene(
            &[FLOOR, FLOOR],
            &format!("{GREY},{shine}"),
            r#""nodes":[{"mesh":0}]"#,
        );
        let mut worlds = 0;
        for k in 0..300_u64 {
            let mut bytes = bytes.clone();
            for change in 0..1 + k % 3 {
                let draw = crate::noise::hash(k << 8 | change);
                let place = (draw >> 16) as usize % bytes.len();
                bytes[place] = draw as u8;
            }
            worlds += u32::from(lit(&bytes).is_ok());
        }
        assert!(worlds > 20, "{worlds}");
    }
}
