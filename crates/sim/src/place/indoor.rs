//! Parts of the large office that are places of their own: hall, atrium, corridors, stairs.

use super::dress::Dress;
use super::site::{Area, Cladding, Site};
use crate::noise::{below, uniform};
use crate::world::builder::{Faces, Placement};
use crate::world::crowd::Stroll;
use crate::world::furniture::{picture, plant, sofa, table};
use crate::world::light::Lamp;
use crate::world::material::{Marks, Material};

/// Height of ordinary ceilings, metres.
pub(super) const CEILING_M: f32 = 2.9;
/// Height of the exhibition hall, metres.
pub(super) const HALL_M: f32 = 4.6;
/// Height of the atrium, metres.
pub(super) const ATRIUM_M: f32 = 15.0;
/// Height of the upper floor at the stairs, metres.
pub(super) const STOREY_M: f32 = 4.0;
/// Part of the stairs' depth before and after the flights.
pub(super) const FLIGHT: [f32; 2] = [6.0, 13.2];
const STEPS: usize = 24;

/// A hall with stands, screens that change, glass cases, and visitors.
pub(super) fn exhibition(site: &mut Site, area: Area) {
    let cladding = Cladding {
        floor: Material::CARPET.busier(0.1),
        wall: Material::PAINT.toned(0.55),
        ceiling: Material::CEILING.toned(0.35),
    };
    let walls = site.hall(area, HALL_M, &cladding);
    for (k, wall) in walls.iter().enumerate() {
        site.dress(wall, Dress::Gallery, 100 + k as u64);
    }
    site.lamps(area, HALL_M, 4.2, 2.6);
    // A big screen on the far wall.
    let far = walls[0].place;
    let middle = 0.5 * walls[0].length_m;
    let (low, high) = ([middle - 3.0, -0.12, 1.0], [middle + 3.0, -0.01, 4.2]);
    site.out()
        .cuboid_with_front(&far, low, high, Faces::All, Material::METAL, Material::SHOW);
    let [w, d] = area.size();
    for (row, y) in [0.3, 0.5, 0.7].into_iter().enumerate() {
        for (column, x) in [0.28, 0.5, 0.72].into_iter().enumerate() {
            let number = (3 * row + column) as u64;
            let at = [area.x[0] + x * w, area.y[0] + y * d, 0.0];
            let turn = uniform(&site.built("stand", number), -0.2, 0.2);
            stand(site, &Placement::new(at, turn), number);
        }
    }
    let ring = area.shrunk(2.6);
    for k in 0..6 {
        let rng = site.built("visitor", k);
        let inset = uniform(&rng, -1.3, -0.8);
        stroll_around(
            site,
            ring.shrunk(inset),
            uniform(&rng, 0.5, 1.1),
            11.0 * k as f32,
        );
    }
}

/// A stand: a partition with pictures on one side and a screen on the other, a desk, a glass case.
fn stand(site: &mut Site, place: &Placement, number: u64) {
    let rng = site.moved("stand", number);
    let body = Material::PAINT.toned(uniform(&rng, 0.2, 0.75));
    let out = site.out();
    out.cuboid(
        place,
        [-1.5, -0.08, 0.0],
        [1.5, 0.08, 2.5],
        Faces::Standing,
        body,
    );
    let front = place.moved([0.0, -0.08, 0.0], 0.0);
    let frame = Material::METAL.toned(0.1);
    let (low, high) = ([-0.65, -0.06, 1.1], [0.65, -0.01, 1.85]);
    out.cuboid_with_front(&front, low, high, Faces::All, frame, Material::SHOW);
    picture(out, &rng, &front, [-1.1, 1.4], [0.6, 0.9]);
    picture(out, &rng, &front, [1.1, 1.4], [0.6, 0.9]);
    let sign = Material::SIGN.toned(uniform(&rng, 0.1, 0.9));
    out.cuboid(
        &front,
        [-1.2, -0.02, 2.08],
        [1.2, 0.0, 2.4],
        Faces::Hanging,
        sign,
    );
    let back = place.moved([0.0, 0.08, 0.0], std::f32::consts::PI);
    for x in [-0.95, 0.0, 0.95] {
        let h = uniform(&rng, 0.8, 1.5);
        picture(out, &rng, &back, [x, 1.45], [0.75, h]);
    }
    if below(&rng, 2) == 0 {
        table(
            out,
            &rng,
            &place.moved([0.0, -1.1, 0.0], 0.0),
            [1.3, 0.6, 0.9],
        );
    } else {
        let case = place.moved([-0.6, -1.2, 0.0], 0.0);
        let wood = Material::WOOD.toned(0.2);
        out.cuboid(
            &case,
            [0.0, -0.35, 0.0],
            [1.2, 0.35, 0.8],
            Faces::Standing,
            wood,
        );
        let pot = Material::PACKAGE.toned(uniform(&rng, 0.3, 0.8));
        let base = case.point([0.6, 0.0, 0.8]);
        out.prism(base, 0.12, 0.2, 0.5, 10, pot.marked(Marks::None));
        for (origin, yaw, width) in [
            ([0.0, -0.35], 0.0, 1.2),
            ([1.2, -0.35], 0.5, 0.7),
            ([1.2, 0.35], 1.0, 1.2),
            ([0.0, 0.35], 1.5, 0.7),
        ] {
            let [x, y] = origin;
            let side = case.moved([x, y, 0.0], yaw * std::f32::consts::PI);
            site.pane(&side, width, [0.8, 1.6]);
        }
    }
}

/// Somebody who walks along the border of an area.
pub(super) fn stroll_around(site: &mut Site, area: Area, speed_m_s: f32, start_m: f32) {
    let ([x0, x1], [y0, y1]) = (area.x, area.y);
    site.plan.strolls.push(Stroll {
        corners: vec![[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]],
        speed_m_s,
        start_m,
    });
}

/// A space fifteen metres high: galleries with balustrades of glass, columns, far walls with few features.
pub(super) fn atrium(site: &mut Site, area: Area) {
    let cladding = Cladding {
        floor: Material::STONE.busier(0.015),
        wall: Material::BLANK.toned(0.7),
        ceiling: Material::SKYLIGHT,
    };
    let walls = site.hall(area, ATRIUM_M, &cladding);
    let [w, d] = area.size();
    for (k, wall) in walls.iter().enumerate() {
        // At eye level doors far apart; above, rows of identical windows.
        site.dress(wall, Dress::Doors(7.5), 200 + k as u64);
        for storey in [5.2, 10.0] {
            let mut x = 1.5;
            while x + 2.2 < wall.length_m {
                site.window(&wall.place, [x, x + 1.6], [storey + 0.9, storey + 2.9], 7);
                x += 4.0;
            }
            let slab = Material::CONCRETE.toned(0.6);
            let (low, high) = ([0.0, -1.3, storey - 0.3], [wall.length_m, 0.0, storey]);
            site.out().cuboid(&wall.place, low, high, Faces::All, slab);
            let edge = wall.place.moved([0.0, -1.25, 0.0], 0.0);
            let mut x = 1.3;
            while x + 3.0 < wall.length_m - 1.3 {
                site.pane(&edge.moved([x, 0.0, 0.0], 0.0), 2.9, [storey, storey + 1.1]);
                x += 3.0;
            }
        }
    }
    // Skylights have beams below them.
    for k in 1..(w / 5.0) as usize {
        let x = area.x[0] + 5.0 * k as f32;
        let beam = Placement::new([x, area.y[0], 0.0], 0.0);
        let (low, high) = ([-0.15, 0.0, ATRIUM_M - 0.6], [0.15, d, ATRIUM_M - 0.05]);
        site.out()
            .cuboid(&beam, low, high, Faces::All, Material::METAL.toned(0.5));
    }
    for i in 0..(w / 4.0) as usize {
        for j in 0..2 {
            site.plan.lamps.push(Lamp {
                position: [
                    area.x[0] + 4.0 * i as f32 + 2.0,
                    area.y[0] + d * (0.3 + 0.4 * j as f32),
                    5.0,
                ],
                power: 7.0,
            });
        }
    }
    for k in 0..(w / 10.0) as usize {
        for side in [0.22, 0.78] {
            let base = [area.x[0] + 5.0 + 10.0 * k as f32, area.y[0] + side * d, 0.0];
            let white = Material::BLANK.toned(0.75);
            site.out().prism(base, 0.35, 0.35, ATRIUM_M, 16, white);
        }
    }
    island(site, area);
    for (k, x) in [0.08, 0.9].into_iter().enumerate() {
        let rng = site.moved("atrium bench", k as u64);
        let at = Placement::new([area.x[0] + x * w, area.y[0] + 0.5 * d, 0.0], 1.57);
        sofa(site.out(), &rng, &at, [2.0, 0.8, 0.75], 0.0);
        let pot = at.point([2.7, -0.4, 0.0]);
        plant(site.out(), &rng, pot, 1.8, 0.5);
    }
    for k in 0..10 {
        let rng = site.built("passer-by", k);
        let [u, v] = [uniform(&rng, 0.05, 0.3) * w, uniform(&rng, 0.12, 0.42) * d];
        let way = Area::new(
            [area.x[0] + u, area.x[1] - u],
            [area.y[0] + v, area.y[1] - v],
        );
        stroll_around(site, way, uniform(&rng, 0.7, 1.5), 13.0 * k as f32);
    }
}

/// What stands in the middle of the atrium: a desk with a tower of pictures.
fn island(site: &mut Site, area: Area) {
    let [x, y] = area.centre();
    let rng = site.moved("island", 0);
    let centre = Placement::new([x, y, 0.0], 0.0);
    let out = site.out();
    out.cuboid(
        &centre,
        [-0.7, -0.7, 0.0],
        [0.7, 0.7, 3.2],
        Faces::Standing,
        Material::WOOD.toned(0.35),
    );
    for k in 0..4 {
        let yaw = k as f32 * std::f32::consts::FRAC_PI_2;
        let side = Placement::new([x, y, 0.0], yaw).moved([0.0, -0.7, 0.0], 0.0);
        picture(out, &rng, &side, [0.0, 1.5], [1.2, 1.7]);
        let sign = Material::SIGN.toned(uniform(&rng, 0.1, 0.9));
        out.cuboid(
            &side,
            [-0.6, -0.03, 2.6],
            [0.6, 0.0, 3.0],
            Faces::Hanging,
            sign,
        );
        let desk = Placement::new([x, y, 0.0], yaw + 0.785).moved([0.0, -2.1, 0.0], 0.0);
        table(out, &rng, &desk, [1.4, 0.7, 0.95]);
        let pot = desk.point([1.3, 0.0, 0.0]);
        plant(out, &rng, pot, 1.3, 0.35);
    }
}

/// Four metres wide, doors that cannot be told apart, posters between them.
pub(super) fn wide_corridor(site: &mut Site, area: Area) {
    let cladding = Cladding {
        floor: Material::LINOLEUM.busier(0.05),
        wall: Material::PLASTER.busier(0.04),
        ceiling: Material::CEILING,
    };
    let walls = site.hall(area, CEILING_M, &cladding);
    for (k, wall) in walls.iter().enumerate() {
        let dress = if wall.length_m > 10.0 {
            Dress::Corridor(4.0)
        } else {
            Dress::Gallery
        };
        site.dress(wall, dress, 300 + k as u64);
    }
    site.lamps(area, CEILING_M, 4.0, 1.5);
    site.shutter(area, 0.5, CEILING_M);
    let duct = Material::METAL
        .toned(0.45)
        .marked(Marks::Boards([1.2, 0.3]));
    let wall = &walls[0];
    let (low, high) = (
        [0.0, -0.4, CEILING_M - 0.3],
        [wall.length_m, 0.0, CEILING_M - 0.02],
    );
    site.out().cuboid(&wall.place, low, high, Faces::All, duct);
}

/// Two metres wide, white walls, few doors, a plain floor, lamps far apart.
pub(super) fn narrow_corridor(site: &mut Site, area: Area) {
    let cladding = Cladding {
        floor: Material::VINYL,
        wall: Material::BLANK,
        ceiling: Material::BLANK.toned(0.75),
    };
    let walls = site.hall(area, 2.6, &cladding);
    for (k, wall) in walls.iter().enumerate().filter(|(k, _)| k % 2 == 0) {
        site.dress(wall, Dress::Doors(15.0), 400 + k as u64);
    }
    site.lamps(area, 2.6, 6.0, 0.9);
    // Not below a lamp.
    site.shutter(area, 0.4, 2.6);
}

/// Two wide flights between two floors, walls full of pictures.
pub(super) fn stairs(site: &mut Site, area: Area) {
    let cladding = Cladding {
        floor: Material::STONE,
        wall: Material::PLASTER.busier(0.09),
        ceiling: Material::CEILING,
    };
    let height = STOREY_M + 4.0;
    let walls = site.hall(area, height, &cladding);
    for (k, wall) in walls.iter().enumerate() {
        site.dress(wall, Dress::Gallery, 500 + k as u64);
        let above = super::site::Wall {
            place: wall.place.moved([0.0, 0.0, STOREY_M], 0.0),
            length_m: wall.length_m,
            taken: Vec::new(),
        };
        site.dress(&above, Dress::Gallery, 520 + k as u64);
    }
    site.lamps(area, height, 3.5, 5.0);
    let [w, d] = area.size();
    let origin = Placement::new([area.x[0], area.y[0], 0.0], 0.0);
    let landing = Material::PARQUET;
    let (low, high) = ([0.0, FLIGHT[1], 0.0], [w, d, STOREY_M]);
    site.out()
        .cuboid(&origin, low, high, Faces::Standing, landing);
    let (run, rise) = (
        (FLIGHT[1] - FLIGHT[0]) / STEPS as f32,
        STOREY_M / STEPS as f32,
    );
    let middle = 0.5 * w;
    for [x0, x1] in [[0.05, middle - 0.6], [middle + 0.6, w - 0.05]] {
        for k in 0..STEPS {
            let y = FLIGHT[0] + k as f32 * run;
            let z = (k + 1) as f32 * rise;
            let step = Material::WOOD.toned(0.45);
            let nose = Material::METAL.toned(0.2);
            let out = site.out();
            let (low, high) = ([x0, y, z - rise], [x1, FLIGHT[1], z]);
            out.cuboid_with_front(&origin, low, high, Faces::Standing, step, step.toned(0.3));
            let (low, high) = ([x0, y - 0.004, z - 0.03], [x1, y + 0.04, z + 0.002]);
            out.cuboid(&origin, low, high, Faces::All, nose);
        }
    }
    // Between the flights a wall with pictures on both sides, sloping with them.
    for k in 0..6 {
        let run = (FLIGHT[1] - FLIGHT[0]) / 6.0;
        let y = FLIGHT[0] + k as f32 * run;
        let top = STOREY_M * (k + 1) as f32 / 6.0 + 0.95;
        let low = [middle - 0.6, y, 0.0];
        let high = [middle + 0.6, y + run, top];
        let paint = Material::PAINT.toned(0.6);
        site.out()
            .cuboid(&origin, low, high, Faces::Standing, paint);
        let rng = site.moved("flight", k);
        for (side, yaw) in [(middle + 0.6, 1.57), (middle - 0.6, -1.57)] {
            let at = origin.moved([side, y + 0.5 * run, top - 0.5], yaw);
            picture(site.out(), &rng, &at, [0.0, 0.0], [0.8, 0.6]);
        }
    }
    for (k, [x, y]) in [[1.0, 1.0], [w - 1.0, 1.0], [middle, 4.5]]
        .into_iter()
        .enumerate()
    {
        let rng = site.moved("stairs plant", k as u64);
        plant(site.out(), &rng, origin.point([x, y, 0.0]), 1.6, 0.45);
    }
    let rng = site.moved("stairs sofa", 0);
    let seat = origin.moved([middle + 1.1, d - 0.05, STOREY_M], 0.0);
    sofa(
        site.out(),
        &rng,
        &seat.moved([-2.1, 0.0, 0.0], 0.0),
        [2.0, 0.8, 0.75],
        0.0,
    );
}
