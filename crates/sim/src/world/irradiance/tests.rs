//! Against closed forms, and against another program where there is none.

use std::f32::consts::PI;

use super::straight::of_polygon;
use super::*;
use crate::world::facet::{Facet, Outline};

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

fn both_ways_lx(scene: &Scene, spot: &Spot) -> [f32; 2] {
    let traced = scene.illuminance_lx(spot, 8192, 7);
    let indirect = scene.gather(spot, 8192, 9, tracer::Light::Indirect);
    let straight: f32 = (0..64).map(|k| scene.straight_lx(spot, k)).sum();
    [traced, straight / 64.0 + indirect.illuminance_lx]
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
        for albedo in [0.0, 0.5, 0.9] {
            let optics = Optics {
                luminance_cd_m2: 100.0,
                ..scattering(albedo)
            };
            let surfaces = inside(
                [-0.5 * edge, -0.5 * edge, 0.0],
                [0.5 * edge, 0.5 * edge, edge],
            );
            let scene = Scene::new(&surfaces.map(|f| (f, optics)), None, 0.0);
            let expected = 100.0 * PI / (1.0 - albedo);
            for point in [[0.0; 3], [0.49 * edge, -0.49 * edge, 0.0]] {
                let spot = Spot { point, ..FLOOR };
                assert_near(both_ways_lx(&scene, &spot), expected, 0.02);
            }
        }
    }
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
        let scene = Scene::new(&disk, None, 0.0);
        let expected = if beside == 0.0 {
            1000.0 * PI * radius * radius / (radius * radius + height * height)
        } else {
            let (h, r) = ((height / beside).powi(2), (radius / beside).powi(2));
            let z = 1.0 + h + r;
            500.0 * PI * (1.0 - (z - 2.0 * r) / (z * z - 4.0 * r).sqrt())
        };
        assert_near(both_ways_lx(&scene, &FLOOR), expected, 0.015);
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
    let scene = |surfaces: &[(Facet, Optics)]| Scene::new(surfaces, sun, 0.0);
    assert_near(both_ways_lx(&scene(&[]), &FLOOR), 72_000.0, 1e-3);
    // Dark, infinitely wide for the purpose, its edge in line with the middle of the sun; and a pane.
    let roof = |from: f32, optics| {
        (
            quad([from, -50.0, 8.0], [50.0, 0.0, 0.0], [0.0, 100.0, 0.0]),
            optics,
        )
    };
    assert_near(
        both_ways_lx(&scene(&[roof(6.0, scattering(0.0))]), &FLOOR),
        36_000.0,
        0.03,
    );
    let glass = Optics {
        glass: true,
        ..Optics::default()
    };
    assert_near(
        both_ways_lx(&scene(&[roof(0.0, glass)]), &FLOOR),
        72_000.0,
        1e-3,
    );
    let pane = quad([0.0, 50.0, 8.0], [50.0, 0.0, 0.0], [0.0, -100.0, 0.0]);
    assert!(pane.normal[2] < 0.0);
    let dimmed = 72_000.0 * scene::PANE_TRANSMITTANCE;
    assert_near(both_ways_lx(&scene(&[(pane, glass)]), &FLOOR), dimmed, 1e-3);
}
