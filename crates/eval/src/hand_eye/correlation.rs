//! By how much two clocks differ: where the angular speeds of two bodies that are one are most alike.

use lsfb_types::{Progress, ProgressFn};

use super::continuous::Continuous;
use crate::Error;

/// Grid on which offsets are tried.
const STEP_SECS: f64 = 0.01;
/// Speeds are means over at least this long.
const LEAST_WIDTH_SECS: f64 = 0.05;
/// Two trajectories must have this much in common at an offset to be compared there.
const LEAST_COMMON_SECS: f64 = 5.0;
/// A trajectory that lasts longer than two days is one whose stamps are wrong.
const LONGEST_SECS: f64 = 172_800.0;
/// Correlation below which nothing was found.
const LEAST_CORRELATION: f64 = 0.5;
/// An offset this far from the best is another answer.
const OTHER_SECS: f64 = 0.5;
/// Correlation of another answer, as a share of the best, that makes the best doubtful.
const RIVAL: f64 = 0.98;
/// Speeds beyond this many times the 95th percentile are jumps of the measurement.
const LARGEST_SPEED: f64 = 1.5;

/// Angular speeds that differ by less are one, rad/s.
const EVEN_RAD_S: f64 = 1e-4;

/// An offset that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Correlated {
    /// To be added to the estimate's time to have the reference's, seconds.
    pub offset_secs: f64,
    /// Correlation of the speeds there.
    pub correlation: f64,
}

/// Tries offsets within `search_secs` of `around_secs`.
pub(super) fn correlate(
    estimate: &Continuous,
    reference: &Continuous,
    around_secs: f64,
    search_secs: f64,
    progress: ProgressFn<'_>,
) -> Result<Correlated, Error> {
    for (role, of) in [("estimate", estimate), ("reference", reference)] {
        let span_secs = of.span_secs().map_or(0.0, |[start, end]| end - start);
        if span_secs > LONGEST_SECS {
            return Err(Error::TooLong { role, span_secs });
        }
    }
    let slower = estimate.median_step_secs.max(reference.median_step_secs);
    let width_secs = (2.0 * slower).max(LEAST_WIDTH_SECS);
    let (a, b) = (
        Speeds::of(estimate, width_secs),
        Speeds::of(reference, width_secs),
    );
    // Offsets in steps of the grid, from the grid points of the estimate to those of the reference.
    let shift =
        |offset_secs: f64| ((a.start_secs + offset_secs - b.start_secs) / STEP_SECS).round() as i64;
    let (low, high) = (
        shift(around_secs - search_secs),
        shift(around_secs + search_secs),
    );
    let mut found: Vec<(i64, Option<f64>)> = Vec::new();
    for s in low..=high {
        progress(Progress {
            stage: "searching the clock offset",
            done: (s - low) as u64,
            total: (high - low + 1) as u64,
        })?;
        found.push((s, correlation(&a, &b, s)));
    }
    let best = found
        .iter()
        .filter_map(|(s, c)| Some((*s, (*c)?)))
        .max_by(|x, y| x.1.total_cmp(&y.1));
    let Some((best, correlation)) = best else {
        for (role, speeds) in [("estimate", &a), ("reference", &b)] {
            if speeds.is_even() {
                return Err(Error::EvenRotation { role });
            }
        }
        let span = |of: &Continuous| {
            let [start, end] = of.span_secs().unwrap_or_default();
            format!("{start:.1} … {end:.1} s")
        };
        return Err(Error::NoCommonTime {
            search_secs,
            around_secs,
            spans: format!("{} and {}", span(estimate), span(reference)),
        });
    };
    if correlation < LEAST_CORRELATION {
        return Err(Error::NotOneBody { correlation });
    }
    let secs = |s: f64| s * STEP_SECS - a.start_secs + b.start_secs;
    let rival = found.iter().find(|(s, c)| {
        ((s - best) as f64 * STEP_SECS).abs() > OTHER_SECS
            && c.is_some_and(|c| c > RIVAL * correlation)
    });
    if let Some((s, _)) = rival {
        return Err(Error::TwoOffsets {
            first_secs: secs(best as f64),
            second_secs: secs(*s as f64),
        });
    }
    let at = |s: i64| found.get(usize::try_from(s - low).ok()?)?.1;
    // The top of the parabola through the best and its neighbours.
    let aside = match (at(best - 1), at(best + 1)) {
        (Some(l), Some(r)) if l - 2.0 * correlation + r < 0.0 => {
            (0.5 * (l - r) / (l - 2.0 * correlation + r)).clamp(-0.5, 0.5)
        }
        _ => 0.0,
    };
    Ok(Correlated {
        offset_secs: secs(best as f64 + aside),
        correlation,
    })
}

/// Angular speeds on an even grid; `None` in gaps.
struct Speeds {
    start_secs: f64,
    values: Vec<Option<f64>>,
}

impl Speeds {
    fn of(trajectory: &Continuous, width_secs: f64) -> Self {
        let [start_secs, end_secs] = trajectory.span_secs().unwrap_or([0.0, 0.0]);
        let count = ((end_secs - start_secs) / STEP_SECS).max(0.0) as usize + 1;
        let mut values: Vec<Option<f64>> = (0..count)
            .map(|i| trajectory.angular_speed(start_secs + i as f64 * STEP_SECS, width_secs))
            .collect();
        let mut sorted: Vec<f64> = values.iter().copied().flatten().collect();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted.get(sorted.len() * 95 / 100).copied().unwrap_or(0.0);
        for value in values.iter_mut().flatten() {
            *value = value.min(LARGEST_SPEED * usual);
        }
        Self { start_secs, values }
    }

    /// Whether they are the same at all times: they fit others nowhere.
    fn is_even(&self) -> bool {
        let mut known = self.values.iter().copied().flatten();
        let Some(first) = known.next() else {
            return false;
        };
        let (least, most) = known.fold((first, first), |(l, m), v| (l.min(v), m.max(v)));
        most - least < EVEN_RAD_S
    }
}

/// Pearson's correlation of what both have, with the second `shift` steps behind.
fn correlation(a: &Speeds, b: &Speeds, shift: i64) -> Option<f64> {
    let mut sums = [0.0; 5];
    let mut count = 0.0;
    let start = usize::try_from((-shift).max(0)).ok()?;
    let behind = usize::try_from(start as i64 + shift).ok()?;
    for (x, y) in a.values.get(start..)?.iter().zip(b.values.get(behind..)?) {
        let (Some(x), Some(y)) = (x, y) else { continue };
        count += 1.0;
        for (sum, value) in sums.iter_mut().zip([*x, *y, x * x, y * y, x * y]) {
            *sum += value;
        }
    }
    if count * STEP_SECS < LEAST_COMMON_SECS {
        return None;
    }
    let [x, y, xx, yy, xy] = sums.map(|sum| sum / count);
    let spread = ((xx - x * x) * (yy - y * y)).sqrt();
    (spread > 1e-9).then(|| (xy - x * y) / spread)
}
