//! Which keyframes' scans are compared, and what they share.

use std::collections::BTreeSet;
use std::iter::successors;
use std::sync::Arc;

use lsfb_geometry::StampedPose;
use rayon::prelude::*;

use super::MappingConfig;
use super::keyframes::Keyframe;
use crate::lidar_features::{Correspondences, correspond};

/// Two keyframes whose scans are compared: features of `n` on surfaces of `m`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ScanPair {
    pub n: usize,
    pub m: usize,
}

/// Keyframes between two that are compared as a revisit at least.
pub(super) const REVISIT_GAP: usize = 8;

/// Each keyframe with those 1, 2, 4, 8 … before it, and with the nearest of earlier visits.
///
/// Neighbours alone would make a chain whose errors add up, while the odometry registers each scan to a map of all before it; with doubling
/// gaps any two keyframes of a walk are a few pairs apart.
pub(super) fn scan_pairs(keyframes: &[Keyframe], config: &MappingConfig) -> Vec<ScanPair> {
    let mut pairs = BTreeSet::new();
    for n in 0..keyframes.len() {
        let gaps =
            successors(Some(1), |gap: &usize| gap.checked_mul(2)).take_while(|gap| *gap <= n);
        pairs.extend(gaps.map(|gap| ScanPair { m: n - gap, n }));
        let here = keyframes[n].world_from_rig.translation;
        let mut revisits: Vec<(f64, usize)> = keyframes[..n.saturating_sub(REVISIT_GAP)]
            .iter()
            .enumerate()
            .map(|(m, k)| ((k.world_from_rig.translation - here).norm(), m))
            .filter(|(distance, _)| *distance < config.revisit_distance_m)
            .collect();
        revisits.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        revisits.truncate(config.scan_revisits);
        pairs.extend(revisits.iter().map(|(_, m)| ScanPair { m: *m, n }));
    }
    pairs.into_iter().collect()
}

/// Shortest way between two keyframes at one place that tells something of drift, metres: on a shorter one somebody turned round.
const LEAST_LOOP_M: f64 = 10.0;

/// Length of the longest part of the way along keyframes that no loop spans, metres: neither it nor what lies around it comes back to within
/// `revisit_distance_m` of where it was before. A loop elsewhere on the walk says nothing of its drift.
pub(super) fn longest_without_loop_m(keyframes: &[StampedPose], config: &MappingConfig) -> f64 {
    let place = |k: &StampedPose| k.world_from_rig.translation;
    let steps_m = keyframes
        .windows(2)
        .map(|pair| (place(&pair[1]) - place(&pair[0])).norm());
    let steps_m: Vec<f64> = steps_m.collect();
    let mut gone_m = vec![0.0; keyframes.len().min(1)];
    for step_m in &steps_m {
        gone_m.push(gone_m[gone_m.len() - 1] + step_m);
    }
    // The first keyframe that each comes back to.
    let comes_back_to = |n: usize| {
        let earlier = keyframes.iter().zip(&gone_m);
        let mut left = earlier.take_while(|(_, m)| gone_m[n] - **m >= LEAST_LOOP_M);
        left.position(|(k, _)| (place(k) - place(&keyframes[n])).norm() < config.revisit_distance_m)
    };
    let mut ends = vec![0; keyframes.len()];
    for n in 0..keyframes.len() {
        if let Some(first) = comes_back_to(n) {
            ends[first] = n;
        }
    }
    let (mut spanned_to, mut open_m, mut longest_m) = (0, 0.0, 0.0_f64);
    for (k, step_m) in steps_m.iter().enumerate() {
        spanned_to = spanned_to.max(ends[k]);
        open_m = if k < spanned_to { 0.0 } else { open_m + step_m };
        longest_m = longest_m.max(open_m);
    }
    longest_m
}

/// What the scans of two keyframes share; residuals share it too.
pub(super) type Compared = (ScanPair, Arc<Correspondences>);

/// Correspondences of the scan pairs at the current poses.
pub(super) fn scan_correspondences(
    keyframes: &[Keyframe],
    pairs: &[ScanPair],
    config: &MappingConfig,
) -> Vec<Compared> {
    pairs
        .par_iter()
        .filter_map(|pair| {
            let (m, n) = (&keyframes[pair.m], &keyframes[pair.n]);
            let m_from_n = m.world_from_rig.inverse() * n.world_from_rig;
            let found = correspond(
                m.lidar.as_ref()?,
                n.lidar.as_ref()?,
                &m_from_n,
                &config.lidar_features,
            );
            Some((*pair, Arc::new(found)))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::{Se3, Vector3};
    use lsfb_types::Timestamp;

    /// Keyframes in a row.
    fn row(count: usize) -> Vec<Keyframe> {
        (0..count)
            .map(|i| Keyframe {
                time: Timestamp::from_nanos(i as i64),
                world_from_rig: Se3::new(Default::default(), Vector3::x() * (10 * i) as f64),
                lidar: None,
            })
            .collect()
    }

    /// A chain of neighbours passes every other check, and adds up its errors over the whole walk.
    #[test]
    fn any_two_keyframes_are_a_few_pairs_apart() {
        let count = 200;
        let pairs = scan_pairs(&row(count), &MappingConfig::default());
        let mut steps = vec![usize::MAX; count];
        steps[0] = 0;
        for _ in 0..count {
            for pair in &pairs {
                let nearer = steps[pair.m].min(steps[pair.n]).saturating_add(1);
                for end in [pair.m, pair.n] {
                    steps[end] = steps[end].min(nearer);
                }
            }
        }
        assert!(steps.iter().all(|s| *s <= 8), "{steps:?}");
        assert!(pairs.len() <= 8 * count, "{}", pairs.len());
    }

    /// Turning on the spot is no way back.
    #[test]
    fn a_walk_that_comes_back_nowhere_is_told_from_one_that_does() {
        let config = MappingConfig::default();
        let along = |xs: &[f64]| -> f64 {
            let poses = xs.iter().enumerate().map(|(i, x)| StampedPose {
                time: Timestamp::from_nanos(i as i64),
                world_from_rig: Se3::new(Default::default(), Vector3::x() * *x),
            });
            longest_without_loop_m(&poses.collect::<Vec<_>>(), &config)
        };
        let out: Vec<f64> = (0..100).map(f64::from).collect();
        assert_eq!(along(&out), 99.0);
        let back: Vec<f64> = out.iter().chain(out.iter().rev()).copied().collect();
        // But for where somebody turns round.
        assert!(along(&back) < LEAST_LOOP_M, "{}", along(&back));
        // Someone stands and turns for a while.
        let mut turning = out.clone();
        turning.splice(50..50, [50.0; 40]);
        assert_eq!(along(&turning), 99.0);
        assert_eq!(along(&[]), 0.0);
        // A loop at the beginning holds nothing of what comes behind it, nor one at the end what was before.
        let begun = (0..15).chain((0..15).rev()).map(|x| f64::from(x) - 20.0);
        let begun: Vec<f64> = begun.chain(out.iter().copied()).collect();
        assert!(along(&begun) >= 99.0, "{}", along(&begun));
        let ended: Vec<f64> = begun.iter().rev().copied().collect();
        assert!(along(&ended) >= 99.0, "{}", along(&ended));
    }

    #[test]
    fn a_revisit_is_compared_once() {
        let mut keyframes = row(17);
        keyframes[16].world_from_rig = keyframes[0].world_from_rig;
        let pairs = scan_pairs(&keyframes, &MappingConfig::default());
        let both = pairs.iter().filter(|p| p.m == 0 && p.n == 16).count();
        assert_eq!(both, 1);
    }
}
