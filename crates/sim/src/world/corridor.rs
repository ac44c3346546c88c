//! The corridor: doors, posters, notice boards, a cabinet, lamps, ducts.

use super::builder::{Builder, Faces, Placement};
use super::fittings::{ceiling_lamp, skirting, walls};
use super::floor_plan::FloorPlan;
use super::furniture::{cabinet, door, notice_board, picture};
use super::light::Lamp;
use super::material::{Marks, Material};
use crate::noise::{Dice, below, uniform};

pub(super) fn corridor(out: &mut Builder, rng: &Dice, plan: &FloorPlan, lamps: &mut Vec<Lamp>) {
    let h = plan.height_m;
    let length = plan.corridor_x_m[1] - plan.corridor_x_m[0];
    let width = plan.corridor_y_m[1] - plan.corridor_y_m[0];
    let [far, right, near, left] = walls(plan.corridor_x_m, plan.corridor_y_m);
    let doorway = plan.doorway_x_m - plan.corridor_x_m[0];

    // The wall opposite the doorway, from its left end: doors with posters and boards between them.
    let mut x = uniform(rng, 0.3, 0.6);
    while x < length - 1.3 {
        door(out, rng, &near, x);
        x += 1.15;
        let gap = uniform(rng, 1.6, 2.1).min(length - x - 0.2);
        if gap > 0.7 {
            if below(rng, 3) == 0 && gap > 1.2 {
                notice_board(out, rng, &near, [x + 0.5 * gap, 1.5], [gap - 0.3, 0.95]);
            } else {
                posters(out, rng, &near, [x, x + gap]);
            }
        }
        x += gap;
    }
    // The wall with the doorway: posters, two doors, a cabinet.
    posters(out, rng, &far, [0.1, doorway - 0.75]);
    let mut x = doorway + 0.85;
    posters(out, rng, &far, [x, x + 1.3]);
    x += 1.45;
    door(out, rng, &far, x);
    x += 1.15;
    let wide = uniform(rng, 0.8, 1.0);
    cabinet(
        out,
        rng,
        &far.moved([x, 0.0, 0.0], 0.0),
        [wide, 0.34, uniform(rng, 0.8, 1.1)],
    );
    picture(out, rng, &far, [x + 0.5 * wide, 1.75], [wide, 0.6]);
    x += wide + 0.15;
    notice_board(out, rng, &far, [x + 0.75, 1.5], [1.3, 0.9]);
    x += 1.65;
    if x < length - 1.1 {
        door(out, rng, &far, x);
    }
    for (end, place) in [(0, &left), (1, &right)] {
        picture(out, rng, place, [0.5 * width, 1.55], [0.8, 1.0]);
        if end == 0 {
            picture(out, rng, place, [0.5 * width, 0.65], [0.6, 0.5]);
        } else {
            cabinet(
                out,
                rng,
                &place.moved([0.5 * width - 0.4, 0.0, 0.0], 0.0),
                [0.8, 0.3, 0.7],
            );
        }
        skirting(out, place, width);
    }
    // Small things that stick out: an extinguisher, a bin, ducts under the ceiling.
    let red = Material::PACKAGE.toned(0.25);
    let spot = far.point([doorway - 0.95, -0.1, 0.55]);
    out.prism(spot, 0.075, 0.075, 0.48, 12, red);
    let bin = near.point([length - 0.25, -0.2, 0.0]);
    out.prism(bin, 0.13, 0.16, 0.55, 12, Material::METAL.toned(0.35));
    let duct = Material::METAL
        .toned(0.45)
        .marked(Marks::Boards([0.9, 0.3]));
    out.cuboid(
        &near,
        [0.0, -0.22, h - 0.2],
        [length, 0.0, h - 0.04],
        Faces::All,
        duct,
    );
    out.cuboid(
        &far,
        [0.0, -0.08, h - 0.3],
        [length, 0.0, h - 0.24],
        Faces::All,
        duct,
    );
    skirting(out, &near, length);
    let count = 5;
    for k in 0..count {
        let along = (k as f32 + 0.5 + uniform(rng, -0.08, 0.08)) * length / count as f32;
        let place = near.moved([along, -0.5 * width, 0.0], 0.0);
        ceiling_lamp(out, &place, h, [0.55, 0.09, 0.06], lamps, 0.75);
    }
}

/// Posters side by side between two points along a wall, some over others.
fn posters(out: &mut Builder, rng: &Dice, wall: &Placement, [from, to]: [f32; 2]) {
    let mut x = from + 0.05;
    while x + 0.4 < to {
        let w = uniform(rng, 0.38, 0.75).min(to - x - 0.02);
        let h = w * uniform(rng, 1.1, 1.45);
        picture(
            out,
            rng,
            wall,
            [x + 0.5 * w, uniform(rng, 1.55, 1.75)],
            [w - 0.06, h - 0.06],
        );
        if below(rng, 3) > 0 {
            picture(
                out,
                rng,
                wall,
                [x + 0.5 * w, uniform(rng, 0.6, 0.75)],
                [0.8 * w - 0.06, 0.4],
            );
        }
        x += w + uniform(rng, 0.06, 0.2);
    }
}
