//! Boxes around facets.

use super::facet::Facet;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub min: [f32; 3],
    pub max: [f32; 3],
}

impl Bounds {
    pub(super) const EMPTY: Self = Self {
        min: [f32::INFINITY; 3],
        max: [f32::NEG_INFINITY; 3],
    };

    pub(super) fn include(&mut self, other: &Self) {
        for i in 0..3 {
            self.min[i] = self.min[i].min(other.min[i]);
            self.max[i] = self.max[i].max(other.max[i]);
        }
    }

    pub(super) fn half_area(&self) -> f32 {
        let d: [f32; 3] = std::array::from_fn(|i| (self.max[i] - self.min[i]).max(0.0));
        d[0] * d[1] + d[1] * d[2] + d[2] * d[0]
    }

    pub(super) fn of(facet: &Facet) -> Self {
        let mut bounds = Self::EMPTY;
        for v in facet.vertices() {
            bounds.include(&Self { min: v, max: v });
        }
        for i in 0..3 {
            bounds.min[i] -= 1e-4;
            bounds.max[i] += 1e-4;
        }
        bounds
    }
}
