//! A part of a map.

use lsfb_geometry::Vector3;
use lsfb_types::ProgressFn;

use super::HdMap;
use crate::Error;
use crate::descriptor_index::IndexConfig;

/// A box along the axes of the world, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Its smallest coordinates.
    pub min: Vector3<f64>,
    /// Its largest coordinates.
    pub max: Vector3<f64>,
}

impl Region {
    /// Whether a point lies in it or on its border.
    pub fn contains(&self, point: &Vector3<f64>) -> bool {
        (0..3).all(|axis| (self.min[axis]..=self.max[axis]).contains(&point[axis]))
    }
}

impl HdMap {
    /// The smallest region that holds all points; `None` of a map without any.
    pub fn region(&self) -> Option<Region> {
        let first = self.position(0)?;
        let all = Region {
            min: first,
            max: first,
        };
        Some(self.positions().fold(all, |r, p| Region {
            min: r.min.inf(&p),
            max: r.max.sup(&p),
        }))
    }

    /// The points in `region` with all that saw them, under an index of their own. Keyframes that saw none are left out.
    /// A region without points is an error.
    pub fn crop(
        &self,
        region: &Region,
        index: &IndexConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let mut rows = self.rows();
        rows.points.retain(|p| region.contains(&p.position));
        if rows.points.is_empty() {
            return Err(Error::EmptyRegion);
        }
        let mut number = vec![None; rows.keyframes.len()];
        for o in rows.points.iter().flat_map(|p| &p.observations) {
            number[o.keyframe as usize] = Some(0);
        }
        let kept = number.iter_mut().flatten().zip(0..);
        kept.for_each(|(number, next)| *number = next);
        let mut seeing = number.iter();
        rows.keyframes
            .retain(|_| seeing.next().is_some_and(Option::is_some));
        for o in rows.points.iter_mut().flat_map(|p| &mut p.observations) {
            o.keyframe = number[o.keyframe as usize].unwrap_or(0);
        }
        Self::from_rows(rows, index, progress)
    }
}
