//! Whether a walk went up and down as its barometer says: where a stretch of it lies on another floor than it was, the pressure knows nothing of
//! the step between them.

use std::ops::Range;

use lsfb_geometry::{Trajectory, Vector3};
use lsfb_recording::{Recording, TopicSummary, message};
use lsfb_types::{Finding, Limit, Timestamp, Verdict, median};
use serde::{Deserialize, Serialize};

use crate::Error;

/// How far pressure falls to a share of 1/e, metres: R T / (M g) of dry air at 15 °C (ISO 2533).
const SCALE_HEIGHT_M: f64 = 8434.0;
/// Pressures are averaged over this long, seconds.
const SPAN_SECS: f64 = 1.0;
/// So many spans before and behind a moment say whether there is a step.
const SPANS: usize = 10;
/// Fewer do not.
const FEWEST_SPANS: usize = 4;
/// So many that all differ from both sides are doubtful; no more, as a gust or a hand that presses a tight phone lasts as long.
const BRIEF_SPANS: usize = 2;
/// Farther apart in time the weather and the building's ventilation may have changed, seconds.
const LONGEST_GAP_SECS: f64 = 120.0;
/// A door or a fan changes the pressure by some pascals; floors are three metres apart.
const USUAL_M: f64 = 1.0;
const MOST_M: f64 = 1.8;

/// Heights of a trajectory beside those of the barometer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BarometerAgreement {
    /// Seconds of the walk that were compared.
    pub compared_secs: f64,
    /// Largest step of the one that is none of the other, metres: upwards in the trajectory where it is positive.
    pub largest_step_m: f64,
    /// When it is.
    pub at_ns: i64,
    /// Largest difference of two or three seconds from what is before and behind them, metres.
    pub largest_brief_m: f64,
    /// When they begin.
    pub brief_at_ns: i64,
}

impl BarometerAgreement {
    /// As every command says it.
    pub fn finding(&self) -> Finding {
        let (step_m, brief_m) = (self.largest_step_m.abs(), self.largest_brief_m.abs());
        let is_brief = step_m <= USUAL_M && brief_m > MOST_M;
        let (off_m, at_ns) = match is_brief {
            true => (brief_m, self.brief_at_ns),
            false => (step_m, self.at_ns),
        };
        let what = format!(
            "over {:.0} s, heights agree with the pressure to {off_m:.1} m, worst {} {}",
            self.compared_secs,
            if is_brief {
                "for some seconds from"
            } else {
                "at"
            },
            Timestamp::from_nanos(at_ns)
        );
        let (verdict, most_m) = match step_m {
            m if m > MOST_M => (Verdict::Fail, MOST_M),
            _ if is_brief => (Verdict::Warn, MOST_M),
            m => (Verdict::Warn.unless(m <= USUAL_M), USUAL_M),
        };
        Finding::new("barometer", verdict, "trajectory", what)
            .value(off_m, "m")
            .limit(Limit::AtMost(most_m))
            .remedy("check the trajectory there: one side of that moment may be on another floor")
    }
}

/// A second of the walk.
struct Span {
    time: Timestamp,
    /// By how much the trajectory is above what the barometer says, up to a constant, metres.
    above_m: f64,
}

/// Holds the heights of a trajectory against the walk's barometer; `up` is the direction away from the earth in its world, of any length. `None`
/// without a barometer, or where it saw too little of the walk.
pub fn barometer_agreement(
    recording: &Recording,
    trajectory: &Trajectory,
    up: &Vector3<f64>,
) -> Result<Option<BarometerAgreement>, Error> {
    let is_barometer =
        |t: &&TopicSummary| t.schema == message::FLUID_PRESSURE.name && t.messages > 0;
    // Of several any will do: the air is the same.
    let Some(topic) = recording.topics().iter().find(is_barometer) else {
        return Ok(None);
    };
    let mut pressures: Vec<(Timestamp, f64)> = Vec::new();
    for item in recording.pressure(Some(&topic.topic))? {
        let item = item?;
        let pressure_pa = item.sample.pressure_pa;
        if pressure_pa.is_finite() && pressure_pa > 0.0 {
            pressures.push((item.time, pressure_pa));
        }
    }
    pressures.sort_by_key(|p| p.0);
    let Some(up) = up.try_normalize(f64::MIN_POSITIVE) else {
        return Ok(None);
    };
    let spans = spans(&pressures, trajectory, &up);
    Ok(agreement(&spans))
}

fn spans(pressures: &[(Timestamp, f64)], trajectory: &Trajectory, up: &Vector3<f64>) -> Vec<Span> {
    let Some(&(first, reference_pa)) = pressures.first() else {
        return Vec::new();
    };
    let number = |time: Timestamp| (time.secs_since(first) / SPAN_SECS) as i64;
    let above = |&(time, pressure_pa): &(Timestamp, f64)| {
        let height_m = position_m(trajectory, time)?.dot(up);
        let by_pressure_m = -SCALE_HEIGHT_M * (pressure_pa / reference_pa).ln();
        Some((time, height_m - by_pressure_m))
    };
    let known: Vec<(Timestamp, f64)> = pressures.iter().filter_map(above).collect();
    known
        .chunk_by(|a, b| number(a.0) == number(b.0))
        .filter_map(|chunk| {
            Some(Span {
                time: chunk.first()?.0,
                above_m: median(chunk.iter().map(|k| k.1).collect())?,
            })
        })
        .collect()
}

/// Where the walk was between two poses that are close in time.
fn position_m(trajectory: &Trajectory, time: Timestamp) -> Option<Vector3<f64>> {
    let poses = trajectory.poses();
    let next = poses.partition_point(|p| p.time < time);
    let (start, end) = (poses.get(next.checked_sub(1)?)?, poses.get(next)?);
    let is_close = end.time.secs_since(start.time) <= SPAN_SECS;
    let pose = is_close.then(|| trajectory.at(time)).flatten()?;
    Some(pose.translation)
}

/// The largest step between two sides of a moment, or of all of a few seconds in a row, which the medians of sides do not feel, from both of theirs.
fn agreement(spans: &[Span]) -> Option<BarometerAgreement> {
    let last = spans.len();
    let steps = (FEWEST_SPANS..=last.saturating_sub(FEWEST_SPANS)).filter_map(|k| {
        let (before, behind) = sides(spans, k..k);
        Some((behind? - before?, spans.get(k)?.time))
    });
    let stretches = |count: usize| {
        (0..(last + 1).saturating_sub(count)).filter_map(move |k| {
            let (Some(before), Some(behind)) = sides(spans, k..k + count) else {
                return None;
            };
            let inside = spans[k..k + count].iter().map(|span| span.above_m);
            let off_m = inside
                .flat_map(|above_m| [above_m - before, above_m - behind])
                .reduce(nearer_zero)?;
            Some((off_m, spans[k].time))
        })
    };
    let (largest_step_m, at) = largest(steps.chain((FEWEST_SPANS..SPANS).flat_map(stretches)))?;
    let brief = largest((BRIEF_SPANS..FEWEST_SPANS).flat_map(stretches));
    let (largest_brief_m, brief_at) = brief.unwrap_or((0.0, at));
    Some(BarometerAgreement {
        compared_secs: SPAN_SECS * last as f64,
        largest_step_m,
        at_ns: at.nanos(),
        largest_brief_m,
        brief_at_ns: brief_at.nanos(),
    })
}

/// Levels before and behind some spans, metres; `None` of a side with too few.
fn sides(spans: &[Span], inside: Range<usize>) -> (Option<f64>, Option<f64>) {
    let level_m = |side: &[Span], at: Option<&Span>| {
        let at = at?.time;
        let is_near = |span: &&Span| span.time.secs_since(at).abs() <= LONGEST_GAP_SECS;
        let near: Vec<f64> = side.iter().filter(is_near).map(|s| s.above_m).collect();
        (near.len() >= FEWEST_SPANS).then(|| median(near)).flatten()
    };
    let before = &spans[inside.start.saturating_sub(SPANS)..inside.start];
    let behind = &spans[inside.end..spans.len().min(inside.end + SPANS)];
    let last = inside.end.saturating_sub(1).max(inside.start);
    (
        level_m(before, spans.get(inside.start)),
        level_m(behind, spans.get(last)),
    )
}

/// Zero where one is up and the other down.
fn nearer_zero(a: f64, b: f64) -> f64 {
    match a.signum() == b.signum() {
        true if a.abs() < b.abs() => a,
        true => b,
        false => 0.0,
    }
}

fn largest(found: impl Iterator<Item = (f64, Timestamp)>) -> Option<(f64, Timestamp)> {
    // Of equal ones the first.
    found.reduce(|most, next| match next.0.abs() > most.0.abs() {
        true => next,
        false => most,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A walk of a minute up a stair of three metres in its middle, by a barometer with echoes of doors; one that stays where it is on the other
    /// side.
    fn spans_of(stair_m: f64, believed_m: f64) -> Vec<Span> {
        (0..60)
            .map(|second| {
                let is_up = f64::from(u8::from(second >= 30));
                let door_m = 0.3 * f64::from(second % 3 - 1);
                Span {
                    time: Timestamp::from_nanos(1_000_000_000 * i64::from(second)),
                    above_m: is_up * (believed_m - stair_m) + door_m + 0.005 * f64::from(second),
                }
            })
            .collect()
    }

    fn verdict(spans: &[Span]) -> Option<Verdict> {
        agreement(spans).map(|found| found.finding().verdict)
    }

    #[test]
    fn a_step_that_the_barometer_did_not_feel_fails() {
        assert_eq!(verdict(&spans_of(0.0, 0.0)), Some(Verdict::Pass));
        assert_eq!(verdict(&spans_of(3.0, 3.0)), Some(Verdict::Pass));
        assert_eq!(verdict(&spans_of(0.0, 3.0)), Some(Verdict::Fail));
        assert_eq!(verdict(&spans_of(3.0, 0.0)), Some(Verdict::Fail));
        assert_eq!(verdict(&spans_of(0.0, 1.5)), Some(Verdict::Warn));
        let found = agreement(&spans_of(3.0, 0.0)).expect("enough");
        assert!((found.largest_step_m + 3.0).abs() < 0.3, "{found:?}");
        assert_eq!(found.at_ns, 30_000_000_000);
    }

    /// What lies a floor higher for some seconds differs from both sides, where their medians feel nothing; at an end they do.
    #[test]
    fn some_seconds_on_another_floor_are_seen() {
        for (secs, begins, expected) in [
            (2, 20, Verdict::Warn),
            (3, 20, Verdict::Warn),
            (4, 20, Verdict::Fail),
            (5, 20, Verdict::Fail),
            (3, 0, Verdict::Fail),
            (3, 57, Verdict::Fail),
        ] {
            let mut spans = spans_of(3.0, 3.0);
            for span in &mut spans[begins..begins + secs] {
                span.above_m += 3.0;
            }
            let found = agreement(&spans).expect("enough");
            assert_eq!(found.finding().verdict, expected, "{secs} {found:?}");
        }
        // A door that opens for a second.
        let mut spans = spans_of(3.0, 3.0);
        spans[20].above_m += 3.0;
        assert_eq!(verdict(&spans), Some(Verdict::Pass));
    }

    #[test]
    fn a_short_walk_says_nothing() {
        assert_eq!(verdict(&spans_of(0.0, 3.0)[27..33]), None);
        assert_eq!(verdict(&[]), None);
    }
}
