//! A part of a map.

use lsfb_geometry::Vector3;
use lsfb_perception::statistics::median;
use lsfb_types::{Bounds, OutOfBounds, ProgressFn};

use super::HdMap;
use super::build::MapRows;
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

lsfb_types::bounds! {
    Region {
        min: each(FINITE),
        max: each(FINITE),
    }
    also is_in_order
}

/// Every coordinate that is a number.
const FINITE: Bounds = Bounds::Within(f64::MIN, f64::MAX);

impl Region {
    /// Of a box the wrong way round nothing would be left.
    fn is_in_order(&self, section: &str) -> Result<(), OutOfBounds> {
        if self.contains(&self.min) {
            return Ok(());
        }
        let [x, y, z] = self.max.into();
        let bounds = "the smallest coordinates or more";
        Err(OutOfBounds::new(
            section,
            "max",
            &format!("{x},{y},{z}"),
            &bounds,
        ))
    }

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
        self.subset(|point| region.contains(point), index, progress)
    }

    /// What is left where some quadrants are withheld. Quadrants are those of the plane around the medians of x and y, of which each has
    /// about a quarter of the points: counted from that of large x and y on, against the clock as seen from above. A map of which nothing
    /// is left is an error.
    pub fn without_quadrants(
        &self,
        withheld: &[usize],
        index: &IndexConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let middle = |axis: usize| median(self.positions().map(|p| p[axis]).collect());
        let (Some(x), Some(y)) = (middle(0), middle(1)) else {
            return Err(Error::EmptyRegion);
        };
        let quadrant = |point: &Vector3<f64>| match (point.x >= x, point.y >= y) {
            (true, true) => 0,
            (false, true) => 1,
            (false, false) => 2,
            (true, false) => 3,
        };
        self.subset(
            |point| !withheld.contains(&quadrant(point)),
            index,
            progress,
        )
    }

    fn subset(
        &self,
        keeps: impl Fn(&Vector3<f64>) -> bool,
        index: &IndexConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        let mut rows = self.rows();
        rows.points.retain(|p| keeps(&p.position));
        rows.without_idle_keyframes(index, progress)
    }
}

impl MapRows {
    /// The map of these points and the keyframes that saw one of them. No points are an error.
    pub(super) fn without_idle_keyframes(
        self,
        index: &IndexConfig,
        progress: ProgressFn,
    ) -> Result<HdMap, Error> {
        let mut rows = self;
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
        let mut seeing = number.iter();
        rows.covariances
            .retain(|_| seeing.next().is_some_and(Option::is_some));
        for o in rows.points.iter_mut().flat_map(|p| &mut p.observations) {
            o.keyframe = number[o.keyframe as usize].unwrap_or(0);
        }
        HdMap::from_rows(rows, index, progress)
    }
}
