//! How often a pose was found.

use serde::Serialize;

/// What counts as found: both are kept.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Threshold {
    /// Largest rotation error, degrees.
    pub rotation_deg: f64,
    /// Largest translation error, metres.
    pub translation_m: f64,
}

impl Threshold {
    /// As benchmarks of localization have it: fine and coarse.
    pub const USUAL: [Self; 2] = [
        Self {
            rotation_deg: 1.0,
            translation_m: 0.1,
        },
        Self {
            rotation_deg: 5.0,
            translation_m: 1.0,
        },
    ];
}

/// How many poses are within a threshold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Recall {
    /// What counts as found.
    #[serde(flatten)]
    pub threshold: Threshold,
    /// Share of the matched poses within it, 0 to 1.
    pub of_matched: f64,
    /// Share of the truth found: that of the matched poses times the share of the truth that the estimate covers. An estimate that
    /// speaks only where it is sure does not gain by it.
    pub of_truth: f64,
}

/// `errors` are translation, metres, and rotation, degrees, of each matched pose.
pub(crate) fn recall(
    errors: impl ExactSizeIterator<Item = (f64, f64)>,
    threshold: Threshold,
    covered: f64,
) -> Recall {
    let matched = errors.len().max(1) as f64;
    let within = errors
        .filter(|(metres, degrees)| {
            *metres <= threshold.translation_m && *degrees <= threshold.rotation_deg
        })
        .count();
    let of_matched = within as f64 / matched;
    Recall {
        threshold,
        of_matched,
        of_truth: of_matched * covered,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of the truth, all of it perfect: naive recall says 100 %.
    #[test]
    fn silence_is_not_found() {
        let errors = [(0.05, 0.5), (0.05, 2.0), (0.5, 0.5), (0.1, 1.0)];
        let found = recall(errors.into_iter(), Threshold::USUAL[0], 0.5);
        assert_eq!((found.of_matched, found.of_truth), (0.5, 0.25));
        let coarse = recall(errors.into_iter(), Threshold::USUAL[1], 0.5);
        assert_eq!((coarse.of_matched, coarse.of_truth), (1.0, 0.5));
    }
}
