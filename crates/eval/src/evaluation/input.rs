//! What a trajectory must be before it is judged.

use lsfb_geometry::StampedPose;

use super::config::DuplicateStamps;
use crate::Error;
use crate::association::PosePair;

/// Pairs below which nothing is judged: through two poses everything fits.
const LEAST_PAIRS: usize = 3;

/// Nobody walks farther, also in millimetres from the Earth's centre; squares of much larger numbers are no numbers any more, metres.
const FARTHEST_M: f64 = 1e12;

/// Number of poses that repeat the stamp before them.
pub(super) fn check(
    poses: &[StampedPose],
    role: &'static str,
    duplicates: DuplicateStamps,
) -> Result<usize, Error> {
    if poses.is_empty() {
        return Err(Error::Empty { role });
    }
    let not_finite = poses.iter().position(|p| {
        let pose = &p.world_from_rig;
        !pose.translation.iter().all(|v| v.is_finite())
            || !pose.rotation.coords.iter().all(|v| v.is_finite())
    });
    if let Some(index) = not_finite {
        return Err(Error::NotFinite {
            role,
            index,
            time_secs: poses[index].time.to_string(),
        });
    }
    let too_far = poses
        .iter()
        .position(|p| p.world_from_rig.translation.amax() > FARTHEST_M);
    if let Some(index) = too_far {
        return Err(Error::TooFar {
            role,
            index,
            time_secs: poses[index].time.to_string(),
            limit_m: FARTHEST_M,
        });
    }
    if let Some(index) = poses.windows(2).position(|w| w[1].time < w[0].time) {
        return Err(Error::Reordered {
            role,
            index: index + 1,
            time_secs: poses[index + 1].time.to_string(),
        });
    }
    let mut repeated = poses.windows(2).filter(|w| w[0].time == w[1].time);
    match (repeated.next(), duplicates) {
        (None, _) => Ok(0),
        (Some(_), DuplicateStamps::Keep) => Ok(1 + repeated.count()),
        (Some(first), DuplicateStamps::Refuse) => Err(Error::Duplicated {
            role,
            count: 1 + repeated.count(),
            time_secs: first[0].time.to_string(),
        }),
    }
}

/// Refuses matched poses by which nothing can be judged.
pub(super) fn check_pairs(pairs: &[PosePair]) -> Result<(), Error> {
    if pairs.len() < LEAST_PAIRS {
        return Err(Error::TooFewMatches {
            matched: pairs.len(),
            needed: LEAST_PAIRS,
            purpose: "alignment and statistics",
        });
    }
    // Pairs are in order of time.
    match (pairs.first(), pairs.last()) {
        (Some(first), Some(last)) if first.truth.time == last.truth.time => {
            Err(Error::NoDuration {
                time_secs: first.truth.time.to_string(),
            })
        }
        _ => Ok(()),
    }
}
