//! How long messages waited: counts on a logarithmic scale, so that a session of any length takes no memory.

use std::time::Duration;

/// Buckets per doubling: a quantile is right within 9 %.
const PER_OCTAVE: f64 = 8.0;
/// From 1 µs to beyond an hour.
const BUCKETS: usize = 256;

/// Waiting times, counted.
#[derive(Clone, Debug)]
pub struct Latencies {
    counts: [u64; BUCKETS],
    total: u64,
    longest: Duration,
}

impl Default for Latencies {
    fn default() -> Self {
        Self {
            counts: [0; BUCKETS],
            total: 0,
            longest: Duration::ZERO,
        }
    }
}

impl Latencies {
    /// Counts one.
    pub fn add(&mut self, latency: Duration) {
        let micros = latency.as_secs_f64() * 1e6;
        // A float cast saturates: whatever is shorter than 1 µs is in the first bucket.
        let bucket = (micros.max(1.0).log2() * PER_OCTAVE) as usize;
        if let Some(count) = self.counts.get_mut(bucket.min(BUCKETS - 1)) {
            *count += 1;
        }
        self.total += 1;
        self.longest = self.longest.max(latency);
    }

    /// The time that `share` of them did not exceed, milliseconds: the upper edge of its bucket; 0 without any.
    pub fn quantile_ms(&self, share: f64) -> f64 {
        let wanted = (self.total as f64 * share).ceil() as u64;
        let mut seen = 0;
        for (bucket, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= wanted && *count > 0 {
                let edge_ms = ((bucket + 1) as f64 / PER_OCTAVE).exp2() / 1e3;
                return edge_ms.min(self.longest_ms());
            }
        }
        0.0
    }

    /// The longest, milliseconds.
    pub fn longest_ms(&self) -> f64 {
        self.longest.as_secs_f64() * 1e3
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_upper_limits_within_a_tenth() {
        let mut latencies = Latencies::default();
        assert_eq!(latencies.quantile_ms(0.99), 0.0);
        (1..=1000).for_each(|n| latencies.add(Duration::from_micros(n * 100)));
        let p99 = latencies.quantile_ms(0.99);
        assert!((99.0..109.0).contains(&p99), "{p99}");
        let median = latencies.quantile_ms(0.5);
        assert!((50.0..55.0).contains(&median), "{median}");
        assert_eq!(latencies.longest_ms(), 100.0);
    }
}
