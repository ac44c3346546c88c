//! The inner loops of casting: eight rays against a box, and against a facet.

use super::bounds::Bounds;
use super::facet::Facet;
use super::lanes::Eight;
use super::ray::{Origin, RayPacket};
use super::vector::dot;

/// Facets reach this much over their outline, so that no ray slips between neighbours.
const EDGE_SLACK: f32 = 1e-5;

/// Which way the rays run along an axis.
#[derive(Clone, Copy)]
enum Sense {
    Forward,
    Backward,
    Mixed,
}

/// A packet made ready for many tests. With `SHARED`, all rays start at `eye`, and what depends on the origin alone is
/// computed once for the eight.
pub(super) struct Prepared<E: Eight, const SHARED: bool> {
    eight: E,
    direction: [E::Numbers; 3],
    inverse: [E::Numbers; 3],
    eye: [f32; 3],
    origin: [E::Numbers; 3],
    senses: [Sense; 3],
}

impl<E: Eight, const SHARED: bool> Prepared<E, SHARED> {
    /// `SHARED` must be true only for packets with a shared origin.
    #[inline(always)]
    pub(super) fn new(eight: E, rays: &RayPacket) -> Self {
        let (eye, origin) = match rays.origin {
            Origin::Shared(eye) => {
                let [x, y, z] = eye;
                (eye, [eight.splat(x), eight.splat(y), eight.splat(z)])
            }
            Origin::Each([x, y, z]) => ([0.0; 3], [eight.load(x), eight.load(y), eight.load(z)]),
        };
        let [x, y, z] = rays.direction;
        let direction = [eight.load(x), eight.load(y), eight.load(z)];
        let [x, y, z] = direction;
        let inverse = [
            inverse_of(eight, x),
            inverse_of(eight, y),
            inverse_of(eight, z),
        ];
        let [x, y, z] = inverse;
        Self {
            eight,
            direction,
            inverse,
            eye,
            origin,
            senses: [
                Sense::of(eight, x),
                Sense::of(eight, y),
                Sense::of(eight, z),
            ],
        }
    }

    /// Smallest distance at which a ray enters the box; `None` if no ray does before its best hit.
    #[inline(always)]
    pub(super) fn enter(&self, bounds: &Bounds, best: E::Numbers) -> Option<f32> {
        let eight = self.eight;
        let mut enter = eight.splat(0.0);
        let mut leave = best;
        for axis in 0..3 {
            let low = eight.sub(eight.splat(bounds.min[axis]), self.origin[axis]);
            let high = eight.sub(eight.splat(bounds.max[axis]), self.origin[axis]);
            let a = eight.mul(low, self.inverse[axis]);
            let b = eight.mul(high, self.inverse[axis]);
            let (near, far) = match self.senses[axis] {
                Sense::Forward => (a, b),
                Sense::Backward => (b, a),
                Sense::Mixed => (eight.min(a, b), eight.max(a, b)),
            };
            enter = eight.max(enter, near);
            leave = eight.min(leave, far);
        }
        let inside = eight.is_at_most(enter, leave);
        if eight.bits(inside) == 0 {
            return None;
        }
        Some(eight.smallest(eight.select(inside, enter, eight.splat(f32::INFINITY))))
    }

    /// Lanes that hit the facet from its front before `best`, which becomes the distance of the hit; `None` where none does.
    #[inline(always)]
    pub(super) fn meet(&self, facet: &Facet, best: &mut E::Numbers) -> Option<E::Mask> {
        let eight = self.eight;
        let zero = eight.splat(0.0);
        // How far the plane is above the origin: negative in front of it.
        let height = if SHARED {
            let height = facet.offset - dot(facet.normal, self.eye);
            if height >= 0.0 {
                return None;
            }
            eight.splat(height)
        } else {
            eight.sub(
                eight.splat(facet.offset),
                eight.dot(&facet.normal, &self.origin),
            )
        };
        let slope = eight.dot(&facet.normal, &self.direction);
        let distance = eight.div(height, slope);
        let towards = eight.both(eight.is_less(slope, zero), eight.is_less(height, zero));
        let closer = eight.both(towards, eight.is_less(distance, *best));
        self.within(facet, distance, closer, best)
    }

    /// Lanes that hit the facet from either side before `best`, which becomes the distance of the hit; `None` where none does.
    #[inline(always)]
    pub(super) fn meet_either(&self, facet: &Facet, best: &mut E::Numbers) -> Option<E::Mask> {
        let eight = self.eight;
        let height = eight.sub(
            eight.splat(facet.offset),
            eight.dot(&facet.normal, &self.origin),
        );
        let distance = eight.div(height, eight.dot(&facet.normal, &self.direction));
        let closer = eight.both(
            eight.is_less(eight.splat(0.0), distance),
            eight.is_less(distance, *best),
        );
        self.within(facet, distance, closer, best)
    }

    /// Of the lanes that are `closer` on the plane of a facet, those that lie in it.
    #[inline(always)]
    fn within(
        &self,
        facet: &Facet,
        distance: E::Numbers,
        closer: E::Mask,
        best: &mut E::Numbers,
    ) -> Option<E::Mask> {
        let eight = self.eight;
        if eight.bits(closer) == 0 {
            return None;
        }
        let a = self.coordinate(&facet.dual_a, facet.dual_a_offset, distance);
        let b = self.coordinate(&facet.dual_b, facet.dual_b_offset, distance);
        let low = eight.is_at_most(eight.splat(-EDGE_SLACK), eight.min(a, b));
        let high = eight.is_at_most(eight.max(a, b), eight.splat(1.0 + EDGE_SLACK));
        let sum = eight.is_at_most(eight.add(a, b), eight.splat(facet.sum_limit));
        let inside = eight.both(closer, eight.both(eight.both(low, high), sum));
        if eight.bits(inside) == 0 {
            return None;
        }
        *best = eight.select(inside, distance, *best);
        Some(inside)
    }

    /// Along an edge of a facet, where the rays are after a distance.
    #[inline(always)]
    fn coordinate(&self, dual: &[f32; 3], offset: f32, distance: E::Numbers) -> E::Numbers {
        let eight = self.eight;
        let start = if SHARED {
            eight.splat(dot(*dual, self.eye) - offset)
        } else {
            eight.sub(eight.dot(dual, &self.origin), eight.splat(offset))
        };
        eight.add(start, eight.mul(distance, eight.dot(dual, &self.direction)))
    }
}

impl Sense {
    #[inline(always)]
    fn of<E: Eight>(eight: E, inverse: E::Numbers) -> Self {
        match eight.bits(eight.is_less(inverse, eight.splat(0.0))) {
            0 => Self::Forward,
            0xff => Self::Backward,
            _ => Self::Mixed,
        }
    }
}

/// One over a component of the rays' directions, which counts as tiny where it is none.
#[inline(always)]
fn inverse_of<E: Eight>(eight: E, direction: E::Numbers) -> E::Numbers {
    let tiny = eight.splat(1e-12);
    let negative = eight.sub(eight.splat(0.0), direction);
    let is_tiny = eight.is_less(eight.max(direction, negative), tiny);
    eight.div(eight.splat(1.0), eight.select(is_tiny, tiny, direction))
}
