//! Which two poses a relative error compares.

use lsfb_geometry::{Se3, StampedPose, so3};
use lsfb_types::{Bounds, OutOfBounds};
use serde::Serialize;

use crate::Error;
use crate::relation::DeltaUnit;

/// Which pairs are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PairSelection {
    /// One after the other: each pair begins where the last one ended.
    #[default]
    Consecutive,
    /// A pair may begin at every pose; its delta may be off by [`ALL_PAIRS_TOLERANCE`].
    All,
}

/// One relative error to compute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RpeConfig {
    /// How far apart the two poses of a pair are.
    pub delta: f64,
    /// What `delta` counts.
    pub unit: DeltaUnit,
    /// Which pairs are taken.
    pub selection: PairSelection,
}

lsfb_types::bounds! {
    RpeConfig {
        delta: number(Bounds::POSITIVE),
        unit: any,
        selection: any,
    }
    also is_of_its_unit
}

impl RpeConfig {
    /// Frames are counted, and no rotation is more than half a turn.
    fn is_of_its_unit(&self, section: &str) -> Result<(), OutOfBounds> {
        let (bounds, is) = match self.unit {
            DeltaUnit::Frames => (
                Bounds::MultipleOf(1.0, 1.0, MOST_FRAMES),
                "a whole number of frames, 1 or more",
            ),
            DeltaUnit::Metres | DeltaUnit::Seconds => return Ok(()),
            DeltaUnit::Degrees => (Bounds::Within(0.0, 180.0), "180 degrees or less"),
            DeltaUnit::Radians => (
                Bounds::Within(0.0, std::f64::consts::PI),
                "pi radians or less",
            ),
        };
        match bounds.hold(self.delta) {
            true => Ok(()),
            false => Err(OutOfBounds::new(section, "delta", &self.delta, &is)),
        }
    }
}

/// Beyond it not every whole number is a double.
const MOST_FRAMES: f64 = 1e15;

/// By how much of the delta a pair of [`PairSelection::All`] may miss it.
pub const ALL_PAIRS_TOLERANCE: f64 = 0.1;
/// By how much of the delta a pair of [`PairSelection::Consecutive`] may be longer and still be of that delta. Pairs per second that are
/// longer are left out; those per metre and angle stay, as evo has them, and are counted.
pub const CONSECUTIVE_TOLERANCE: f64 = 0.2;

/// Two indices into the matched poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndexPair {
    /// The earlier.
    pub from: usize,
    /// The later.
    pub to: usize,
}

/// Which pairs there are, and how far apart they truly are.
#[derive(Clone, Debug, PartialEq)]
pub struct Selected {
    /// In the order of where they begin.
    pub pairs: Vec<IndexPair>,
    /// How far apart each is, in the unit of the delta.
    pub deltas: Vec<f64>,
    /// Pairs that were left out, as they are longer than the delta by more than [`CONSECUTIVE_TOLERANCE`]: the poses between are missing.
    pub left_out: usize,
}

/// The pairs of `poses` that are `delta` apart. Path and angle are those of `poses`, accumulated along the way; only
/// [`PairSelection::All`] with an angle takes the direct angle between two poses.
///
/// Consecutive pairs per metre or angle end at the first pose that is `delta` away or further, however far that is, as evo has them: where
/// poses are missing, or are further apart than `delta`, they are longer. Those per second, which evo does not have, are never longer by
/// more than [`CONSECUTIVE_TOLERANCE`]; behind such a gap the next pair begins.
pub fn select(
    poses: &[StampedPose],
    delta: f64,
    unit: DeltaUnit,
    selection: PairSelection,
) -> Result<Selected, Error> {
    let asked = RpeConfig {
        delta,
        unit,
        selection,
    };
    asked.check_bounds("rpe")?;
    let mut left_out = 0;
    let pairs = match (unit, selection) {
        (DeltaUnit::Frames, PairSelection::Consecutive) => {
            let step = delta as usize;
            (0..poses.len().saturating_sub(step))
                .step_by(step)
                .map(|from| IndexPair {
                    from,
                    to: from + step,
                })
                .collect()
        }
        (DeltaUnit::Frames, PairSelection::All) => {
            let step = delta as usize;
            (0..poses.len().saturating_sub(step))
                .map(|from| IndexPair {
                    from,
                    to: from + step,
                })
                .collect()
        }
        (DeltaUnit::Metres, PairSelection::Consecutive) => chain(&steps(poses, path_step), delta),
        (DeltaUnit::Metres, PairSelection::All) => nearest(&sums(&steps(poses, path_step)), delta),
        (DeltaUnit::Seconds, PairSelection::Consecutive) => {
            let chained = chain_by_time(poses, delta);
            let all = chained.len();
            let most = delta * (1.0 + CONSECUTIVE_TOLERANCE);
            let secs = |p: &IndexPair| poses[p.to].time.secs_since(poses[p.from].time);
            let kept: Vec<IndexPair> = chained.into_iter().filter(|p| secs(p) <= most).collect();
            left_out = all - kept.len();
            kept
        }
        (DeltaUnit::Seconds, PairSelection::All) => nearest(&seconds(poses), delta),
        (DeltaUnit::Degrees, _) => by_angle(poses, delta.to_radians(), selection),
        (DeltaUnit::Radians, _) => by_angle(poses, delta, selection),
    };
    if pairs.is_empty() {
        return Err(Error::NoPairs {
            poses: poses.len(),
            delta,
            unit,
        });
    }
    Ok(Selected {
        deltas: deltas(poses, &pairs, unit, selection),
        pairs,
        left_out,
    })
}

/// How far apart pairs are, in the unit by which they were chosen.
fn deltas(
    poses: &[StampedPose],
    pairs: &[IndexPair],
    unit: DeltaUnit,
    selection: PairSelection,
) -> Vec<f64> {
    let of_sums = |sums: Vec<f64>| pairs.iter().map(|p| sums[p.to] - sums[p.from]).collect();
    let radians = || -> Vec<f64> {
        let turn =
            |p: &IndexPair| angle_step(&poses[p.from].world_from_rig, &poses[p.to].world_from_rig);
        match selection {
            PairSelection::Consecutive => of_sums(sums(&steps(poses, angle_step))),
            PairSelection::All => pairs.iter().map(turn).collect(),
        }
    };
    match unit {
        DeltaUnit::Frames => pairs.iter().map(|p| (p.to - p.from) as f64).collect(),
        DeltaUnit::Metres => of_sums(sums(&steps(poses, path_step))),
        DeltaUnit::Seconds => of_sums(seconds(poses)),
        DeltaUnit::Degrees => radians().into_iter().map(f64::to_degrees).collect(),
        DeltaUnit::Radians => radians(),
    }
}

fn path_step(a: &Se3, b: &Se3) -> f64 {
    (b.translation - a.translation).norm()
}

fn angle_step(a: &Se3, b: &Se3) -> f64 {
    so3::log(&(a.rotation.inverse() * b.rotation)).norm()
}

fn steps(poses: &[StampedPose], step: fn(&Se3, &Se3) -> f64) -> Vec<f64> {
    poses
        .windows(2)
        .map(|w| step(&w[0].world_from_rig, &w[1].world_from_rig))
        .collect()
}

fn sums(steps: &[f64]) -> Vec<f64> {
    let mut total = 0.0;
    std::iter::once(0.0)
        .chain(steps.iter().map(|s| {
            total += s;
            total
        }))
        .collect()
}

fn seconds(poses: &[StampedPose]) -> Vec<f64> {
    let Some(first) = poses.first() else {
        return Vec::new();
    };
    poses
        .iter()
        .map(|p| p.time.secs_since(first.time))
        .collect()
}

/// Cuts a chain wherever `delta` has come together since the last cut.
fn chain(steps: &[f64], delta: f64) -> Vec<IndexPair> {
    let mut pairs = Vec::new();
    let (mut from, mut since) = (0, 0.0);
    for (i, step) in steps.iter().enumerate() {
        since += step;
        if since >= delta {
            pairs.push(IndexPair { from, to: i + 1 });
            (from, since) = (i + 1, 0.0);
        }
    }
    pairs
}

/// As [`chain`], in whole nanoseconds: sums of seconds in `f64` would miss a cut by one rounding.
fn chain_by_time(poses: &[StampedPose], delta_secs: f64) -> Vec<IndexPair> {
    let delta_nanos = (delta_secs * 1e9).round() as i64;
    let mut pairs = Vec::new();
    let mut from = 0;
    for (to, pose) in poses.iter().enumerate() {
        if to > from && pose.time - poses[from].time >= delta_nanos {
            pairs.push(IndexPair { from, to });
            from = to;
        }
    }
    pairs
}

/// For each place the later one whose distance is nearest to `delta`; of two equally near the earlier.
fn nearest(places: &[f64], delta: f64) -> Vec<IndexPair> {
    let mut pairs = Vec::new();
    for from in 0..places.len().saturating_sub(1) {
        let rest = &places[from + 1..];
        let distance = |i: usize| (rest[i] - places[from] - delta).abs();
        let above = rest.partition_point(|p| p - places[from] < delta);
        let mut best = above.min(rest.len() - 1);
        if above > 0 && distance(above - 1) <= distance(best) {
            // Poses that stand still share one place: the first of them counts.
            best = rest.partition_point(|p| *p < rest[above - 1]);
        }
        if distance(best) <= delta * ALL_PAIRS_TOLERANCE {
            pairs.push(IndexPair {
                from,
                to: from + 1 + best,
            });
        }
    }
    pairs
}

fn by_angle(poses: &[StampedPose], delta_rad: f64, selection: PairSelection) -> Vec<IndexPair> {
    match selection {
        PairSelection::Consecutive => chain(&steps(poses, angle_step), delta_rad),
        PairSelection::All => {
            let tolerance = delta_rad * ALL_PAIRS_TOLERANCE;
            // |q · q'| is the cosine of half the angle between two rotations: no arc tangent for millions of pairs.
            let half_cosines =
                ((delta_rad + tolerance) * 0.5).cos()..=((delta_rad - tolerance) * 0.5).cos();
            let rotations: Vec<_> = poses
                .iter()
                .map(|p| p.world_from_rig.rotation.into_inner().coords)
                .collect();
            let mut pairs = Vec::new();
            for (from, a) in rotations.iter().enumerate() {
                for (to, b) in rotations.iter().enumerate().skip(from + 1) {
                    if half_cosines.contains(&a.dot(b).abs()) {
                        pairs.push(IndexPair { from, to });
                    }
                }
            }
            pairs
        }
    }
}

#[cfg(test)]
mod tests;
