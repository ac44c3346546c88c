//! The parts that places are put together from: halls with passages between them, stairs, façades.

use std::f32::consts::{FRAC_PI_2, PI};

use crate::noise::{Dice, hash, stream};
use crate::world::Blueprint;
use crate::world::builder::{Builder, Faces, Placement};
use crate::world::fittings::walls;
use crate::world::light::Lamp;
use crate::world::material::Material;

/// Luminous intensity, straight down, of a lamp of power 1, cd: with it, a luminaire of 1.2 m has the 4000 lm that are usual above desks.
const CANDELA: f32 = 1150.0;
/// Thickness of walls between halls, metres.
pub(crate) const WALL_M: f32 = 0.3;

/// A place under construction.
pub(crate) struct Site {
    pub plan: Blueprint,
    pub passages: Vec<Passage>,
    /// Across halls, where fire doors come out of the walls.
    pub shutters: Vec<Passage>,
    pub seed: u64,
    /// Changes the draws of what people move about: posters, things on desks.
    pub later: u64,
    /// Of how many lamps one is lit.
    pub one_lit_of: u64,
}

/// A rectangle of the floor plan, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Area {
    pub x: [f32; 2],
    pub y: [f32; 2],
}

/// A way through a wall: the wall's cross-section on the plan, and the height of the opening.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Passage {
    pub area: Area,
    pub z: f32,
    pub height: f32,
}

/// What a hall is clad with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cladding {
    pub floor: Material,
    pub wall: Material,
    pub ceiling: Material,
}

/// A wall to hang things on.
#[derive(Clone, Debug)]
pub(crate) struct Wall {
    pub place: Placement,
    pub length_m: f32,
    /// Stretches taken by passages.
    pub taken: Vec<[f32; 2]>,
}

impl Area {
    pub(crate) const fn new(x: [f32; 2], y: [f32; 2]) -> Self {
        Self { x, y }
    }

    pub(crate) fn size(&self) -> [f32; 2] {
        [self.x[1] - self.x[0], self.y[1] - self.y[0]]
    }

    pub(crate) fn centre(&self) -> [f32; 2] {
        [0.5 * (self.x[0] + self.x[1]), 0.5 * (self.y[0] + self.y[1])]
    }

    /// Smaller by a margin on all sides.
    pub(crate) fn shrunk(&self, by: f32) -> Self {
        Self::new(
            [self.x[0] + by, self.x[1] - by],
            [self.y[0] + by, self.y[1] - by],
        )
    }
}

impl Site {
    pub(crate) fn new(seed: u64, later: u64) -> Self {
        Self {
            plan: Blueprint {
                ambient: crate::world::light::AMBIENT,
                ..Blueprint::default()
            },
            passages: Vec::new(),
            shutters: Vec::new(),
            seed,
            later,
            one_lit_of: 1,
        }
    }

    pub(crate) fn out(&mut self) -> &mut Builder {
        &mut self.plan.builder
    }

    /// Draws for what stays as it was built.
    pub(crate) fn built(&self, purpose: &str, index: u64) -> Dice {
        stream(self.seed, purpose, index)
    }

    /// Draws for what is moved about in months; one thing in two stays.
    pub(crate) fn moved(&self, purpose: &str, index: u64) -> Dice {
        let changed = self.later * (hash(index ^ self.later) % 2);
        stream(self.seed.wrapping_add(changed << 32), purpose, index)
    }

    /// A passage between two halls.
    pub(crate) fn pass(&mut self, area: Area, height: f32) {
        self.passages.push(Passage {
            area,
            z: 0.0,
            height,
        });
    }

    /// Where a fire door can come out of the walls of a hall along x, at a share of its length.
    pub(crate) fn shutter(&mut self, area: Area, share: f32, height: f32) {
        let x = area.x[0] + share * area.size()[0];
        let half = 0.5 * WALL_M;
        self.shutters.push(Passage {
            area: Area::new([x - half, x + half], area.y),
            z: 0.0,
            height,
        });
    }

    /// Floor, ceiling and walls of a hall, its walls open where passages lead; walls in the order far (greatest y),
    /// right (greatest x), near, left.
    pub(crate) fn hall(&mut self, area: Area, height: f32, cladding: &Cladding) -> [Wall; 4] {
        let [w, d] = area.size();
        let ([x, _], [y, _]) = (area.x, area.y);
        let out = &mut self.plan.builder;
        out.quad([x, y, 0.0], [w, 0.0, 0.0], [0.0, d, 0.0], cladding.floor);
        out.quad(
            [x, y, height],
            [0.0, d, 0.0],
            [w, 0.0, 0.0],
            cladding.ceiling,
        );
        self.sides(&walls(area.x, area.y), [w, d, w, d], height, cladding.wall)
    }

    /// The outsides of a building's walls: near (least y), right, far, left.
    pub(crate) fn outsides(&mut self, area: Area, height: f32, material: Material) -> [Wall; 4] {
        let [w, d] = area.size();
        let ([x0, x1], [y0, y1]) = (area.x, area.y);
        let places = [
            Placement::new([x0, y0, 0.0], 0.0),
            Placement::new([x1, y0, 0.0], FRAC_PI_2),
            Placement::new([x1, y1, 0.0], PI),
            Placement::new([x0, y1, 0.0], -FRAC_PI_2),
        ];
        self.sides(&places, [w, d, w, d], height, material)
    }

    fn sides(
        &mut self,
        places: &[Placement; 4],
        lengths: [f32; 4],
        height: f32,
        material: Material,
    ) -> [Wall; 4] {
        std::array::from_fn(|k| {
            let (place, length_m) = (places[k], lengths[k]);
            let mut gaps: Vec<([f32; 2], f32)> = self
                .passages
                .iter()
                .filter_map(|p| Some((p.along(&place, length_m)?, p.z + p.height)))
                .collect();
            gaps.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
            let out = &mut self.plan.builder;
            let mut panel = |[from, to]: [f32; 2], [low, high]: [f32; 2]| {
                if to - from > 1e-3 && high - low > 1e-3 {
                    let corner = place.point([from, 0.0, low]);
                    let end = place.point([to, 0.0, low]);
                    let along = std::array::from_fn(|i| end[i] - corner[i]);
                    out.quad(corner, along, [0.0, 0.0, high - low], material);
                }
            };
            let mut from = 0.0;
            for ([a, b], top) in &gaps {
                panel([from, *a], [0.0, height]);
                panel([*a, *b], [*top, height]);
                from = *b;
            }
            panel([from, length_m], [0.0, height]);
            Wall {
                place,
                length_m,
                taken: gaps
                    .iter()
                    .map(|g| [g.0[0] - 0.15, g.0[1] + 0.15])
                    .collect(),
            }
        })
    }

    /// Floors, jambs and lintels of all passages.
    pub(crate) fn line_passages(&mut self) {
        let jamb = Material::WOOD.toned(0.4);
        for p in self.passages.clone() {
            let ([x0, x1], [y0, y1]) = (p.area.x, p.area.y);
            let ([w, d], top) = (p.area.size(), p.z + p.height);
            let out = &mut self.plan.builder;
            out.quad([x0, y0, p.z], [w, 0.0, 0.0], [0.0, d, 0.0], Material::STONE);
            out.quad([x0, y0, top], [0.0, d, 0.0], [w, 0.0, 0.0], jamb);
            let up = [0.0, 0.0, p.height];
            if w < d {
                out.quad([x1, y0, p.z], [-w, 0.0, 0.0], up, jamb);
                out.quad([x0, y1, p.z], [w, 0.0, 0.0], up, jamb);
            } else {
                out.quad([x0, y0, p.z], [0.0, d, 0.0], up, jamb);
                out.quad([x1, y1, p.z], [0.0, -d, 0.0], up, jamb);
            }
        }
    }

    /// A lamp that hangs from a ceiling, of power 0 where it is not lit.
    fn lamp(&mut self, at: [f32; 3], half: [f32; 3], power: f32) {
        let place = Placement::new([at[0], at[1], 0.0], 0.0);
        let [x, y, z] = half;
        self.plan.builder.cuboid(
            &place,
            [-x, -y, at[2] - z],
            [x, y, at[2]],
            Faces::All,
            Material {
                luminance_cd_m2: CANDELA * power / (4.0 * x * y),
                glow: if power > 0.0 {
                    Material::LAMP.glow
                } else {
                    0.0
                },
                ..Material::LAMP
            },
        );
        if power <= 0.0 {
            return;
        }
        self.plan.lamps.push(Lamp {
            position: [at[0], at[1], at[2] - z - 0.05],
            power,
        });
    }

    /// Lamps over an area, `pitch` metres apart.
    pub(crate) fn lamps(&mut self, area: Area, ceiling: f32, pitch: f32, power: f32) {
        let [w, d] = area.size();
        let (nx, ny) = ((w / pitch).ceil().max(1.0), (d / pitch).ceil().max(1.0));
        let draw =
            hash(self.seed ^ hash(u64::from(area.x[0].to_bits())) ^ u64::from(area.y[0].to_bits()));
        for i in 0..nx as usize {
            for j in 0..ny as usize {
                let number = (i * ny as usize + j) as u64;
                let is_lit = (draw >> 8)
                    .wrapping_add(number)
                    .is_multiple_of(self.one_lit_of);
                let power = if is_lit { power } else { 0.0 };
                let x = area.x[0] + (i as f32 + 0.5) * w / nx;
                let y = area.y[0] + (j as f32 + 0.5) * d / ny;
                self.lamp([x, y, ceiling], [0.6, 0.12, 0.06], power);
            }
        }
    }

    /// A pane of glass that stands on the floor, seen from both sides.
    pub(crate) fn pane(&mut self, place: &Placement, width: f32, [low, high]: [f32; 2]) {
        let corner = place.point([0.0, 0.0, low]);
        let end = place.point([width, 0.0, low]);
        let along: [f32; 3] = std::array::from_fn(|i| end[i] - corner[i]);
        let up = [0.0, 0.0, high - low];
        let out = self.out();
        out.quad(corner, along, up, Material::GLASS);
        out.quad(end, along.map(|v| -v), up, Material::GLASS);
        let frame = Material::METAL.toned(0.35);
        for x in [0.0, width - 0.04] {
            let from = [x, -0.02, low];
            out.cuboid(place, from, [x + 0.04, 0.02, high], Faces::All, frame);
        }
        let from = [0.0, -0.025, high - 0.04];
        out.cuboid(place, from, [width, 0.025, high], Faces::All, frame);
    }
}

impl Passage {
    /// Where on a wall it is, metres from the wall's beginning; `None` on another wall.
    fn along(&self, wall: &Placement, length_m: f32) -> Option<[f32; 2]> {
        let (s, c) = wall.yaw.sin_cos();
        let local = |x: f32, y: f32| {
            let (dx, dy) = (x - wall.origin[0], y - wall.origin[1]);
            [c * dx + s * dy, c * dy - s * dx]
        };
        let (p, q) = (
            local(self.area.x[0], self.area.y[0]),
            local(self.area.x[1], self.area.y[1]),
        );
        let (low, high) = (p[0].min(q[0]), p[0].max(q[0]));
        let (front, back) = (p[1].min(q[1]), p[1].max(q[1]));
        let on = front < 0.02 && back > -0.02 && low > 0.0 && high < length_m;
        (on && high - low > back - front).then_some([low, high])
    }
}
