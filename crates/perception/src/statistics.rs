//! Numbers of many numbers.

pub use lsfb_types::{median, quantile};

/// Where scores that were taken a step apart are largest: the best of them and, where it has neighbours, the top of the parabola
/// through all three, in steps from the first. `None` without scores.
pub fn peak(scores: &[f64]) -> Option<f64> {
    let best = (0..scores.len()).max_by(|a, b| scores[*a].total_cmp(&scores[*b]))?;
    let beside = best.checked_sub(1).and_then(|k| scores.get(k..=best + 1));
    let off = match beside {
        Some([l, m, r]) if l + r - 2.0 * m < 0.0 => 0.5 * (l - r) / (l + r - 2.0 * m),
        _ => 0.0,
    };
    Some(best as f64 + off.clamp(-0.5, 0.5))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_of_a_parabola_is_between_its_samples() {
        let scores: Vec<f64> = (0..9).map(|k| -(f64::from(k) - 3.3).powi(2)).collect();
        assert!((peak(&scores).expect("scores") - 3.3).abs() < 1e-12);
        assert_eq!(peak(&[3.0, 2.0, 1.0]), Some(0.0), "at the end");
        assert_eq!(peak(&[1.0, 1.0, 1.0]), Some(2.0), "flat");
        assert_eq!(peak(&[]), None);
    }
}
