//! The building: a furnished room of about 20 m² that opens into a corridor.

use std::f32::consts::FRAC_PI_2;

use super::builder::{Builder, Faces, Placement};
use super::corridor::corridor;
use super::fittings::{ceiling_lamp, skirting, walls};
use super::floor_plan::{FloorPlan, WALL_M};
use super::furniture::{
    cabinet, chair, fill_board, notice_board, picture, plant, shelf, sofa, table,
};
use super::light::Lamp;
use super::material::Material;
use crate::noise::{Dice, stream, uniform};

const DOOR_HEIGHT_M: f32 = 2.1;

/// Everything that has a surface, and the lamps.
pub(crate) fn furnish(plan: &FloorPlan, seed: u64) -> (Builder, Vec<Lamp>) {
    let mut out = Builder::default();
    let mut lamps = Vec::new();
    let rng = stream(seed, "room", 0);
    shell(&mut out, plan);
    room(&mut out, &rng, plan, &mut lamps);
    corridor(&mut out, &stream(seed, "corridor", 0), plan, &mut lamps);
    (out, lamps)
}

fn wall(
    out: &mut Builder,
    place: &Placement,
    [from, to]: [f32; 2],
    [z0, z1]: [f32; 2],
    material: Material,
) {
    let corner = place.point([from, 0.0, z0]);
    let end = place.point([to, 0.0, z0]);
    let along = std::array::from_fn(|i| end[i] - corner[i]);
    out.quad(corner, along, [0.0, 0.0, z1 - z0], material);
}

fn shell(out: &mut Builder, plan: &FloorPlan) {
    let [w, d] = plan.room_m;
    let h = plan.height_m;
    let ([x0, x1], [y0, y1]) = (plan.corridor_x_m, plan.corridor_y_m);
    out.quad(
        [0.0, 0.0, 0.0],
        [w, 0.0, 0.0],
        [0.0, d, 0.0],
        Material::PARQUET,
    );
    out.quad(
        [0.0, 0.0, h],
        [0.0, d, 0.0],
        [w, 0.0, 0.0],
        Material::CEILING,
    );
    let (cw, cd) = (x1 - x0, y1 - y0);
    out.quad(
        [x0, y0, 0.0],
        [cw, 0.0, 0.0],
        [0.0, cd, 0.0],
        Material::LINOLEUM,
    );
    out.quad(
        [x0, y0, h],
        [0.0, cd, 0.0],
        [cw, 0.0, 0.0],
        Material::CEILING,
    );

    let half = 0.5 * plan.doorway_width_m;
    let (l, r) = (plan.doorway_x_m - half, plan.doorway_x_m + half);
    let [far, right, near, left] = walls([0.0, w], [0.0, d]);
    let paper = Material::WALLPAPER;
    wall(out, &far, [0.0, w], [0.0, h], paper);
    wall(out, &right, [0.0, d], [0.0, h], paper);
    wall(out, &left, [0.0, d], [0.0, h], paper);
    wall(out, &near, [0.0, w - r], [0.0, h], paper);
    wall(out, &near, [w - l, w], [0.0, h], paper);
    wall(out, &near, [w - r, w - l], [DOOR_HEIGHT_M, h], paper);

    let [far, right, near, left] = walls(plan.corridor_x_m, plan.corridor_y_m);
    let plaster = Material::PLASTER;
    wall(out, &near, [0.0, cw], [0.0, h], plaster);
    wall(out, &right, [0.0, cd], [0.0, h], plaster);
    wall(out, &left, [0.0, cd], [0.0, h], plaster);
    wall(out, &far, [0.0, l - x0], [0.0, h], plaster);
    wall(out, &far, [r - x0, cw], [0.0, h], plaster);
    wall(out, &far, [l - x0, r - x0], [DOOR_HEIGHT_M, h], plaster);

    // The doorway through the wall: sill, lintel, jambs, and a frame on either side.
    let frame = Material::WOOD.toned(0.5);
    out.quad([l, y1, 0.0], [r - l, 0.0, 0.0], [0.0, WALL_M, 0.0], frame);
    out.quad(
        [l, y1, DOOR_HEIGHT_M],
        [0.0, WALL_M, 0.0],
        [r - l, 0.0, 0.0],
        frame,
    );
    out.quad(
        [l, y1, 0.0],
        [0.0, WALL_M, 0.0],
        [0.0, 0.0, DOOR_HEIGHT_M],
        frame,
    );
    out.quad(
        [r, 0.0, 0.0],
        [0.0, -WALL_M, 0.0],
        [0.0, 0.0, DOOR_HEIGHT_M],
        frame,
    );
    let side = frame.turned().toned(0.35);
    for (place, a, b) in [
        (walls([0.0, w], [0.0, d])[2], w - r, w - l),
        (far, l - x0, r - x0),
    ] {
        let top = DOOR_HEIGHT_M;
        out.cuboid(
            &place,
            [a - 0.08, -0.025, 0.0],
            [a, 0.0, top + 0.08],
            Faces::All,
            side,
        );
        out.cuboid(
            &place,
            [b, -0.025, 0.0],
            [b + 0.08, 0.0, top + 0.08],
            Faces::All,
            side,
        );
        out.cuboid(
            &place,
            [a, -0.025, top],
            [b, 0.0, top + 0.08],
            Faces::All,
            frame,
        );
    }
}

fn room(out: &mut Builder, rng: &Dice, plan: &FloorPlan, lamps: &mut Vec<Lamp>) {
    let [w, d] = plan.room_m;
    let h = plan.height_m;
    let [far, right, near, left] = walls([0.0, w], [0.0, d]);
    let [cx, cy] = plan.table_centre();

    // In the middle: a rug, a table with a chair at either end.
    let centre = Placement::new([cx, cy, 0.0], uniform(rng, -0.05, 0.05));
    out.cuboid(
        &centre,
        [-0.95, -0.65, 0.0],
        [0.95, 0.65, 0.006],
        Faces::Standing,
        Material::RUG,
    );
    table(
        out,
        rng,
        &centre,
        [uniform(rng, 1.0, 1.1), uniform(rng, 0.55, 0.62), 0.74],
    );
    for side in [-1.0, 1.0] {
        let yaw = -side * FRAC_PI_2 + uniform(rng, -0.15, 0.15);
        chair(
            out,
            rng,
            &centre.moved([side * uniform(rng, 0.56, 0.62), 0.0, 0.0], yaw),
        );
    }

    // Far wall: shelves with a picture between them.
    let first = uniform(rng, 1.5, 1.75);
    let second = uniform(rng, 1.2, 1.5);
    let tall = uniform(rng, 1.85, 2.1);
    shelf(
        out,
        rng,
        &far.moved([0.12, 0.0, 0.0], 0.0),
        [first, 0.31, tall],
    );
    let low = uniform(rng, 1.1, 1.4);
    shelf(
        out,
        rng,
        &far.moved([w - 0.4 - second, 0.0, 0.0], 0.0),
        [second, 0.3, low],
    );
    let gap = [0.12 + first, w - 0.4 - second];
    let middle = 0.5 * (gap[0] + gap[1]);
    let wide = (gap[1] - gap[0] - 0.3).min(0.9);
    picture(
        out,
        rng,
        &far,
        [middle, 1.55],
        [wide, uniform(rng, 0.6, 0.95)],
    );
    picture(out, rng, &far, [middle, 0.75], [0.7 * wide, 0.4]);
    picture(
        out,
        rng,
        &far,
        [w - 0.4 - 0.5 * second, 1.95],
        [uniform(rng, 0.6, 1.0), 0.5],
    );
    fill_board(
        out,
        rng,
        &far.moved([0.2, 0.0, tall], 0.0),
        [first - 0.2, 0.3, 0.3],
    );
    fill_board(
        out,
        rng,
        &far.moved([w - 0.4 - second, 0.0, low], 0.0),
        [second, 0.28, 0.3],
    );

    // Right wall: a sofa under the window, a plant in the corner.
    let couch = uniform(rng, 1.7, 2.0);
    let start = 0.55;
    sofa(
        out,
        rng,
        &right.moved([start, 0.0, 0.0], 0.0),
        [couch, 0.68, 0.78],
        0.08,
    );
    window(
        out,
        rng,
        &right,
        [start + 0.5 * couch, 1.6],
        [uniform(rng, 1.2, 1.5), 1.1],
    );
    let rest = d - start - couch;
    picture(
        out,
        rng,
        &right,
        [start + couch + 0.5 * rest, 1.6],
        [0.55 * rest, 0.8],
    );
    picture(
        out,
        rng,
        &right,
        [start + couch + 0.5 * rest, 0.85],
        [0.5 * rest, 0.4],
    );
    plant(
        out,
        rng,
        right.point([d - 0.4, -0.36, 0.0]),
        uniform(rng, 1.0, 1.4),
        0.34,
    );
    window_light(&right, [start + 0.5 * couch, 1.6], lamps);

    // Near wall, beside the doorway: a low cabinet with a screen and pictures above it.
    let free = w - plan.doorway_x_m - 0.5 * plan.doorway_width_m - 0.3;
    let wide = uniform(rng, 1.4, 1.7).min(free - 0.75);
    cabinet(
        out,
        rng,
        &near.moved([0.85, 0.0, 0.0], 0.0),
        [wide, 0.42, uniform(rng, 0.6, 0.8)],
    );
    let screen = 0.85 + 0.5 * wide;
    out.cuboid_with_front(
        &near,
        [screen - 0.45, -0.06, 1.1],
        [screen + 0.45, -0.01, 1.65],
        Faces::All,
        Material::METAL.toned(0.1),
        Material::SCREEN,
    );
    picture(out, rng, &near, [0.5, 1.6], [0.45, 0.6]);
    picture(out, rng, &near, [screen, 2.0], [0.9, 0.35]);
    picture(out, rng, &near, [0.85 + wide + 0.3, 1.5], [0.36, 0.7]);

    // Left wall: a chest of drawers, a notice board, pictures.
    let chest = uniform(rng, 1.1, 1.4);
    cabinet(
        out,
        rng,
        &left.moved([1.5, 0.0, 0.0], 0.0),
        [chest, 0.45, uniform(rng, 0.75, 0.95)],
    );
    notice_board(out, rng, &left, [1.5 + 0.5 * chest, 1.7], [1.1, 0.8]);
    picture(out, rng, &left, [0.75, 1.55], [0.7, 0.95]);
    picture(out, rng, &left, [0.7, 0.65], [0.5, 0.5]);
    picture(out, rng, &left, [d - 0.55, 1.6], [0.45, 0.6]);
    plant(
        out,
        rng,
        left.point([d - 0.62, -0.36, 0.0]),
        uniform(rng, 0.8, 1.1),
        0.3,
    );

    skirting(out, &far, w);
    skirting(out, &right, d);
    skirting(out, &left, d);
    for k in 0..2 {
        let (x, y) = (cx + (k as f32 - 0.5) * 1.5, cy + uniform(rng, -0.1, 0.1));
        let place = Placement::new([x, y, 0.0], 0.0);
        ceiling_lamp(out, &place, h, [0.28, 0.28, 0.09], lamps, 1.3);
    }
}

fn window(
    out: &mut Builder,
    rng: &Dice,
    wall: &Placement,
    [right, up]: [f32; 2],
    [w, h]: [f32; 2],
) {
    let (x, z) = (right - 0.5 * w, up - 0.5 * h);
    let view = Material::WINDOW.toned(uniform(rng, 0.5, 0.65));
    out.cuboid(
        wall,
        [x, -0.005, z],
        [x + w, 0.0, z + h],
        Faces::Hanging,
        view,
    );
    let bar = Material::WOOD.toned(0.75);
    let t = 0.05;
    for k in 0..3 {
        let bx = x + 0.5 * w * k as f32 - 0.5 * t;
        out.cuboid(wall, [bx, -0.04, z], [bx + t, 0.0, z + h], Faces::All, bar);
        let bz = z + 0.5 * h * k as f32 - 0.5 * t;
        out.cuboid(wall, [x, -0.035, bz], [x + w, 0.0, bz + t], Faces::All, bar);
    }
    out.cuboid(
        wall,
        [x - 0.1, -0.16, z - 0.06],
        [x + w + 0.1, 0.0, z - 0.025],
        Faces::All,
        bar,
    );
}

fn window_light(wall: &Placement, [right, up]: [f32; 2], lamps: &mut Vec<Lamp>) {
    for side in [-0.4, 0.4] {
        lamps.push(Lamp {
            position: wall.point([right + side, -0.2, up + 0.1]),
            power: 0.5,
        });
    }
}
