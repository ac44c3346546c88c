//! Findings that several steps have in common.

use lsfb_types::{Finding, Limit, Verdict};

use crate::coverage::{empty_corners, empty_parts};

/// Share of outliers above which a warning is due.
const MOST_OUTLIERS: f64 = 0.05;
/// And above which what is left says nothing of the camera: a quarter of all corners belongs to something else.
const FAILED_OUTLIERS: f64 = 0.25;

/// In how much of a camera's image corners were seen.
pub(crate) fn coverage(camera: &str, cells: &[u32], least: f64) -> Finding {
    let seen = cells.iter().filter(|n| **n > 0).count();
    let share = seen as f64 / cells.len().max(1) as f64;
    let limit = Limit::AtLeast(100.0 * least);
    let percent = 100.0 * share;
    let verdict = Verdict::Warn.unless(limit.holds(percent));
    let seen = format!("corners cover {percent:.0} % of the image");
    let what = match verdict {
        Verdict::Pass => seen,
        _ => format!("poorly covered: {seen}"),
    };
    Finding::new("coverage", verdict, camera, what)
        .value(percent.round(), "%")
        .limit(limit)
        .remedy(format!("move the board into {}", empty_parts(cells)))
}

/// Corners of the image in which nothing was seen: there the lens is continued, not measured. `None` where all were seen.
pub(crate) fn unseen_corners(camera: &str, cells: &[u32]) -> Option<Finding> {
    let empty = empty_corners(cells);
    if empty.is_empty() {
        return None;
    }
    let what = format!(
        "no corners in {} of the image: the lens is extrapolated there",
        empty.join(", ")
    );
    let finding = Finding::new("image-corners", Verdict::Unknown, camera, what);
    Some(finding.remedy("show the board there, unless the lens is dark in that corner"))
}

/// How many corners a camera's views could not explain.
pub(crate) fn outliers(camera: &str, outliers: usize, corners: usize) -> Finding {
    let percent = 100.0 * outliers as f64 / corners.max(1) as f64;
    let failed = Limit::AtMost(100.0 * FAILED_OUTLIERS);
    let (worst, limit) = match failed.holds(percent) {
        true => (Verdict::Warn, Limit::AtMost(100.0 * MOST_OUTLIERS)),
        false => (Verdict::Fail, failed),
    };
    let what = format!("{outliers} of {corners} corners are outliers");
    Finding::new("outliers", worst, camera, what)
        .judged(percent, "%", limit)
        .remedy(
            "check that the board is flat, hold it still, and use enough light for short exposures",
        )
}

/// How views that were held back from the adjustment are met.
pub(crate) fn holdout(camera: &str, holdout_px: f64, adjusted_px: f64, most_px: f64) -> Finding {
    let limit = Limit::AtMost(most_px);
    let what = format!(
        "reprojection error {holdout_px:.2} px on held-out views, {adjusted_px:.2} px on the others"
    );
    Finding::new("holdout", Verdict::Warn, camera, what)
        .judged(holdout_px, "px", limit)
        .remedy("record more views")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coverage::COVERAGE_CELLS;

    /// A rig with 30 % of the corners left out was written, with a warning: half of the images were another camera's.
    #[test]
    fn a_quarter_of_outliers_fails() {
        for (count, verdict) in [
            (5, Verdict::Pass),
            (6, Verdict::Warn),
            (25, Verdict::Warn),
            (26, Verdict::Fail),
        ] {
            assert_eq!(outliers("cam0", count, 100).verdict, verdict, "{count}");
        }
    }

    /// Three quarters of the image are covered, which is enough; its lower right corner is not, and the lens is not known there.
    #[test]
    fn a_corner_of_the_image_without_observations_is_remarked() {
        let [columns, rows] = COVERAGE_CELLS;
        let mut cells = vec![3; columns * rows];
        assert_eq!(unseen_corners("cam0", &cells), None);
        for (k, count) in cells.iter_mut().enumerate() {
            let (row, column) = (k / columns, k % columns);
            if row >= rows / 2 && column >= columns / 2 {
                *count = 0;
            }
        }
        assert_eq!(coverage("cam0", &cells, 0.5).verdict, Verdict::Pass);
        let remark = unseen_corners("cam0", &cells).expect("a remark");
        assert_eq!(remark.verdict, Verdict::Unknown);
        assert!(remark.what.contains("the lower right corner"), "{remark:?}");
        assert!(!remark.what.contains("upper"), "{remark:?}");
    }
}
