//! A map that is to fit into so many bytes: descriptors that say the least go first, then points that its views miss the least.
//!
//! A view (an image of a keyframe) is found by its points, and found well by points all over it. So each view is cut into cells, and
//! the n-th point of a cell is worth 1/n to it; a point is worth that over all views that saw it, per byte that it takes. What is worth
//! most is kept first. The worth of a point falls only as others are kept, so that the choice, one after the other, is never far from the
//! best one there is (Nemhauser, Wolsey, Fisher 1978).

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use lsfb_types::{Bounds, ProgressFn};
use serde::{Deserialize, Serialize};

use super::build::{MapRows, PointRow};
use super::{HdMap, MapObservation};
use crate::descriptor_index::IndexConfig;
use crate::features::DESCRIPTOR_LEN;
use crate::{Error, Refusal};

/// Bytes of a point in `points.arrow`, of an observation, and of a descriptor with its entry in the index but for its code (`FORMAT.md`).
const POINT_BYTES: usize = 76;
const OBSERVATION_BYTES: usize = 18;
const DESCRIPTOR_BYTES: usize = 4 + DESCRIPTOR_LEN + 8;
/// Of a keyframe, with its covariance, and of an inverted list.
const KEYFRAME_BYTES: usize = 8 * 29;
const LIST_BYTES: usize = 4 * DESCRIPTOR_LEN + 4;
/// The index's words, heads and feet of the files, the rig and the header, rounded up.
const FIXED_BYTES: usize = 4 * 256 * DESCRIPTOR_LEN + 60_000;

/// Configuration of [`HdMap::prune`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PruneConfig {
    /// Descriptors that each point keeps at least where it has so many: fewer are left only where even this many of all points are too large.
    pub descriptors_per_point: usize,
    /// Cells along each side of a view.
    pub cells_per_side: u32,
    /// Points that each view keeps, or all of its own where it has fewer; otherwise the size is refused.
    pub fewest_points_per_view: usize,
    /// The index of the result.
    pub index: IndexConfig,
}

impl Default for PruneConfig {
    fn default() -> Self {
        Self {
            descriptors_per_point: 2,
            cells_per_side: 4,
            fewest_points_per_view: 30,
            index: IndexConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    PruneConfig {
        descriptors_per_point: number(Bounds::AT_LEAST_ONE),
        cells_per_side: number(Bounds::Within(1.0, 64.0)),
        fewest_points_per_view: number(Bounds::AT_LEAST_ONE),
        index: section,
    }
}

/// What pruning left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PruneReport {
    /// Points before and after.
    pub points: [usize; 2],
    /// Descriptors before and after.
    pub descriptors: [usize; 2],
    /// Most descriptors that a point has now.
    pub most_descriptors_per_point: usize,
    /// Points that a view has in the middle (median), before and after.
    pub median_points_per_view: [usize; 2],
    /// Points of the view that has fewest, before and after.
    pub fewest_points_per_view: [usize; 2],
}

/// Keyframe and camera.
type View = (u32, u16);

impl HdMap {
    /// A map whose folder takes `size_bytes` at most; the whole map where it does anyway. A size that would leave a view with too few points to
    /// be found by is refused, and the error says what size would not.
    pub fn prune(
        &self,
        size_bytes: usize,
        config: &PruneConfig,
        progress: ProgressFn,
    ) -> Result<(Self, PruneReport), Error> {
        config.check_bounds("prune")?;
        let mut rows = self.rows();
        let before = points_per_view(&rows.points);
        let counts = |rows: &MapRows| {
            let descriptors: usize = rows.points.iter().map(|p| p.descriptors.len()).sum();
            (rows.points.len(), descriptors)
        };
        let (points, descriptors) = counts(&rows);
        let sizes = Sizes {
            index: &config.index,
            keyframes: rows.keyframes.len(),
        };
        let most = most_descriptors(&rows.points);
        let fewest = config.descriptors_per_point.min(most).max(1);
        // As many descriptors each as all points may have.
        let limit = (fewest..=most).rev();
        let limit = limit
            .into_iter()
            .find(|limit| sizes.of(&rows.points, *limit) <= size_bytes);
        for row in &mut rows.points {
            row.descriptors.truncate(limit.unwrap_or(fewest));
        }
        if limit.is_none() {
            let order = self.by_worth(&rows.points, config, &sizes);
            let kept = enough(&rows, &order, size_bytes, config, &sizes, &before)?;
            let mut is_kept = vec![false; rows.points.len()];
            kept.iter().for_each(|point| is_kept[*point] = true);
            let mut is_kept = is_kept.into_iter();
            rows.points.retain(|_| is_kept.next().unwrap_or(false));
        }
        let after = points_per_view(&rows.points);
        let (points_left, descriptors_left) = counts(&rows);
        let report = PruneReport {
            points: [points, points_left],
            descriptors: [descriptors, descriptors_left],
            most_descriptors_per_point: most_descriptors(&rows.points),
            median_points_per_view: [middle(&before), middle(&after)],
            fewest_points_per_view: [&before, &after]
                .map(|views| views.values().copied().min().unwrap_or(0)),
        };
        let map = rows.without_idle_keyframes(&config.index, progress)?;
        Ok((map, report))
    }

    /// The points in the order in which they are kept.
    fn by_worth(&self, points: &[PointRow], config: &PruneConfig, sizes: &Sizes) -> Vec<usize> {
        let mut taken: BTreeMap<(View, u32), u32> = BTreeMap::new();
        let cells: Vec<Vec<(View, u32)>> = points
            .iter()
            .map(|p| {
                let cell = |o: &MapObservation| (view(o), self.cell(o, config.cells_per_side));
                p.observations.iter().map(cell).collect()
            })
            .collect();
        let worth = |point: usize, taken: &BTreeMap<(View, u32), u32>| {
            let of_cell =
                |cell: &(View, u32)| 1.0 / f64::from(1 + taken.get(cell).copied().unwrap_or(0));
            let sum: f64 = cells[point].iter().map(of_cell).sum();
            // Bits of positive numbers are in the order of the numbers.
            (sum / sizes.of_point(&points[point], usize::MAX) as f64).to_bits()
        };
        let mut waiting: BinaryHeap<(u64, Reverse<usize>)> = (0..points.len())
            .map(|point| (worth(point, &taken), Reverse(point)))
            .collect();
        let mut order = Vec::with_capacity(points.len());
        while let Some((was, Reverse(point))) = waiting.pop() {
            let now = worth(point, &taken);
            if now < was {
                waiting.push((now, Reverse(point)));
                continue;
            }
            for cell in &cells[point] {
                *taken.entry(*cell).or_default() += 1;
            }
            order.push(point);
        }
        order
    }

    /// The cell of its view in which a point was seen.
    fn cell(&self, seen: &MapObservation, per_side: u32) -> u32 {
        let camera = self.cameras.get(usize::from(seen.camera));
        let camera = camera.and_then(|name| self.rig.cameras.get(name));
        let [width, height] = camera.map_or([1, 1], |c| [c.camera.width, c.camera.height]);
        let along = |pixel: f32, size: u32| {
            let share = (f64::from(pixel) + 0.5) / f64::from(size.max(1));
            ((share * f64::from(per_side)).max(0.0) as u32).min(per_side - 1)
        };
        along(seen.pixel[1], height) * per_side + along(seen.pixel[0], width)
    }
}

/// What a map takes on disk.
struct Sizes<'a> {
    index: &'a IndexConfig,
    keyframes: usize,
}

impl Sizes<'_> {
    /// With at most so many descriptors of each point.
    fn of(&self, points: &[PointRow], limit: usize) -> usize {
        let descriptors = points.iter().map(|p| p.descriptors.len().min(limit)).sum();
        let of_points: usize = points.iter().map(|p| self.of_point(p, limit)).sum();
        of_points + self.beside(descriptors)
    }

    fn of_point(&self, point: &PointRow, limit: usize) -> usize {
        let descriptors = point.descriptors.len().min(limit);
        POINT_BYTES
            + OBSERVATION_BYTES * point.observations.len()
            + (DESCRIPTOR_BYTES + self.index.code_bytes) * descriptors
    }

    /// What is there besides, with so many descriptors.
    fn beside(&self, descriptors: usize) -> usize {
        let lists = descriptors.div_ceil(self.index.list_length.max(1));
        let lists = lists.clamp(1, self.index.max_lists.max(1));
        FIXED_BYTES + KEYFRAME_BYTES * self.keyframes + LIST_BYTES * lists
    }
}

/// Of the points in `order` as many as fit; an error where they leave a view with too few, or none fits.
fn enough<'a>(
    rows: &MapRows,
    order: &'a [usize],
    size_bytes: usize,
    config: &PruneConfig,
    sizes: &Sizes,
    before: &BTreeMap<View, usize>,
) -> Result<&'a [usize], Error> {
    let needed = |view: &View| {
        let own = before.get(view).copied().unwrap_or(0);
        own.min(config.fewest_points_per_view)
    };
    let mut missing: BTreeMap<View, usize> = before.keys().map(|v| (*v, needed(v))).collect();
    let (mut bytes, mut descriptors) = (0, 0);
    let mut fitting = 0;
    let mut left_short: Option<(View, usize)> = None;
    for (kept, point) in order.iter().enumerate() {
        let row = &rows.points[*point];
        bytes += sizes.of_point(row, usize::MAX);
        descriptors += row.descriptors.len();
        let all = bytes + sizes.beside(descriptors);
        if all > size_bytes && left_short.is_none() {
            fitting = kept;
            match missing
                .iter()
                .max_by_key(|(view, short)| (**short, Reverse(**view)))
            {
                Some((view, short)) if *short > 0 => left_short = Some((*view, *short)),
                _ => break,
            }
        }
        for o in &row.observations {
            if let Some(short) = missing.get_mut(&view(o)) {
                *short = short.saturating_sub(1);
            }
        }
        if let Some((view, short)) = left_short
            && missing.values().all(|short| *short == 0)
        {
            let (keyframe, camera) = view;
            let time = rows.keyframes.get(keyframe as usize).map(|k| k.time);
            let camera = rows.rig.cameras.keys().nth(usize::from(camera));
            return Err(Refusal::MapBudget {
                keyframe,
                time: time.unwrap_or_default(),
                camera: camera.cloned().unwrap_or_default(),
                points: needed(&view) - short,
                needed: needed(&view),
                // Rounded up, so that what is said is enough.
                smallest_mb: (all as f64 / 1e4).ceil() / 100.0,
            }
            .into());
        }
    }
    Ok(&order[..fitting])
}

fn view(seen: &MapObservation) -> View {
    (seen.keyframe, seen.camera)
}

fn points_per_view(points: &[PointRow]) -> BTreeMap<View, usize> {
    let mut counts = BTreeMap::new();
    for o in points.iter().flat_map(|p| &p.observations) {
        *counts.entry(view(o)).or_default() += 1;
    }
    counts
}

fn most_descriptors(points: &[PointRow]) -> usize {
    points
        .iter()
        .map(|p| p.descriptors.len())
        .max()
        .unwrap_or(0)
}

fn middle(views: &BTreeMap<View, usize>) -> usize {
    let mut counts: Vec<usize> = views.values().copied().collect();
    counts.sort_unstable();
    counts.get(counts.len() / 2).copied().unwrap_or(0)
}
