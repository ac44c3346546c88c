//! How many random samples a consensus needs.

/// Samples of so many until one of inliers only has been drawn with the given probability (Fischler and Bolles, "Random sample consensus",
/// CACM 1981).
pub(crate) fn samples_needed(inlier_ratio: f64, sample_size: i32, confidence: f64) -> usize {
    let good = inlier_ratio.powi(sample_size);
    if good >= 1.0 {
        return 0;
    }
    let needed = (1.0 - confidence).max(1e-12).ln() / (1.0 - good).ln();
    if needed.is_finite() {
        needed.ceil() as usize
    } else {
        usize::MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 − (1 − w^s)^n ≥ p, by hand: half inliers, three at a time: 35 for 0.99.
    #[test]
    fn samples_are_as_many_as_the_probability_asks() {
        assert_eq!(samples_needed(0.5, 3, 0.99), 35);
        assert_eq!(samples_needed(0.5, 5, 0.99), 146);
        assert_eq!(samples_needed(1.0, 5, 0.99), 0);
        assert_eq!(samples_needed(0.0, 5, 0.99), usize::MAX);
    }
}
