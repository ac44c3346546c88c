//! Pictures shared by many facets: a large building has far more surface than memory has room for.
//!
//! What has no layout of its own (walls, floors, cloth) shows parts of one large picture of its material, others on each facet.
//! What has one (posters, doors, books) shows a picture painted at about its size: of its own where the real thing is unlike any
//! other, one of some variants where the real thing comes in series.

use std::collections::BTreeMap;

use rayon::prelude::*;

use lsfb_types::{Progress, ProgressFn, Stopped};

use super::april_grid;
use super::atlas::Atlas;
use super::builder::Surface;
use super::detail;
use super::grain::Grain;
use super::material::{Marks, Material};
use super::patchwork::Patchwork;
use super::skin::{Beyond, LightMaps, Skin};
use super::vector::norm;
use crate::config::Look;
use crate::noise::{hash, unit};

/// Edge of a shared picture, metres, before its material's coarseness.
const SHEET_M: f32 = 4.0;
/// Texels along the edge of a shared picture at most.
const SHEET_TEXELS: f32 = 1400.0;
/// Variants of what comes in series: doors and cupboards, editions of books.
const DOORS: u64 = 6;
const EDITIONS: u64 = 60;
/// Editions of books with titles.
const TITLES: u64 = 600;
/// In the detailed look, what is no larger than this, square metres, has texels of half the size: there is writing on it.
const CLOSE_M2: f32 = 0.3;
/// Tones painted for each material; what is between is made brighter or darker.
const TONES: f32 = 4.0;

/// What decides how a picture looks.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    material: [u32; 13],
    /// Size in half octaves, 0 for shared sheets.
    size: [i32; 2],
    variant: u64,
    grain: Grain,
}

/// A picture to be painted.
struct Order {
    material: Material,
    size_m: [f32; 2],
    texel_m: f32,
    seed: u64,
}

/// Paints what `surfaces` need, and says what each shows. Lights are numbered as the surfaces are.
pub(super) fn paint(
    surfaces: &[Surface],
    (texel_m, look): (f32, Look),
    seed: u64,
    atlas: &mut Atlas,
    progress: ProgressFn,
) -> Result<Vec<Skin>, Stopped> {
    let wanted: Vec<(Key, Order)> = surfaces
        .iter()
        .map(|surface| order(surface, texel_m, look, seed))
        .collect();
    let mut orders: BTreeMap<&Key, &Order> = BTreeMap::new();
    for (key, order) in &wanted {
        orders.entry(key).or_insert(order);
    }
    let mut first: BTreeMap<&Key, usize> = BTreeMap::new();
    let list: Vec<_> = orders.into_iter().collect();
    let mut done = 0;
    // In batches, so that the painted pictures in full precision need not all be held at once.
    for batch in list.chunks(32) {
        progress(Progress {
            stage: "rendering textures",
            done,
            total: list.len() as u64,
        })?;
        done += batch.len() as u64;
        let painted: Vec<Vec<_>> = batch
            .par_iter()
            .map(|(_, order)| {
                (0..order.material.pictures)
                    .map(|picture| {
                        let seed = hash(order.seed ^ u64::from(picture));
                        let (material, size_m) = (&order.material, order.size_m);
                        let mut canvas = match look {
                            Look::Plain => material.paint(size_m, order.texel_m, seed),
                            Look::Detailed => detail::paint(material, size_m, order.texel_m, seed),
                        };
                        for value in &mut canvas.values {
                            *value = (super::EXPOSURE * *value).sqrt();
                        }
                        canvas
                    })
                    .collect()
            })
            .collect();
        for ((key, _), canvases) in batch.iter().zip(painted) {
            first.insert(key, atlas.count());
            for canvas in &canvases {
                atlas.push(canvas);
            }
        }
    }
    let skins = wanted
        .iter()
        .zip(surfaces)
        .enumerate()
        .map(|(k, ((key, order), surface))| {
            skin(
                surface,
                order,
                first.get(key).copied().unwrap_or_default(),
                seed,
                k as u64,
            )
        })
        .collect();
    Ok(skins)
}

fn order(surface: &Surface, texel_m: f32, look: Look, seed: u64) -> (Key, Order) {
    let painted_tone = (surface.material.tone * TONES).round().max(0.5) / TONES;
    let material = Material {
        tone: painted_tone.min(0.9),
        ..surface.material
    };
    let size = [norm(surface.facet.edge_a), norm(surface.facet.edge_b)];
    let mut material = material;
    if let Marks::Poster(_) = material.marks {
        // What a picture shows grows with it, in steps, as its size does.
        let edge = size[0].min(size[1]).max(0.1);
        material.largest_m = 0.34 * (0.5 * (2.0 * edge.log2()).round()).exp2();
    }
    let bits = hash(seed ^ place_of(surface));
    let mut texel_m = 1.33 * texel_m * material.coarseness;
    let (buckets, size_m, variant) = match material.marks {
        Marks::None | Marks::Boards(_) => {
            let edge = (SHEET_M * material.coarseness).min(SHEET_TEXELS * texel_m);
            ([0; 2], [edge; 2], 0)
        }
        Marks::AprilGrid(tag_m) => {
            texel_m = april_grid::texel_m(tag_m);
            (size.map(|s| (s * 1e4) as i32), size, 0)
        }
        _ => {
            let buckets = size.map(|s| (2.0 * s.max(0.02).log2()).round() as i32);
            let size_m = buckets.map(|b| (0.5 * b as f32).exp2());
            let variant = match material.marks {
                Marks::Panel(_) => bits % DOORS,
                Marks::Spine if look == Look::Detailed => bits % TITLES,
                Marks::Spine => bits % EDITIONS,
                _ => bits,
            };
            if look == Look::Detailed && size_m[0] * size_m[1] < CLOSE_M2 {
                texel_m *= 0.5;
            }
            (buckets, size_m, variant)
        }
    };
    let key = Key {
        material: identity(&material),
        size: buckets,
        variant,
        grain: material.grain,
    };
    let paint_seed = key.material.iter().fold(hash(seed ^ variant), |sum, bits| {
        hash(sum ^ u64::from(*bits))
    });
    let order = Order {
        material,
        size_m,
        texel_m,
        seed: paint_seed,
    };
    (key, order)
}

/// Tells surfaces apart by where they are: what stays when other things are moved keeps its looks.
fn place_of(surface: &Surface) -> u64 {
    let facet = &surface.facet;
    let numbers = [facet.corner, facet.edge_a, facet.edge_b].concat();
    numbers
        .iter()
        .fold(0, |sum, number| hash(sum ^ u64::from(number.to_bits())))
}

/// The fields that the painting depends on.
fn identity(m: &Material) -> [u32; 13] {
    let marks = match m.marks {
        Marks::None => [0, 0, 0],
        Marks::Text(h) => [1, h.to_bits(), 0],
        Marks::Poster(margin) => [2, margin.to_bits(), 0],
        Marks::Boards([w, h]) => [3, w.to_bits(), h.to_bits()],
        Marks::Spine => [4, 0, 0],
        Marks::Panel(margin) => [5, margin.to_bits(), 0],
        Marks::AprilGrid(tag) => [6, tag.to_bits(), 0],
        Marks::Sign => [7, 0, 0],
    };
    let [a, b, c] = marks;
    let f = f32::to_bits;
    [
        a,
        b,
        c,
        f(m.tone),
        f(m.noise),
        f(m.longest_m),
        f(m.stretch[0]),
        f(m.stretch[1]),
        f(m.coverage),
        f(m.spread),
        f(m.largest_m),
        u32::from(m.pictures),
        f(m.coarseness),
    ]
}

fn skin(surface: &Surface, order: &Order, texture: usize, seed: u64, number: u64) -> Skin {
    let material = &surface.material;
    let size = [norm(surface.facet.edge_a), norm(surface.facet.edge_b)];
    let bits = hash(!seed ^ place_of(surface));
    let (scale, offset, zoom, beyond) = match material.marks {
        Marks::None | Marks::Boards(_) => {
            let boards_m = match material.marks {
                Marks::Boards(size_m) => Some(size_m),
                _ => None,
            };
            let patchwork = Patchwork::new(order.size_m, material.coarseness, boards_m, bits);
            let scale: [f32; 2] = std::array::from_fn(|i| size[i] / order.size_m[i]);
            let draws = [unit(bits) as f32, unit(hash(bits)) as f32];
            let corner = patchwork.corner(scale, draws);
            (scale, corner, 1.0, Beyond::Patched(patchwork))
        }
        _ => {
            let zoom = order.size_m[0] / size[0].max(1e-3);
            ([1.0; 2], [0.0; 2], zoom, Beyond::Nothing)
        }
    };
    Skin {
        texture: texture as u32,
        pictures: material.pictures,
        glass: material.glass,
        edges: [[scale[0], 0.0], [0.0, scale[1]]],
        offset,
        beyond,
        zoom,
        gain: (material.tone / order.material.tone).max(0.0).sqrt(),
        light: number as u32,
    }
}

/// Light of the surfaces on a walker: the same from all sides.
pub(super) fn unlit(skin: Skin) -> Skin {
    Skin {
        light: LightMaps::NONE,
        ..skin
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::no_progress;

    use crate::world::material::Material;
    use crate::world::{Blueprint, World};

    /// Surfaces once were told apart by their numbers: after somebody had moved a chair, every wall looked different.
    #[test]
    fn what_is_not_moved_keeps_its_looks() {
        let built = |chairs: usize| {
            let mut blueprint = Blueprint {
                ambient: 1.0,
                ..Blueprint::default()
            };
            for k in 0..chairs {
                let corner = [300.0 + k as f32, 0.0, 0.0];
                let (along, up) = ([0.5, 0.0, 0.0], [0.0, 0.0, 0.5]);
                blueprint.builder.quad(corner, along, up, Material::WOOD);
            }
            for (y, material) in [(0.0, Material::PLASTER), (5.0, Material::SIGN)] {
                let (along, up) = ([6.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
                blueprint.builder.quad([0.0, y, 0.0], along, up, material);
            }
            let world = World::of(&blueprint, 3, 0.01, &no_progress).expect("built");
            [0.0, 5.0].map(|y| {
                let facets = world.facets().iter();
                let wall = facets.enumerate().find(|(_, f)| f.corner == [0.0, y, 0.0]);
                let number = wall.expect("wall").0;
                let at = |k: u32| world.radiance(number, 0.005 * k as f32, 0.4, 0.01, 0.0);
                (0..200).map(at).collect::<Vec<f32>>()
            })
        };
        assert!(built(1) == built(4));
        let [plaster, sign] = built(1);
        assert!(plaster != sign);
    }
}
