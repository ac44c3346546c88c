//! The inner loops of casting: eight rays against a box, and against a facet.

use wide::f32x8;

use super::bounds::Bounds;
use super::facet::Facet;
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
pub(super) struct Prepared<'a, const SHARED: bool> {
    direction: &'a [f32x8; 3],
    inverse: [f32x8; 3],
    eye: [f32; 3],
    origin: [f32x8; 3],
    senses: [Sense; 3],
}

impl<'a, const SHARED: bool> Prepared<'a, SHARED> {
    /// `SHARED` must be true only for packets with a shared origin.
    pub(super) fn new(rays: &'a RayPacket) -> Self {
        let tiny = f32x8::splat(1e-12);
        let zero = f32x8::splat(0.0);
        let inverse = rays
            .direction
            .map(|d| f32x8::splat(1.0) / d.abs().simd_lt(tiny).bitselect(tiny, d));
        let (eye, origin) = match rays.origin {
            Origin::Shared(eye) => (eye, eye.map(f32x8::splat)),
            Origin::Each(origin) => ([0.0; 3], origin),
        };
        Self {
            direction: &rays.direction,
            inverse,
            eye,
            origin,
            senses: inverse.map(|v| match v.simd_lt(zero).to_bitmask() {
                0 => Sense::Forward,
                0xff => Sense::Backward,
                _ => Sense::Mixed,
            }),
        }
    }

    /// Smallest distance at which a ray enters the box; `None` if no ray does before its best hit.
    #[inline(always)]
    pub(super) fn enter(&self, bounds: &Bounds, best: f32x8) -> Option<f32> {
        let mut enter = f32x8::splat(0.0);
        let mut leave = best;
        for axis in 0..3 {
            let (low, high) = if SHARED {
                let eye = self.eye[axis];
                (
                    f32x8::splat(bounds.min[axis] - eye),
                    f32x8::splat(bounds.max[axis] - eye),
                )
            } else {
                (
                    f32x8::splat(bounds.min[axis]) - self.origin[axis],
                    f32x8::splat(bounds.max[axis]) - self.origin[axis],
                )
            };
            let (a, b) = (low * self.inverse[axis], high * self.inverse[axis]);
            let (near, far) = match self.senses[axis] {
                Sense::Forward => (a, b),
                Sense::Backward => (b, a),
                Sense::Mixed => (a.fast_min(b), a.fast_max(b)),
            };
            enter = enter.fast_max(near);
            leave = leave.fast_min(far);
        }
        let inside = enter.simd_le(leave);
        if inside.to_bitmask() == 0 {
            return None;
        }
        Some(smallest(
            inside.bitselect(enter, f32x8::splat(f32::INFINITY)),
        ))
    }

    /// Lanes that hit the facet from its front before `best`, which becomes the distance of the hit.
    #[inline(always)]
    pub(super) fn meet(&self, facet: &Facet, best: &mut f32x8) -> u32 {
        let zero = f32x8::splat(0.0);
        // How far the plane is above the origin: negative in front of it.
        let height = if SHARED {
            let height = facet.offset - dot(facet.normal, self.eye);
            if height >= 0.0 {
                return 0;
            }
            f32x8::splat(height)
        } else {
            f32x8::splat(facet.offset) - dot8(&facet.normal, &self.origin)
        };
        let slope = dot8(&facet.normal, self.direction);
        let distance = height / slope;
        let closer = slope.simd_lt(zero) & height.simd_lt(zero) & distance.simd_lt(*best);
        if closer.to_bitmask() == 0 {
            return 0;
        }
        let coordinate = |dual: &[f32; 3], offset: f32| {
            let start = if SHARED {
                f32x8::splat(dot(*dual, self.eye) - offset)
            } else {
                dot8(dual, &self.origin) - f32x8::splat(offset)
            };
            start + distance * dot8(dual, self.direction)
        };
        let a = coordinate(&facet.dual_a, facet.dual_a_offset);
        let b = coordinate(&facet.dual_b, facet.dual_b_offset);
        let inside = closer & covers(facet, a, b);
        *best = inside.bitselect(distance, *best);
        inside.to_bitmask()
    }

    /// Lanes that hit the facet from either side before `best`, which becomes the distance of the hit.
    #[inline(always)]
    pub(super) fn meet_either(&self, facet: &Facet, best: &mut f32x8) -> u32 {
        let height = f32x8::splat(facet.offset) - dot8(&facet.normal, &self.origin);
        let distance = height / dot8(&facet.normal, self.direction);
        let closer = distance.simd_gt(f32x8::splat(0.0)) & distance.simd_lt(*best);
        if closer.to_bitmask() == 0 {
            return 0;
        }
        let coordinate = |dual: &[f32; 3], offset: f32| {
            let start = dot8(dual, &self.origin) - f32x8::splat(offset);
            start + distance * dot8(dual, self.direction)
        };
        let a = coordinate(&facet.dual_a, facet.dual_a_offset);
        let b = coordinate(&facet.dual_b, facet.dual_b_offset);
        let inside = closer & covers(facet, a, b);
        *best = inside.bitselect(distance, *best);
        inside.to_bitmask()
    }
}

/// Lanes whose place on the plane of a facet, in its own coordinates, lies in it.
#[inline(always)]
fn covers(facet: &Facet, a: f32x8, b: f32x8) -> f32x8 {
    let low = f32x8::splat(-EDGE_SLACK);
    let high = f32x8::splat(1.0 + EDGE_SLACK);
    a.fast_min(b).simd_ge(low)
        & a.fast_max(b).simd_le(high)
        & (a + b).simd_le(f32x8::splat(facet.sum_limit))
}

#[inline(always)]
fn dot8(a: &[f32; 3], b: &[f32x8; 3]) -> f32x8 {
    f32x8::splat(a[0]) * b[0] + f32x8::splat(a[1]) * b[1] + f32x8::splat(a[2]) * b[2]
}

#[inline(always)]
fn smallest(v: f32x8) -> f32 {
    v.to_array().into_iter().fold(f32::INFINITY, f32::min)
}

/// The largest lane, 0 if all are negative.
#[inline(always)]
pub(super) fn largest(v: f32x8) -> f32 {
    v.to_array().into_iter().fold(0.0, f32::max)
}
