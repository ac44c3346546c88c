//! Outside: façades, houses one can enter, a plaza, lawns, trees, the sky.

use std::f32::consts::FRAC_PI_2;

use super::dress::Dress;
use super::indoor::stroll_around;
use super::site::{Area, Cladding, Site, WALL_M, Wall};
use crate::noise::uniform;
use crate::world::builder::{Faces, Placement};
use crate::world::furniture::door;
use crate::world::light::{Lamp, Sky, Sun};
use crate::world::material::{Marks, Material};
use crate::world::vector::norm;

/// Edge of the park, metres.
pub(super) const PARK_M: f32 = 100.0;
const SKY_M: f32 = 260.0;
/// Houses of the park with houses.
pub(super) const HOUSES: [Area; 3] = [
    Area::new([14.0, 32.0], [18.0, 30.0]),
    Area::new([60.0, 80.0], [16.0, 28.0]),
    Area::new([20.0, 36.0], [66.0, 78.0]),
];
/// Large buildings of the other one.
const BLOCKS: [(Area, f32); 3] = [
    (Area::new([10.0, 42.0], [12.0, 34.0]), 16.0),
    (Area::new([62.0, 88.0], [10.0, 40.0]), 12.0),
    (Area::new([14.0, 36.0], [64.0, 88.0]), 20.0),
];
const HOUSE_M: f32 = 3.2;
/// Half the power of a lamp on a post.
const POST_POWER: f32 = 1.0;

/// Large office buildings and a plaza.
pub(super) fn buildings(site: &mut Site) {
    grounds(site);
    for (k, (area, height)) in BLOCKS.into_iter().enumerate() {
        let material = [Material::CLADDING, Material::BRICK, Material::CONCRETE][k];
        let walls = site.outsides(area, height, material);
        roof(site, area, height);
        for (side, wall) in walls.iter().enumerate() {
            facade(site, wall, height, (8 * k + side) as u64);
        }
    }
    furnish(site);
}

/// Houses with small rooms and passages, and a plaza.
pub(super) fn houses(site: &mut Site) {
    for (k, area) in HOUSES.into_iter().enumerate() {
        house(site, area, k as u64);
    }
    grounds(site);
    furnish(site);
}

/// Ground, plaza, hedges, sky and sun.
fn grounds(site: &mut Site) {
    let norm_of = |v: [f32; 3]| v.map(|c| c / norm(v));
    site.plan.sky = Sky::Day(Sun {
        direction: norm_of([0.45, -0.5, 0.75]),
        power: 0.75,
    });
    site.plan.ambient = 0.4;
    let out = site.out();
    let flat = |x: [f32; 2], y: [f32; 2], z: f32| {
        (
            [x[0], y[0], z],
            [x[1] - x[0], 0.0, 0.0],
            [0.0, y[1] - y[0], 0.0],
        )
    };
    // Under the floors of the houses, not in their plane: which of two a ray meets would be chance.
    let (a, b, c) = flat([-60.0, PARK_M + 60.0], [-60.0, PARK_M + 60.0], -0.012);
    out.quad(a, b, c, Material::ASPHALT);
    // The plaza in the middle, in fields, so that each has its own piece of pavement.
    for i in 0..4 {
        for j in 0..4 {
            let (x, y) = (38.0 + 6.0 * i as f32, 42.0 + 5.0 * j as f32);
            let (a, b, c) = flat([x, x + 6.0], [y, y + 5.0], 0.012);
            out.quad(
                a,
                b,
                c,
                Material::PAVEMENT.toned(0.38 + 0.03 * ((i + j) % 3) as f32),
            );
        }
    }
    for (x, y) in [
        ([2.0, 98.0], [2.0, 8.0]),
        ([66.0, 98.0], [66.0, 96.0]),
        ([42.0, 60.0], [66.0, 96.0]),
        ([2.0, 9.0], [8.0, 96.0]),
    ] {
        let place = Placement::new([x[0], y[0], 0.0], 0.0);
        let (low, high) = ([0.0, 0.0, 0.0], [x[1] - x[0], y[1] - y[0], 0.09]);
        out.cuboid(&place, low, high, Faces::Standing, Material::GRASS);
    }
    // What stands around the park hides the horizon.
    let middle = 0.5 * PARK_M;
    for k in 0..4 {
        let yaw = k as f32 * FRAC_PI_2;
        let side = Placement::new([middle, middle, 0.0], yaw);
        for i in 0..8 {
            let x = 20.0 * i as f32 - 80.0;
            let height = 6.0
                + 9.0
                    * crate::noise::unit(crate::noise::hash(site.seed ^ (8 * k + i) as u64)) as f32;
            let corner = side.point([x, 72.0, 0.0]);
            let end = side.point([x + 20.0, 72.0, 0.0]);
            let along = std::array::from_fn(|n| end[n] - corner[n]);
            let material = if i % 3 == 0 {
                Material::CLADDING
            } else {
                Material::FOLIAGE
            };
            site.out().quad(corner, along, [0.0, 0.0, height], material);
        }
        let corner = side.point([-SKY_M, SKY_M, -20.0]);
        let end = side.point([SKY_M, SKY_M, -20.0]);
        let along = std::array::from_fn(|n| end[n] - corner[n]);
        site.out()
            .quad(corner, along, [0.0, 0.0, SKY_M], Material::SKY);
    }
    let corner = [middle - SKY_M, middle - SKY_M, 220.0];
    site.out().quad(
        corner,
        [0.0, 2.0 * SKY_M, 0.0],
        [2.0 * SKY_M, 0.0, 0.0],
        Material::SKY,
    );
}

/// Trees, benches, lamps, cars, people.
fn furnish(site: &mut Site) {
    let spots = [
        [46.0, 68.0],
        [52.0, 76.0],
        [57.0, 88.0],
        [70.0, 70.0],
        [82.0, 74.0],
        [92.0, 84.0],
        [74.0, 90.0],
        [5.0, 14.0],
        [5.0, 40.0],
        [6.0, 58.0],
        [5.0, 82.0],
        [20.0, 5.0],
        [45.0, 5.0],
        [70.0, 5.0],
        [92.0, 5.0],
        [40.0, 38.0],
        [64.0, 60.0],
    ];
    for (k, at) in spots.into_iter().enumerate() {
        tree(site, at, k as u64);
    }
    for k in 0..6 {
        let place = Placement::new(
            [41.0 + 3.6 * k as f32, 43.0 + 18.0 * (k % 2) as f32, 0.0],
            0.0,
        );
        let wood = Material::WOOD.toned(0.4);
        let out = site.out();
        out.cuboid(
            &place,
            [0.0, -0.2, 0.4],
            [1.8, 0.25, 0.46],
            Faces::All,
            wood,
        );
        out.cuboid(&place, [0.0, 0.2, 0.5], [1.8, 0.25, 0.85], Faces::All, wood);
        for x in [0.1, 1.6] {
            let dark = Material::METAL.toned(0.2);
            out.cuboid(
                &place,
                [x, -0.18, 0.0],
                [x + 0.08, 0.22, 0.4],
                Faces::Standing,
                dark,
            );
        }
        let post = [40.0 + 4.2 * k as f32, 41.0, 0.0];
        out.prism(post, 0.08, 0.05, 4.5, 8, Material::METAL.toned(0.3));
        out.prism([post[0], post[1], 4.5], 0.3, 0.2, 0.25, 8, Material::LAMP);
        if site.plan.night {
            // To either side of the post, in whose shadow the ground would lie otherwise.
            site.plan.lamps.extend([-0.35, 0.35].map(|aside| Lamp {
                position: [post[0], post[1] + aside, 4.45],
                power: POST_POWER,
            }));
        }
    }
    // A round basin in the plaza, a sign, cars along the road.
    let out = site.out();
    out.prism([50.0, 52.0, 0.0], 2.4, 2.4, 0.5, 20, Material::STONE);
    out.prism(
        [50.0, 52.0, 0.5],
        0.5,
        0.3,
        1.7,
        12,
        Material::STONE.toned(0.4),
    );
    for k in 0..6 {
        car(
            site,
            &Placement::new(
                [46.5 + 2.9 * k as f32, 12.0 + 0.3 * (k % 3) as f32, 0.0],
                FRAC_PI_2,
            ),
            k as u64,
        );
    }
    for k in 0..8 {
        let rng = site.built("walker outside", k);
        let area = Area::new([38.5, 61.5], [42.5, 61.5]).shrunk(uniform(&rng, -3.0, 5.0));
        stroll_around(site, area, uniform(&rng, 0.8, 1.5), 17.0 * k as f32);
    }
}

fn tree(site: &mut Site, [x, y]: [f32; 2], number: u64) {
    let rng = site.built("tree", number);
    let height = uniform(&rng, 5.0, 8.5);
    let trunk = 0.38 * height;
    let out = site.out();
    out.prism([x, y, 0.0], 0.22, 0.13, trunk + 1.0, 8, Material::BARK);
    for _ in 0..150 {
        let angle = uniform(&rng, 0.0, std::f32::consts::TAU);
        let up = uniform(&rng, 0.0, 1.0);
        // A crown that is widest a third of the way up.
        let reach =
            0.3 * height * (1.0 - (up - 0.35).abs() * 1.2).max(0.2) * uniform(&rng, 0.4, 1.0);
        let stem = [
            x + reach * angle.cos(),
            y + reach * angle.sin(),
            trunk + (height - trunk) * up,
        ];
        let along = [
            0.9 * angle.cos(),
            0.9 * angle.sin(),
            uniform(&rng, -0.5, 0.6),
        ];
        let leaf = Material::FOLIAGE.toned(uniform(&rng, 0.1, 0.3));
        out.leaf(stem, along, uniform(&rng, 0.7, 1.2), leaf);
    }
}

fn car(site: &mut Site, place: &Placement, number: u64) {
    // Next month other cars stand here.
    let rng = site.moved("car", number);
    let paint = Material::BLANK.toned(uniform(&rng, 0.1, 0.8));
    let dark = Material::METAL.toned(0.08);
    let out = site.out();
    out.cuboid(
        place,
        [-2.1, -0.85, 0.25],
        [2.1, 0.85, 0.85],
        Faces::All,
        paint,
    );
    out.cuboid(
        place,
        [-1.2, -0.75, 0.85],
        [1.1, 0.75, 1.4],
        Faces::Standing,
        dark,
    );
    out.cuboid(
        place,
        [-1.15, -0.7, 1.4],
        [1.05, 0.7, 1.44],
        Faces::All,
        paint,
    );
    for (x, y) in [(-1.3, -0.87), (1.3, -0.87), (-1.3, 0.87), (1.3, 0.87)] {
        let (low, high) = ([x - 0.3, y - 0.02, 0.0], [x + 0.3, y + 0.02, 0.6]);
        out.cuboid(place, low, high, Faces::All, dark);
    }
    let plate = Material::PAPER.marked(Marks::Text(0.07));
    let (low, high) = ([2.1, -0.26, 0.45], [2.115, 0.26, 0.56]);
    out.cuboid(place, low, high, Faces::All, plate);
}

fn roof(site: &mut Site, area: Area, height: f32) {
    let [w, d] = area.size();
    let corner = [area.x[0], area.y[0], height];
    site.out()
        .quad(corner, [w, 0.0, 0.0], [0.0, d, 0.0], Material::CONCRETE);
}

/// Rows of windows, all alike, a door in the middle.
fn facade(site: &mut Site, wall: &Wall, height: f32, number: u64) {
    let storeys = (height / 3.8) as usize;
    for storey in 0..storeys {
        let z = 3.8 * storey as f32 + 1.0;
        let mut x = 1.2;
        while x + 2.0 < wall.length_m {
            let entrance = storey == 0 && (x - 0.5 * wall.length_m).abs() < 2.2;
            if !entrance {
                // The same few views behind all windows of a storey.
                site.window(
                    &wall.place,
                    [x, x + 1.5],
                    [z, z + 1.8],
                    number << 8 | storey as u64,
                );
            }
            x += 2.6;
        }
        let ledge = Material::CONCRETE.toned(0.65);
        let (low, high) = ([0.0, -0.12, z + 2.3], [wall.length_m, 0.0, z + 2.5]);
        site.out().cuboid(&wall.place, low, high, Faces::All, ledge);
    }
    let rng = site.built("entrance", number);
    let middle = 0.5 * wall.length_m;
    door(site.out(), &rng, &wall.place, middle - 1.0);
    door(site.out(), &rng, &wall.place, middle + 0.1);
    let sign = Material::SIGN.toned(uniform(&rng, 0.1, 0.8));
    let (low, high) = ([middle - 1.6, -0.06, 2.3], [middle + 1.6, 0.0, 2.9]);
    site.out().cuboid(&wall.place, low, high, Faces::All, sign);
}

/// Four small rooms along a passage, with a door at either end.
fn house(site: &mut Site, area: Area, number: u64) {
    let ([x0, x1], [y0, y1]) = (area.x, area.y);
    let [_, cy] = area.centre();
    let (low, high) = (cy - 0.9, cy + 0.9);
    let way = Area::new([x0 + WALL_M, x1 - WALL_M], [low, high]);
    for x in [[x0, x0 + WALL_M], [x1 - WALL_M, x1]] {
        site.pass(Area::new(x, [cy - 0.6, cy + 0.6]), 2.2);
    }
    let rooms = 3;
    let pitch = (x1 - x0 - WALL_M) / rooms as f32;
    let cells = |k: usize| {
        let x = x0 + WALL_M + pitch * k as f32;
        [x, x + pitch - WALL_M]
    };
    for k in 0..rooms {
        let [a, b] = cells(k);
        let middle = 0.5 * (a + b);
        let door = [middle - 0.55, middle + 0.55];
        site.pass(Area::new(door, [low - WALL_M, low]), 2.1);
        site.pass(Area::new(door, [high, high + WALL_M]), 2.1);
    }
    let cladding = Cladding {
        floor: Material::PARQUET,
        wall: Material::PLASTER,
        ceiling: Material::CEILING,
    };
    let walls = site.hall(way, 2.6, &cladding);
    for (k, wall) in walls.iter().enumerate() {
        site.dress(wall, Dress::Gallery, 1000 + 32 * number + k as u64);
    }
    site.lamps(way, 2.6, 3.0, 0.7);
    for k in 0..rooms {
        for (side, y) in [[y0 + WALL_M, low - WALL_M], [high + WALL_M, y1 - WALL_M]]
            .into_iter()
            .enumerate()
        {
            let room = Area::new(cells(k), y);
            let key = 1100 + 64 * number + 4 * (2 * k + side) as u64;
            let walls = site.hall(room, 2.6, &cladding);
            for (n, wall) in walls.iter().enumerate() {
                site.dress(wall, Dress::Office, 4 * key + n as u64);
            }
            site.lamps(room, 2.6, 3.0, 1.0);
            let rng = site.moved("house room", key);
            let [cx, cy] = room.centre();
            let across = if side == 0 { -0.9 } else { 0.9 };
            let place = Placement::new([cx, cy + across, 0.0], 0.0);
            crate::world::furniture::table(site.out(), &rng, &place, [1.6, 0.8, 0.74]);
        }
    }
    let material = [Material::BRICK, Material::PLASTER, Material::CLADDING][number as usize % 3];
    let walls = site.outsides(area, HOUSE_M, material);
    roof(site, area, HOUSE_M);
    for (k, wall) in walls.iter().enumerate() {
        let mut x = 1.2;
        while x + 2.0 < wall.length_m {
            if wall.free(x - 0.2, x + 1.7) {
                site.window(
                    &wall.place,
                    [x, x + 1.5],
                    [0.95, 2.2],
                    2000 + 8 * number + k as u64,
                );
            }
            x += 2.9;
        }
    }
}
