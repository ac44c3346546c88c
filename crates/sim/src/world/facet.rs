use super::vector::{cross, dot, scale, sub};

/// Where a facet ends within its plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outline {
    /// The whole parallelogram `0 ≤ a, b ≤ 1`.
    Parallelogram,
    /// The half with `a + b ≤ 1`.
    Triangle,
}

/// A flat piece of surface, visible from the side its normal points to.
///
/// A point on it is `corner + a · edge_a + b · edge_b`; `(a, b)` are also its texture coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    /// The point with `a = b = 0`, metres.
    pub corner: [f32; 3],
    /// From the corner to `a = 1`, metres.
    pub edge_a: [f32; 3],
    /// From the corner to `b = 1`, metres.
    pub edge_b: [f32; 3],
    /// `edge_a × edge_b`, normalised.
    pub normal: [f32; 3],
    /// `dot(normal, p)` of the points of the plane.
    pub(crate) offset: f32,
    /// `a = dot(dual_a, p) − dual_a_offset`.
    pub(crate) dual_a: [f32; 3],
    pub(crate) dual_a_offset: f32,
    pub(crate) dual_b: [f32; 3],
    pub(crate) dual_b_offset: f32,
    /// Largest `a + b`.
    pub(crate) sum_limit: f32,
}

impl Facet {
    /// The facet spanned by two edges that are not parallel.
    pub fn new(corner: [f32; 3], edge_a: [f32; 3], edge_b: [f32; 3], outline: Outline) -> Self {
        let area = cross(edge_a, edge_b);
        let squared = dot(area, area);
        let normal = scale(area, squared.sqrt().recip());
        // Dual basis within the plane: dual_a · edge_a = 1, dual_a · edge_b = 0.
        let dual_a = scale(cross(edge_b, area), squared.recip());
        let dual_b = scale(cross(area, edge_a), squared.recip());
        Self {
            corner,
            edge_a,
            edge_b,
            normal,
            offset: dot(normal, corner),
            dual_a,
            dual_a_offset: dot(dual_a, corner),
            dual_b,
            dual_b_offset: dot(dual_b, corner),
            sum_limit: match outline {
                Outline::Parallelogram => 3.0,
                Outline::Triangle => 1.0 + 1e-5,
            },
        }
    }

    /// Whether the facet is the triangle `a + b ≤ 1`.
    pub fn outline(&self) -> Outline {
        if self.sum_limit > 2.0 {
            Outline::Parallelogram
        } else {
            Outline::Triangle
        }
    }

    /// The point at `(a, b)`.
    pub fn point(&self, a: f32, b: f32) -> [f32; 3] {
        std::array::from_fn(|i| self.corner[i] + a * self.edge_a[i] + b * self.edge_b[i])
    }

    /// `(a, b)` of a point of the plane.
    pub fn coordinates(&self, point: [f32; 3]) -> [f32; 2] {
        [
            dot(self.dual_a, point) - self.dual_a_offset,
            dot(self.dual_b, point) - self.dual_b_offset,
        ]
    }

    /// Distance of a point from the plane, positive on the visible side, metres.
    pub fn height_of(&self, point: [f32; 3]) -> f32 {
        dot(self.normal, sub(point, self.corner))
    }

    /// Its vertices, counter-clockwise from the visible side.
    pub fn vertices(&self) -> Vec<[f32; 3]> {
        match self.outline() {
            Outline::Parallelogram => vec![
                self.point(0.0, 0.0),
                self.point(1.0, 0.0),
                self.point(1.0, 1.0),
                self.point(0.0, 1.0),
            ],
            Outline::Triangle => vec![
                self.point(0.0, 0.0),
                self.point(1.0, 0.0),
                self.point(0.0, 1.0),
            ],
        }
    }
}
