//! How a material is painted in the detailed look.

use super::canvas::{Canvas, Leaves};
use super::grain::Grain;
use super::material::{Marks, Material, boards, panel};
use super::print;
use super::substance::Substance;
use crate::noise::stream;

/// Paints a surface of a material; `seed` tells apart what is of one material.
pub(super) fn paint(material: &Material, size_m: [f32; 2], texel_m: f32, seed: u64) -> Canvas {
    if matches!(material.marks, Marks::AprilGrid(_)) {
        return material.paint(size_m, texel_m, seed);
    }
    let rng = stream(seed, "detail", 0);
    let mut canvas = Canvas::new(size_m, texel_m, material.tone);
    if let Marks::Boards(board_m) = material.marks {
        let (tones, joint_m, joint) = material.grain.boards();
        let joint = (joint_m, (joint * material.tone).min(0.9));
        boards(&mut canvas, board_m, material.tone, tones, joint, &rng);
    }
    if material.grain == Grain::None && matches!(material.marks, Marks::None | Marks::Boards(_)) {
        // What has no grain has stains and marks, fewer than the plain look has shapes.
        if material.coverage > 0.0 {
            let spread = material.spread;
            let leaves = Leaves {
                coverage: 0.3 * material.coverage,
                largest_m: material.largest_m,
                smallest_m: 0.003,
                tones: [material.tone - spread, material.tone + spread]
                    .map(|t| t.clamp(0.04, 0.92)),
            };
            canvas.scatter(&leaves, &rng);
        }
        canvas.add_noise(material.noise, material.longest_m, material.stretch, seed);
    }
    let (tone, stretch) = (material.tone, material.stretch);
    material.grain.work(&mut canvas, tone, stretch, seed);
    let is_screen = material.glow > 0.0;
    match material.marks {
        Marks::None | Marks::Boards(_) | Marks::AprilGrid(_) => {}
        Marks::Text(_) if is_screen => print::desktop(&mut canvas, &rng),
        Marks::Text(_) if material.substance == Substance::Metal => {
            print::keyboard(&mut canvas, material.tone, &rng);
        }
        Marks::Text(height_m) if material.substance == Substance::Soft => {
            print::page(&mut canvas, height_m, material.tone, &rng);
        }
        Marks::Text(_) => print::parcel(&mut canvas, material.tone, &rng),
        Marks::Poster(margin_m) => print::poster(&mut canvas, margin_m, &rng),
        Marks::Spine => print::spine(&mut canvas, material.tone, &rng),
        Marks::Panel(margin_m) => panel(&mut canvas, margin_m, material.tone),
        Marks::Sign => print::sign(&mut canvas, material.tone, &rng),
    }
    if !matches!(material.marks, Marks::None | Marks::Boards(_)) {
        canvas.add_noise(0.004, 0.3, [1.0, 1.0], seed);
    }
    for value in &mut canvas.values {
        *value = value.clamp(0.02, 0.95);
    }
    canvas
}

#[cfg(test)]
mod tests {
    use lsfb_types::no_progress;

    use super::*;
    use crate::config::Look;
    use crate::world::ray::RayPacket;
    use crate::world::{Blueprint, World};

    /// Traced light takes a material's tone for its reflectance.
    #[test]
    fn what_has_grain_reflects_as_much_as_its_material() {
        for material in [
            Material::PLASTER,
            Material::PARQUET,
            Material::CARPET,
            Material::CEILING,
            Material::CONCRETE,
            Material::BRICK,
            Material::STONE,
            Material::ASPHALT,
            Material::GRASS,
            Material::FOLIAGE,
            Material::METAL,
            Material::CLOTH,
        ] {
            let canvas = paint(&material, [2.0, 2.0], 0.005, 9);
            let mean = canvas.values.iter().sum::<f32>() / canvas.values.len() as f32;
            let off = mean / material.tone - 1.0;
            assert!(off.abs() < 0.05, "{material:?}: {off}");
        }
    }

    fn window(look: Look) -> World {
        let mut blueprint = Blueprint {
            ambient: 1.0,
            look,
            ..Blueprint::default()
        };
        let (along, up) = ([0.0, -40.0, 0.0], [0.0, 0.0, 20.0]);
        let corner = [5.0, 20.0, -10.0];
        blueprint.builder.quad(corner, along, up, Material::VIEW);
        World::of(&blueprint, 3, 0.02, &no_progress).expect("built")
    }

    /// What is behind windows once was a picture on the pane, and moved with it.
    #[test]
    fn behind_a_window_is_what_is_far_away() {
        let moved = |look: Look| {
            let world = window(look);
            let seen = |k: usize, y: f32| {
                let (sin, cos) = (0.01 * k as f32 - 0.5).sin_cos();
                let rays = RayPacket::splat([0.0, y, 0.0], [cos, sin, 0.0]);
                world.see(&rays, 0.003, &world.moment(0.0, [0.0; 2]))[0].value
            };
            let apart = (0..100).map(|k| (seen(k, 0.0) - seen(k, 3.0)).abs());
            let range = (0..100).map(|k| (seen(k, 0.0) - seen(0, 0.0)).abs());
            (apart.fold(0.0, f32::max), range.fold(0.0, f32::max))
        };
        let (apart, range) = moved(Look::Detailed);
        assert!(apart < 0.5 && range > 20.0, "{apart} {range}");
        assert!(moved(Look::Plain).0 > 5.0);
    }

    #[test]
    fn any_number_of_threads_paints_the_same() {
        let painted = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads").install(|| {
                let mut blueprint = Blueprint {
                    ambient: 1.0,
                    look: Look::Detailed,
                    ..Blueprint::default()
                };
                let all = [
                    Material::WOOD,
                    Material::POSTER,
                    Material::SCREEN,
                    Material::SIGN,
                    Material::PAPER,
                ];
                for (k, material) in all.into_iter().enumerate() {
                    let (along, up) = ([1.0, 0.0, 0.0], [0.0, 0.0, 0.4]);
                    blueprint
                        .builder
                        .quad([2.0 * k as f32, 0.0, 0.0], along, up, material);
                }
                let world = World::of(&blueprint, 5, 0.005, &no_progress).expect("built");
                let at = |k: usize| world.radiance(k % 5, 0.001 * (k / 5) as f32, 0.5, 0.002, 0.0);
                (0..5000).map(at).collect::<Vec<f32>>()
            })
        };
        assert!(painted(1) == painted(3));
    }
}
