//! People who walk about: bodies in a few attitudes of the gait, carried along closed lines at a steady speed.

use wide::f32x8;

use super::builder::{Builder, Surface};
use super::bvh::Bvh;
use super::facet::Facet;
use super::material::Material;
use super::ray::{LANES, NO_FACET, Origin, PacketHit, RayPacket};
use super::vector::{add, norm, scale, sub};
use crate::noise::{Dice, stream, uniform};

/// Attitudes of a walking body.
const ATTITUDES: usize = 6;
/// Differently dressed people.
const OUTFITS: usize = 5;
/// Length of two steps, metres.
const STRIDE_M: f64 = 1.35;
/// Time of two steps of somebody who steps aside, seconds.
const STRIDE_S: f64 = 1.2;
/// Half the height of a body, and the radius of a sphere about its middle that holds it, metres.
const MIDDLE_M: f32 = 0.9;
const REACH_M: f32 = 1.05;
/// Half the width of a body, and how far from its feet the floor is darker for it, metres.
const HALF_WIDTH_M: f32 = 0.2;
const SHADE_M: f32 = 1.6;
/// Nobody comes nearer to who walks than this, metres.
const CLEARANCE_M: f32 = 0.9;
/// People at most, so that who carries a facet fits a byte.
pub(crate) const MOST_PEOPLE: usize = 200;

/// Somebody's way.
#[derive(Clone, Debug)]
pub(crate) struct Stroll {
    /// Corners of a closed line on the floor, metres.
    pub corners: Vec<[f32; 3]>,
    pub speed_m_s: f32,
    /// Where on the line they are at the beginning, metres.
    pub start_m: f32,
}

/// All people of a place.
#[derive(Clone, Debug, Default)]
pub(crate) struct Crowd {
    bodies: Vec<Body>,
    strolls: Vec<Stroll>,
}

/// One outfit in one attitude, feet at the origin, facing x.
#[derive(Clone, Debug)]
struct Body {
    facets: Vec<Facet>,
    bvh: Bvh,
    /// Number of its first facet among all facets of the world.
    first: usize,
}

/// Somebody who stands in somebody's way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Passer {
    pub feet: [f32; 3],
    /// Unit vector that they face.
    pub heading: [f32; 2],
}

/// Where everybody is at one time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Moment {
    pub time_s: f64,
    people: Vec<Stand>,
}

#[derive(Clone, Copy, Debug)]
struct Stand {
    body: usize,
    feet: [f32; 3],
    sin: f32,
    cos: f32,
}

impl Crowd {
    /// The bodies, their facets numbered from `first` on; returns what they are made of, in the order of the numbers.
    pub(crate) fn new(mut strolls: Vec<Stroll>, seed: u64, first: usize) -> (Self, Vec<Surface>) {
        strolls.truncate(MOST_PEOPLE);
        let mut bodies = Vec::new();
        let mut surfaces = Vec::new();
        if strolls.is_empty() {
            return (Self::default(), surfaces);
        }
        for outfit in 0..OUTFITS {
            for attitude in 0..ATTITUDES {
                let rng = stream(seed, "outfit", outfit as u64);
                let mut out = Builder::default();
                let swing = (std::f32::consts::TAU * attitude as f32 / ATTITUDES as f32).sin();
                person(&mut out, &rng, swing);
                let unsorted: Vec<Facet> = out.surfaces.iter().map(|s| s.facet).collect();
                let (bvh, order) = Bvh::build(&unsorted);
                bodies.push(Body {
                    facets: order.iter().map(|&i| unsorted[i]).collect(),
                    bvh,
                    first: first + surfaces.len(),
                });
                surfaces.extend(order.iter().map(|&i| out.surfaces[i]));
            }
        }
        (Self { bodies, strolls }, surfaces)
    }

    /// Where everybody is, out of the way of somebody at `walker`.
    pub(crate) fn at(&self, time_s: f64, walker: [f32; 2]) -> Moment {
        let people = self.strolls.iter().enumerate().map(|(k, stroll)| {
            let travelled = f64::from(stroll.start_m) + f64::from(stroll.speed_m_s) * time_s;
            let attitude = (travelled / STRIDE_M * ATTITUDES as f64) as usize % ATTITUDES;
            let (mut feet, [dx, dy]) = stroll.at(travelled);
            step_aside(&mut feet, walker);
            let length = dx.hypot(dy).max(1e-6);
            Stand {
                body: (k % OUTFITS) * ATTITUDES + attitude,
                feet,
                sin: dy / length,
                cos: dx / length,
            }
        });
        Moment {
            time_s,
            people: people.collect(),
        }
    }

    /// Somebody more, as if they had walked there; nobody where there are no people at all.
    pub(crate) fn join(&self, moment: &mut Moment, passer: &Passer) {
        if self.bodies.is_empty() || moment.people.len() > MOST_PEOPLE {
            return;
        }
        let attitude = (moment.time_s / STRIDE_S * ATTITUDES as f64) as usize % ATTITUDES;
        let [cos, sin] = passer.heading;
        moment.people.push(Stand {
            body: (moment.people.len() % OUTFITS) * ATTITUDES + attitude,
            feet: passer.feet,
            sin,
            cos,
        });
    }

    /// Replaces hits of the building by those of people in front of it.
    pub(crate) fn cast(&self, moment: &Moment, rays: &RayPacket, hit: &mut PacketHit) {
        for (carrier, stand) in moment.people.iter().enumerate() {
            let middle = add(stand.feet, [0.0, 0.0, MIDDLE_M]);
            if !passes(rays, middle, hit.distance) {
                continue;
            }
            let body = &self.bodies[stand.body];
            let local = stand.localize(rays);
            let met = body.bvh.cast(&body.facets, &local, hit.distance);
            for lane in 0..LANES {
                if met.facet[lane] != NO_FACET {
                    hit.facet[lane] = met.facet[lane] + body.first as u32;
                    hit.carrier[lane] = carrier as u8 + 1;
                }
            }
            hit.distance = met.distance;
        }
    }

    /// The facet with a number that [`Crowd::cast`] gave, in the frame of its carrier.
    pub(crate) fn facet(&self, moment: &Moment, carrier: u8, facet: usize) -> Option<&Facet> {
        let stand = moment.people.get(usize::from(carrier).checked_sub(1)?)?;
        let body = &self.bodies[stand.body];
        body.facets.get(facet.checked_sub(body.first)?)
    }
}

impl Moment {
    /// A point of the world, or a direction, in the frame of a carrier.
    pub(crate) fn to_carrier(&self, carrier: u8, point: [f32; 3], ray: [f32; 3]) -> [[f32; 3]; 2] {
        let Some(stand) = usize::from(carrier)
            .checked_sub(1)
            .and_then(|k| self.people.get(k))
        else {
            return [point, ray];
        };
        [stand.turn(sub(point, stand.feet)), stand.turn(ray)]
    }

    /// Whether anybody is there.
    pub(crate) fn has_people(&self) -> bool {
        !self.people.is_empty()
    }

    /// How much of the light from everywhere above a point of a floor people around it leave: each is an upright strip that faces it.
    pub(crate) fn open_share(&self, point: [f32; 3]) -> f32 {
        let mut share = 1.0;
        for stand in &self.people {
            let [dx, dy, dz] = sub(point, stand.feet);
            let squared = dx * dx + dy * dy;
            if squared < SHADE_M * SHADE_M && dz.abs() < 0.3 {
                // Its azimuth's share, times the cosine-weighted share of the height up to the head.
                let aside = (HALF_WIDTH_M / squared.sqrt().max(0.02)).atan();
                let up = 4.0 * MIDDLE_M * MIDDLE_M / (4.0 * MIDDLE_M * MIDDLE_M + squared);
                // Fades out, so that no border is seen.
                let fade = 1.0 - squared / (SHADE_M * SHADE_M);
                share *= 1.0 - aside / std::f32::consts::PI * up * fade;
            }
        }
        share
    }

    /// A direction in the frame of a carrier, in the world.
    pub(crate) fn in_world(&self, carrier: u8, direction: [f32; 3]) -> [f32; 3] {
        let stand = usize::from(carrier).checked_sub(1);
        let stand = stand.and_then(|k| self.people.get(k));
        stand.map_or(direction, |stand| stand.turn_back(direction))
    }
}

impl Stand {
    fn turn_back(&self, v: [f32; 3]) -> [f32; 3] {
        let (s, c) = (self.sin, self.cos);
        [c * v[0] - s * v[1], c * v[1] + s * v[0], v[2]]
    }

    fn turn(&self, v: [f32; 3]) -> [f32; 3] {
        let (s, c) = (self.sin, self.cos);
        [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]]
    }

    fn localize(&self, rays: &RayPacket) -> RayPacket {
        let (s, c) = (f32x8::splat(self.sin), f32x8::splat(self.cos));
        let turn = |v: &[f32x8; 3]| [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]];
        RayPacket {
            origin: match rays.origin {
                Origin::Shared(eye) => Origin::Shared(self.turn(sub(eye, self.feet))),
                Origin::Each(origin) => Origin::Each(turn(&std::array::from_fn(|i| {
                    origin[i] - f32x8::splat(self.feet[i])
                }))),
            },
            direction: turn(&rays.direction),
        }
    }
}

impl Stroll {
    /// The point at a distance along the closed line, and the direction there.
    fn at(&self, travelled_m: f64) -> ([f32; 3], [f32; 2]) {
        let n = self.corners.len();
        if n == 0 {
            return ([0.0; 3], [1.0, 0.0]);
        }
        let side = |k: usize| sub(self.corners[(k + 1) % n], self.corners[k]);
        let length: f32 = (0..n).map(|k| norm(side(k))).sum();
        let mut left = travelled_m.rem_euclid(f64::from(length.max(1e-3))) as f32;
        for k in 0..n {
            let way = side(k);
            let long = norm(way);
            if left <= long || k + 1 == n {
                let point = add(self.corners[k], scale(way, left / long.max(1e-6)));
                return (point, [way[0], way[1]]);
            }
            left -= long;
        }
        (self.corners[0], [1.0, 0.0])
    }
}

/// Moves somebody away from who walks there, the more the nearer they are.
fn step_aside(feet: &mut [f32; 3], walker: [f32; 2]) {
    let away = [feet[0] - walker[0], feet[1] - walker[1]];
    let distance = away[0].hypot(away[1]).max(1e-3);
    let push = (CLEARANCE_M * CLEARANCE_M + distance * distance).sqrt() - distance;
    for (place, away) in feet.iter_mut().zip(away) {
        *place += away / distance * push;
    }
}

/// Whether any ray comes near a body before what it has hit already.
fn passes(rays: &RayPacket, middle: [f32; 3], limit: f32x8) -> bool {
    let to: [f32x8; 3] = match &rays.origin {
        Origin::Shared(eye) => sub(middle, *eye).map(f32x8::splat),
        Origin::Each(origin) => std::array::from_fn(|i| f32x8::splat(middle[i]) - origin[i]),
    };
    let d = &rays.direction;
    let along = to[0] * d[0] + to[1] * d[1] + to[2] * d[2];
    let squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    let off = to[0] * to[0] + to[1] * to[1] + to[2] * to[2] - along * along / squared;
    let reach = f32x8::splat(REACH_M);
    let near = off.simd_lt(reach * reach) & (along / squared - reach).simd_lt(limit);
    (near & along.simd_gt(f32x8::splat(-REACH_M))).to_bitmask() != 0
}

/// A body facing x, its legs apart by `swing` in ±1.
fn person(out: &mut Builder, rng: &Dice, swing: f32) {
    let coat = Material::CLOTH.toned(uniform(rng, 0.12, 0.7));
    let trousers = Material::CLOTH.toned(uniform(rng, 0.08, 0.4));
    let skin = Material::SKIN.toned(uniform(rng, 0.25, 0.6));
    let hair = Material::CLOTH.toned(uniform(rng, 0.06, 0.35));
    let tall = uniform(rng, 0.94, 1.06);
    for side in [-1.0_f32, 1.0] {
        let step = 0.32 * swing * side;
        let y = 0.1 * side;
        // The knee of the leg behind is bent.
        let knee = 0.5 * step + 0.05 + 0.08 * (-step).max(0.0);
        let leg = [
            ([step, y, 0.07], [0.05, 0.045]),
            ([0.6 * step + 0.4 * knee - 0.02, y, 0.3], [0.062, 0.055]),
            ([knee, y, 0.48], [0.062, 0.06]),
            ([0.4 * knee, y, 0.72], [0.085, 0.08]),
            ([0.0, 0.9 * y, 0.92], [0.1, 0.095]),
        ];
        loft(out, tall, &leg, trousers);
        let shoe = [
            ([step + 0.05, y, 0.0], [0.14, 0.05]),
            ([step + 0.04, y, 0.05], [0.13, 0.05]),
            ([step, y, 0.1], [0.06, 0.05]),
        ];
        loft(out, 1.0, &shoe, hair);
        let hand = -0.9 * step;
        let arm = [
            ([hand, 0.27 * side, 0.8], [0.034, 0.032]),
            ([0.4 * hand - 0.05, 0.27 * side, 1.1], [0.046, 0.044]),
            ([0.0, 0.22 * side, 1.4], [0.062, 0.055]),
            ([0.0, 0.19 * side, 1.45], [0.04, 0.04]),
        ];
        loft(out, tall, &arm, coat);
        let fingers = [
            ([hand + 0.03, 0.26 * side, 0.64], [0.02, 0.012]),
            ([hand + 0.01, 0.27 * side, 0.72], [0.042, 0.02]),
            ([hand, 0.27 * side, 0.8], [0.026, 0.022]),
        ];
        loft(out, tall, &fingers, skin);
    }
    let trunk = [
        ([0.0, 0.0, 0.84], [0.12, 0.17]),
        ([0.0, 0.0, 0.98], [0.115, 0.165]),
        ([0.0, 0.0, 1.14], [0.105, 0.15]),
        ([0.01, 0.0, 1.32], [0.125, 0.19]),
        ([0.0, 0.0, 1.42], [0.105, 0.2]),
        ([0.0, 0.0, 1.49], [0.06, 0.09]),
    ];
    loft(out, tall, &trunk, coat);
    let head = [
        ([0.0, 0.0, 1.44], [0.055, 0.055]),
        ([0.0, 0.0, 1.53], [0.055, 0.052]),
        ([0.03, 0.0, 1.55], [0.075, 0.055]),
        ([0.02, 0.0, 1.6], [0.095, 0.07]),
        ([0.01, 0.0, 1.67], [0.1, 0.077]),
        ([0.0, 0.0, 1.74], [0.08, 0.065]),
    ];
    loft(out, tall, &head, skin);
    let crown = [
        ([-0.04, 0.0, 1.57], [0.065, 0.072]),
        ([-0.025, 0.0, 1.66], [0.09, 0.084]),
        ([-0.012, 0.0, 1.69], [0.105, 0.085]),
        ([-0.01, 0.0, 1.74], [0.092, 0.074]),
        ([-0.01, 0.0, 1.78], [0.045, 0.04]),
    ];
    loft(out, tall, &crown, hair);
}

/// Sides of what is round.
const SIDES: usize = 8;

/// A closed body through level ellipses, the lowest first: their middles and half axes along x and y, metres; heights times `tall`.
fn loft(out: &mut Builder, tall: f32, rings: &[([f32; 3], [f32; 2])], material: Material) {
    let point = |ring: usize, k: usize| {
        let ([x, y, z], [a, b]) = rings[ring];
        let (sin, cos) = (k as f32 * std::f32::consts::TAU / SIDES as f32).sin_cos();
        [x + a * cos, y + b * sin, z * tall]
    };
    let middle = |ring: usize| {
        let [x, y, z] = rings[ring].0;
        [x, y, z * tall]
    };
    let last = rings.len() - 1;
    let mut triangle = |p: [f32; 3], q: [f32; 3], r: [f32; 3]| {
        out.triangle(p, sub(q, p), sub(r, p), material);
    };
    for k in 0..SIDES {
        for ring in 0..last {
            let (p, q) = (point(ring, k), point(ring, k + 1));
            let (r, s) = (point(ring + 1, k), point(ring + 1, k + 1));
            triangle(p, q, r);
            triangle(s, r, q);
        }
        triangle(middle(last), point(last, k), point(last, k + 1));
        triangle(middle(0), point(0, k + 1), point(0, k));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_are_closed_from_all_sides_and_move_with_their_line() {
        let stroll = Stroll {
            corners: vec![[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]],
            speed_m_s: 1.0,
            start_m: 1.0,
        };
        let (crowd, surfaces) = Crowd::new(vec![stroll], 3, 10);
        assert!(surfaces.len() > 100);
        for (time_s, x) in [(0.0, 1.0), (1.0, 2.0), (4.0, 3.0)] {
            let moment = crowd.at(time_s, [0.0, 1e4]);
            for k in 0..16 {
                let (s, c) = (k as f32 * std::f32::consts::FRAC_PI_8).sin_cos();
                let origin = [x + 3.0 * c, 3.0 * s, 1.2];
                let rays = RayPacket::splat(origin, [-c, -s, 0.0]);
                let mut hit = PacketHit::nothing(f32x8::splat(50.0));
                crowd.cast(&moment, &rays, &mut hit);
                let distance = hit.distance.to_array()[0];
                assert!((2.6..2.95).contains(&distance), "{time_s} {k}: {distance}");
                assert_eq!(hit.carrier[0], 1);
                let facet = crowd
                    .facet(&moment, 1, hit.facet[0] as usize)
                    .expect("numbered");
                let point = std::array::from_fn(|i| origin[i] - distance * [c, s, 0.0][i]);
                let [local, ray] = moment.to_carrier(1, point, [-c, -s, 0.0]);
                assert!(facet.height_of(local).abs() < 1e-4);
                assert!(facet.normal[0] * ray[0] + facet.normal[1] * ray[1] < 0.0);
            }
        }
    }
}
