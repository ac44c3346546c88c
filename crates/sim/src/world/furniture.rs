//! Pieces of furniture. A piece stands on a [`Placement`]: right along the wall, depth from minus its own depth at the
//! front to 0 at the wall.

use super::builder::{Builder, Faces, Placement};
use super::material::{Marks, Material};
use crate::noise::{Dice, below, uniform};

/// Width, depth and height, metres.
pub(crate) type Size = [f32; 3];

/// An open shelf filled with books, boxes and jars.
pub(crate) fn shelf(out: &mut Builder, rng: &Dice, place: &Placement, [w, d, h]: Size) {
    let wood = Material::WOOD.toned(uniform(rng, 0.3, 0.6));
    let t = 0.022;
    let upright = wood.turned();
    out.cuboid(place, [0.0, -d, 0.0], [t, 0.0, h], Faces::Standing, upright);
    out.cuboid(
        place,
        [w - t, -d, 0.0],
        [w, 0.0, h],
        Faces::Standing,
        upright,
    );
    out.cuboid(
        place,
        [t, -0.01, 0.0],
        [w - t, 0.0, h],
        Faces::Hanging,
        wood,
    );
    let boards = ((h - 0.1) / 0.36) as usize;
    let pitch = (h - 0.08 - t) / boards as f32;
    for k in 0..=boards {
        let z = 0.08 + k as f32 * pitch;
        out.cuboid(place, [t, -d, z], [w - t, -0.01, z + t], Faces::All, wood);
        if k < boards {
            fill_board(
                out,
                rng,
                &place.moved([t, 0.0, z + t], 0.0),
                [w - 2.0 * t, d, pitch - t],
            );
        }
    }
}

/// Things side by side from left to right in the space given.
pub(crate) fn fill_board(out: &mut Builder, rng: &Dice, place: &Placement, [w, d, h]: Size) {
    let mut x = uniform(rng, 0.01, 0.05);
    while x < w - 0.06 {
        match below(rng, 8) {
            0..=4 => {
                // A run of books, the last ones may lean on nothing: shelves are patient.
                for _ in 0..3 + below(rng, 6) {
                    let thick = uniform(rng, 0.018, 0.05);
                    if x + thick > w - 0.01 {
                        break;
                    }
                    let tall = h * uniform(rng, 0.6, 0.93);
                    let deep = uniform(rng, 0.6, 0.85) * d;
                    let book = Material::BOOK.toned(uniform(rng, 0.1, 0.8));
                    let paper = Material::PAPER.marked(Marks::None);
                    out.cuboid_with_front(
                        place,
                        [x, -deep, 0.0],
                        [x + thick, -0.02, tall],
                        Faces::Standing,
                        if thick > 0.03 { book } else { paper.toned(0.7) },
                        book,
                    );
                    x += thick + 0.001;
                }
            }
            5 => {
                let wide = uniform(rng, 0.1, 0.28).min(w - x - 0.01);
                let tall = h * uniform(rng, 0.35, 0.8);
                let package = Material::PACKAGE.toned(uniform(rng, 0.2, 0.75));
                out.cuboid(
                    place,
                    [x, -0.8 * d, 0.0],
                    [x + wide, -0.03, tall],
                    Faces::Standing,
                    package,
                );
                x += wide;
            }
            6 => {
                let r = uniform(rng, 0.03, 0.06).min(0.4 * (w - x));
                let pot = Material::PACKAGE
                    .toned(uniform(rng, 0.2, 0.8))
                    .marked(Marks::None);
                let base = place.point([x + r, -0.5 * d, 0.0]);
                let top = r * uniform(rng, 0.6, 1.0);
                out.prism(base, r, top, h * uniform(rng, 0.3, 0.7), 8, pot);
                x += 2.0 * r;
            }
            _ => {
                // Books lying in a pile.
                let wide = uniform(rng, 0.16, 0.24).min(w - x - 0.01);
                let mut z = 0.0;
                for _ in 0..2 + below(rng, 3) {
                    let thick = uniform(rng, 0.02, 0.045);
                    if z + thick > 0.8 * h {
                        break;
                    }
                    let inset = uniform(rng, 0.0, 0.02);
                    let book = Material::BOOK.toned(uniform(rng, 0.1, 0.8));
                    out.cuboid(
                        place,
                        [x + inset, -0.75 * d, z],
                        [x + wide - inset, -0.05, z + thick],
                        Faces::Standing,
                        book,
                    );
                    z += thick;
                }
                x += wide;
            }
        }
        x += uniform(rng, 0.005, 0.06);
    }
}

/// A closed cabinet with doors or drawers in front, and things on top.
pub(crate) fn cabinet(out: &mut Builder, rng: &Dice, place: &Placement, [w, d, h]: Size) {
    let body = Material::CUPBOARD
        .toned(uniform(rng, 0.25, 0.65))
        .marked(Marks::None);
    out.cuboid(place, [0.0, -d, 0.04], [w, 0.0, h], Faces::All, body);
    let columns = (w / 0.5).round().max(1.0) as usize;
    let rows = if below(rng, 2) == 0 {
        1
    } else {
        (h / 0.25) as usize
    };
    let (fw, fh) = (w / columns as f32, (h - 0.06) / rows as f32);
    for i in 0..columns {
        for j in 0..rows {
            let door = Material::CUPBOARD.toned(uniform(rng, 0.35, 0.6));
            let (x, z) = (i as f32 * fw, 0.05 + j as f32 * fh);
            out.cuboid(
                place,
                [x + 0.006, -d - 0.018, z + 0.006],
                [x + fw - 0.006, -d, z + fh - 0.006],
                Faces::Hanging,
                door,
            );
            let (hx, hz) = (x + 0.5 * fw, z + 0.75 * fh);
            out.cuboid(
                place,
                [hx - 0.06, -d - 0.045, hz - 0.008],
                [hx + 0.06, -d - 0.03, hz + 0.008],
                Faces::All,
                Material::METAL.toned(0.15),
            );
        }
    }
    let top = place.moved([0.0, 0.0, h], 0.0);
    fill_board(out, rng, &top, [w, d, 0.32]);
}

/// A table with what lies on it; the place is its centre.
pub(crate) fn table(out: &mut Builder, rng: &Dice, centre: &Placement, [w, d, h]: Size) {
    let wood = Material::WOOD.toned(uniform(rng, 0.35, 0.6));
    let (x, y) = (0.5 * w, 0.5 * d);
    out.cuboid(centre, [-x, -y, h - 0.035], [x, y, h], Faces::All, wood);
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        let (lx, ly) = (sx * (x - 0.06), sy * (y - 0.06));
        out.cuboid(
            centre,
            [lx - 0.03, ly - 0.03, 0.0],
            [lx + 0.03, ly + 0.03, h - 0.035],
            Faces::Standing,
            wood.turned(),
        );
    }
    // A notebook computer, papers, mugs and books, each in its own part of the table top.
    let top = centre.moved([0.0, 0.0, h], 0.0);
    let laptop = top.moved([-0.2 * w, -0.05, 0.0], uniform(rng, -0.4, 0.4));
    let dark = Material::METAL.toned(0.2);
    let keys = dark.marked(Marks::Text(0.02));
    out.cuboid(
        &laptop,
        [-0.16, -0.11, 0.0],
        [0.16, 0.11, 0.018],
        Faces::Standing,
        keys,
    );
    out.cuboid_with_front(
        &laptop,
        [-0.16, 0.11, 0.01],
        [0.16, 0.12, 0.23],
        Faces::All,
        dark,
        Material::SCREEN,
    );
    for k in 0..4 {
        let sheet = top.moved(
            [
                uniform(rng, 0.0, 0.35) * w,
                uniform(rng, -0.3, 0.3) * d,
                0.001 + 0.001 * k as f32,
            ],
            uniform(rng, -1.5, 1.5),
        );
        let paper = Material::PAPER.toned(uniform(rng, 0.7, 0.9));
        out.cuboid(
            &sheet,
            [-0.1, -0.14, 0.0],
            [0.1, 0.14, 0.0015],
            Faces::Standing,
            paper,
        );
    }
    for k in 0..3 {
        let spot = top.point([
            (0.18 + 0.1 * k as f32) * w,
            uniform(rng, -0.3, 0.3) * d,
            0.004,
        ]);
        let mug = Material::PACKAGE
            .toned(uniform(rng, 0.15, 0.85))
            .marked(Marks::None);
        out.prism(spot, 0.038, 0.038, 0.095, 10, mug);
    }
    let pile = top.moved([-0.42 * w, 0.25 * d, 0.0], uniform(rng, -0.3, 0.3));
    fill_board(out, rng, &pile, [0.24, 0.2, 0.25]);
}

/// A chair; the place is the centre of its seat, its back is at positive depth.
pub(crate) fn chair(out: &mut Builder, rng: &Dice, centre: &Placement) {
    let wood = Material::WOOD.toned(uniform(rng, 0.25, 0.5));
    let fabric = Material::FABRIC.toned(uniform(rng, 0.2, 0.6));
    let r = 0.2;
    out.cuboid(centre, [-r, -r, 0.43], [r, r, 0.47], Faces::All, fabric);
    for (sx, sy, top) in [
        (-1.0, -1.0, 0.43),
        (1.0, -1.0, 0.43),
        (1.0, 1.0, 0.9),
        (-1.0, 1.0, 0.9),
    ] {
        let (x, y) = (sx * (r - 0.02), sy * (r - 0.02));
        out.cuboid(
            centre,
            [x - 0.018, y - 0.018, 0.0],
            [x + 0.018, y + 0.018, top],
            Faces::Standing,
            wood.turned(),
        );
    }
    for z in [0.58, 0.74] {
        out.cuboid(
            centre,
            [-r, r - 0.03, z],
            [r, r - 0.012, z + 0.11],
            Faces::All,
            wood,
        );
    }
}

/// A sofa with cushions, its base so much above the floor.
pub(crate) fn sofa(
    out: &mut Builder,
    rng: &Dice,
    place: &Placement,
    [w, d, h]: Size,
    above_floor_m: f32,
) {
    let fabric = Material::FABRIC.toned(uniform(rng, 0.25, 0.5));
    let low = [0.0, -d, above_floor_m];
    out.cuboid(place, low, [w, 0.0, 0.4], Faces::All, fabric);
    out.cuboid(
        place,
        [0.0, -0.22, 0.4],
        [w, 0.0, h],
        Faces::Standing,
        fabric,
    );
    for x in [0.0, w - 0.16] {
        out.cuboid(
            place,
            [x, -d, 0.4],
            [x + 0.16, -0.22, 0.6],
            Faces::Standing,
            fabric,
        );
    }
    for k in 0..3 {
        let x = 0.2 + (w - 0.7) * 0.5 * k as f32;
        let cushion = place.moved([x, -0.26, 0.4], uniform(rng, -0.2, 0.2));
        let pattern = Material::RUG.toned(uniform(rng, 0.3, 0.65));
        out.cuboid(
            &cushion,
            [0.0, -0.12, 0.0],
            [0.36, 0.0, 0.34],
            Faces::Standing,
            pattern,
        );
    }
}

/// A pot with a plant of many leaves.
pub(crate) fn plant(out: &mut Builder, rng: &Dice, base: [f32; 3], height: f32, reach: f32) {
    let pot = Material::PACKAGE
        .toned(uniform(rng, 0.3, 0.7))
        .marked(Marks::None);
    let pot_height = 0.28 * height;
    out.prism(base, 0.5 * reach, 0.65 * reach, pot_height, 10, pot);
    for _ in 0..46 {
        let angle = uniform(rng, 0.0, std::f32::consts::TAU);
        let root = 0.35 * reach * uniform(rng, 0.0, 1.0);
        let z = base[2] + pot_height + (height - pot_height) * uniform(rng, 0.0, 0.75);
        let stem = [
            base[0] + root * angle.cos(),
            base[1] + root * angle.sin(),
            z,
        ];
        let out_m = reach * uniform(rng, 0.3, 0.62);
        let along = [
            out_m * angle.cos(),
            out_m * angle.sin(),
            0.25 * height * uniform(rng, 0.2, 1.0),
        ];
        let leaf = Material::LEAF.toned(uniform(rng, 0.12, 0.4));
        out.leaf(stem, along, uniform(rng, 0.05, 0.1), leaf);
    }
}

/// A framed picture or an unframed poster, centred `right` along the wall at height `up`.
pub(crate) fn picture(
    out: &mut Builder,
    rng: &Dice,
    wall: &Placement,
    [right, up]: [f32; 2],
    [w, h]: [f32; 2],
) {
    let poster = Material::POSTER.toned(uniform(rng, 0.3, 0.65));
    let (low, high) = (
        [right - 0.5 * w, up - 0.5 * h],
        [right + 0.5 * w, up + 0.5 * h],
    );
    if below(rng, 2) == 0 {
        let frame = Material::WOOD.toned(uniform(rng, 0.1, 0.5));
        let t = 0.03;
        for (l, r) in [
            ([low[0] - t, low[1] - t], [high[0] + t, low[1]]),
            ([low[0] - t, high[1]], [high[0] + t, high[1] + t]),
            ([low[0] - t, low[1]], [low[0], high[1]]),
            ([high[0], low[1]], [high[0] + t, high[1]]),
        ] {
            out.cuboid(
                wall,
                [l[0], -0.03, l[1]],
                [r[0], 0.0, r[1]],
                Faces::All,
                frame,
            );
        }
    }
    out.cuboid(
        wall,
        [low[0], -0.008, low[1]],
        [high[0], 0.0, high[1]],
        Faces::Hanging,
        poster,
    );
}

/// A cork board covered with sheets of paper.
pub(crate) fn notice_board(
    out: &mut Builder,
    rng: &Dice,
    wall: &Placement,
    [right, up]: [f32; 2],
    [w, h]: [f32; 2],
) {
    let (x, z) = (right - 0.5 * w, up - 0.5 * h);
    out.cuboid(
        wall,
        [x, -0.02, z],
        [x + w, 0.0, z + h],
        Faces::Hanging,
        Material::CORK,
    );
    for k in 0..(w * h * 22.0) as usize {
        let (pw, ph) = (uniform(rng, 0.09, 0.21), uniform(rng, 0.1, 0.28));
        let (px, pz) = (
            x + uniform(rng, 0.01, w - pw - 0.01),
            z + uniform(rng, 0.01, h - ph - 0.01),
        );
        let near = -0.0205 - 0.0005 * k as f32;
        let sheet = if below(rng, 3) == 0 {
            Material::POSTER
                .marked(Marks::Poster(0.01))
                .toned(uniform(rng, 0.4, 0.7))
        } else {
            Material::PAPER.toned(uniform(rng, 0.6, 0.9))
        };
        out.cuboid(
            wall,
            [px, near, pz],
            [px + pw, -0.02, pz + ph],
            Faces::Hanging,
            sheet,
        );
    }
}

/// A closed door with its frame, plate and handle, `right` being its left edge.
pub(crate) fn door(out: &mut Builder, rng: &Dice, wall: &Placement, right: f32) {
    let (w, h) = (0.95, 2.05);
    let leaf = Material::CUPBOARD
        .toned(uniform(rng, 0.3, 0.65))
        .marked(Marks::Panel(0.14));
    let frame = Material::WOOD.toned(uniform(rng, 0.2, 0.6)).turned();
    out.cuboid(
        wall,
        [right, -0.02, 0.0],
        [right + w, 0.0, h],
        Faces::Hanging,
        leaf,
    );
    for (l, r, z0, z1) in [
        (right - 0.08, right, 0.0, h + 0.08),
        (right + w, right + w + 0.08, 0.0, h + 0.08),
        (right, right + w, h, h + 0.08),
    ] {
        out.cuboid(wall, [l, -0.045, z0], [r, 0.0, z1], Faces::All, frame);
    }
    let metal = Material::METAL.toned(0.55);
    let hx = right + 0.08;
    out.cuboid(
        wall,
        [hx, -0.07, 1.03],
        [hx + 0.13, -0.045, 1.055],
        Faces::All,
        metal,
    );
    out.cuboid(
        wall,
        [hx - 0.01, -0.03, 0.95],
        [hx + 0.03, -0.02, 1.12],
        Faces::All,
        metal,
    );
    let plate = Material::PAPER.marked(Marks::Text(0.03));
    out.cuboid(
        wall,
        [right + 0.33, -0.026, 1.5],
        [right + 0.63, -0.02, 1.64],
        Faces::Hanging,
        plate,
    );
}
