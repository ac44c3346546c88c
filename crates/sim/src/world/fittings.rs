//! What all rooms have: walls, skirtings, lamps under the ceiling.

use std::f32::consts::{FRAC_PI_2, PI};

use super::builder::{Builder, Faces, Placement};
use super::light::Lamp;
use super::material::Material;

/// Walls of a rectangle seen from inside: far (greatest y), right (greatest x), near, left.
pub(crate) fn walls([x0, x1]: [f32; 2], [y0, y1]: [f32; 2]) -> [Placement; 4] {
    [
        Placement::new([x0, y1, 0.0], 0.0),
        Placement::new([x1, y1, 0.0], -FRAC_PI_2),
        Placement::new([x1, y0, 0.0], PI),
        Placement::new([x0, y0, 0.0], FRAC_PI_2),
    ]
}

pub(crate) fn skirting(out: &mut Builder, wall: &Placement, length: f32) {
    let wood = Material::WOOD.toned(0.3);
    out.cuboid(
        wall,
        [0.0, -0.015, 0.0],
        [length, 0.0, 0.08],
        Faces::Hanging,
        wood,
    );
}

pub(super) fn ceiling_lamp(
    out: &mut Builder,
    place: &Placement,
    ceiling: f32,
    half: [f32; 3],
    lamps: &mut Vec<Lamp>,
    power: f32,
) {
    let [x, y, z] = half;
    out.cuboid(
        place,
        [-x, -y, ceiling - z],
        [x, y, ceiling],
        Faces::All,
        Material::LAMP,
    );
    lamps.push(Lamp {
        position: place.point([0.0, 0.0, ceiling - z - 0.05]),
        power,
    });
}
