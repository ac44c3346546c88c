/// The middle one of some numbers, of an even count the upper of two; `None` of none.
pub fn median(values: Vec<f64>) -> Option<f64> {
    quantile(values, 0.5)
}

/// The number that a share (0 to 1) of some numbers lies below: the one that many places up in their order, rounded down, at most the
/// largest. `None` of none.
pub fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let at = ((share * values.len() as f64) as usize).min(last);
    let (_, found, _) = values.select_nth_unstable_by(at, f64::total_cmp);
    Some(*found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_members_in_order() {
        let values = || {
            (0..101)
                .map(|k| f64::from((k * 37) % 101))
                .collect::<Vec<_>>()
        };
        for (share, expected) in [(0.0, 0.0), (0.5, 50.0), (0.95, 95.0), (1.0, 100.0)] {
            assert_eq!(quantile(values(), share), Some(expected), "{share}");
        }
        assert_eq!(median(vec![3.0, 1.0, 2.0, 4.0]), Some(3.0));
        assert_eq!(median(vec![7.0]), Some(7.0));
        assert_eq!(median(Vec::new()), None);
        // What cannot be compared comes last.
        assert_eq!(median(vec![f64::NAN, 1.0, 2.0]), Some(2.0));
    }
}
