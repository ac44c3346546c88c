//! The shortest delay below a few hundred, of which the nearest ones tell how far below the least of them it may be.
//!
//! Delays are taken for a Poisson process whose density grows with some power of the height above the shortest (as
//! [`crate::clock`] takes arrivals), of which the lowest quarter is looked at: those that queued say nothing.

/// Share of the delays that is looked at, and the least number of them.
const SHARE: f64 = 0.25;
const FEWEST: usize = 8;
/// The number of delays grows like height^power: 1 where they are spread evenly from the shortest on, more behind several queues.
const POWERS: [f64; 3] = [1.0, 1.5, 2.0];
/// How likely each is beforehand.
const PRIOR: [f64; 3] = [0.9, 0.05, 0.05];
/// Steps of the integration, and how far down it goes as a share of the layer that is looked at.
const STEPS: u32 = 200;
const DEPTH_SHARE: f64 = 1.5;
/// Nothing is known better than stamps tell it, nanoseconds.
const LEAST_SIGMA_NS: f64 = 500.0;

/// A shortest delay, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Floor {
    pub(super) delay_ns: f64,
    pub(super) sigma_ns: f64,
}

/// The shortest delay that there may have been; `None` of too few.
pub(super) fn floor(mut delays_ns: Vec<f64>) -> Option<Floor> {
    delays_ns.sort_by(f64::total_cmp);
    let count = ((delays_ns.len() as f64 * SHARE) as usize).max(FEWEST);
    delays_ns.truncate(count);
    let (least_ns, top_ns) = (*delays_ns.first()?, *delays_ns.last()?);
    let layer_ns = top_ns - least_ns;
    if delays_ns.len() < 2 || !layer_ns.is_finite() {
        return None;
    }
    if layer_ns <= LEAST_SIGMA_NS {
        return Some(Floor {
            delay_ns: least_ns,
            sigma_ns: LEAST_SIGMA_NS,
        });
    }
    // Finer near the least delay, where most of the probability is: `below` grows like step².
    let share = |step: u32| f64::from(step) / f64::from(STEPS);
    let below_ns = |step: u32| DEPTH_SHARE * layer_ns * share(step).powi(2);
    let logs: Vec<[f64; 3]> = (1..=STEPS)
        .map(|step| log_likelihoods(&delays_ns, least_ns - below_ns(step)))
        .collect();
    let best = logs.iter().flatten().copied().fold(f64::MIN, f64::max);
    let (mut total, mut mean, mut square) = (0.0, 0.0, 0.0);
    for (step, logs) in (1..=STEPS).zip(logs) {
        for (log, prior) in logs.into_iter().zip(PRIOR) {
            let weight = prior * (log - best).exp() * share(step);
            total += weight;
            mean += weight * below_ns(step);
            square += weight * below_ns(step).powi(2);
        }
    }
    let mean = mean / total;
    let variance = (square / total - mean * mean).max(0.0);
    Some(Floor {
        delay_ns: least_ns - mean,
        sigma_ns: variance.sqrt().max(LEAST_SIGMA_NS),
    })
}

/// How well delays fit a shortest one, for each power.
fn log_likelihoods(delays_ns: &[f64], shortest_ns: f64) -> [f64; 3] {
    let top_ns = delays_ns.last().map_or(0.0, |top| top - shortest_ns);
    let count = delays_ns.len() as f64;
    let heights = delays_ns.iter().map(|delay| delay - shortest_ns);
    let logs: f64 = heights.map(|height| (top_ns / height).ln()).sum();
    POWERS.map(|power| count * (power.ln() - top_ns.ln()) - (power - 1.0) * logs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_floor_is_below_the_least_delay_and_few_or_equal_ones_are_no_fault() {
        let even: Vec<f64> = (1..=100).map(|n| 5e6 + f64::from(n) * 1e4).collect();
        let found = floor(even).expect("a floor");
        assert!((found.delay_ns - 5e6).abs() < 1.5e4, "{found:?}");
        assert!((5e3..3e4).contains(&found.sigma_ns), "{found:?}");
        assert_eq!(floor(vec![5.0; 9]).map(|f| f.delay_ns), Some(5.0));
        assert_eq!(floor(vec![5.0]), None);
        assert_eq!(floor(Vec::new()), None);
        assert_eq!(floor(vec![0.0, f64::INFINITY]), None);
    }
}
