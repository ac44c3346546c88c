//! Putting facets together: boxes, pictures, round things.

use super::facet::{Facet, Outline};
use super::material::Material;
use super::vector::{add, cross, norm, scale};

/// A surface before it is painted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub facet: Facet,
    pub material: Material,
}

/// Collects surfaces.
#[derive(Clone, Debug, Default)]
pub(crate) struct Builder {
    pub surfaces: Vec<Surface>,
}

/// A place to build on: `origin`, and the direction called "right", in the plane of the floor. Depth goes to the
/// left of "right", away from who looks at the piece of furniture; z is up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    pub origin: [f32; 3],
    pub yaw: f32,
}

impl Placement {
    pub(crate) fn new(origin: [f32; 3], yaw: f32) -> Self {
        Self { origin, yaw }
    }

    /// The world point `right`, `depth`, `up` metres from the origin.
    pub(crate) fn point(&self, [right, depth, up]: [f32; 3]) -> [f32; 3] {
        add(self.origin, self.vector([right, depth, up]))
    }

    fn vector(&self, [right, depth, up]: [f32; 3]) -> [f32; 3] {
        let (s, c) = self.yaw.sin_cos();
        [c * right - s * depth, s * right + c * depth, up]
    }

    /// The same directions about another origin, turned by `yaw`.
    pub(crate) fn moved(&self, by: [f32; 3], yaw: f32) -> Self {
        Self::new(self.point(by), self.yaw + yaw)
    }
}

/// Which faces of a box are seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Faces {
    All,
    /// All but the bottom: what stands on something.
    Standing,
    /// All but the back: what hangs on a wall.
    Hanging,
}

impl Builder {
    /// One parallelogram.
    pub(crate) fn quad(&mut self, corner: [f32; 3], a: [f32; 3], b: [f32; 3], material: Material) {
        self.surfaces.push(Surface {
            facet: Facet::new(corner, a, b, Outline::Parallelogram),
            material,
        });
    }

    /// One triangle.
    pub(crate) fn triangle(
        &mut self,
        corner: [f32; 3],
        a: [f32; 3],
        b: [f32; 3],
        material: Material,
    ) {
        self.surfaces.push(Surface {
            facet: Facet::new(corner, a, b, Outline::Triangle),
            material,
        });
    }

    /// A box from `low` to `high` in the directions of `place`.
    pub(crate) fn cuboid(
        &mut self,
        place: &Placement,
        low: [f32; 3],
        high: [f32; 3],
        faces: Faces,
        material: Material,
    ) {
        self.cuboid_with_front(place, low, high, faces, material, material);
    }

    /// A box whose front (towards the viewer, least depth) is of another material.
    pub(crate) fn cuboid_with_front(
        &mut self,
        place: &Placement,
        low: [f32; 3],
        high: [f32; 3],
        faces: Faces,
        material: Material,
        front: Material,
    ) {
        let [w, d, h] = [high[0] - low[0], high[1] - low[1], high[2] - low[2]];
        let right = place.vector([w, 0.0, 0.0]);
        let back = place.vector([0.0, d, 0.0]);
        let up = [0.0, 0.0, h];
        let at = |r: f32, p: f32, u: f32| place.point([r, p, u]);
        self.quad(at(low[0], low[1], low[2]), right, up, front);
        self.quad(at(high[0], low[1], low[2]), back, up, material);
        self.quad(at(low[0], high[1], low[2]), scale(back, -1.0), up, material);
        self.quad(at(low[0], low[1], high[2]), right, back, material);
        if faces != Faces::Standing {
            self.quad(
                at(low[0], high[1], low[2]),
                right,
                scale(back, -1.0),
                material,
            );
        }
        if faces != Faces::Hanging {
            self.quad(
                at(high[0], high[1], low[2]),
                scale(right, -1.0),
                up,
                material,
            );
        }
    }

    /// An upright prism with `sides` sides, radius `bottom` below and `top` above, closed above.
    pub(crate) fn prism(
        &mut self,
        base: [f32; 3],
        bottom: f32,
        top: f32,
        height: f32,
        sides: usize,
        material: Material,
    ) {
        let ring = |k: usize, r: f32, z: f32| {
            let angle = k as f32 * std::f32::consts::TAU / sides as f32;
            add(base, [r * angle.cos(), r * angle.sin(), z])
        };
        for k in 0..sides {
            let (p, q) = (ring(k, bottom, 0.0), ring(k + 1, bottom, 0.0));
            let (r, s) = (ring(k, top, height), ring(k + 1, top, height));
            let edge = |from: [f32; 3], to: [f32; 3]| std::array::from_fn(|i| to[i] - from[i]);
            // A slanted side is a trapezium: two triangles.
            if bottom == top {
                self.quad(p, edge(p, q), edge(p, r), material);
            } else {
                self.triangle(p, edge(p, q), edge(p, r), material);
                self.triangle(s, edge(s, r), edge(s, q), material);
            }
            let middle = add(base, [0.0, 0.0, height]);
            self.triangle(middle, edge(middle, r), edge(middle, s), material);
        }
    }

    /// A leaf: a triangle seen from both sides.
    pub(crate) fn leaf(&mut self, stem: [f32; 3], along: [f32; 3], width: f32, material: Material) {
        let side = cross(along, [0.3, 0.2, 1.0]);
        let side = scale(side, width / norm(side).max(1e-6));
        self.triangle(
            stem,
            add(along, scale(side, 0.5)),
            add(along, scale(side, -0.5)),
            material,
        );
        self.triangle(
            stem,
            add(along, scale(side, -0.5)),
            add(along, scale(side, 0.5)),
            material,
        );
    }
}
