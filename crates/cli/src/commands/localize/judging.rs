//! What a localization is worth.

use lsfb_types::{Finding, Judgement, Limit, Verdict};

use super::Summary;

/// Share of images below which poses may all be those that are accepted by chance. Walks of fewer give no pose at all.
const FEW: f64 = 0.2;

/// Nothing found is no success, whatever the reason; nor are poses in a map that failed.
pub fn judgement(summary: &Summary, damaged: u64) -> Judgement {
    let failed = summary.map_failures.iter().map(|why| {
        let what = format!(
            "failed its checks when it was made ({why}): poses in it may be far from the truth"
        );
        Finding::new("map-failed", Verdict::Fail, "map", what)
            .remedy("mend that and map the place again")
    });
    let share = summary.localized as f64 / summary.images.max(1) as f64;
    let what = format!("{} of {} localized", summary.localized, summary.images);
    let verdict = match summary.localized {
        0 => Verdict::Fail,
        _ => Verdict::Warn.unless(share >= FEW),
    };
    let localized = Finding::new("localized", verdict, "images", what)
        .value(100.0 * share, "%")
        .limit(Limit::AtLeast(100.0 * FEW))
        .remedy("check that they show the map's place; the reasons of the frames say what each of them lacks");
    let listed = summary
        .right
        .map(|right| right_as_listed(right, summary.localized, summary.min_probability));
    let by_little = (summary.by_little > 0).then(|| {
        let what = format!(
            "{} localized with so little evidence that a similar place outside the map could explain it",
            summary.by_little
        );
        Finding::new("little-evidence", Verdict::Warn, "images", what)
            .value(summary.by_little as f64, "")
            .remedy("make sure that the map contains the place")
    });
    let damaged = (damaged > 0).then(|| {
        let what = format!("{damaged} damaged images or messages were left out");
        Finding::new("damaged", Verdict::Warn, "images", what).value(damaged as f64, "")
    });
    let of_images = [listed.flatten(), by_little, damaged].into_iter().flatten();
    Judgement::new(failed.chain([localized]).chain(of_images).collect())
}

/// Whether poses are as often right by those that are listed as they are said to be; `None` where there are none.
fn right_as_listed(right: usize, localized: usize, min_probability: f64) -> Option<Finding> {
    let wrong = localized - right;
    let most = 1.0 - min_probability;
    let share = (localized > 0).then(|| wrong as f64 / localized as f64)?;
    let what = format!("{wrong} of {localized} poses are more than 10 cm or 5° from those listed");
    let verdict = Verdict::Warn.unless(share <= most);
    let finding = Finding::new("listed-poses", verdict, "poses", what)
        .value(100.0 * share, "%")
        .limit(Limit::AtMost(100.0 * most))
        .remedy("check that the poses listed are in the map's frame and unit, and that the images show its place");
    Some(finding)
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

    /// One image of ten of another place, and poses that are all metres from those listed, had no problems.
    #[test]
    fn few_that_are_found_and_poses_unlike_those_listed_are_no_pass() {
        let verdict = |localized, right| {
            let listed = Summary {
                right,
                ..summary(localized, 0, &[])
            };
            judgement(&listed, 0).verdict()
        };
        assert_eq!(verdict(1, None), Verdict::Warn);
        assert_eq!(verdict(2, None), Verdict::Pass);
        assert_eq!(verdict(9, Some(9)), Verdict::Pass);
        assert_eq!(verdict(9, Some(8)), Verdict::Warn);
        assert_eq!(verdict(9, Some(0)), Verdict::Warn);
        assert_eq!(verdict(0, Some(0)), Verdict::Fail);
    }
}
