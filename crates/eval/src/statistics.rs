use serde::Serialize;

/// What is said about a list of errors, in the errors' own unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Number of errors.
    pub count: usize,
    /// Root of the mean square.
    pub rmse: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Middle value; mean of the two middle ones where their number is even.
    pub median: f64,
    /// Standard deviation about the mean, divided by n.
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Sum of squares, unit squared.
    pub sse: f64,
}

impl Statistics {
    /// Of a list; `None` where it is empty.
    pub fn of(errors: &[f64]) -> Option<Self> {
        let count = errors.len();
        let (min, max) = errors
            .iter()
            .fold((*errors.first()?, *errors.first()?), |(l, h), e| {
                (
                    if e.total_cmp(&l).is_lt() { *e } else { l },
                    if e.total_cmp(&h).is_gt() { *e } else { h },
                )
            });
        let n = count as f64;
        let sse: f64 = errors.iter().map(|e| e * e).sum();
        let mean = errors.iter().sum::<f64>() / n;
        let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n;
        let mut halves = errors.to_vec();
        let (below, middle, _) = halves.select_nth_unstable_by(count / 2, f64::total_cmp);
        let median = match count % 2 {
            1 => *middle,
            _ => 0.5 * (below.iter().copied().max_by(f64::total_cmp)? + *middle),
        };
        Some(Self {
            count,
            rmse: (sse / n).sqrt(),
            mean,
            median,
            std: variance.sqrt(),
            min,
            max,
            sse,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_four_numbers() {
        let s = Statistics::of(&[4.0, 1.0, 2.0, 3.0]).expect("four errors");
        assert_eq!(
            (s.count, s.mean, s.median, s.min, s.max, s.sse),
            (4, 2.5, 2.5, 1.0, 4.0, 30.0)
        );
        assert_eq!((s.rmse, s.std), (7.5f64.sqrt(), 1.25f64.sqrt()));
        assert_eq!(Statistics::of(&[7.0]).map(|s| s.median), Some(7.0));
        assert!(Statistics::of(&[]).is_none());
    }
}
