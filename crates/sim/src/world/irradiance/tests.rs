//! Against closed forms, and against another program where there is none.

use std::f32::consts::PI;

use super::straight::of_polygon;
use super::*;
use crate::world::builder::{Builder, Faces, Placement};
use crate::world::facet::{Facet, Outline};
use crate::world::light::LightGrid;
use crate::world::material::Material;
use lsfb_types::no_progress;

const FLOOR: Spot = Spot {
    point: [0.0; 3],
    normal: [0.0, 0.0, 1.0],
};

fn quad(corner: [f32; 3], a: [f32; 3], b: [f32; 3]) -> Facet {
    Facet::new(corner, a, b, Outline::Parallelogram)
}

fn shining(luminance_cd_m2: f32) -> Optics {
    Optics {
        luminance_cd_m2,
        ..Optics::default()
    }
}

fn scattering(albedo: f32) -> Optics {
    Optics {
        albedo,
        ..Optics::default()
    }
}

/// The six sides of a box seen from inside: floor, ceiling, left, right, near, far.
fn inside([x0, y0, z0]: [f32; 3], [x1, y1, z1]: [f32; 3]) -> [Facet; 6] {
    let (w, d, h) = (x1 - x0, y1 - y0, z1 - z0);
    [
        quad([x0, y0, z0], [w, 0.0, 0.0], [0.0, d, 0.0]),
        quad([x0, y0, z1], [0.0, d, 0.0], [w, 0.0, 0.0]),
        quad([x0, y0, z0], [0.0, d, 0.0], [0.0, 0.0, h]),
        quad([x1, y1, z0], [0.0, -d, 0.0], [0.0, 0.0, h]),
        quad([x1, y0, z0], [-w, 0.0, 0.0], [0.0, 0.0, h]),
        quad([x0, y1, z0], [w, 0.0, 0.0], [0.0, 0.0, h]),
    ]
}

/// By paths alone, and baked into a plate at the spot that scatters nothing.
fn both_ways_lx(surfaces: &[(Facet, Optics)], sun: Option<SunDisc>, spot: &Spot) -> [f32; 2] {
    let [x, y, z] = spot.point;
    let plate = quad([x - 0.01, y - 0.01, z], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]);
    let mut surfaces = surfaces.to_vec();
    surfaces.push((plate, scattering(0.0)));
    let scene = Scene::new(&surfaces, sun, 0.0);
    let baking = Baking {
        spacing_m: 1.0,
        paths: 4096,
        seed: 3,
    };
    let grids = bake(&scene, &surfaces, &baking, &no_progress).expect("not stopped");
    let baked = grids[surfaces.len() - 1].at(0.5, 0.5);
    [scene.illuminance_lx(spot, 8192, 7), baked]
}

fn assert_near(got: [f32; 2], expected: f32, share: f32) {
    for got in got {
        assert!(
            (got / expected - 1.0).abs() < share,
            "{got} lx, expected {expected}"
        );
    }
}

/// In an enclosure that shines and scatters evenly, light is L / (1 − ρ) in all directions, wherever one is.
#[test]
fn light_in_a_white_furnace_is_the_same_everywhere() {
    // Sides that are emitters to be tried by shadow rays, and sides that are too large for that.
    for edge in [2.0_f32, 20.0] {
        for albedo in [0.0, 0.5, 0.8] {
            let optics = Optics {
                luminance_cd_m2: 100.0,
                ..scattering(albedo)
            };
            let surfaces = inside(
                [-0.5 * edge, -0.5 * edge, 0.0],
                [0.5 * edge, 0.5 * edge, edge],
            );
            let surfaces = surfaces.map(|f| (f, optics));
            let expected = 100.0 * PI / (1.0 - albedo);
            for point in [[0.0, 0.0, 0.001], [0.45 * edge, -0.45 * edge, 0.001]] {
                let spot = Spot { point, ..FLOOR };
                assert_near(both_ways_lx(&surfaces, None, &spot), expected, 0.02);
            }
        }
    }
}

/// A sheet seen from both sides, as leaves are and surfaces of scenes may be, consists of two that lie back to back; which of them a ray finds
/// first is chance. Half of the paths once ended there, as if they had begun inside something.
#[test]
fn light_goes_on_from_both_sides_of_a_sheet() {
    let furnace = Optics {
        luminance_cd_m2: 100.0,
        ..scattering(0.5)
    };
    let mut surfaces = inside([-2.0, -2.0, 0.0], [2.0, 2.0, 4.0])
        .map(|f| (f, furnace))
        .to_vec();
    // In the way of most rays, scattering as the furnace does.
    for k in 0..40_u8 {
        let (s, c) = f32::from(k).sin_cos();
        let corner = [1.2 * s, 1.2 * c, 0.3 + 0.08 * f32::from(k)];
        let (a, b) = ([0.6 * c, -0.6 * s, 0.2], [0.5 * s, 0.5 * c, 0.3]);
        for [a, b] in [[a, b], [b, a]] {
            surfaces.push((Facet::new(corner, a, b, Outline::Triangle), furnace));
        }
    }
    let expected = 100.0 * PI / 0.5;
    for point in [[0.0, 0.0, 0.001], [1.1, 0.4, 0.001]] {
        assert_near(
            both_ways_lx(&surfaces, None, &Spot { point, ..FLOOR }),
            expected,
            0.03,
        );
    }
}

/// The same in the air, for whatever moves there, from all sides.
#[test]
fn probes_in_a_white_furnace_find_the_same_light() {
    let optics = Optics {
        luminance_cd_m2: 100.0,
        ..scattering(0.5)
    };
    let surfaces = inside([0.0; 3], [6.0, 5.0, 3.0]).map(|f| (f, optics));
    let scene = Scene::new(&surfaces, None, 0.0);
    let probes = Probes::bake(&scene, [[0.5, 0.5, 0.0], [5.5, 4.5, 0.0]], 1);
    for normal in [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [-0.36, -0.48, 0.8]] {
        for point in [[1.0, 1.0, 0.1], [3.3, 2.2, 1.4], [9.0, 9.0, 9.0]] {
            let lux = probes.at(point, normal).expect("a grid");
            assert!((lux / (200.0 * PI) - 1.0).abs() < 0.06, "{lux}");
        }
    }
    assert_eq!(Probes::default().at([0.0; 3], [0.0, 0.0, 1.0]), None);
}

/// A disk of radius r at height h, a metres beside the point: E = πL/2 (1 − (1+H²−R²)/√((1+H²+R²)²−4R²)), H = h/a, R = r/a
/// (Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-13); right above it πL r²/(r²+h²).
#[test]
fn a_disk_lights_a_plane_as_its_closed_form_says() {
    let (sides, radius, height) = (36, 0.8_f32, 1.5_f32);
    // A polygon of the disk's area.
    let turn = 2.0 * PI / sides as f32;
    let corner_m = radius * (turn / turn.sin()).sqrt();
    for beside in [0.0_f32, 0.5, 1.2, 4.0] {
        let rim = |k: i32| {
            let (s, c) = (k as f32 * turn).sin_cos();
            [corner_m * s, corner_m * c, 0.0]
        };
        // Its light falls downwards.
        let disk: Vec<_> = (0..sides)
            .map(|k| {
                let corner = [beside, 0.0, height];
                let facet = Facet::new(corner, rim(k), rim(k + 1), Outline::Triangle);
                assert!(facet.normal[2] < 0.0);
                (facet, shining(1000.0))
            })
            .collect();
        let expected = if beside == 0.0 {
            1000.0 * PI * radius * radius / (radius * radius + height * height)
        } else {
            let (h, r) = ((height / beside).powi(2), (radius / beside).powi(2));
            let z = 1.0 + h + r;
            500.0 * PI * (1.0 - (z - 2.0 * r) / (z * z - 4.0 * r).sqrt())
        };
        assert_near(both_ways_lx(&disk, None, &FLOOR), expected, 0.015);
    }
}

/// The configuration factor of two unit squares that face each other a metre apart is 0.1998 (Howell, C-11).
#[test]
fn parallel_squares_exchange_light_by_their_form_factor() {
    let lamp = quad([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]);
    let scene = Scene::new(&[(lamp, shining(1000.0))], None, 0.0);
    let mut sums = [0.0; 3];
    for i in 0..16 {
        for j in 0..16 {
            let point = [(i as f32 + 0.5) / 16.0, (j as f32 + 0.5) / 16.0, 0.0];
            let spot = Spot { point, ..FLOOR };
            sums[0] += scene.illuminance_lx(&spot, 256, (16 * i + j) as u64);
            sums[1] += scene.straight_lx(&spot, 1);
            sums[2] += of_polygon(&lamp, 1000.0, &spot);
        }
    }
    for sum in sums {
        let factor = sum / 256.0 / (1000.0 * PI);
        assert!((factor - 0.1998).abs() < 0.0008, "{factor}");
    }
}

/// A wall's lamp that reaches below the horizon of the point counts as far as it is above: half of a square at right angles.
#[test]
fn what_is_below_the_horizon_brings_nothing() {
    let whole = quad([1.0, -1.0, -1.0], [0.0, 0.0, 2.0], [0.0, 2.0, 0.0]);
    let half = quad([1.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 2.0, 0.0]);
    assert!(half.normal[0] < 0.0);
    let [a, b] = [whole, half].map(|facet| of_polygon(&facet, 500.0, &FLOOR));
    assert!(a > 50.0 && (a - b).abs() < 1e-3 * a, "{a} {b}");
    let below = quad([1.0, -1.0, -2.0], [0.0, 0.0, 1.0], [0.0, 2.0, 0.0]);
    assert_eq!(of_polygon(&below, 500.0, &FLOOR), 0.0);
}

#[test]
fn the_sun_lights_by_the_cosine_and_an_edge_halves_its_disc() {
    let direction = [0.6, 0.0, 0.8];
    let sun = Some(SunDisc {
        direction,
        illuminance_lx: 90_000.0,
    });
    let lit = |surfaces: &[(Facet, Optics)]| both_ways_lx(surfaces, sun, &FLOOR);
    assert_near(lit(&[]), 72_000.0, 1e-3);
    // Dark, its edge in line with the middle of the sun.
    let roof = quad([6.0, -5.0, 8.0], [5.0, 0.0, 0.0], [0.0, 10.0, 0.0]);
    // A ray in eight goes along the edge.
    assert_near(lit(&[(roof, scattering(0.0))]), 36_000.0, 0.13);
    let glass = Optics {
        glass: true,
        ..Optics::default()
    };
    let upward = quad([0.0, -5.0, 8.0], [9.0, 0.0, 0.0], [0.0, 10.0, 0.0]);
    let downward = quad([0.0, 5.0, 8.0], [9.0, 0.0, 0.0], [0.0, -10.0, 0.0]);
    let dimmed = 72_000.0 * scene::PANE_TRANSMITTANCE;
    assert_near(lit(&[(upward, glass), (downward, glass)]), dimmed, 1e-3);
}

/// Two rooms behind each other, one with a lamp, a doorway between, a pane in it, and a block on the floor.
fn rooms() -> Vec<(Facet, Optics)> {
    let mut surfaces = Vec::new();
    let [floor, ceiling, left, right, near, far] = inside([0.0; 3], [4.0, 6.0, 2.5]);
    for (side, albedo) in [
        (floor, 0.3),
        (ceiling, 0.8),
        (left, 0.05),
        (right, 0.65),
        (near, 0.7),
        (far, 0.7),
    ] {
        surfaces.push((side, scattering(albedo)));
    }
    let mut builder = Builder::default();
    let here = Placement::new([0.0; 3], 0.0);
    let body = Material::BLANK;
    for (low, high) in [
        ([0.0, 3.0, 0.0], [1.5, 3.1, 2.5]),
        ([2.5, 3.0, 0.0], [4.0, 3.1, 2.5]),
        ([2.2, 0.8, 0.0], [3.2, 1.6, 0.7]),
    ] {
        builder.cuboid(&here, low, high, Faces::Standing, body);
    }
    let solid = builder.surfaces.iter().map(|s| (s.facet, scattering(0.6)));
    surfaces.extend(solid);
    let lamp = quad([1.4, 1.2, 2.45], [0.0, 0.4, 0.0], [1.2, 0.0, 0.0]);
    surfaces.push((lamp, shining(4000.0)));
    surfaces
}

fn baked(threads: usize, baking: &Baking) -> Vec<LightGrid> {
    let surfaces = rooms();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.expect("pool").install(|| {
        let scene = Scene::new(&surfaces, None, 0.0);
        bake(&scene, &surfaces, baking, &no_progress).expect("not stopped")
    })
}

#[test]
fn any_number_of_threads_bakes_the_same_light() {
    let baking = Baking {
        spacing_m: 0.2,
        paths: 32,
        seed: 5,
    };
    let [one, three] = [1, 3].map(|threads| baked(threads, &baking));
    let same = |(a, b): (&LightGrid, &LightGrid)| {
        let bits = |grid: &LightGrid| grid.values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        a.columns == b.columns && bits(a) == bits(b)
    };
    assert!(one.iter().zip(&three).all(same));
}

/// Interpolated light is that of paths alone, on floor and walls of both rooms, in the light and in the shadow of the block.
#[test]
fn baked_light_is_the_light_of_paths() {
    let surfaces = rooms();
    let scene = Scene::new(&surfaces, None, 0.0);
    let baking = Baking {
        spacing_m: 0.1,
        paths: 192,
        seed: 5,
    };
    let grids = baked(2, &baking);
    let mut off = Vec::new();
    for (k, grid) in grids.iter().enumerate().take(6) {
        let facet = &surfaces[k].0;
        for n in 0..20 {
            let mut draws = tracer::Draws::new(100 * k as u64 + n);
            let [a, b] = [draws.next(), draws.next()];
            let (point, normal) = (facet.point(a, b), facet.normal);
            let spot = Spot { point, normal };
            let gathered = scene.illuminance_lx(&spot, 4096, n);
            // Below the block and behind the walls is no light to compare.
            if gathered > 1.0 {
                off.push((grid.at(a, b) / gathered - 1.0).abs());
            }
        }
    }
    off.sort_by(f32::total_cmp);
    assert!(off.len() > 100);
    let [median, most] = [off.len() / 2, off.len() * 95 / 100].map(|k| off[k]);
    assert!(median < 0.03 && most < 0.15, "{median} {most}");
}

#[test]
fn light_that_was_kept_is_read_and_a_damaged_file_is_none() {
    let folder = tempfile::tempdir().expect("folder");
    let surfaces = rooms();
    let baking = Baking {
        spacing_m: 0.5,
        paths: 8,
        seed: 1,
    };
    let key_of = |surfaces: &[_]| key(surfaces, (None, &[]), 0.0, &baking, None);
    let name = key_of(&surfaces);
    let mut moved = surfaces.clone();
    moved[0].1.albedo += 0.01;
    assert_ne!(name, key_of(&moved));
    let file = path(folder.path(), &name);
    assert!(matches!(read(&file, &name), Found::Nothing));
    let scene = Scene::new(&surfaces, None, 0.0);
    let light = Baked {
        grids: bake(&scene, &surfaces, &baking, &no_progress).expect("not stopped"),
        probes: Probes::bake(&scene, [[0.5, 0.5, 0.0], [3.5, 2.5, 0.0]], 1),
    };
    write(&file, &name, &light).expect("written");
    let Found::Light(again) = read(&file, &name) else {
        panic!("not read");
    };
    assert_eq!(again.probes, light.probes);
    for (a, b) in again.grids.iter().zip(&light.grids) {
        assert_eq!(
            (a.columns, a.rows, &a.values),
            (b.columns, b.rows, &b.values)
        );
    }
    let whole = std::fs::read(&file).expect("there");
    for end in (0..whole.len()).step_by(97) {
        std::fs::write(&file, &whole[..end]).expect("written");
        assert!(matches!(read(&file, &name), Found::Damaged(_)));
        let mut bent = whole.clone();
        bent[end] ^= 4;
        std::fs::write(&file, &bent).expect("written");
        assert!(matches!(read(&file, &name), Found::Damaged(_)));
    }
}
