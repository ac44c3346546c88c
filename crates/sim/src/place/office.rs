//! Offices: the medium one, and the large one that holds hall, atrium, corridors and stairs.

use std::f32::consts::FRAC_PI_2;

use super::dress::Dress;
use super::indoor::{
    CEILING_M, atrium, exhibition, narrow_corridor, stairs, stroll_around, wide_corridor,
};
use super::site::{Area, Cladding, Site, WALL_M};
use crate::noise::uniform;
use crate::world::builder::{Faces, Placement};
use crate::world::furniture::{plant, sofa, table};
use crate::world::material::Material;

/// Where the parts of the large office lie.
pub(super) const EXHIBITION: Area = Area::new([0.0, 20.0], [0.0, 30.0]);
pub(super) const ATRIUM: Area = Area::new([20.3, 80.3], [0.0, 15.0]);
pub(super) const WIDE: Area = Area::new([20.3, 60.3], [15.3, 19.3]);
pub(super) const STAIRS: Area = Area::new([80.6, 90.6], [0.0, 20.0]);
pub(super) const NARROW: Area = Area::new([90.9, 120.9], [13.0, 15.0]);
pub(super) const EAST: Area = Area::new([121.2, 135.0], [0.0, 30.0]);
pub(super) const SOUTH: Area = Area::new([90.9, 120.9], [0.0, 12.7]);
pub(super) const NORTH: Area = Area::new([60.6, 120.9], [20.3, 30.0]);
pub(super) const WEST: Area = Area::new([20.3, 60.3], [19.6, 30.0]);
pub(super) const LOBBY: Area = Area::new([60.6, 80.3], [15.3, 20.0]);

/// An open-plan office 15 × 35: a core of rooms with glass fronts, desks around it.
pub(super) fn medium(site: &mut Site, area: Area) {
    let [w, d] = area.size();
    let cladding = office_cladding();
    let walls = site.hall(area, CEILING_M, &cladding);
    for (k, wall) in walls.iter().enumerate() {
        let dress = if k % 2 == 1 {
            Dress::Windows(2.4)
        } else {
            Dress::Office
        };
        site.dress(wall, dress, 600 + k as u64);
    }
    site.lamps(area, CEILING_M, 2.8, 1.1);
    let ([x0, _], [y0, _]) = (area.x, area.y);
    // The core: three rooms, closed to one side, glass to the other.
    for k in 0..3 {
        let y = y0 + 6.0 + 8.0 * k as f32;
        core_room(site, Area::new([x0 + 5.6, x0 + 9.4], [y, y + 6.0]), 700 + k);
    }
    for k in 0..7 {
        let y = y0 + 4.0 + 4.5 * k as f32;
        for (side, x) in [(0, x0 + 1.9), (1, x0 + w - 1.9)] {
            if y < y0 + d - 3.0 {
                site.desks(
                    &Placement::new([x, y, 0.0], FRAC_PI_2),
                    40 + 2 * k as u64 + side,
                );
            }
        }
    }
    lounge(site, [x0 + 0.5 * w, y0 + 1.1], 20);
    lounge(site, [x0 + 0.5 * w, y0 + d - 0.4], 21);
    stroll_around(
        site,
        Area::new([x0 + 3.8, x0 + w - 4.0], [y0 + 3.0, y0 + d - 3.0]),
        0.9,
        4.0,
    );
    stroll_around(
        site,
        Area::new([x0 + 3.8, x0 + w - 4.0], [y0 + 5.2, y0 + d - 5.6]),
        1.2,
        50.0,
    );
}

fn office_cladding() -> Cladding {
    Cladding {
        floor: Material::CARPET,
        wall: Material::PAINT,
        ceiling: Material::CEILING,
    }
}

/// A room within a room: solid walls, one of glass, a table inside.
fn core_room(site: &mut Site, area: Area, number: u64) {
    let ([x0, x1], [y0, y1]) = (area.x, area.y);
    let [w, d] = area.size();
    let wall = Material::PAINT.toned(0.6);
    let corner = Placement::new([x0, y0, 0.0], 0.0);
    let h = CEILING_M;
    for (low, high) in [
        ([0.0, 0.0, 0.0], [0.1, d, h]),
        ([0.0, 0.0, 0.0], [w, 0.1, h]),
        ([0.0, d - 0.1, 0.0], [w, d, h]),
    ] {
        site.out().cuboid(&corner, low, high, Faces::Standing, wall);
    }
    let mut y = y0 + 0.1;
    while y + 1.0 < y1 {
        let wide = 1.42_f32.min(y1 - 0.1 - y);
        site.pane(&Placement::new([x1, y, 0.0], FRAC_PI_2), wide, [0.0, 2.4]);
        y += 1.45;
    }
    let beam = Placement::new([x1, y0, 0.0], 0.0);
    site.out()
        .cuboid(&beam, [-0.08, 0.0, 2.4], [0.08, d, h], Faces::All, wall);
    let outside = site.outsides(
        Area::new([x0 - 0.001, x1], [y0 - 0.001, y1 + 0.001]),
        0.001,
        wall,
    );
    for (k, wall) in outside.iter().enumerate().filter(|(k, _)| k % 4 != 1) {
        site.dress(wall, Dress::Office, number * 8 + k as u64);
    }
    let rng = site.moved("core", number);
    let [cx, cy] = area.centre();
    table(
        site.out(),
        &rng,
        &Placement::new([cx, cy, 0.0], 1.57),
        [2.4, 1.1, 0.74],
    );
    for k in 0..4 {
        let side = if k % 2 == 0 { -1.0 } else { 1.0 };
        let seat = Placement::new(
            [cx + 0.85 * side, cy + (k / 2) as f32 - 0.5, 0.0],
            -1.57 * side,
        );
        crate::world::furniture::chair(site.out(), &rng, &seat);
    }
    let inner = Placement::new([x0 + 0.1, y0, 0.0], FRAC_PI_2);
    let size = [uniform(&rng, 1.2, 1.8), 1.0];
    crate::world::furniture::picture(site.out(), &rng, &inner, [0.5 * d, 1.5], size);
}

/// Sofa, table, plants.
fn lounge(site: &mut Site, [x, y]: [f32; 2], number: u64) {
    let rng = site.moved("lounge", number);
    let place = Placement::new([x - 1.0, y, 0.0], 0.0);
    sofa(site.out(), &rng, &place, [2.0, 0.8, 0.75], 0.0);
    for side in [-0.6, 2.6] {
        let pot = place.point([side, -0.4, 0.0]);
        plant(site.out(), &rng, pot, uniform(&rng, 1.1, 1.7), 0.4);
    }
}

/// A hall full of desks.
fn open_plan(site: &mut Site, area: Area, number: u64) {
    let walls = site.hall(area, CEILING_M, &office_cladding());
    for (k, wall) in walls.iter().enumerate() {
        let dress = if wall.length_m > 20.0 && k % 2 == 0 {
            Dress::Windows(2.6)
        } else {
            Dress::Office
        };
        site.dress(wall, dress, number * 16 + k as u64);
    }
    site.lamps(area, CEILING_M, 3.2, 1.2);
    let [w, d] = area.size();
    // Desks in bays, all alike; a lane stays free along the middle and the borders.
    let (columns, rows) = (((w - 3.4) / 4.4) as usize, ((d - 2.0) / 4.2) as usize);
    for i in 0..columns {
        for j in 0..rows {
            let x = area.x[0] + 1.7 + (w - 3.4) * (i as f32 + 0.5) / columns as f32;
            let y = area.y[0] + d * (j as f32 + 0.5) / rows as f32;
            let bay = number * 256 + (i * rows + j) as u64;
            site.desks(&Placement::new([x, y, 0.0], FRAC_PI_2), bay);
        }
    }
}

/// A passage through the wall between two areas, `width` wide around `at` along the wall.
fn between(site: &mut Site, x: [f32; 2], y: [f32; 2]) {
    site.pass(Area::new(x, y), 2.3);
}

/// The whole floor, 135 × 30.
pub(super) fn large(site: &mut Site) {
    let wide = 2.0;
    let gap_x = |x: f32| [x, x + WALL_M];
    let span = |middle: f32| [middle - 0.5 * wide, middle + 0.5 * wide];
    // Hall – atrium, hall – wide corridor, hall – west office.
    between(site, gap_x(20.0), span(7.5));
    between(site, gap_x(20.0), span(17.3));
    // Atrium – corridor, atrium – lobby, atrium – stairs.
    between(site, span(40.3), [15.0, 15.3]);
    between(site, span(70.0), [15.0, 15.3]);
    between(site, gap_x(80.3), span(3.0));
    // Corridor – west office, corridor – lobby.
    between(site, span(30.3), [19.3, 19.6]);
    between(site, gap_x(60.3), span(17.3));
    // Lobby – north office.
    between(site, span(66.0), [20.0, 20.3]);
    // Stairs – south office, south – narrow corridor, narrow – east.
    between(site, gap_x(90.6), span(2.0));
    between(site, span(92.5), [12.7, 13.0]);
    between(site, gap_x(120.9), [13.3, 14.7]);
    between(site, gap_x(120.9), span(27.0));

    exhibition(site, EXHIBITION);
    atrium(site, ATRIUM);
    wide_corridor(site, WIDE);
    stairs(site, STAIRS);
    narrow_corridor(site, NARROW);
    for (k, area) in [EAST, SOUTH, NORTH, WEST].into_iter().enumerate() {
        open_plan(site, area, 30 + k as u64);
    }
    let walls = site.hall(LOBBY, CEILING_M, &office_cladding());
    for (k, wall) in walls.iter().enumerate() {
        site.dress(wall, Dress::Gallery, 900 + k as u64);
    }
    site.lamps(LOBBY, CEILING_M, 3.5, 1.4);
    lounge(site, [74.0, 19.9], 22);
}
