//! What hangs on walls and stands in rooms of large buildings.

use super::site::{Site, Wall};
use crate::noise::{Dice, below, stream, uniform};
use crate::world::builder::{Faces, Placement};
use crate::world::fittings::skirting;
use crate::world::furniture::{cabinet, chair, door, notice_board, picture, shelf, table};
use crate::world::material::Material;

/// What is on a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Dress {
    /// Nothing but doors, all alike, this far apart.
    Doors(f32),
    /// Doors, all alike, this far apart, posters and boards between them.
    Corridor(f32),
    /// Shelves, cabinets, boards, pictures.
    Office,
    /// Large pictures and signs.
    Gallery,
    /// Windows, all alike, this far apart.
    Windows(f32),
}

impl Site {
    /// Dresses a wall; `number` tells walls apart.
    pub(crate) fn dress(&mut self, wall: &Wall, dress: Dress, number: u64) {
        skirting_around(self, wall);
        match dress {
            Dress::Doors(pitch) => self.doors(wall, pitch),
            Dress::Corridor(pitch) => {
                self.doors(wall, pitch);
                self.between_doors(wall, pitch, number);
            }
            Dress::Office => self.office_wall(wall, number),
            Dress::Gallery => self.gallery_wall(wall, number),
            Dress::Windows(pitch) => self.windows(wall, pitch, number),
        }
    }

    fn doors(&mut self, wall: &Wall, pitch: f32) {
        let mut x = 0.5 * pitch;
        while x + 1.2 < wall.length_m {
            if wall.free(x - 0.1, x + 1.1) {
                // Every door from the same draws: identical doors are what confuses a localizer.
                let alike = stream(self.seed, "door", 0);
                door(self.out(), &alike, &wall.place, x);
            }
            x += pitch;
        }
    }

    fn between_doors(&mut self, wall: &Wall, pitch: f32, number: u64) {
        let mut x = 0.0;
        let mut k = 0;
        while x < wall.length_m {
            let (from, to) = if k == 0 {
                (0.2, 0.5 * pitch - 0.2)
            } else {
                (x + 1.2, (x + pitch - 0.2).min(wall.length_m - 0.1))
            };
            let rng = self.moved("between doors", number << 16 | k);
            if to - from > 0.8 && wall.free(from, to) {
                let middle = 0.5 * (from + to);
                let wide = (to - from - 0.3).min(1.6);
                match below(&rng, 5) {
                    0 => notice_board(self.out(), &rng, &wall.place, [middle, 1.5], [wide, 0.95]),
                    1 => self.extinguisher(wall, middle),
                    2 | 3 => {
                        let w = uniform(&rng, 0.45, 0.8).min(wide);
                        let up = uniform(&rng, 1.5, 1.7);
                        picture(self.out(), &rng, &wall.place, [middle, up], [w, 1.3 * w]);
                    }
                    _ => {}
                }
            }
            x = if k == 0 { 0.5 * pitch } else { x + pitch };
            k += 1;
        }
    }

    fn extinguisher(&mut self, wall: &Wall, x: f32) {
        let base = wall.place.point([x, -0.11, 0.5]);
        let red = Material::PACKAGE.toned(0.25);
        self.out().prism(base, 0.08, 0.08, 0.5, 10, red);
        let sign = Material::SIGN.toned(0.3);
        let (low, high) = ([x - 0.12, -0.01, 1.7], [x + 0.12, 0.0, 1.94]);
        self.out()
            .cuboid(&wall.place, low, high, Faces::Hanging, sign);
    }

    fn office_wall(&mut self, wall: &Wall, number: u64) {
        let mut x = 0.3;
        let mut k = 0;
        while x + 1.0 < wall.length_m {
            let rng = self.moved("office wall", number << 16 | k);
            k += 1;
            let w = uniform(&rng, 0.9, 1.9).min(wall.length_m - x - 0.2);
            if wall.free(x, x + w) {
                let place = wall.place.moved([x, 0.0, 0.0], 0.0);
                let out = self.out();
                match below(&rng, 6) {
                    0 => shelf(out, &rng, &place, [w, 0.32, uniform(&rng, 1.4, 2.1)]),
                    1 => {
                        cabinet(out, &rng, &place, [w, 0.42, uniform(&rng, 0.8, 1.2)]);
                        picture(out, &rng, &place, [0.5 * w, 1.85], [0.7 * w, 0.5]);
                    }
                    2 => notice_board(out, &rng, &place, [0.5 * w, 1.5], [w - 0.2, 1.0]),
                    3 => {
                        let white = Material::BLANK.toned(0.85);
                        let (low, high) = ([0.1, -0.03, 0.9], [w - 0.1, 0.0, 2.0]);
                        out.cuboid(&place, low, high, Faces::Hanging, white);
                        let notes = Material::PAPER.toned(0.8);
                        let (low, high) = ([0.25, -0.032, 1.2], [0.6 * w, -0.03, 1.8]);
                        out.cuboid(&place, low, high, Faces::Hanging, notes);
                    }
                    4 => {
                        let size = [0.6 * w, uniform(&rng, 0.5, 0.9)];
                        picture(out, &rng, &place, [0.5 * w, 1.55], size);
                    }
                    _ => {}
                }
            }
            x += w + uniform(&rng, 0.2, 0.9);
        }
    }

    fn gallery_wall(&mut self, wall: &Wall, number: u64) {
        let mut x = 0.5;
        let mut k = 0;
        while x + 1.2 < wall.length_m {
            let rng = self.moved("gallery wall", number << 16 | k);
            k += 1;
            let w = uniform(&rng, 1.0, 2.4).min(wall.length_m - x - 0.3);
            if wall.free(x, x + w) {
                let h = uniform(&rng, 0.9, 1.7);
                let middle = [x + 0.5 * w, uniform(&rng, 1.5, 1.8)];
                picture(self.out(), &rng, &wall.place, middle, [w, h]);
                if below(&rng, 3) == 0 {
                    let sign = Material::SIGN.toned(uniform(&rng, 0.1, 0.8));
                    let (low, high) = ([x, -0.03, 2.75], [x + w, 0.0, 3.05]);
                    self.out()
                        .cuboid(&wall.place, low, high, Faces::Hanging, sign);
                }
            }
            x += w + uniform(&rng, 0.3, 1.2);
        }
    }

    fn windows(&mut self, wall: &Wall, pitch: f32, number: u64) {
        let mut x = 0.4;
        let mut k = 0;
        while x + pitch < wall.length_m + 0.3 {
            let w = pitch - 0.7;
            if wall.free(x, x + w) {
                self.window(&wall.place, [x, x + w], [0.95, 2.3], number << 16 | k);
                self.plan.lamps.push(crate::world::light::Lamp {
                    position: wall.place.point([x + 0.5 * w, -0.3, 1.8]),
                    power: 0.5,
                });
            }
            k += 1;
            x += pitch;
        }
    }

    /// A window with its frame, bright from the light outside.
    pub(crate) fn window(
        &mut self,
        wall: &Placement,
        [l, r]: [f32; 2],
        [z0, z1]: [f32; 2],
        number: u64,
    ) {
        let rng = self.built("window", number);
        let out = self.out();
        let view = Material::VIEW.toned(uniform(&rng, 0.45, 0.7));
        out.cuboid(wall, [l, -0.01, z0], [r, 0.0, z1], Faces::Hanging, view);
        let bar = Material::METAL.toned(0.6);
        let t = 0.05;
        for x in [l, 0.5 * (l + r - t), r - t] {
            out.cuboid(wall, [x, -0.05, z0], [x + t, 0.0, z1], Faces::Hanging, bar);
        }
        for z in [z0, z1 - t] {
            out.cuboid(wall, [l, -0.05, z], [r, 0.0, z + t], Faces::All, bar);
        }
    }

    /// Four desks back to back with a screen between them, chairs at each; the place is the middle.
    pub(crate) fn desks(&mut self, centre: &Placement, number: u64) {
        let rng = self.moved("desks", number);
        let fixed = self.built("desks", number);
        let screen = Material::FABRIC.toned(uniform(&fixed, 0.25, 0.55));
        let (low, high) = ([-1.65, -0.02, 0.4], [1.65, 0.02, 1.25]);
        self.out().cuboid(centre, low, high, Faces::All, screen);
        for side in [-1.0_f32, 1.0] {
            for along in [-0.82, 0.82] {
                let yaw = if side > 0.0 {
                    0.0
                } else {
                    std::f32::consts::PI
                };
                let desk = centre.moved([along, -0.42 * side, 0.0], yaw);
                table(self.out(), &rng, &desk, [1.55, 0.75, 0.73]);
                self.monitor(&rng, &desk);
                let seat = desk.moved(
                    [uniform(&rng, -0.25, 0.25), -uniform(&rng, 0.55, 0.8), 0.0],
                    uniform(&rng, 2.3, 4.0),
                );
                chair(self.out(), &rng, &seat);
            }
        }
    }

    fn monitor(&mut self, rng: &Dice, desk: &Placement) {
        let place = desk.moved(
            [uniform(rng, -0.2, 0.3), 0.2, 0.73],
            uniform(rng, -0.2, 0.2),
        );
        let dark = Material::METAL.toned(0.12);
        let show = Material::SCREEN.toned(uniform(rng, 0.2, 0.6));
        let out = self.out();
        out.cuboid_with_front(
            &place,
            [-0.29, 0.0, 0.12],
            [0.29, 0.03, 0.47],
            Faces::All,
            dark,
            show,
        );
        out.cuboid(
            &place,
            [-0.03, 0.0, 0.0],
            [0.03, 0.03, 0.12],
            Faces::All,
            dark,
        );
    }
}

impl Wall {
    /// Whether nothing has taken this stretch.
    pub(crate) fn free(&self, from: f32, to: f32) -> bool {
        from >= 0.0 && to <= self.length_m && self.taken.iter().all(|[a, b]| to <= *a || from >= *b)
    }
}

fn skirting_around(site: &mut Site, wall: &Wall) {
    let mut from = 0.0;
    for [a, b] in &wall.taken {
        if *a > from {
            skirting(
                site.out(),
                &wall.place.moved([from, 0.0, 0.0], 0.0),
                a - from,
            );
        }
        from = *b;
    }
    if wall.length_m > from {
        let rest = wall.length_m - from;
        skirting(site.out(), &wall.place.moved([from, 0.0, 0.0], 0.0), rest);
    }
}
