//! Light that comes straight from the emitters of a place's list and from the sun, smooth wherever nothing is in the way: the closed form for a
//! polygon of even luminance (Lambert, "Photometria", 1760; as in Arvo, "The Irradiance Jacobian for Partially Occluded Polyhedral Sources", 1994)
//! times the share of it that shadow rays find in sight.

use wide::f32x8;

use super::super::facet::{Facet, Outline};
use super::super::ray::{LANES, RayPacket};
use super::super::vector::{add, dot, norm, scale, sub};
use super::emitters::point_on;
use super::scene::{CLEARANCE_M, FAR_M, Lanes, SUN_RADIUS_RAD, Scene};
use super::tracer::{Draws, Frame, Spot};

/// An emitter that brings less than this share of the light is tried by a single ray.
const MINOR: f32 = 0.02;

/// Illuminance of a spot by a facet that shines evenly before itself, nothing being in the way, lux.
pub(super) fn of_polygon(facet: &Facet, luminance_cd_m2: f32, spot: &Spot) -> f32 {
    if facet.height_of(spot.point) <= 0.0 {
        return 0.0;
    }
    let corners: &[[f32; 2]] = match facet.outline() {
        Outline::Parallelogram => &[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        Outline::Triangle => &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
    };
    // What is above the spot's horizon: a corner more than the facet has, at most.
    let mut above = [[0.0_f32; 3]; 5];
    let mut count = 0;
    for (k, &[a, b]) in corners.iter().enumerate() {
        let [c, d] = corners[(k + 1) % corners.len()];
        let (from, to) = (
            sub(facet.point(a, b), spot.point),
            sub(facet.point(c, d), spot.point),
        );
        let heights = [dot(from, spot.normal), dot(to, spot.normal)];
        let mut put = |v: [f32; 3]| {
            if count < above.len() {
                above[count] = v;
                count += 1;
            }
        };
        if heights[0] > 0.0 {
            put(from);
        }
        if (heights[0] > 0.0) != (heights[1] > 0.0) {
            put(add(
                from,
                scale(sub(to, from), heights[0] / (heights[0] - heights[1])),
            ));
        }
    }
    let normal = spot.normal.map(f64::from);
    let mut sum = 0.0;
    for k in 0..count {
        let [p, q] = [above[k], above[(k + 1) % count]].map(|v| v.map(f64::from));
        let cross = [
            p[1] * q[2] - p[2] * q[1],
            p[2] * q[0] - p[0] * q[2],
            p[0] * q[1] - p[1] * q[0],
        ];
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let sine = dot(cross, cross).sqrt();
        if sine > 1e-14 {
            sum += sine.atan2(dot(p, q)) / sine * dot(cross, normal);
        }
    }
    (0.5 * f64::from(luminance_cd_m2) * sum.abs()) as f32
}

impl Scene {
    /// Illuminance of a spot straight from the emitters of its list and from the sun, lux.
    pub(super) fn straight_lx(&self, spot: &Spot, seed: u64) -> f32 {
        let start = add(spot.point, scale(spot.normal, CLEARANCE_M));
        let mut draws = Draws::new(seed);
        let mut sum = self.sunshine_lx(spot, start, &mut draws) + self.points_lx(spot, start);
        let choices = self.emitters.near(start);
        let bring = |facet: u32| {
            let luminance = self.optics(facet).luminance_cd_m2;
            of_polygon(self.facet(facet), luminance, spot)
        };
        let brought: Vec<f32> = choices.iter().map(|c| bring(c.facet)).collect();
        let total: f32 = brought.iter().sum();
        let mut minor = Rays::default();
        for (choice, brought) in choices.iter().zip(brought) {
            let facet = self.facet(choice.facet);
            if brought <= 0.0 {
                continue;
            }
            if brought < MINOR * total {
                let target = point_on(facet, [draws.next(), draws.next()]);
                minor.push(sub(target, start), brought);
                if minor.count == LANES {
                    sum += self.in_sight(&minor, start);
                    minor = Rays::default();
                }
            } else {
                sum += brought * self.share_in_sight(facet, spot, start, &mut draws);
            }
        }
        sum + self.in_sight(&minor, start)
    }

    /// Share of an emitter's light that arrives.
    fn share_in_sight(
        &self,
        facet: &Facet,
        spot: &Spot,
        start: [f32; 3],
        draws: &mut Draws,
    ) -> f32 {
        let (mut seen, mut all) = (0.0, 0.0);
        // Four by two along the longer edge; twice where a border of a shadow is.
        let long_a = norm(facet.edge_a) >= norm(facet.edge_b);
        for _ in 0..2 {
            let mut rays = Rays::default();
            for k in 0..LANES {
                let along = ((k % 4) as f32 + draws.next()) / 4.0;
                let across = ((k / 4) as f32 + draws.next()) / 2.0;
                let place = match long_a {
                    true => [along, across],
                    false => [across, along],
                };
                let to = sub(point_on(facet, place), start);
                let squared = dot(to, to).max(1e-8);
                let here = dot(spot.normal, to).max(0.0);
                let there = -dot(facet.normal, to).max(-FAR_M);
                rays.push(to, here * there.max(0.0) / (squared * squared));
            }
            let weights: f32 = rays.gain.iter().sum();
            let in_sight = self.in_sight(&rays, start);
            (seen, all) = (seen + in_sight, all + weights);
            if in_sight <= 0.0 || in_sight >= 0.999 * weights {
                break;
            }
        }
        if all > 0.0 { seen / all } else { 0.0 }
    }

    fn in_sight(&self, rays: &Rays, start: [f32; 3]) -> f32 {
        if rays.gain == [0.0; LANES] {
            return 0.0;
        }
        let limit = rays.gain.map(|g| if g > 0.0 { 0.999 } else { 0.0 });
        let packet = RayPacket::from_point(start, rays.to.map(f32x8::new));
        let seen = self.visibility(&packet, f32x8::new(limit));
        (0..LANES).map(|lane| rays.gain[lane] * seen[lane]).sum()
    }

    fn points_lx(&self, spot: &Spot, start: [f32; 3]) -> f32 {
        let mut sum = 0.0;
        for group in self.points.chunks(LANES) {
            let mut rays = Rays::default();
            for light in group {
                let (to, lux) = light.arriving(start, spot.normal);
                rays.push(to, lux);
            }
            sum += self.in_sight(&rays, start);
        }
        sum
    }

    fn sunshine_lx(&self, spot: &Spot, start: [f32; 3], draws: &mut Draws) -> f32 {
        let Some(sun) = self.sun else {
            return 0.0;
        };
        let cosine = dot(spot.normal, sun.direction);
        if cosine <= -SUN_RADIUS_RAD {
            return 0.0;
        }
        let frame = Frame::about(sun.direction);
        let turn = draws.next();
        let mut rays = Rays::default();
        for k in 0..LANES {
            let place = [(k as f32 + 0.5) / LANES as f32, turn + 0.381_966 * k as f32];
            let to = frame.in_disc(place);
            rays.push(to, dot(spot.normal, to).max(0.0));
        }
        let packet = RayPacket::from_point(start, rays.to.map(f32x8::new));
        let limit = rays.gain.map(|g| if g > 0.0 { FAR_M } else { 0.0 });
        let seen = self.visibility_of_sky(&packet, f32x8::new(limit));
        let lit: f32 = (0..LANES).map(|lane| rays.gain[lane] * seen[lane]).sum();
        sun.illuminance_lx * lit / LANES as f32
    }
}

/// Up to eight directions from one point with what is gained along each.
#[derive(Default)]
struct Rays {
    to: [Lanes; 3],
    gain: Lanes,
    count: usize,
}

impl Rays {
    fn push(&mut self, to: [f32; 3], gain: f32) {
        for (lanes, component) in self.to.iter_mut().zip(to) {
            lanes[self.count] = component;
        }
        self.gain[self.count] = gain;
        self.count += 1;
    }
}
