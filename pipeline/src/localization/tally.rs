//! What a localization of many images is worth.

use lsfb_types::{Finding, Judgement, Limit, Verdict};

use super::sequence::LEAST_LOCALIZED;

/// A pose counts as right within these of one that is listed, metres and degrees, as in the benchmarks of the field.
pub const RIGHT_DISTANCE_M: f64 = 0.10;
/// See [`RIGHT_DISTANCE_M`].
pub const RIGHT_ANGLE_DEG: f64 = 5.0;

/// What became of all images that were to be localized.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tally {
    /// Images, or instants of a walk.
    pub images: usize,
    /// Those that have a pose.
    pub localized: usize,
    /// Those whose pose has so little evidence that a place outside the map that looks the same may have all of it
    /// ([`Evidence::is_thin`](super::Evidence::is_thin)).
    pub by_little: usize,
    /// Poses within [`RIGHT_DISTANCE_M`] and [`RIGHT_ANGLE_DEG`] of those that are listed; `None` where none are.
    pub right: Option<usize>,
    /// Least probability of a pose that is given.
    pub min_probability: f64,
    /// Images or messages that could not be read.
    pub damaged: u64,
}

impl Tally {
    /// Nothing found is no success, whatever the reason; nor are poses in a map that failed, of which
    /// [`HdMap::failed_checks`](crate::hd_map::HdMap::failed_checks) are given.
    pub fn judgement(&self, failed_checks: impl IntoIterator<Item = Finding>) -> Judgement {
        let of_map = failed_checks.into_iter().chain([self.localized()]);
        let of_images = [self.as_listed(), self.little_evidence(), self.damaged()];
        Judgement::new(of_map.chain(of_images.into_iter().flatten()).collect())
    }

    /// As few as of a walk that is refused for it may all be those that are accepted by chance.
    fn localized(&self) -> Finding {
        let share = self.localized as f64 / self.images.max(1) as f64;
        let what = format!("{} of {} localized", self.localized, self.images);
        let verdict = match self.localized {
            0 => Verdict::Fail,
            _ => Verdict::Warn.unless(share >= LEAST_LOCALIZED),
        };
        Finding::new("localized", verdict, "images", what)
            .value(100.0 * share, "%")
            .limit(Limit::AtLeast(100.0 * LEAST_LOCALIZED))
            .remedy("check that they show the map's place; the reasons of the frames say what each of them lacks")
    }

    /// Whether poses are as often right by those that are listed as they are said to be; `None` where there are none.
    fn as_listed(&self) -> Option<Finding> {
        let wrong = self.localized.saturating_sub(self.right?);
        let most = 1.0 - self.min_probability;
        let share = (self.localized > 0).then(|| wrong as f64 / self.localized as f64)?;
        let what = format!(
            "{wrong} of {} poses are more than {:.0} cm or {RIGHT_ANGLE_DEG:.0}° from those listed",
            self.localized,
            100.0 * RIGHT_DISTANCE_M
        );
        let finding = Finding::new("listed-poses", Verdict::Warn.unless(share <= most), "poses", what)
            .value(100.0 * share, "%")
            .limit(Limit::AtMost(100.0 * most))
            .remedy("check that the poses listed are in the map's frame and unit, and that the images show its place");
        Some(finding)
    }

    fn little_evidence(&self) -> Option<Finding> {
        let what = format!(
            "{} localized with so little evidence that a similar place outside the map could explain it",
            self.by_little
        );
        let finding = Finding::new("little-evidence", Verdict::Warn, "images", what)
            .value(self.by_little as f64, "")
            .remedy("make sure that the map contains the place");
        (self.by_little > 0).then_some(finding)
    }

    fn damaged(&self) -> Option<Finding> {
        let what = format!("{} damaged images or messages were left out", self.damaged);
        let finding = Finding::new("damaged", Verdict::Warn, "images", what);
        (self.damaged > 0).then_some(finding.value(self.damaged as f64, ""))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tally(localized: usize) -> Tally {
        Tally {
            images: 10,
            localized,
            by_little: 0,
            right: None,
            min_probability: 0.99,
            damaged: 0,
        }
    }

    #[test]
    fn nothing_found_and_maps_that_failed_fail() {
        let verdict = |tally: Tally| tally.judgement([]).verdict();
        assert_eq!(verdict(tally(9)), Verdict::Pass);
        assert_eq!(verdict(tally(0)), Verdict::Fail);
        let by_little = 2;
        assert_eq!(
            verdict(Tally {
                by_little,
                ..tally(9)
            }),
            Verdict::Warn
        );
        let damaged = 1;
        assert_eq!(
            verdict(Tally {
                damaged,
                ..tally(9)
            }),
            Verdict::Warn
        );
        let map = Finding::new("failed-map", Verdict::Fail, "map", "axes are exchanged");
        let failed = tally(9).judgement([map]);
        assert_eq!(failed.verdict(), Verdict::Fail);
        assert!(failed.headline("").contains("axes are exchanged"));
    }

    /// One image of ten of another place, and poses that are all metres from those listed, had no problems.
    #[test]
    fn few_that_are_found_and_poses_unlike_those_listed_are_no_pass() {
        let verdict = |localized, right| {
            let listed = Tally {
                right,
                ..tally(localized)
            };
            listed.judgement([]).verdict()
        };
        assert_eq!(verdict(1, None), Verdict::Warn);
        assert_eq!(verdict(2, None), Verdict::Pass);
        assert_eq!(verdict(9, Some(9)), Verdict::Pass);
        assert_eq!(verdict(9, Some(8)), Verdict::Warn);
        assert_eq!(verdict(9, Some(0)), Verdict::Warn);
        assert_eq!(verdict(0, Some(0)), Verdict::Fail);
    }
}
