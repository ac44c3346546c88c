//! What is said of how scans lie in a map.

use std::collections::BTreeSet;

use lsfb_geometry::Se3;
use lsfb_perception::statistics::median;
use lsfb_types::{Finding, Limit, Timestamp, Verdict};
use serde::{Deserialize, Serialize};

use crate::lidar_features::ScanOffset;

/// One scan may be of a crowd: of so many in a row the middle counts.
const IN_A_ROW: usize = 3;
/// So many scans held against keyframes say something together, and so many of those that are held against keyframes far away.
const LEAST_HELD: usize = 3;
const LEAST_FAR: usize = 6;
/// Of a scan that is held against a keyframe near by so much lies on its surfaces, as a share of what lies on surfaces where it has a part in them; of
/// one far away, which sees other things too.
const LEAST_SHARED: f64 = 0.5;
const LEAST_SHARED_FAR: f64 = 0.7;

/// A scan lies off only where it fits better elsewhere, by such a share of what it would gain ([`ScanOffset::gain`]). Across a vertical step of 10 cm on
/// stairs three pairs in four gain 0.45 and more; of those that right maps move by as much, scattered over the walk, one in four or fewer.
const LEAST_GAIN: f64 = 0.4;
/// And by so much must that logarithm grow in all: where a handful of points holds a direction, a scan of a right map is drawn some centimetres along it by chance
/// (3 to 7; across such steps 5 to 40).
const LEAST_EVIDENCE: f64 = 8.0;

/// What a map of some centimetres bears, metres, and what it does not: by what most of several pairs say. Right maps reach 3.4 cm where few surfaces hold
/// the height.
const LIMITS_M: [f64; 2] = [0.035, 0.05];
/// By the least that the pairs of a scan say, of scans in a row.
const LEAST_LIMIT_M: f64 = 0.02;
/// Of scans beside other visits, which see the same surfaces from elsewhere: right maps reach 5.5 cm.
const VISIT_LIMITS_M: [f64; 2] = [0.08, 0.12];

/// Which keyframe a scan is held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Beside {
    /// One of the next, before it or behind it.
    Next,
    /// The n-th before it or behind it.
    Far(usize),
    /// One of another visit.
    Revisit,
}

/// A scan held against a keyframe that it had no part in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeldScan {
    pub scan: Timestamp,
    pub keyframe: Timestamp,
    pub beside: Beside,
    /// Share of the scan's points that lie on surfaces of keyframes that it has a part in.
    pub expected: f64,
    /// `None` where hardly a surface of the keyframe is near.
    pub offset: Option<ScanOffset>,
}

impl HeldScan {
    /// Whether a time lies between the scan and the keyframe.
    fn bridges(&self, time: Timestamp) -> bool {
        let (a, b) = (self.scan, self.keyframe);
        a.min(b) < time && time < a.max(b)
    }

    /// The offset where enough of the scan lies on surfaces of the keyframe; none where it fits as well where it is.
    fn certain(&self) -> Option<ScanOffset> {
        let least = match self.beside {
            Beside::Next => LEAST_SHARED,
            Beside::Far(_) | Beside::Revisit => LEAST_SHARED_FAR,
        };
        let offset = self.offset?;
        let offset = match offset.gain < LEAST_GAIN || offset.evidence < LEAST_EVIDENCE {
            true => ScanOffset {
                correction: Se3::identity(),
                moved_m: 0.0,
                ..offset
            },
            false => offset,
        };
        (offset.on_surfaces >= least * self.expected).then_some(offset)
    }
}

/// How far scans lie off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanOffsets {
    /// Scans that were looked at and share enough with keyframes that they have no part in.
    pub scans: u64,
    /// How far their points would have to be moved, in the middle of all scans, metres.
    pub median_m: f64,
    /// The same of the worst part of the walk, metres.
    pub worst_m: f64,
    /// When that is, seconds after the first scan.
    pub worst_after_secs: f64,
    /// By how much it is turned there, degrees.
    pub turn_deg: f64,
    /// By how much it is shifted there, metres.
    pub shift_m: f64,
    /// The least that the next keyframes before and behind a scan say, of scans in a row where that is most, metres.
    #[serde(default)]
    pub least_m: f64,
    /// How far scans lie from the surfaces of other visits where that is most, metres; absent where there is none.
    #[serde(default)]
    pub visits_apart_m: Option<f64>,
    /// When that is, seconds after the first scan.
    #[serde(default)]
    pub visits_after_secs: f64,
    /// For how long in all too few scans share enough with keyframes before or behind them to tell, seconds.
    #[serde(default)]
    pub unseen_secs: f64,
    /// When the longest such time began, seconds after the first scan.
    #[serde(default)]
    pub unseen_after_secs: f64,
}

/// The one in the middle of what several scans say, by how far they lie off; `None` of too few.
fn middle(mut offsets: Vec<ScanOffset>, least: usize) -> Option<ScanOffset> {
    offsets.sort_by(|a, b| a.moved_m.total_cmp(&b.moved_m));
    let middle = offsets.len() / 2;
    offsets
        .get(middle)
        .copied()
        .filter(|_| offsets.len() >= least)
}

impl ScanOffsets {
    /// Of scans held against keyframes, in order of time, by when the first of all scans is.
    ///
    /// What pairs say together counts: those of scans in a row; those over a moment, as a step lies between their scans and their keyframes, near by and
    /// far away; those of scans in a row with other visits. And the least that all pairs of one scan say, on both of its sides: a trajectory may jump and come back.
    pub(super) fn of(first: Timestamp, held: &[HeldScan]) -> Self {
        let scans: Vec<&[HeldScan]> = held.chunk_by(|a, b| a.scan == b.scan).collect();
        let of = |pairs: &mut dyn Iterator<Item = &HeldScan>, least| {
            middle(pairs.filter_map(HeldScan::certain).collect(), least)
        };
        let mut said: Vec<(Timestamp, ScanOffset)> = Vec::new();
        let mut visits: Vec<(Timestamp, ScanOffset)> = Vec::new();
        let mut least_m = 0.0;
        let is_next = |h: &&HeldScan| h.beside == Beside::Next;
        let is_revisit = |h: &&HeldScan| h.beside == Beside::Revisit;
        for row in scans.windows(IN_A_ROW.min(scans.len()).max(1)) {
            let time = row[row.len() / 2][0].scan;
            let all = || row.iter().flat_map(|scan| scan.iter());
            said.extend(of(&mut all().filter(is_next), LEAST_HELD).map(|o| (time, o)));
            visits.extend(of(&mut all().filter(is_revisit), LEAST_HELD).map(|o| (time, o)));
            let least = row.iter().filter_map(|scan| {
                let next = scan.iter().filter(is_next).filter_map(HeldScan::certain);
                next.min_by(|a, b| a.moved_m.total_cmp(&b.moved_m))
            });
            let least = middle(least.collect(), 1).map_or(0.0, |o| o.moved_m);
            least_m = f64::max(least_m, least);
        }
        said.extend(scans.iter().filter_map(|scan| {
            let next = || {
                scan.iter()
                    .filter(is_next)
                    .filter(|h| h.certain().is_some())
            };
            let on_both_sides =
                next().any(|h| h.keyframe < h.scan) && next().any(|h| h.keyframe > h.scan);
            let of_all = next().filter_map(HeldScan::certain);
            let least = of_all.min_by(|a, b| a.moved_m.total_cmp(&b.moved_m));
            let offset = least.filter(|_| on_both_sides && next().count() >= LEAST_HELD)?;
            Some((scan[0].scan, offset))
        }));
        let far: BTreeSet<Beside> = held.iter().map(|h| h.beside).collect();
        let far = || far.iter().filter(|b| matches!(b, Beside::Far(_)));
        let (mut unseen_secs, mut unseen_after_secs) = (0.0, 0.0);
        let (mut since, mut longest_s) = (None, 0.0);
        for pair in scans.windows(2) {
            let (from, to) = (pair[0][0].scan, pair[1][0].scan);
            let secs = to.secs_since(from);
            let time = from.plus_secs(0.5 * secs);
            let over: Vec<&HeldScan> = held.iter().filter(|h| h.bridges(time)).collect();
            let next = || over.iter().copied().filter(is_next);
            let certain = next().filter(|h| h.certain().is_some()).count();
            let seen = of(&mut next(), LEAST_HELD).filter(|_| 2 * certain >= next().count());
            said.extend(seen.map(|o| (time, o)));
            for place in far() {
                let mut at = over.iter().copied().filter(|h| h.beside == *place);
                said.extend(of(&mut at, LEAST_FAR).map(|o| (time, o)));
            }
            if seen.is_some() {
                since = None;
                continue;
            }
            unseen_secs += secs;
            let began = *since.get_or_insert(from);
            if to.secs_since(began) > longest_s {
                longest_s = to.secs_since(began);
                unseen_after_secs = began.secs_since(first);
            }
        }
        let each = scans.iter().filter_map(|scan| {
            let certain = scan.iter().filter_map(HeldScan::certain);
            median(certain.map(|o| o.moved_m).collect())
        });
        let each: Vec<f64> = each.collect();
        let worst_of = |said: Vec<(Timestamp, ScanOffset)>| {
            said.into_iter()
                .max_by(|a, b| a.1.moved_m.total_cmp(&b.1.moved_m))
        };
        let visit = worst_of(visits).map(|(time, o)| (time.secs_since(first), o.moved_m));
        let worst = worst_of(said);
        let told = Self {
            least_m,
            visits_apart_m: visit.map(|(_, m)| m),
            visits_after_secs: visit.map_or(0.0, |(secs, _)| secs),
            scans: each.len() as u64,
            median_m: median(each).unwrap_or(0.0),
            unseen_secs,
            unseen_after_secs,
            ..Self::default()
        };
        worst.map_or(told, |(time, worst)| Self {
            worst_m: worst.moved_m,
            worst_after_secs: time.secs_since(first),
            turn_deg: worst.correction.rotation.angle().to_degrees(),
            shift_m: worst.correction.translation.norm(),
            ..told
        })
    }

    /// As every command and page says it.
    pub fn findings(&self) -> Vec<Finding> {
        let [warn, fail] = LIMITS_M;
        let verdict = match self.worst_m {
            worst if worst > fail => Verdict::Fail,
            worst if worst > warn || self.least_m > LEAST_LIMIT_M => Verdict::Warn,
            _ => Verdict::Pass,
        };
        let what = format!(
            "{:.1} s after the first scan, scans are {:.1} cm off the surfaces of other keyframes (rotated by {:.2}°, shifted by {:.1} cm; {:.1} cm median over {} scans, {:.1} cm where all neighbouring keyframes agree)",
            self.worst_after_secs,
            1e2 * self.worst_m,
            self.turn_deg,
            1e2 * self.shift_m,
            1e2 * self.median_m,
            self.scans,
            1e2 * self.least_m
        );
        let off = Finding::new("scans-off", verdict, "trajectory", what)
            .value(1e2 * self.worst_m, "cm")
            .limit(Limit::AtMost(1e2 * warn))
            .remedy("the map or its trajectory is bent there: start from a better trajectory, give images without gaps, and walk that part again");
        let is_seen = self.scans > 0 && self.unseen_secs <= 0.0;
        let what = match (is_seen, self.scans) {
            (true, _) => "throughout the walk, scans overlap enough with the keyframes before and after them".to_owned(),
            (false, 0) => "no scan overlaps enough with keyframes made from other scans: whether the map is bent is unknown".to_owned(),
            (false, _) => format!(
                "for {:.1} s in total, longest {:.1} s after the first scan, too few scans overlap enough with the keyframes before and after them: whether the map is bent or has a step there is unknown",
                self.unseen_secs, self.unseen_after_secs
            ),
        };
        let unseen = Finding::new("scans-unseen", Verdict::Warn.unless(is_seen), "trajectory", what)
            .value(self.unseen_secs, "s")
            .limit(Limit::AtMost(0.0))
            .remedy("look at the map there (`lsfb view`), and walk that part again, slowly where it is narrow");
        let visits = self.visits_apart_m.map(|apart_m| {
            let [warn, fail] = VISIT_LIMITS_M;
            let verdict = match apart_m {
                apart if apart > fail => Verdict::Fail,
                apart if apart > warn => Verdict::Warn,
                _ => Verdict::Pass,
            };
            let what = format!(
                "{:.1} s after the first scan, scans are {:.1} cm off the surfaces of other visits to the same place",
                self.visits_after_secs,
                1e2 * apart_m
            );
            Finding::new("visits-apart", verdict, "trajectory", what)
                .value(1e2 * apart_m, "cm")
                .limit(Limit::AtMost(1e2 * warn))
                .remedy("the visits do not match: close loops (close_loops = true), or start from a better trajectory")
        });
        let off = Some(off).filter(|_| self.scans > 0);
        [off, Some(unseen), visits].into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector3;

    use super::*;

    /// Scans of 10 s, each held against keyframes half a second to a second and a half before and behind it, whose places along a line are off by this.
    fn walk(off_m: impl Fn(f64) -> f64) -> ScanOffsets {
        let at = |secs: f64| Timestamp::from_secs_f64(secs);
        let hold = |k: i32| {
            let scan_s = 0.25 * f64::from(k);
            let keyframes = [-1.5, -1.0, -0.5, 0.5, 1.0, 1.5].map(|s| scan_s + s);
            let there = keyframes.into_iter().filter(|s| (0.0..=10.0).contains(s));
            let (here_m, off_m) = (off_m(scan_s), &off_m);
            let held = there.map(|keyframe_s| {
                let shift_m = off_m(keyframe_s) - here_m;
                // What is farther off is not met.
                let met = shift_m.abs() < 1.0;
                let offset = ScanOffset {
                    correction: Se3::new(Default::default(), Vector3::x() * shift_m),
                    moved_m: shift_m.abs(),
                    on_surfaces: 0.8,
                    evidence: 100.0,
                    gain: 1.0,
                };
                HeldScan {
                    scan: at(scan_s),
                    keyframe: at(keyframe_s),
                    beside: Beside::Next,
                    expected: 0.8,
                    offset: met.then_some(offset),
                }
            });
            held.collect::<Vec<_>>()
        };
        let held: Vec<HeldScan> = (0..41).flat_map(hold).collect();
        ScanOffsets::of(at(0.0), &held)
    }

    fn verdicts(offsets: &ScanOffsets) -> [Verdict; 2] {
        let findings = offsets.findings();
        [findings[0].verdict, findings[1].verdict]
    }

    /// Of two keyframes near a step one is on the scan's own side: the nearer-fitting one says that all is well.
    #[test]
    fn a_step_is_named() {
        let right = walk(|_| 0.0);
        assert_eq!(verdicts(&right), [Verdict::Pass; 2]);
        assert_eq!(right.scans, 41);
        let jump = walk(|s| if s == 5.25 { 0.3 } else { 0.0 });
        assert_eq!(verdicts(&jump)[0], Verdict::Fail, "{jump:?}");
        for (step_m, verdict) in [
            (0.04, Verdict::Warn),
            (0.06, Verdict::Fail),
            (0.6, Verdict::Fail),
        ] {
            let step = walk(|s| if s > 6.1 { step_m } else { 0.0 });
            assert_eq!(verdicts(&step), [verdict, Verdict::Pass], "{step:?}");
            assert!((step.worst_m - step_m).abs() < 1e-9 && step.median_m < 1e-9);
            assert!((step.worst_after_secs - 6.1).abs() < 0.8, "{step:?}");
        }
        // Beyond what can be met nothing is off, and that is said.
        let far = walk(|s| if s > 6.1 { 3.0 } else { 0.0 });
        assert_eq!(verdicts(&far), [Verdict::Pass, Verdict::Warn]);
        assert!((far.unseen_after_secs - 6.0).abs() < 0.3, "{far:?}");
        let nothing = ScanOffsets::of(Timestamp::from_nanos(0), &[]);
        assert_eq!(nothing.findings()[0].verdict, Verdict::Warn);
        assert_eq!(nothing.findings()[0].code, "scans-unseen");
    }

    #[test]
    fn a_part_of_a_walk_that_is_off_is_named() {
        let part = walk(|s| if (4.1..5.4).contains(&s) { 0.06 } else { 0.0 });
        assert_eq!(verdicts(&part)[0], Verdict::Fail, "{part:?}");
        let bent = walk(|s| 0.06 * s);
        assert_eq!(verdicts(&bent)[0], Verdict::Fail, "{bent:?}");
    }
}
