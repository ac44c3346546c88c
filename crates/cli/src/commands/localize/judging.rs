//! What a localization is worth.

use lsfb_types::{Finding, Judgement, Limit, Verdict};

use super::Summary;

/// Nothing found is no success, whatever the reason; nor are poses in a map that failed.
pub fn judgement(summary: &Summary, damaged: u64) -> Judgement {
    let failed = summary.map_failures.iter().map(|why| {
        let what = format!(
            "failed its checks when it was made ({why}): poses in it may be far from the truth"
        );
        Finding::new("map-failed", Verdict::Fail, "map", what)
            .remedy("mend that and map the place again")
    });
    let share = 100.0 * summary.localized as f64 / summary.images.max(1) as f64;
    let what = format!("{} of {} localized", summary.localized, summary.images);
    let verdict = Verdict::Fail.unless(summary.localized > 0);
    let localized = Finding::new("localized", verdict, "images", what)
        .value(share, "%")
        .remedy("look at the reasons of the frames: they say what each of them lacks");
    let by_little = (summary.by_little > 0).then(|| {
        let what = format!(
            "{} localized with so little evidence that a similar place outside the map could explain it",
            summary.by_little
        );
        Finding::new("little-evidence", Verdict::Warn, "images", what)
            .value(summary.by_little as f64, "")
            .limit(Limit::AtMost(0.0))
            .remedy("make sure that the map contains the place")
    });
    let damaged = (damaged > 0).then(|| {
        let what = format!("{damaged} damaged images or messages were left out");
        Finding::new("damaged", Verdict::Warn, "images", what)
            .value(damaged as f64, "")
            .limit(Limit::AtMost(0.0))
    });
    let findings = failed.chain([localized]).chain(by_little).chain(damaged);
    Judgement::new(findings.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(localized: usize, by_little: usize, map_failures: &[&str]) -> Summary {
        Summary {
            images: 10,
            localized,
            min_probability: 0.99,
            more_than_30_inliers: localized,
            by_little,
            right: None,
            recall: Vec::new(),
            median_distance_m: None,
            median_angle_deg: None,
            map_failures: map_failures.iter().map(|why| (*why).to_owned()).collect(),
            frames: Vec::new(),
        }
    }

    #[test]
    fn nothing_found_and_maps_that_failed_fail() {
        let verdict = |summary, damaged| judgement(&summary, damaged).verdict();
        assert_eq!(verdict(summary(9, 0, &[]), 0), Verdict::Pass);
        assert_eq!(verdict(summary(0, 0, &[]), 0), Verdict::Fail);
        assert_eq!(verdict(summary(9, 2, &[]), 0), Verdict::Warn);
        assert_eq!(verdict(summary(9, 0, &[]), 1), Verdict::Warn);
        let failed = judgement(&summary(9, 0, &["the IMU: its axes are exchanged"]), 0);
        assert_eq!(failed.verdict(), Verdict::Fail);
        assert!(failed.headline("").contains("its axes are exchanged"));
    }
}
