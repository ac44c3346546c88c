//! Whether the trajectory has scans where these lie on each other.
//!
//! Where scans come often each is held by the IMU more than by the map, and what the map is drawn from is drawn away with it: an IMU that is wrong
//! in one axis bends a walk by metres, in which every scan lies on the map. So scans are taken a second later, registered to those about the first
//! alone by planes and without the IMU's help, and held against the trajectory along the directions that they see; and to a chain of the scans between them.
//! The walk is judged by its worst stretch, as half of one may be right.

use lsfb_geometry::{Matrix6, Se3, Vector3};
use lsfb_perception::lidar::{LocalMap, PosePrior, ScanFinder, register};
use lsfb_perception::statistics::median;
use rayon::prelude::*;

use super::chain::Chain;
use super::scans::{GATE_M, Scans, seen_off_m};
use crate::odometry::OdometryConfig;
use crate::odometry::warning::MAX_APART_M;

/// From the scan in the middle of the map to the one that is registered, seconds: at least and at most.
const LATER_S: std::ops::RangeInclusive<f64> = 0.9..=1.3;
/// Scans before and behind the middle one that the map is made of as well: one alone is rings.
const BESIDE: usize = 3;
/// From one pair to the next, seconds, at most; on a short walk less, so that there are some.
const EVERY_S: f64 = 2.0;
const SHORT_WALK: f64 = 12.0;
/// Pairs of a stretch: of half of them there may be something wrong with the scans, as of people who walk by.
const IN_A_STRETCH: usize = 3;
/// A stretch in which no pair tells anything is said to be so from this long on, seconds.
const UNCHECKED_S: f64 = 10.0;
/// A pair of which less lies on each other tells nothing.
const MIN_OVERLAP: f64 = 0.4;
/// A chain counts where its scans lie so much better on each other: right walks come to 0.08, wrong ones to 0.4 and more.
const BETTER: f64 = 0.15;

/// What scans that are laid on each other say of a trajectory.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::odometry) struct Laid {
    /// Where they lie elsewhere, the worst stretch of the walk.
    pub off: Option<StretchOff>,
    /// From and until when nothing tells, seconds after the first scan.
    pub unchecked: Vec<[f64; 2]>,
}

/// A stretch in which scans lie elsewhere on each other than the trajectory has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::odometry) struct StretchOff {
    /// Half of its pairs by more, metres.
    pub off_m: f64,
    /// Its first and last scan, seconds after the first of all.
    pub from_s: f64,
    pub to_s: f64,
}

/// A pair of scans, and by how much the trajectory has the second elsewhere; `None` where that is not told.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair {
    from_s: f64,
    to_s: f64,
    off_m: Option<f64>,
}

/// Lays scans of a walk on each other.
pub(in crate::odometry) fn lay(scans: &Scans<'_>, config: &OdometryConfig) -> Laid {
    let poses = scans.poses;
    let (Some(start), Some(end)) = (poses.first(), poses.last()) else {
        return Laid::default();
    };
    let at_s = |k: usize| poses[k].time.secs_since(start.time);
    let lasts_s = end.time.secs_since(start.time);
    let every_s = EVERY_S.min(lasts_s / SHORT_WALK);
    let later = |first: usize| {
        let far = |k: &usize| at_s(*k) - at_s(first) >= *LATER_S.start();
        let second = (first + BESIDE + 1..poses.len()).find(far)?;
        LATER_S
            .contains(&(at_s(second) - at_s(first)))
            .then_some((first, second))
    };
    let mut next_s = 0.0;
    let mut chosen = Vec::new();
    for first in BESIDE..poses.len() {
        if at_s(first) >= next_s
            && let Some(pair) = later(first)
        {
            chosen.push(pair);
            next_s = at_s(first) + every_s;
        }
    }
    let pairs = chosen.into_par_iter().map(|(first, second)| Pair {
        from_s: at_s(first),
        to_s: at_s(second),
        off_m: pair_off(scans, config, first, second),
    });
    judged(&pairs.collect::<Vec<_>>(), lasts_s)
}

/// What pairs in the order of their times say of a walk that lasts so long.
fn judged(pairs: &[Pair], lasts_s: f64) -> Laid {
    let told: Vec<&Pair> = pairs.iter().filter(|p| p.off_m.is_some()).collect();
    let stretches = told.windows(IN_A_STRETCH).filter_map(|stretch| {
        let off_m = median(stretch.iter().filter_map(|p| p.off_m).collect())?;
        Some(StretchOff {
            off_m,
            from_s: stretch.first()?.from_s,
            to_s: stretch.last()?.to_s,
        })
    });
    let off = stretches.filter(|stretch| stretch.off_m > MAX_APART_M);
    let off = off.max_by(|a, b| a.off_m.total_cmp(&b.off_m));
    if told.len() < IN_A_STRETCH {
        return Laid {
            off,
            unchecked: vec![[0.0, lasts_s]],
        };
    }
    let begins = told.iter().map(|p| p.from_s).chain([lasts_s]);
    let ends = [0.0].into_iter().chain(told.iter().map(|p| p.to_s));
    let gaps = ends.zip(begins).map(|(end, begin)| [end, begin]);
    Laid {
        off,
        unchecked: gaps.filter(|[a, b]| b - a > UNCHECKED_S).collect(),
    }
}

/// By the map about the first scan, and where a chain of scans says more by better evidence, by that.
fn pair_off(
    scans: &Scans<'_>,
    config: &OdometryConfig,
    first: usize,
    second: usize,
) -> Option<f64> {
    let by_map = off_by_map(scans, config, first, second);
    let Some(chain) = Chain::new(scans, config, first, second, MIN_OVERLAP) else {
        return by_map;
    };
    if chain.off_m <= MAX_APART_M.max(by_map.unwrap_or(0.0)) {
        return by_map.or(Some(chain.off_m));
    }
    match chain.better(scans, config) {
        Some(better) if better > BETTER => Some(chain.off_m),
        _ => by_map,
    }
}

fn off_by_map(
    scans: &Scans<'_>,
    config: &OdometryConfig,
    first: usize,
    second: usize,
) -> Option<f64> {
    let lidar = scans.lidar;
    let sensor_in_rig = lidar.rig_from_lidar.translation;
    let mut map = LocalMap::new(config.local_map(lidar));
    for k in first - BESIDE..=first + BESIDE {
        map.insert(
            &scans.points(k)?,
            &scans.seen_from(first, k),
            &sensor_in_rig,
        );
    }
    let stated = scans.seen_from(first, second);
    let prior = PosePrior {
        world_from_rig: stated,
        information: Matrix6::identity(),
    };
    let settings = config.registration(lidar, GATE_M.min(config.initial_gate_m));
    let points = scans.points(second)?;
    let mut finder = ScanFinder::new(&map, &points, &sensor_in_rig);
    let found = register(&points, &prior, &settings, |pose, gate_m| {
        finder.find_planes(pose, gate_m)
    });
    let planes = |points: &[Vector3<f64>], pose: &Se3, gate_m: f64| {
        ScanFinder::new(&map, points, &sensor_in_rig).find_planes(pose, gate_m)
    };
    let off_m = seen_off_m(&points, &stated, &found, &settings, config, planes)?;
    (found.inlier_ratio > MIN_OVERLAP).then_some(off_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs two seconds apart; `None` tells nothing.
    fn walk(off_m: impl Fn(usize) -> Option<f64>) -> Laid {
        let pairs = (0..60).map(|k| Pair {
            from_s: 2.0 * k as f64 + 0.3,
            to_s: 2.0 * k as f64 + 1.3,
            off_m: off_m(k),
        });
        judged(&pairs.collect::<Vec<_>>(), 121.0)
    }

    /// Naively the median of all pairs was asked: a walk of which less than half is bent was right.
    #[test]
    fn a_third_of_a_walk_that_is_bent_is_named_and_one_pair_is_not() {
        assert_eq!(walk(|_| Some(0.02)), Laid::default());
        let bent = walk(|k| Some(if k >= 40 { 0.3 } else { 0.01 }));
        let off = bent.off.expect("bent");
        assert!(off.off_m > 0.29 && off.from_s > 75.0, "{off:?}");
        let of_a_moment = walk(|k| Some(if k % 10 == 5 { 0.5 } else { 0.01 }));
        assert_eq!(of_a_moment, Laid::default());
    }

    /// Naively nothing was said where nothing could be looked at.
    #[test]
    fn what_is_not_checked_is_said() {
        let nothing = walk(|_| None);
        assert_eq!(nothing.unchecked, [[0.0, 121.0]]);
        let gap = walk(|k| (!(20..30).contains(&k)).then_some(0.01));
        let [[from_s, to_s]] = gap.unchecked[..] else {
            panic!("{gap:?}");
        };
        assert!((from_s - 39.3).abs() < 0.1 && (to_s - 60.3).abs() < 0.1);
        assert_eq!(judged(&[], 0.4).unchecked, [[0.0, 0.4]]);
    }
}
