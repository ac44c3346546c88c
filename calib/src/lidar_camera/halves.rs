//! Whether what two halves of the poses find agrees, and whether the result of all lies between them.

use lsfb_geometry::Vector6;
use lsfb_types::{Finding, Limit, Verdict};

/// Standard deviations beyond which halves disagree.
const DEVIATIONS: f64 = 4.0;
/// Components of a pose as words, rotations first.
const NAMES: [&str; 6] = [
    "rotation about the LiDAR's x axis",
    "rotation about the LiDAR's y axis",
    "rotation about the LiDAR's z axis",
    "translation along the LiDAR's x axis",
    "translation along the LiDAR's y axis",
    "translation along the LiDAR's z axis",
];

/// What is said of halves that lie `from_whole` (tangents, rad and m) from the result of all poses, of standard deviations `sigma`.
///
/// Each half is known √2 times worse than the whole, so their difference twice as badly. A whole that lies beside both of them contradicts
/// them as well, by as much as it is farther than the nearer one.
pub(super) fn finding(camera: &str, from_whole: &[Vector6<f64>; 2], sigma: &[f64; 6]) -> Finding {
    let [first, second] = from_whole;
    let deviations = |k: usize| {
        let sigma = sigma[k].max(f64::MIN_POSITIVE);
        let apart = (first[k] - second[k]).abs() / (2.0 * sigma);
        let is_beside = first[k] * second[k] > 0.0;
        let beside = first[k].abs().min(second[k].abs()) / sigma;
        if is_beside { apart.max(beside) } else { apart }
    };
    let worst = (0..6)
        .max_by(|a, b| deviations(*a).total_cmp(&deviations(*b)))
        .unwrap_or_default();
    let (factor, unit) = match worst {
        0..=2 => (1f64.to_degrees(), "°"),
        _ => (1e3, " mm"),
    };
    let [first, second] = [first[worst], second[worst]].map(|v| v * factor);
    let value = deviations(worst);
    let limit = Limit::AtMost(DEVIATIONS);
    let what = format!(
        "in {}, two halves of the poses are {first:+.2}{unit} and {second:+.2}{unit} from the result of all poses: {value:.1} standard deviations",
        NAMES[worst]
    );
    Finding::new("halves", Verdict::Warn, camera, what)
        .judged(value, "σ", limit)
        .remedy("check that nothing moved between the poses and that the lens belongs to these images, and record more poses")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_that_disagree_and_a_whole_beside_both_are_warned_of() {
        let sigma = [1e-3, 1e-3, 1e-3, 2e-3, 2e-3, 2e-3];
        let verdict = |first: [f64; 6], second: [f64; 6]| {
            finding("cam0", &[first.into(), second.into()], &sigma)
        };
        let near = verdict([1e-3, 0.0, 0.0, 2e-3, 0.0, 0.0], [-1e-3; 6]);
        assert_eq!(near.verdict, Verdict::Pass, "{near:?}");
        let apart = verdict(
            [0.0, 0.0, 0.0, 0.0, 0.0, 9e-3],
            [0.0, 0.0, 0.0, 0.0, 0.0, -9e-3],
        );
        assert_eq!(apart.verdict, Verdict::Warn);
        assert!(
            apart.what.contains("z axis") && apart.what.contains("+9.00 mm"),
            "{apart:?}"
        );
        // They agree with each other, and not with what is reported.
        let beside = verdict(
            [0.0, 0.0, 0.0, 9e-3, 0.0, 0.0],
            [0.0, 0.0, 0.0, 9e-3, 0.0, 0.0],
        );
        assert_eq!(beside.verdict, Verdict::Warn, "{beside:?}");
    }
}
