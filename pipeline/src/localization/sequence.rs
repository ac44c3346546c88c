//! Poses of a walk against one another: whoever walks is never here and, a moment later, in another room that looks the same.
//!
//! Each pose is probable by itself, and a place that looks like another deceives image after image. So poses within ten seconds vote: those
//! between which one can have walked agree, and a way through them is a chain in which each agrees with the next. The longest way through a
//! pose is held against the longest one through any that it disagrees with: it is given where its own has clearly more poses, and of two
//! places that are as often found neither is.

use lsfb_geometry::Se3;
use lsfb_types::Timestamp;
use rayon::prelude::*;

use super::outcome::{Localization, NotLocalized, NotLocalizedReason};

/// Poses within this time vote for one another: half before, half after.
const WINDOW_SECS: f64 = 10.0;
/// Share of the instants of a window that must be localized: fewer poses than these may all be those that are accepted by chance.
pub(super) const LEAST_LOCALIZED: f64 = 0.2;
/// Of a window with more poses on one side every so many vote that no more do.
const VOTERS_PER_SIDE: usize = 50;
/// By how many poses the way through a pose must be longer, as a share of those that contradict it; one at least.
const CLEAR_SHARE: f64 = 0.5;
/// How fast people move at most, their hands and heads included, metres and radians a second.
const FASTEST_M_S: f64 = 4.0;
const FASTEST_RAD_S: f64 = 8.0;
/// What two poses may be apart besides: standard deviations, and what these may not know, metres and radians.
const DEVIATIONS: f64 = 3.0;
const UNKNOWN_M: f64 = 0.1;
const UNKNOWN_RAD: f64 = 0.05;

/// A localized instant.
struct Voter {
    time: Timestamp,
    world_from_rig: Se3,
    variance_m2: f64,
    variance_rad2: f64,
}

impl Voter {
    fn new(time: Timestamp, found: &Localization) -> Self {
        let variance = |first: usize| {
            (first..first + 3)
                .map(|i| found.covariance[(i, i)])
                .sum::<f64>()
        };
        Self {
            time,
            world_from_rig: found.world_from_rig,
            variance_m2: variance(3),
            variance_rad2: variance(0),
        }
    }

    /// Whether one can have walked from here to there.
    fn agrees(&self, other: &Self) -> bool {
        let secs = other.time.secs_since(self.time).abs();
        let off = self.world_from_rig.inverse() * other.world_from_rig;
        let bound = |fastest: f64, variance: f64, unknown: f64| {
            fastest * secs + DEVIATIONS * variance.sqrt() + unknown
        };
        let variance_m2 = self.variance_m2 + other.variance_m2;
        let variance_rad2 = self.variance_rad2 + other.variance_rad2;
        off.translation.norm() <= bound(FASTEST_M_S, variance_m2, UNKNOWN_M)
            && off.rotation.angle() <= bound(FASTEST_RAD_S, variance_rad2, UNKNOWN_RAD)
    }
}

/// Of the instants within ten seconds of each, in order of time, the share that is localized.
pub(super) fn localized_shares(
    times: &[Timestamp],
    is_localized: impl Iterator<Item = bool>,
) -> Vec<f64> {
    let mut before = vec![0usize];
    for (k, is_localized) in is_localized.enumerate() {
        before.push(before[k] + usize::from(is_localized));
    }
    let half = (0.5e9 * WINDOW_SECS) as i64;
    let share = |time: &Timestamp| {
        let first = times.partition_point(|t| *t < *time + -half);
        let end = times.partition_point(|t| *t <= *time + half);
        (before[end] - before[first]) as f64 / (end - first).max(1) as f64
    };
    times.iter().map(share).collect()
}

/// Refuses the few poses of a walk that is hardly recognised: in a corridor with the same doors from either end, one of ten images was found, each for sure, and
/// all of them at the wrong end. Instants in order of time.
pub(super) fn refuse_hardly_recognised(
    times: &[Timestamp],
    found: Vec<Result<Localization, NotLocalized>>,
) -> Vec<Result<Localization, NotLocalized>> {
    let shares = localized_shares(times, found.iter().map(Result::is_ok));
    let judged = found.into_iter().zip(shares).map(|(found, share)| {
        let found = found?;
        if share >= LEAST_LOCALIZED {
            return Ok(found);
        }
        Err(NotLocalized {
            reason: NotLocalizedReason::HardlyRecognised {
                best: Box::new(found),
                share,
            },
        })
    });
    judged.collect()
}

/// Refuses poses of a walk that others contradict; instants in order of time.
pub(super) fn refuse_contradicted(
    times: &[Timestamp],
    found: Vec<Result<Localization, NotLocalized>>,
) -> Vec<Result<Localization, NotLocalized>> {
    let localized = times.iter().zip(&found);
    let voters: Vec<Voter> = localized
        .filter_map(|(time, found)| Some(Voter::new(*time, found.as_ref().ok()?)))
        .collect();
    let votes: Vec<Votes> = (0..voters.len())
        .into_par_iter()
        .map(|i| Votes::of(&voters, i))
        .collect();
    let mut votes = votes.into_iter();
    let judged = found
        .into_iter()
        .map(|found| -> Result<Localization, NotLocalized> {
            let found = found?;
            match votes.next() {
                Some(votes) if votes.is_against() => Err(NotLocalized {
                    reason: NotLocalizedReason::Sequence {
                        best: Box::new(found),
                        agreeing: votes.way,
                        contradicting: votes.other_way,
                    },
                }),
                _ => Ok(found),
            }
        });
    judged.collect()
}

/// What the poses of a window say of one of them.
struct Votes {
    /// Poses of the longest way through it.
    way: usize,
    /// Poses of the longest way through one that contradicts it.
    other_way: usize,
    /// Poses that contradict it.
    contradicting: usize,
}

impl Votes {
    fn of(voters: &[Voter], i: usize) -> Self {
        let own = &voters[i];
        let near = |other: &&Voter| other.time.secs_since(own.time).abs() <= WINDOW_SECS / 2.0;
        let before: Vec<&Voter> = voters[..i].iter().rev().take_while(near).collect();
        let after: Vec<&Voter> = voters[i + 1..].iter().take_while(near).collect();
        let thinned = |side: Vec<&'_ Voter>| -> Vec<usize> {
            let every = side.len().div_ceil(VOTERS_PER_SIDE).max(1);
            // The nearest tell most.
            (1..=side.len()).step_by(every).collect()
        };
        let before = thinned(before).into_iter().rev().map(|k| i - k);
        let before: Vec<usize> = before.collect();
        let own_place = before.len();
        let after = thinned(after).into_iter().map(|k| i + k);
        let window: Vec<&Voter> = before
            .into_iter()
            .chain([i])
            .chain(after)
            .map(|k| &voters[k])
            .collect();
        let ways = ways(&window);
        let contradicting = window.iter().zip(&ways).filter(|(v, _)| !own.agrees(v));
        let contradicting: Vec<usize> = contradicting.map(|(_, way)| *way).collect();
        Self {
            way: ways[own_place],
            other_way: contradicting.iter().copied().max().unwrap_or(0),
            contradicting: contradicting.len(),
        }
    }

    fn is_against(&self) -> bool {
        let clearly = (CLEAR_SHARE * self.contradicting as f64).max(1.0);
        self.contradicting > 0 && self.way as f64 - (self.other_way as f64) < clearly
    }
}

/// For each pose, in order of time, the number of poses of the longest way through it.
fn ways(poses: &[&Voter]) -> Vec<usize> {
    let count = poses.len();
    let (mut until, mut from) = (vec![1usize; count], vec![1usize; count]);
    let agree: Vec<Vec<usize>> = (0..count)
        .map(|k| {
            (k + 1..count)
                .filter(|next| poses[k].agrees(poses[*next]))
                .collect()
        })
        .collect();
    for (k, later) in agree.iter().enumerate() {
        for next in later {
            until[*next] = until[*next].max(until[k] + 1);
        }
    }
    for (k, later) in agree.iter().enumerate().rev() {
        from[k] = 1 + later.iter().map(|next| from[*next]).max().unwrap_or(0);
    }
    until
        .iter()
        .zip(from)
        .map(|(until, from)| until + from - 1)
        .collect()
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Matrix6, Vector3};

    use super::super::acceptance::Evidence;
    use super::*;

    fn at(x_m: f64) -> Result<Localization, NotLocalized> {
        let evidence = Evidence {
            first_matches: 300,
            first_inliers: 90,
            chance_level: 0.001,
            log10_false_alarms: -120.0,
            known_decades: 0.0,
            guided_inliers: 200,
            decoy_inliers: 12.0,
            image_spread: 0.6,
            first_spread: 0.6,
            focal_scale: 1.0,
            focal_log_sigma: 0.01,
            focal_decades: 0.0,
            log10_false_alarms_mirrored: 3.0,
            decades_together: 0.02,
            rival_inliers: 0,
            twin_inliers: 0,
        };
        Ok(Localization {
            world_from_rig: Se3::new(Default::default(), Vector3::new(x_m, 0.0, 0.0)),
            covariance: Matrix6::identity() * 1e-4,
            matches: Vec::new(),
            reprojection_rms_px: 0.5,
            votes: 60,
            evidence,
            probability: evidence.probability(),
        })
    }

    /// Which of a walk's poses, a tenth of a second apart, are given.
    fn given(found: Vec<Result<Localization, NotLocalized>>) -> Vec<bool> {
        let times: Vec<Timestamp> = (0..found.len() as i64)
            .map(|k| Timestamp::from_nanos(100_000_000 * k))
            .collect();
        let judged = refuse_contradicted(&times, found);
        judged.iter().map(Result::is_ok).collect()
    }

    /// Walking at 1.5 m/s, with places that look like the one 6 m farther on.
    fn walk(count: usize, is_deceived: impl Fn(usize) -> bool) -> Vec<bool> {
        let place = |k: usize| 0.15 * k as f64 + if is_deceived(k) { 6.0 } else { 0.0 };
        given((0..count).map(|k| at(place(k))).collect())
    }

    #[test]
    fn a_place_that_looks_like_another_is_outvoted() {
        assert!(walk(200, |_| false).iter().all(|given| *given));
        for run in [1, 5, 15] {
            let deceived = |k: usize| (100..100 + run).contains(&k);
            let given = walk(200, deceived);
            let right = (0..200).all(|k| given[k] != deceived(k));
            assert!(right, "{run}: {given:?}");
        }
        // One image in seven, all along the walk.
        let given = walk(200, |k| k % 7 == 3);
        assert!((0..200).all(|k| given[k] != (k % 7 == 3)), "{given:?}");
    }

    #[test]
    fn of_two_places_as_often_found_neither_is_given() {
        let given = walk(200, |k| k % 2 == 0);
        assert!(given.iter().all(|given| !given), "{given:?}");
    }

    #[test]
    fn the_few_poses_of_a_walk_that_is_hardly_recognised_are_refused() {
        let given = |count: usize, is_found: fn(usize) -> bool| -> Vec<bool> {
            let nowhere = || NotLocalized {
                reason: NotLocalizedReason::NoPose,
            };
            let found = |k: usize| match is_found(k) {
                true => at(0.1 * k as f64),
                false => Err(nowhere()),
            };
            let times: Vec<Timestamp> = (0..count as i64)
                .map(|k| Timestamp::from_nanos(100_000_000 * k))
                .collect();
            let judged = refuse_hardly_recognised(&times, (0..count).map(found).collect());
            judged.iter().map(Result::is_ok).collect()
        };
        assert!(given(100, |k| (50..59).contains(&k)).iter().all(|g| !g));
        let half = given(200, |k| k >= 100);
        assert!(half[100..].iter().all(|g| *g), "{half:?}");
        assert_eq!(given(1, |_| true), [true]);
        assert!(given(0, |_| true).is_empty());
    }

    #[test]
    fn poses_that_nothing_contradicts_are_given() {
        assert_eq!(given(vec![at(1.0)]), [true]);
        assert!(given(Vec::new()).is_empty());
        // Alone in its window, however far it has gone since.
        let times = [0, 60].map(|secs| Timestamp::from_nanos(1_000_000_000 * secs));
        let judged = refuse_contradicted(&times, vec![at(0.0), at(500.0)]);
        assert!(judged.iter().all(Result::is_ok));
        // What was not localized is neither for nor against.
        let nowhere = || {
            Err(NotLocalized {
                reason: NotLocalizedReason::NoPose,
            })
        };
        assert_eq!(
            given(vec![at(0.0), nowhere(), at(0.2)]),
            [true, false, true]
        );
    }
}
