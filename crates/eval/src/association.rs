//! Which pose of the estimate belongs to which pose of the truth.

use lsfb_geometry::StampedPose;
use lsfb_types::{Bounds, OutOfBounds, Timestamp};

use crate::Error;

/// Two poses of about the same time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    /// From the truth.
    pub truth: StampedPose,
    /// From the estimate.
    pub estimate: StampedPose,
}

/// What the largest difference of two stamps may be, seconds.
pub(crate) const MAX_DIFFERENCE: Bounds = Bounds::NOT_NEGATIVE;

/// Each pose of the shorter list with the one of the longer whose stamp is nearest, where they differ by no more than
/// `max_difference_secs`; of two equally near stamps the earlier. Of lists of one length the estimate counts as the
/// shorter. Both must be in order of time, which [`crate::evaluate`] checks.
pub fn associate(
    truth: &[StampedPose],
    estimate: &[StampedPose],
    max_difference_secs: f64,
) -> Result<Vec<PosePair>, Error> {
    if !MAX_DIFFERENCE.hold(max_difference_secs) {
        let name = "max_difference_secs";
        return Err(OutOfBounds::new("", name, &max_difference_secs, &MAX_DIFFERENCE).into());
    }
    let max_nanos = (max_difference_secs * 1e9).round() as i64;
    let pairs: Vec<PosePair> = if estimate.len() > truth.len() {
        truth
            .iter()
            .filter_map(|&t| {
                let estimate = nearest(estimate, t.time, max_nanos)?;
                Some(PosePair { truth: t, estimate })
            })
            .collect()
    } else {
        estimate
            .iter()
            .filter_map(|&e| {
                let truth = nearest(truth, e.time, max_nanos)?;
                Some(PosePair { truth, estimate: e })
            })
            .collect()
    };
    if pairs.is_empty() {
        return Err(Error::NoMatch {
            max_difference_secs,
            truth_span: span(truth),
            estimate_span: span(estimate),
            hint: unit_hint(truth, estimate),
        });
    }
    Ok(pairs)
}

fn nearest(poses: &[StampedPose], time: Timestamp, max_nanos: i64) -> Option<StampedPose> {
    let next = poses.partition_point(|p| p.time <= time);
    let before = next.checked_sub(1).and_then(|i| poses.get(i));
    let after = poses.get(next);
    let found = match (before, after) {
        (Some(b), Some(a)) if a.time - time < time - b.time => a,
        (Some(b), _) => b,
        (None, Some(a)) => a,
        (None, None) => return None,
    };
    ((found.time - time).abs() <= max_nanos).then_some(*found)
}

/// Whether one of the two seems to have its stamps in another unit: how long they last, or when, differs by a power of a thousand.
fn unit_hint(truth: &[StampedPose], estimate: &[StampedPose]) -> String {
    let ends = |poses: &[StampedPose]| Some((poses.first()?.time, poses.last()?.time));
    let (Some((a, b)), Some((c, d))) = (ends(truth), ends(estimate)) else {
        return String::new();
    };
    let epoch = Timestamp::from_nanos(0);
    let ratios = [
        d.secs_since(c) / b.secs_since(a),
        c.secs_since(epoch) / a.secs_since(epoch),
    ];
    let hint = ratios.into_iter().find_map(|ratio| {
        let thousands = (ratio.log10() / 3.0).round();
        let is_near = (ratio / 1000f64.powf(thousands)).log2().abs() < 1.0;
        (is_near && (1.0..=3.0).contains(&thousands.abs())).then_some(thousands)
    });
    let unit =
        |thousands: f64| ["milliseconds", "microseconds", "nanoseconds"][thousands as usize - 1];
    match hint {
        Some(thousands) if thousands > 0.0 => {
            format!("; the estimate's stamps look like {}", unit(thousands))
        }
        Some(thousands) => format!("; the truth's stamps look like {}", unit(-thousands)),
        None => String::new(),
    }
}

fn span(poses: &[StampedPose]) -> String {
    match (poses.first(), poses.last()) {
        (Some(first), Some(last)) => format!("{} to {} s", first.time, last.time),
        _ => "nothing".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Se3;

    fn at(millis: &[i64]) -> Vec<StampedPose> {
        millis
            .iter()
            .map(|&m| StampedPose {
                time: Timestamp::from_nanos(m * 1_000_000),
                world_from_rig: Se3::identity(),
            })
            .collect()
    }

    fn pairs(truth: &[i64], estimate: &[i64]) -> Vec<(i64, i64)> {
        associate(&at(truth), &at(estimate), 0.01)
            .expect("valid")
            .iter()
            .map(|p| {
                (
                    p.truth.time.nanos() / 1_000_000,
                    p.estimate.time.nanos() / 1_000_000,
                )
            })
            .collect()
    }

    #[test]
    fn takes_the_nearest_and_of_two_the_earlier() {
        assert_eq!(pairs(&[0, 10, 20, 30], &[4, 15, 41]), [(0, 4), (10, 15)]);
        assert_eq!(pairs(&[-10, 100], &[-20, 110]), [(-10, -20), (100, 110)]);
        assert_eq!(pairs(&[5, 100], &[0, 8, 9, 120]), [(5, 8)]);
    }

    #[test]
    fn says_why_nothing_matches() {
        let error = associate(&at(&[0, 1000]), &at(&[500]), 0.01).expect_err("too far");
        let text = error.to_string();
        assert!(
            text.contains("0.000000000 to 1.000000000 s") && text.contains("0.5"),
            "{text}"
        );
        let millis = associate(
            &at(&[0, 1000, 2000]),
            &at(&[9_000, 1_009_000, 1_909_000]),
            0.01,
        );
        let text = millis.expect_err("other unit").to_string();
        assert!(
            text.ends_with("the estimate's stamps look like milliseconds"),
            "{text}"
        );
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(associate(&at(&[0]), &at(&[0]), bad).is_err());
        }
    }
}
