//! Surfaces that shine, and which of them are worth a shadow ray from where.

use rayon::prelude::*;

use super::super::facet::{Facet, Outline};
use super::super::vector::{add, cross, dot, norm, scale, sub};
use super::optics::Optics;

/// Larger surfaces are found well enough by rays in random directions, m².
const LARGEST_M2: f32 = 6.0;
/// Smaller ones shine too little, m².
const SMALLEST_M2: f32 = 0.01;
/// Under a sky, what is darker than this share of it does no harm when it is found by chance.
const FAINT: f32 = 0.2;
/// Emitters tried from one cell at most.
const MOST: usize = 128;
/// Share of the light in a cell that those beyond the list may have by the estimate.
const REMAINDER: f32 = 0.001;
/// Edges of cells, metres, smallest first: the first that needs no more than [`MOST_CELLS`] is taken.
const CELL_EDGES_M: [f32; 4] = [1.5, 2.5, 4.0, 8.0];
const MOST_CELLS: usize = 30_000;

/// Lists of emitters by place.
#[derive(Clone, Debug, Default)]
pub(super) struct Emitters {
    low: [f32; 3],
    edge_m: f32,
    counts: [usize; 3],
    cells: Vec<Vec<Choice>>,
}

/// One emitter of a list.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    /// Number of the facet.
    pub facet: u32,
    /// Chance of being drawn.
    pub chance: f32,
    /// Sum of the chances up to this one.
    pub sum: f32,
}

impl Emitters {
    pub(super) fn new(facets: &[Facet], optics: &[Optics], void_cd_m2: f32) -> Self {
        let shining: Vec<Shining> = facets
            .iter()
            .zip(optics)
            .enumerate()
            .filter(|(_, (facet, optics))| is_compact(facet, optics, void_cd_m2))
            .map(|(k, (facet, optics))| Shining::new(k as u32, facet, optics))
            .filter(|s| s.area_m2 >= SMALLEST_M2)
            .collect();
        if shining.is_empty() {
            return Self::default();
        }
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        let near = facets.iter().zip(optics).filter(|(_, o)| !o.backdrop);
        for v in near.flat_map(|(facet, _)| facet.vertices()) {
            for i in 0..3 {
                low[i] = low[i].min(v[i]);
                high[i] = high[i].max(v[i]);
            }
        }
        let counts = |edge_m: f32| -> [usize; 3] {
            std::array::from_fn(|i| (((high[i] - low[i]) / edge_m) as usize).min(1 << 20) + 1)
        };
        let fits = |edge_m: &&f32| {
            let product = counts(**edge_m).into_iter().map(|c| c as f64);
            product.product::<f64>() <= MOST_CELLS as f64
        };
        let largest = (0..3).map(|i| high[i] - low[i]).fold(1.0, f32::max);
        let edge_m = *CELL_EDGES_M.iter().find(fits).unwrap_or(&(largest / 30.0));
        let counts = counts(edge_m);
        let cells = (0..counts.iter().product::<usize>()).into_par_iter();
        let cells = cells.map(|k| {
            let at = [
                k % counts[0],
                k / counts[0] % counts[1],
                k / (counts[0] * counts[1]),
            ];
            let middle = std::array::from_fn(|i| low[i] + (at[i] as f32 + 0.5) * edge_m);
            list(&shining, middle, edge_m)
        });
        Self {
            low,
            edge_m,
            counts,
            cells: cells.collect(),
        }
    }

    /// The emitters worth trying from a point; empty where none is.
    pub(super) fn near(&self, point: [f32; 3]) -> &[Choice] {
        let mut index = 0;
        for i in (0..3).rev() {
            // A cast from float to integer saturates.
            let k = ((point[i] - self.low[i]) / self.edge_m) as usize;
            index = index * self.counts[i] + k.min(self.counts[i].saturating_sub(1));
        }
        self.cells.get(index).map_or(&[], Vec::as_slice)
    }
}

/// Whether a surface shines so brightly, and is so small, that rays in random directions would find it too rarely.
pub(super) fn is_compact(facet: &Facet, optics: &Optics, void_cd_m2: f32) -> bool {
    let bright = optics.luminance_cd_m2 > FAINT * void_cd_m2;
    bright && !optics.backdrop && area_m2(facet) <= LARGEST_M2
}

/// The one that a number in [0, 1) draws.
pub(super) fn draw(choices: &[Choice], u: f32) -> Option<&Choice> {
    let k = choices.partition_point(|c| c.sum <= u);
    choices.get(k).or(choices.last())
}

/// A point spread evenly over a facet by two numbers in [0, 1).
pub(super) fn point_on(facet: &Facet, [u, v]: [f32; 2]) -> [f32; 3] {
    match facet.outline() {
        Outline::Triangle if u + v > 1.0 => facet.point(1.0 - u, 1.0 - v),
        _ => facet.point(u, v),
    }
}

/// Area, m².
pub(super) fn area_m2(facet: &Facet) -> f32 {
    let whole = norm(cross(facet.edge_a, facet.edge_b));
    match facet.outline() {
        Outline::Parallelogram => whole,
        Outline::Triangle => 0.5 * whole,
    }
}

struct Shining {
    facet: u32,
    middle: [f32; 3],
    normal: [f32; 3],
    area_m2: f32,
    luminance_cd_m2: f32,
}

impl Shining {
    fn new(number: u32, facet: &Facet, optics: &Optics) -> Self {
        let share = match facet.outline() {
            Outline::Parallelogram => 0.5,
            Outline::Triangle => 1.0 / 3.0,
        };
        Self {
            facet: number,
            middle: add(facet.corner, scale(add(facet.edge_a, facet.edge_b), share)),
            normal: facet.normal,
            area_m2: area_m2(facet),
            luminance_cd_m2: optics.luminance_cd_m2,
        }
    }

    /// About the illuminance that it brings into a cell, nothing being in the way; 0 behind it.
    fn estimate(&self, middle: [f32; 3], edge_m: f32) -> f32 {
        let reach = 0.87 * edge_m;
        let to = sub(middle, self.middle);
        let distance = norm(to).max(0.5 * reach);
        let front = dot(self.normal, to) + reach;
        if front <= 0.0 {
            return 0.0;
        }
        let cosine = (front / (distance + reach)).min(1.0);
        self.luminance_cd_m2 * self.area_m2 * cosine / (distance * distance + self.area_m2)
    }
}

/// The strongest emitters in a cell with the chances by which they are drawn.
fn list(shining: &[Shining], middle: [f32; 3], edge_m: f32) -> Vec<Choice> {
    let mut weighed: Vec<(f32, u32)> = shining
        .iter()
        .map(|s| (s.estimate(middle, edge_m), s.facet))
        .filter(|(weight, _)| *weight > 0.0)
        .collect();
    weighed.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let total: f32 = weighed.iter().map(|w| w.0).sum();
    let mut kept = 0.0;
    let mut count = 0;
    while count < weighed.len().min(MOST) && kept < (1.0 - REMAINDER) * total {
        kept += weighed[count].0;
        count += 1;
    }
    weighed.truncate(count);
    let mut sum = 0.0;
    weighed
        .into_iter()
        .map(|(weight, facet)| {
            let chance = weight / kept;
            sum += chance;
            Choice { facet, chance, sum }
        })
        .collect()
}
